"""What the estimated velocity of an obstacle is worth to the safety filter: one crosses where the hands are."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from controllers.obstacle_tracker import ObstacleTracker, TrackingSettings
from controllers.perception import Detection
from controllers.policies.kinematic_agent import KinematicAgent, KinematicOutput
from controllers.whole_body.robot_config import controller_config
from experiments.metrics.metric import Metric
from experiments.running.loop import ClosedLoop, Observer
from experiments.scenarios.passing_sphere import AHEAD, DISTANCE, RADIUS
from robots.checks import require_one_of
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import upper_body_joints
from safety.barriers.barrier_set import ObstacleBarrier, standard_barriers
from safety.filters.safety_filter import SafetyFilter
from safety.geometry.shapes import Obstacle
from safety.tracking import TrackerSettings
from sims.kinematic import KinematicPlant
from sims.obstacles import PositionSensor, StraightMotion

TICK = 0.002
"""Control period [s]."""

NOISE = 0.005
"""Standard deviation of each measured coordinate [m]."""

SPEEDS = (0.25, 0.5, 1.0)
"""Speeds of the crossing obstacle [m/s]."""

PASSED = 0.5
"""How far beyond the left hand the crossing obstacle is followed [m]: past the right one."""

RETURN = 2.0
"""Rate at which the nominal velocity of the closed loop returns to the posture [1/s]."""

KNOWLEDGE = ("zero", "estimated", "estimated + 3 sigma", "true")
"""What the filter is told of the obstacle's velocity; 3 sigma: it is also taken as larger by three standard deviations
of its estimated position."""

CROSSING = (
    Metric("filter", "filter"),
    Metric("speed", "speed", "m/s"),
    Metric("velocity", "velocity told"),
    Metric("clearance_mean_m", "smallest distance, mean", "mm", 1e3),
    Metric("clearance_worst_m", "worst", "mm", 1e3),
    Metric("acceleration_rms", "joint acceleration", "rad/s^2"),
)


class Crossing:
    """An obstacle that crosses where the G1's hands are; the upper body follows the filtered velocity exactly.

    Args:
        name: of the filter.
        speed: of the obstacle, above 0 [m/s].
        velocity: what the filter is told of the obstacle's velocity, one of ``KNOWLEDGE``. Where the obstacle is comes
            from the track in every case.
        seed: of the sensor's noise.
        settings: of the track.

    Raises:
        ConfigError: no such filter or knowledge.
    """

    def __init__(
        self, name: str, speed: float, velocity: str, seed: int, settings: TrackerSettings | None = None
    ) -> None:
        require_one_of("velocity", velocity, KNOWLEDGE)
        robot = load_robot("g1")
        self._kin = Kinematics(robot, base="fixed", joints=upper_body_joints(robot), posture="hands_front")
        self._home = self._kin.posture("hands_front")
        self._kin.update_geometry(self._home)
        hand = self._kin.frame_placement(self._kin.frame_id(robot.roles["left_hand"]))[1]
        self._sphere = StraightMotion(hand + np.array([AHEAD, DISTANCE, 0.0]), np.array([0.0, -speed, 0.0]))
        self._duration = (DISTANCE + PASSED) / speed
        self._sensor = PositionSensor(60.0, NOISE, np.random.default_rng([seed, 3]))
        told = {"zero": "zero", "true": "measured"}.get(velocity, "estimated")
        kappa = 3.0 if velocity.endswith("sigma") else 0.0
        track = settings or TrackerSettings(position_noise=NOISE)
        self._tracker = ObstacleTracker(TrackingSettings(track, kappa, told))
        self._barriers = standard_barriers(self._kin, ("sphere",))
        self._obstacles = next(b for b in self._barriers.barriers if isinstance(b, ObstacleBarrier))
        tuning = controller_config(robot, filter=name).safety
        v_max = tuning.velocity_scale * self._kin.joint_array("velocity")
        self._filter = SafetyFilter(name, self._barriers.size, tuning.parameters(), v_max)

    def run(self) -> tuple[float, float]:
        """Smallest true distance of the obstacle [m], and the RMS length of the joints' acceleration [rad/s^2]."""
        agent = KinematicAgent(self._kin, self, self._barriers, self._filter, TICK, self)
        trace = _Trace(self)
        ClosedLoop(KinematicPlant(self._kin, self._home), agent, observers=[trace]).run(self._duration)
        return trace.smallest, float(np.sqrt(trace.squared / trace.ticks))

    def velocity(self, kin: Kinematics) -> Array:
        """Back to the posture; see :class:`controllers.policies.kinematic_agent.Policy`."""
        return RETURN * (self._home - kin.q)

    def move_goals(self, t: float) -> None:
        """The posture stays; see :class:`controllers.policies.kinematic_agent.Surroundings`."""

    def true_distance(self, t: float) -> float:
        """Of the obstacle to the robot where its kinematics are, at ``t`` [s]; below 0 inside [m]."""
        self._obstacles.set_obstacles([Obstacle.sphere(self._sphere.position(t), RADIUS)])
        return float(self._barriers.evaluate(self._kin).h[self._barriers.slices["obstacle"]].min())

    def obstacles(self, t: float) -> list[Obstacle]:
        """As the track has it; see :class:`controllers.policies.kinematic_agent.Surroundings`."""
        place, velocity = self._sphere.position(t), self._sphere.velocity(t)
        measured = self._sensor.measure(place, t)
        seen = measured is not None
        shape = Obstacle.sphere(place if measured is None else measured, RADIUS, velocity)
        self._tracker.observe(Detection("sphere", t, shape, seen))
        return list(self._tracker.obstacles(t).values())


class _Trace(Observer):
    """Keeps what :meth:`Crossing.run` is after."""

    def __init__(self, crossing: Crossing) -> None:
        self._crossing = crossing
        self.smallest, self.squared, self.ticks = np.inf, 0.0, 0
        self._last: Array | None = None

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: KinematicOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        v = output.command
        change = v if self._last is None else v - self._last
        self._last = v
        self.squared += float(np.sum(change**2)) / TICK**2
        self.smallest = min(self.smallest, self._crossing.true_distance(state.stamp))
        self.ticks += 1


def crossing_study(
    seeds: Sequence[int], speeds: Sequence[float] = SPEEDS, filters: Sequence[str] = ("cbf", "issf")
) -> list[dict[str, Any]]:
    """What the filter makes of an obstacle whose velocity it is not told, told by the track, or told truly.

    Returns:
        A row per filter, speed and knowledge: smallest true distance over time, its mean over seeds and the worst [m],
        and the mean over seeds of the joints' RMS acceleration [rad/s^2].
    """
    rows = []
    for name in filters:
        for speed in speeds:
            for velocity in KNOWLEDGE:
                runs = np.array([Crossing(name, speed, velocity, seed).run() for seed in seeds])
                figures = {
                    "clearance_mean_m": float(runs[:, 0].mean()),
                    "clearance_worst_m": float(runs[:, 0].min()),
                    "acceleration_rms": float(runs[:, 1].mean()),
                }
                rows.append({"filter": name, "speed": speed, "velocity": velocity} | figures)
    return rows
