"""Deployments without a network or a clock: a robot in memory, whose joints are where they are told to be."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from controllers.deployment.deployment import SEEN
from controllers.deployment.heartbeat import Heartbeat
from controllers.deployment.loop import DeploymentLoop
from controllers.deployment.ring import Kind, Record, RingLog, read_head, read_log
from controllers.deployment.stages import Stage
from experiments.running.deployment_tasks import build
from robots.loader import load_robot
from robots.messages import SensorReading
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import Remote, write_remote

ROBOT = load_robot("g1")
JOINTS = G1Joints(ROBOT)
AMPLE = 40_000_000
"""Of a log that holds all of them [bytes]."""


class MemoryRobot:
    """Plays robot, network, guardian and clock: a state each 2 ms, joints where stiff motors were last sent."""

    def __init__(self, heart: Heartbeat, seed: int = 0) -> None:
        self.now, self._heart, self._rng = 100.0, heart, np.random.default_rng(seed)
        self._q = ROBOT.posture("standing").joints + 0.05
        self._state, self._command, self._tick = StateMessage(), CommandMessage(), 0
        self.sent = 0

    def clock(self) -> float:
        return self.now

    def receive(self, until: float) -> list[tuple[bytes, float]]:
        self.now = 100.0 + 0.002 * (self._tick // 2 + 1) + self._rng.uniform(0.0, 2e-4)
        self._heart.mark("guarded", self.now)
        self._tick += 2
        noise, zero = self._rng.normal(0.0, 1e-3, (2, 3)), np.zeros(29)
        reading = SensorReading(self._q, zero, zero + 0.5, noise[0], noise[1] + [0.0, 0.0, 9.81], 0.0)
        JOINTS.write_state(reading, np.array([0.0, 0.0, 0.0, 1.0]), self._state, self._tick)
        write_remote(self._state.remote, Remote(frozenset(), (0.0, 0.0), (0.0, 0.0), True))
        return [(self._state.sealed(), self.now)]

    def send(self, command: bytes) -> None:
        self.sent += 1
        assert self._command.read(command)
        told = JOINTS.read_command(self._command, 0.0)
        self._q = np.where(told.kp > 0.0, told.q, self._q)
        self.now += 3e-4

    def strangers(self) -> int:
        return 0

    def battery(self) -> float:
        return 90.0


class Script:
    """A person who says go wherever they are asked, and ends a stage after a while."""

    def __init__(self, last: Stage) -> None:
        self._last = last

    def wishes(self, stage: Stage, asks: bool, since: float) -> tuple[bool, bool, bool]:
        ends = stage is self._last and since > 0.12
        return asks and stage is not self._last and since > SEEN, ends, False


def deployed(folder: Path, task: object, last: Stage, dry: bool = False, size: int = AMPLE) -> Path:
    """A deployment from its first stage to damping, which it goes to from the stage ``last``; returns its log."""
    folder.mkdir(parents=True, exist_ok=True)
    built = build(task)
    head = {"task": built.scenario, "options": {"dry_run": dry}, "robot": "g1"}
    log, heart = RingLog(folder / "log.bin", size, head), Heartbeat(folder / "heartbeat", create=True)
    robot = MemoryRobot(heart)
    deployment = built.deployment(lambda text: log.write(Kind.EVENT, robot.now, text.encode()))
    if dry:
        deployment.begin_dry()
    log.write(Kind.EVENT, robot.now, deployment.stage.value.encode())
    DeploymentLoop(deployment, robot, heart, log, Script(last), not dry, robot.clock).run()
    log.close()
    (folder / "deployment.json").write_text("{}\n")
    assert robot.sent == 0 if dry else robot.sent > 1000
    return folder / "log.bin"


def rewritten(log: Path, copy: Path, change: Callable[[Record], bytes]) -> Path:
    """A copy of a log in which the bytes of every record are what ``change`` makes of it."""
    written = RingLog(copy, AMPLE, read_head(log))
    for record in read_log(log):
        written.write(record.kind, record.time, change(record))
    written.close()
    return copy
