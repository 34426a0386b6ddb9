"""Both hands follow references while the robot stands: section 5.2.1 of Lee et al."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from experiments.scenarios.options import refuse_without
from experiments.scenarios.passing_sphere import Passage, passing_sphere
from experiments.scenarios.scenario import Scenario, Setup
from experiments.scenarios.world import Sensor, WorldObject
from robots.checks import require_one_of
from robots.errors import ConfigError

if TYPE_CHECKING:
    from robots.description import RobotDescription

MOTIONS = ("circles", "beyond-reach", "target", "cross", "hold")

SENSOR_OPTIONS = ("obstacle_rate", "obstacle_noise", "obstacle_velocity", "obstacle_kappa", "obstacle_lost_at")


@dataclass(frozen=True)
class HandTracking(Scenario):
    """Both hands follow references while the robot stands: circles through the torso, targets in it or beyond reach."""

    name: ClassVar[str] = "hand-tracking"

    duration: float = 12.0
    """Simulated time [s]."""
    motion: str = "circles"
    """Hand motion: circles (3D circles through the torso), beyond-reach (targets 30 cm out of reach), target (both in
    one jump to --target), cross (each to where the other was) or hold."""
    target: tuple[float, float, float] = (0.0, 0.03, 0.0)
    """Only with --motion target: where the left hand is sent, from the origin of the torso's frame in the world's axes;
    the right one mirrors it [m m m]."""
    obstacle: bool = False
    """A sphere of 8 cm radius passes through where the hands start, from left to right at 0.25 m/s. Best with
    --motion hold: circles and beyond-reach have taken the hands elsewhere when it arrives, after two to three
    seconds."""
    obstacle_rate: float = 60.0
    """Only with --obstacle: how often its position is measured; its velocity comes from a Kalman filter [Hz]."""
    obstacle_noise: float = 0.005
    """Only with --obstacle: standard deviation of each measured coordinate [m]."""
    obstacle_velocity: str = "estimated"
    """Only with --obstacle: what the filter is told of its velocity: estimated, zero or true, to compare."""
    obstacle_kappa: float = 0.0
    """Only with --obstacle: by how many standard deviations of its estimated position it is taken as larger [-]."""
    obstacle_lost_at: float | None = None
    """Only with --obstacle: its sensor loses it at this time, to see the controlled stop [s]."""

    def setup(self, robot: RobotDescription) -> Setup:
        """Hands that move, on a robot that stands: see :meth:`Scenario.setup`."""
        from controllers.motions.hands import circle_settings
        from experiments.scenarios.hand_motions import hand_motion, start_posture

        require_one_of("motion", self.motion, MOTIONS)
        if not all(math.isfinite(x) for x in self.target):
            raise ConfigError("target", self.target, "three finite numbers [m]")
        refuse_without(self, self.motion == "target", ("target",), "--motion target")
        refuse_without(self, self.obstacle, SENSOR_OPTIONS, "--obstacle")
        robot.posture(start_posture(robot))
        if self.motion == "circles":
            circle_settings(robot)
        return Setup(start_posture(robot), hand_motion(self.motion, self.target), reference_motion=True)

    def passage(self) -> Passage:
        """How the sphere passes the hands."""
        return Passage()

    def objects(self, robot: RobotDescription) -> tuple[WorldObject, ...]:
        """The passing sphere, if it was asked for: see :meth:`Scenario.objects`."""
        sensor = Sensor(
            self.obstacle_rate,
            self.obstacle_noise,
            self.obstacle_lost_at,
            self.obstacle_velocity,
            self.obstacle_kappa,
        )
        return (*self.world, *((passing_sphere(robot, self.passage(), sensor),) if self.obstacle else ()))
