"""One tick of the stack: state in, motor command out."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.reference import WholeBodyReference
from controllers.whole_body.config import ControllerConfig, FilterTuning, TaskTuning
from controllers.whole_body.dynamics import DynamicLevel
from controllers.whole_body.mass_estimator import MassEstimator
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.safety_level import SafetyLevel
from controllers.whole_body.task_stack import PlacedTask, TaskStack
from controllers.whole_body.warm_up import situations
from controllers.whole_body.whole_body_tasks import WholeBodyTasks
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, MotorCommand, RobotState
from safety.barriers.barrier_set import Barrier, BarrierSet
from safety.filters.results import FilterResult
from safety.filters.safety_filter import SafetyFilter
from safety.geometry.shapes import Obstacle
from wbc.dynwbc import DynWbc, DynWbcResult, DynWbcWeights
from wbc.kinwbc import KinWbc

STAGES = ("kinematics", "tasks", "kinwbc", "rows", "safety_qp", "dynamics", "dynwbc")
"""Stages of a tick, in order; ``dynamics`` is the assembly of DynWBC's problem, ``dynwbc`` its solution."""


@dataclass(frozen=True, slots=True)
class TickResult:
    """What one tick decided.

    Attributes:
        command: for the motors.
        v_des: shape (nv,) velocity of KinWBC.
        safety: result of the safety filter.
        dynwbc: result of DynWBC.
        stage_seconds: shape (len(STAGES),) time spent in each stage [s].
    """

    command: MotorCommand
    v_des: Array
    safety: FilterResult
    dynwbc: DynWbcResult
    stage_seconds: Array


