"""A G1 that is played: a plant behind a board, on a hoist, with its sensors, its service and its faults."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import MotorCommand
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage
from sims.plant import MujocoPlant, PlantConfig
from sims.sensors import SensorErrors
from sims.twin.board import Board
from sims.twin.defects import Defects
from sims.twin.hoist import Hoist, holding_torque
from sims.twin.instruments import Instruments
from sims.twin.link import Link
from sims.twin.orders import Order, read_order
from sims.twin.ports import Ports, Switcher
from sims.twin.record import Record
from sims.twin.service import OwnService, written
from sims.twin.stream_faults import StreamFaults

STEP = 0.001
"""One step of the physics [s]."""

STATE_STEPS, SERVED_STEPS, OWN_STEPS, BATTERY_STEPS = 2, 10, 20, 1000
"""Steps from state to state, from look to look at the switcher's requests, from one command of the robot's own service
to the next, and from battery to battery."""


@dataclass(frozen=True, slots=True)
class TwinConfig:
    """How the played robot is.

    Attributes:
        plant: mismatch of the robot; its step must be 1 ms.
        errors: of its sensors.
        motor_timeout: after which motors without a command time out [s].
        on_timeout: what they do then, ``hold`` or ``damp``.
        seed: of errors, noise and losses.

    Raises:
        ConfigError: the plant's step is another one.
    """

    plant: PlantConfig = field(default_factory=PlantConfig)
    errors: SensorErrors = field(default_factory=SensorErrors)
    motor_timeout: float = 0.1
    on_timeout: str = "hold"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.plant.dt != STEP:
            raise ConfigError("dt", self.plant.dt, f"{STEP:g} s, the step of a twin")


class Twin:
    """Plays the robot, a millisecond each time it is told so; it neither waits nor prints.

    It begins hanging at rest in its posture ``standing``, moved by its own service.

    Args:
        robot: a G1.
        config: how it is.
        ports: to the world.
        switcher: the robot's motion switcher.
        script: orders with their times [s], in the order of time.
        record: that every state is added to.
        tell: is told what happens, a line each.

    Attributes:
        plant: the robot itself.
        board: its motors' commands.
        hoist: that it hangs from.
        events: times [s] and texts of what has happened.
        ended: whether it was told to end.

    Raises:
        ConfigError: the robot has other joints than a G1, or a setting is not allowed.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: TwinConfig,
        ports: Ports,
        switcher: Switcher,
        script: Sequence[tuple[float, Order]] = (),
        record: Record | None = None,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        rngs = [np.random.default_rng([config.seed, i]) for i in range(3)]
        self._ports, self._switcher, self._record, self._tell = ports, switcher, record, tell
        joints = self._joints = G1Joints(robot)
        self.plant = MujocoPlant(robot, config.plant)
        self.board = Board(joints, config.motor_timeout, config.on_timeout)
        self.hoist = Hoist(self.plant)
        self.defects, self._stream = Defects(), StreamFaults()
        self._out: Link[tuple[Callable[[bytes], None], bytes]] = Link(rngs[1])
        self._in: Link[bytes] = Link(rngs[2])
        self._instruments = Instruments(self.plant, joints, config.errors, self.defects, rngs[0])
        torque = holding_torque(self.plant, self.hoist.step(0.0))
        self._own = OwnService(joints, self.plant.data.qpos[7:].copy(), torque)
        self._torso = int(self.plant.data.body(robot.frame(robot.roles["torso"]).body).id)
        self._script, self._selected, self._steps = list(script), switcher.selected, 0
        self._given: MotorCommand | None = None
        self._foreign, self._foreign_message = False, CommandMessage()
        self._timed_out = False
        self.events: list[tuple[float, str]] = []
        self.ended = False
        if switcher.name:
            self.board.service = self._own.command

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.plant.time

    def say(self, text: str) -> None:
        """Tell what happens now, and remember it."""
        self.events.append((self.time, text))
        self._tell(f"[{self.time:9.3f}] {text}")

    def obey(self, line: str) -> Order | None:
        """Carry out the order of a line; one that is not allowed is told of, and has no effect."""
        try:
            order = read_order(line)
        except ConfigError as error:
            self.say(f"refused: {error}")
            return None
        self.carry_out(order)
        return order

    def carry_out(self, order: Order) -> None:
        """Carry out an order."""
        self.say(order.text)
        parts = (self.defects, self._stream, self._out, self._in)
        if order.verb == "lower":
            self.hoist.lower()
        elif order.verb == "raise":
            self.hoist.lift()
        elif order.verb == "end":
            self.ended = True
        elif order.verb == "clear":
            for part in parts:
                part.clear(order.cleared)
        elif order.fault is not None:
            for part in parts:
                if order.fault.name in part.names:
                    part.begin(order.fault, self.time)

    def step(self, now: float) -> None:
        """Play a millisecond; ``now``: time of the clock by which the commands' age is told [s]."""
        t = self.time
        while self._script and self._script[0][0] <= t + 1e-9:
            self.carry_out(self._script.pop(0)[1])
        self.defects.advance(t)
        self.board.mode_machine = self.defects.mode_machine
        if self._steps % SERVED_STEPS == 0:
            self._serve()
        self._send_commands()
        for data in self._ports.commands():
            self._in.send(data, t)
        for data in self._in.due(t):
            self.board.take(data, now)
        self._move(now)
        self._steps += 1
        if self._steps % STATE_STEPS == 0:
            self._publish(now)
        for send, data in self._out.due(self.time):
            send(data)

    def _serve(self) -> None:
        """Answer requests to the switcher, and let its service go or come."""
        switcher, board = self._switcher, self.board
        switcher.refuses = self.defects.switcher_refuses
        switcher.serve()
        if switcher.selected != self._selected:
            self._selected = switcher.selected
            self._own.begin_again()
            board.release()
            self.say(f"selected {switcher.name}")
        if switcher.name:
            board.service = self._own.command
        elif board.service is not None:
            board.release()
            self._ports.send_own_command(None)
            self.say("released")

    def _send_commands(self) -> None:
        """Commands of the robot's own service, and of somebody else."""
        if self.board.service is not None and self._steps % OWN_STEPS == 0:
            self._ports.send_own_command(self._own.message(self.defects.mode_machine))
        if self._steps % STATE_STEPS:
            return
        foreign = self.defects.foreign
        if foreign:
            zero = np.zeros(len(self._joints.robot.joints))
            nothing = MotorCommand(zero, zero, zero, zero, zero, 0.0)
            data = written(self._joints, nothing, self._foreign_message, self.defects.mode_machine)
            self._ports.send_foreign_command(data)
        elif self._foreign:
            self._ports.send_foreign_command(None)
        self._foreign = foreign

    def _move(self, now: float) -> None:
        """One step of the physics under the motors' command, the rope and the pushes."""
        plant, timed_out = self.plant, self.board.timed_out(now)
        if timed_out != self._timed_out:
            self._timed_out = timed_out
            self.say(f"motors timed out: they {self.board.reaction}" if timed_out else "motors are commanded again")
        command = self.board.command(now)
        wrong = self.defects.encoder
        if command is not self._given or wrong.any():
            self._given = command
            # the drive reads the encoder that is wrong, and has no other
            plant.send(replace(command, q=command.q - wrong[self._joints.slots]) if wrong.any() else command)
        wrench = self.hoist.step(STEP)
        wrench[:3] += self.defects.push
        plant.data.xfrc_applied[self._torso] = wrench
        plant.step()

    def _publish(self, now: float) -> None:
        """Send what is measured, and record what is true."""
        t, ports, instruments = self.time, self._ports, self._instruments
        for data in self._stream.passed(instruments.state(self._timed_out), t):
            self._out.send((ports.send_state, data), t)
        self._out.send((ports.send_torso_imu, instruments.torso_imu()), t)
        if self._steps % BATTERY_STEPS == 0:
            self._out.send((ports.send_battery, instruments.battery()), t)
        if self._record is not None:
            self._add(self._record, now)

    def _add(self, record: Record, now: float) -> None:
        """One row of the record."""
        state, command = self.plant.true_state(), self.board.command(now)
        kp, tau = float(command.kp.max()), float(np.abs(command.tau).max())
        record.add(
            monotonic=now,
            time=state.stamp,
            q=state.q,
            v=state.v,
            torque=state.tau,
            foot_wrench=self.plant.contact_wrenches(),
            rope_tension=self.hoist.tension,
            lowcmd_age=self.board.age(now),
            applied_kp_max=kp,
            applied_tau_max=tau,
            damped=bool(kp == 0.0 and tau == 0.0 and command.kd.max() > 0.0),
        )
