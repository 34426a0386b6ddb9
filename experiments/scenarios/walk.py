"""Walking on command: at a velocity of the body, or by a script, with pushes, with a sphere beside the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from experiments.metrics.declared_motion import WALKING
from experiments.metrics.metric import Metric
from experiments.scenarios.passing_sphere import BESIDE, sphere_beside
from experiments.scenarios.pushes import Push, parse_pushes
from experiments.scenarios.scenario import Scenario, Setup
from experiments.scenarios.world import Sensor, WorldObject
from robots.checks import require_one_of
from robots.errors import ConfigError

if TYPE_CHECKING:
    from robots.description import RobotDescription
    from robots.messages import Array


@dataclass(frozen=True)
class Walk(Scenario):
    """Walk at a commanded velocity of the body, or by a script of commands.

    The robot stands for the first second, and is told to stop 3 s before the end.
    Without a script and with --vx 0 --vy 0 --wz 0 it steps on the spot.
    """

    name: ClassVar[str] = "walk"
    metrics: ClassVar[tuple[Metric, ...]] = WALKING

    duration: float = 20.0
    """Simulated time, above 4 s [s]."""
    vx: float = 0.2
    """Velocity forward [m/s]."""
    vy: float = 0.0
    """Velocity to the left [m/s]."""
    wz: float = 0.0
    """Turning to the left [rad/s]."""
    script: Path | None = None
    """File of commands, one a line: time [s], vx [m/s], vy [m/s], wz [rad/s]; or time and the word stop, or step (on
    the spot). Each holds until the next; # begins a comment. Takes the place of --vx --vy --wz."""
    hands: bool = False
    """Hold the hands in front of the body, as tasks; otherwise the arms keep their posture."""
    load_estimate: bool = True
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""
    push: tuple[str, ...] = ()
    """Pushes of 0.1 s at the torso: N,direction,time, with forward, left, backward, right or degrees from the world's
    x axis; for example 80,left,5."""
    obstacle: str = "none"
    """A sphere of 8 cm radius to the left of the way at the height of the left hand, 4 cm into where the hand goes:
    none, static, or moving (towards the robot at 0.25 m/s); only on a straight walk forward."""

    def setup(self, robot: RobotDescription) -> Setup:
        """A gait at the commands that options ask for: see :meth:`Scenario.setup`."""
        from experiments.scenarios.walk_plan import (
            FIRST,
            LAST,
            check_obstacle,
            command_profile,
            walk_posture,
            walk_setup,
        )

        robot.posture(walk_posture(self.hands))
        parse_pushes(self.push, self.duration)
        shortest = FIRST + LAST
        if self.duration <= shortest:
            allowed = (
                f"above {shortest:g} s: the robot stands for {FIRST:g} s first and stops {LAST:g} s before the end"
            )
            raise ConfigError("duration", self.duration, allowed)
        command = command_profile(self, robot)
        require_one_of("obstacle", self.obstacle, ("none", *BESIDE))
        if self.obstacle != "none":
            check_obstacle(self, robot)
        return walk_setup(robot, command, self.load_estimate, self.hands)

    def all_pushes(self, robot: RobotDescription) -> tuple[Push, ...]:
        """Those of ``push`` and of ``pushes``."""
        return (*self.pushes, *parse_pushes(self.push, self.duration))

    def objects(self, robot: RobotDescription) -> tuple[WorldObject, ...]:
        """The sphere beside the way, if it was asked for: see :meth:`Scenario.objects`."""
        from experiments.scenarios.walk_plan import meeting

        if self.obstacle == "none":
            return self.world
        return (*self.world, sphere_beside(robot, meeting(self, robot), Sensor()))

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """Steps, and how well the commands were followed: see :meth:`Scenario.measure`."""
        from experiments.metrics.locomotion import walk_metrics

        return walk_metrics(series, series["command"])