class WholeBodyController:
    """KinWBC, safety filter and DynWBC for one robot, on its nominal model.

    What is set between two ticks (filter, parameters, gains) takes force in the next one: checked as when the
    controller is made, and with nothing changed where it is refused. Nothing can be set in another way.

    Args:
        robot: the description.
        config: settings.
        with_hands: whether the hands are tasks (then every reference must give them).
        obstacle_kinds: kind of each obstacle that every tick is given (see :mod:`safety.geometry.shapes`).
        clock: monotonic seconds, for the stage times.
        extra_barriers: makes further barriers from the controller's kinematics. An
            :class:`safety.barriers.barrier_set.ObstacleBarrier` among them, of chosen bodies say, is told the obstacles
            of every tick where ``obstacle_kinds`` are none.
        extra_tasks: makes further tasks, with a priority and a role among those of the whole body, from the
            controller's kinematics. Their targets are set by hand (:attr:`tasks`) or by the references' ``extra``.

    Raises:
        ConfigError: a setting is not allowed.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: ControllerConfig,
        with_hands: bool,
        obstacle_kinds: Sequence[str] = (),
        clock: Callable[[], float] = time.perf_counter,
        extra_barriers: Callable[[Kinematics], Sequence[Barrier]] | None = None,
        extra_tasks: Callable[[Kinematics], Sequence[PlacedTask]] | None = None,
    ) -> None:
        self._config, self._clock = config, clock
        self._kinds, self._extra_barriers, self._extra_tasks = tuple(obstacle_kinds), extra_barriers, extra_tasks
        self._kin = Kinematics(robot)
        self._dynamics = DynamicLevel(self._kin, config)
        own = () if extra_tasks is None else extra_tasks(self._kin)
        self._tasks = WholeBodyTasks(self._kin, config, with_hands, self._dynamics.half_sizes, own)
        self._safety = SafetyLevel(self._kin, config, self._dynamics.dynwbc, self._kinds, extra_barriers)
        self._kinematics_time = 0.0
        self._kp, self._kd = _motor_gains(robot, config.gain_scale)

    @property
    def robot(self) -> RobotDescription:
        """The description."""
        return self._kin.robot

    @property
    def config(self) -> ControllerConfig:
        """Settings as they are now."""
        return self._config

    @property
    def kin(self) -> Kinematics:
        """Kinematics of the state of the last tick."""
        return self._kin

    @property
    def barriers(self) -> BarrierSet:
        """What is kept."""
        return self._safety.barriers

    @property
    def with_hands(self) -> bool:
        """Whether the hands are tasks."""
        return self._tasks.with_hands

    @property
    def kinwbc(self) -> KinWbc:
        """The kinematic level."""
        return self._tasks.stack.kinwbc

    @property
    def tasks(self) -> TaskStack:
        """The tasks by name: ``left_sole``, ``com``, ``torso``, ``left_hand``, ... and further ones.

        Targets are set here for further tasks only: every tick sets those of the standard ones from its reference.
        """
        return self._tasks.stack

    @property
    def dynwbc(self) -> DynWbc:
        """The dynamic level."""
        return self._dynamics.dynwbc

    @property
    def load(self) -> MassEstimator | None:
        """How heavy the robot really is; ``None`` where the model's mass is taken."""
        return self._dynamics.load

    @property
    def filter(self) -> SafetyFilter | None:
        """The filter of velocities; ``None`` where the conditions are DynWBC's."""
        return self._safety.filter

    def _warm_up(self, config: ControllerConfig) -> None:
        """Tick a twin with these settings through all situations, and throw it away."""
        twin = WholeBodyController(
            self.robot,
            config,
            self.with_hands,
            self._kinds,
            extra_barriers=self._extra_barriers,
            extra_tasks=self._tasks_with_target,
        )
        for state, reference, obstacles in situations(twin.kin, self.with_hands, twin._safety.obstacle_kinds):
            twin.tick(state, reference, obstacles)

    def _tasks_with_target(self, kin: Kinematics) -> list[PlacedTask]:
        """Further tasks as they are made, for a twin: nobody sets targets there."""
        made = () if self._extra_tasks is None else self._extra_tasks(kin)
        return [placed for placed in made if placed.task.is_set]

    def warm_up(self) -> None:
        """Have everything ready that the first tick would wait for: kernels compiled or loaded, libraries started.

        A twin made of the same arguments ticks through the situations of :mod:`controllers.whole_body.warm_up` and is
        thrown away. So this controller stays as it is, whenever this is called, and its answers do not change by a bit;
        only ``extra_barriers`` and ``extra_tasks`` are called once more, and a further task without a target is left
        out. Takes some 0.2 s, where the kernels have to be compiled some 20 s.
        """
        self._warm_up(self._config)
        self._safety.warm()

    def prepare_filter(self, name: str, adaptive: bool = False) -> None:
        """Have another filter ready, so that :meth:`set_filter` keeps no tick waiting; as long as :meth:`warm_up`.

        Raises:
            ConfigError: unknown filter, or one that these settings do not allow.
        """
        config = self._with_filter(name, adaptive, None)
        self._safety.prepare(config)
        self._warm_up(config)

    def set_filter(self, name: str, safety: FilterTuning | None = None, adaptive: bool = False) -> None:
        """Take another safety filter from the next tick on, which goes on from the command of the last one.

        One that is not prepared (:meth:`prepare_filter`), and was not at work before, is made here, which takes some 30
        ms and, for its first tick, what :meth:`warm_up` spares.

        Args:
            name: of the filter.
            safety: parameters, weights and bounds; ``None``: those that the robot's description has for it, or where
                others were set than the description has for the filter at work, these.
            adaptive: whether its epsilon is adapted; with ``issf`` only.

        Raises:
            ConfigError: unknown filter, or one that these settings do not allow; nothing changes.
        """
        config = self._with_filter(name, adaptive, safety)
        self._safety.change(config)
        self._config = config

    def _with_filter(self, name: str, adaptive: bool, safety: FilterTuning | None) -> ControllerConfig:
        """The settings with another filter; parameters of its own belong to one filter only."""
        now = self._config
        if safety is None and name != now.filter:
            # what the description tuned for the filter at work need not be safe with another one
            as_described = now.safety == controller_config(self.robot, filter=now.filter).safety
            described = controller_config(self.robot, filter=name).safety
            safety = described if as_described else replace(now.safety, own=described.own)
        return replace(now, filter=name, adaptive=adaptive, safety=safety or now.safety)

    def set_safety(self, safety: FilterTuning) -> None:
        """Take other parameters (alpha, epsilon, margins, ...), weights and bounds of the filter from the next tick on.

        Raises:
            ConfigError: they have parameters of another filter; nothing changes.
        """
        config = replace(self._config, safety=safety)
        self._safety.change(config)
        self._config = config

    def set_gains(
        self,
        tasks: TaskTuning | None = None,
        dynwbc: DynWbcWeights | None = None,
        dcm_gain: float | None = None,
        gain_scale: float | None = None,
    ) -> None:
        """Take other gains from the next tick on; ``None``: those there are.

        Args:
            tasks: gains, bounds and thresholds of KinWBC's tasks.
            dynwbc: weights and gains of DynWBC.
            dcm_gain: rate at which an error of the DCM decays, above 0 [1/s].
            gain_scale: factor on the motors' gains of the description, 0 or above.

        Raises:
            ConfigError: one is not allowed; nothing changes.
        """
        now = self._config
        self._config = replace(
            now,
            tasks=tasks or now.tasks,
            dynwbc=dynwbc or now.dynwbc,
            balance=now.balance if dcm_gain is None else replace(now.balance, dcm_gain=dcm_gain),
            gain_scale=now.gain_scale if gain_scale is None else gain_scale,
        )
        self._kp, self._kd = _motor_gains(self.robot, self._config.gain_scale)
        self._tasks.set_gains(self._config)
        self.dynwbc.set_weights(self._config.dynwbc)

    def reset(self, state: RobotState) -> None:
        """Start from a state at rest: the torques measured there are the first tau_prev."""
        self._kin.update(state.q, state.v)
        self.kinwbc.reset()
        self.dynwbc.reset(state.tau)
        if self.load is not None:
            self.load.reset()
        self._safety.reset()

    def desired_velocity(self, reference: WholeBodyReference) -> Array:
        """KinWBC alone: velocity (nv,) for a reference at the configuration of ``kin``."""
        if self._tasks.compensates_bias:
            self._kin.update_bias_acceleration()
        self._tasks.set_references(reference)
        return self.kinwbc.solve(self.kinwbc.evaluate(self._kin))

    def tick(self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()) -> TickResult:
        """Compute the motor command for one measured state.

        Args:
            state: measured or estimated.
            reference: what to do now.
            obstacles: of the kinds announced.

        Returns:
            The command and what led to it.

        Raises:
            ValueError: the state is not finite (a supervisor stops before that, see
                :class:`controllers.supervisor.Supervisor`), number or kinds of obstacles are not as announced, the
                reference gives no hands to a controller that has them as tasks, or a further task has no target.
        """
        if not all_finite(state.q, state.v):
            raise ValueError("measured state is not finite")
        self.update(state)
        return self.respond(state, reference, obstacles)

    def update(self, state: RobotState) -> None:
        """Bring ``kin`` up to a measured state, for :meth:`respond` and for whoever moves the references before it."""
        began = self._clock()
        self._kin.update(state.q, state.v)
        if self._tasks.compensates_bias:
            self._kin.update_bias_acceleration()
        self._kinematics_time = self._clock() - began

    def respond(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> TickResult:
        """:meth:`tick` for the state of the last :meth:`update`."""
        kin, kinwbc, strategy = self._kin, self._tasks.stack.kinwbc, self._safety.strategy
        clock, marks = self._clock, np.empty(len(STAGES) + 1)
        marks[1] = clock()
        marks[0] = marks[1] - self._kinematics_time
        self._tasks.set_references(reference)
        levels = kinwbc.evaluate(kin)
        marks[2] = clock()
        v_des = kinwbc.solve(levels)
        marks[3] = clock()
        rows = self._safety.rows(obstacles)
        marks[4] = clock()
        filtered = strategy.filter_velocity(rows, v_des, self._tasks.jacobians(), reference.in_contact, state.v)
        marks[5] = clock()
        conditions = strategy.conditions(rows, state.v)
        problem = self._dynamics.problem(state, reference, filtered.v, conditions)
        marks[6] = clock()
        dynamic = self._dynamics.dynwbc.solve(problem)
        safety = strategy.conclude(filtered, conditions, dynamic, state.v)
        marks[7] = clock()
        self._safety.note(v_des, safety.v)
        command = self._command(state, safety.v, self._dynamics.feed_forward(dynamic, reference.in_contact))
        return TickResult(command, v_des, safety, dynamic, marks[1:] - marks[:-1])

    def _command(self, state: RobotState, v_safe: Array, torque: Array) -> MotorCommand:
        q = state.q[7:] + v_safe[6:] * self._config.dt
        return MotorCommand(q, v_safe[6:].copy(), torque, self._kp, self._kd, state.stamp)


def _motor_gains(robot: RobotDescription, scale: float) -> tuple[Array, Array]:
    """Stiffness and damping of the motors' own feedback; read-only, since every command hands them out."""
    kp, kd = scale * robot.joint_array("kp"), scale * robot.joint_array("kd")
    for gains in (kp, kd):
        gains.setflags(write=False)
    return kp, kd
