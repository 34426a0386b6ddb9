"""The measured state of a robot from its own sensors: IMU in, base, contacts and forces under the feet out."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from controllers.estimation.bias_watch import BiasDoubt, BiasWatch
from controllers.estimation.contact_belief import ContactBelief, ContactCues
from controllers.estimation.invariant_filter import FilterNoise, InvariantFilter
from controllers.estimation.momentum_observer import MomentumObserver
from controllers.estimation.rotations import skew
from controllers.estimation.simple_filter import SimpleFilter
from robots.checks import all_finite, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, Mask, RobotState, SensorReading
from robots.pinocchio_model import standing_configuration
from wbc.wrench import GRAVITY

LONGEST_STEP = 0.02
"""A step of time is cut to this [s]: after a longer gap the past tells little of the present."""

BASE_FILTERS: dict[str, type[InvariantFilter] | type[SimpleFilter]] = {
    "invariant": InvariantFilter,
    "simple": SimpleFilter,
}
"""Filters of the base by name."""

STANDS = 0.5
"""A foot stands from this probability on."""


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """The state estimator.

    Attributes:
        noise: of sensors and soles.
        cues: of the contacts.
        observer_bandwidth: of the forces under the feet, above 0 [1/s].
        level_ground: whether the ground is level, at the height on which the robot stands at the start: soles that
            stand are then on it and level, and the base's height does not drift.
        base: filter of the base, one of ``BASE_FILTERS``.
        bias_doubt: when the gyro's bias is taken to have jumped.
    """

    noise: FilterNoise = field(default_factory=FilterNoise)
    cues: ContactCues = field(default_factory=ContactCues)
    observer_bandwidth: float = 100.0
    level_ground: bool = True
    base: str = "invariant"
    bias_doubt: BiasDoubt = field(default_factory=BiasDoubt)

    def __post_init__(self) -> None:
        require_positive("observer_bandwidth", self.observer_bandwidth)
        require_one_of("base", self.base, tuple(BASE_FILTERS))


class StateEstimator:
    """Estimates the base by an invariant Kalman filter, forces by a momentum observer, contacts by several cues.

    Args:
        robot: the description.
        settings: those of :class:`EstimatorSettings` if not given.
        plan: tells which feet (2,) are to stand now, or ``None``.

    Attributes:
        filter: of the base.
        contact: which feet stand, as probabilities.
        wrenches: shape (2, 6) on the soles, sole axes [N, N m].
        bias_watch: tells a gyro whose bias jumps.
        refused: number of readings that were not taken in: taken in before, older, or not finite.
    """

    def __init__(
        self,
        robot: RobotDescription,
        settings: EstimatorSettings | None = None,
        plan: Callable[[], Mask | None] | None = None,
    ) -> None:
        self.robot, self.settings = robot, settings or EstimatorSettings()
        self._plan = plan
        self._kin = Kinematics(robot)
        self._imu = self._kin.frame_id(robot.roles["imu"])
        self._soles = [self._kin.frame_id(sole.frame) for sole in robot.soles]
        self._q = standing_configuration(robot, "standing")
        self._q[:7] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
        self._base_to_imu = self._imu_in_base()
        self.filter = BASE_FILTERS[self.settings.base](self.settings.noise)
        self._observer = MomentumObserver(robot, self.settings.observer_bandwidth)
        self.contact = ContactBelief(robot.total_mass * GRAVITY, self.settings.cues)
        self.bias_watch = BiasWatch(self.settings.bias_doubt)
        self.wrenches = np.zeros((2, 6))
        self._sole_places, self._sole_turns = np.zeros((2, 3)), np.zeros((2, 3, 3))
        self._last: RobotState | None = None
        self._taken = -math.inf
        self.refused = 0

    def _imu_in_base(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of the IMU in the base's axes [m].

        Raises:
            ConfigError: the IMU is not on the base's body.
        """
        if self._kin.frame_joint(self._imu) != 1:
            raise ConfigError("role imu", self.robot.roles["imu"], "a frame of the base's body")
        self._kin.update_geometry(self._q)
        rotation, position = self._kin.frame_placement(self._imu)
        return rotation.copy(), position.copy()

    def calibrate(
        self,
        readings: Sequence[SensorReading],
        base: Array | None = None,
        gyro_bias: Array | None = None,
        standing: bool = True,
    ) -> RobotState:
        """Begin with a robot at rest, hanging or standing: the gyro's mean is its bias, gravity says what is up.

        Args:
            readings: of a robot that does not move; the more, the better the bias is known.
            base: shape (7,) position [m] and quaternion x, y, z, w of the base, where it is known better: at the start
                of a simulation. Otherwise the lower sole is on the ground at the world's origin and the base looks
                along x.
            gyro_bias: shape (3,) where it is known from longer rest than these readings [rad/s].
            standing: whether its feet stand; soles in the air need be neither level nor still.

        Returns:
            The state at the last of them.

        Raises:
            ConfigError: no readings, or one with a number that is none; nothing changes.
        """
        if not readings:
            raise ConfigError("readings", 0, "at least one of a robot at rest")
        for i, reading in enumerate(readings):
            if not _is_sound(reading):
                raise ConfigError(f"reading {i} at {reading.stamp:g} s", "not finite", "finite numbers")
        last, kin = readings[-1], self._kin
        bias = np.mean([r.gyro for r in readings], axis=0) if gyro_bias is None else gyro_bias
        up = np.mean([r.accelerometer for r in readings], axis=0)
        self._q[7:] = last.joint_position
        kin.update_geometry(self._q)
        mount, arm = self._base_to_imu
        places = [kin.frame_placement(sole) for sole in self._soles]
        if base is None:
            rotation = _upright(mount @ up)
            heights = [rotation[2] @ position for _, position in places]
            origin = np.array([0.0, 0.0, -min(heights)])
        else:
            rotation, origin = pin.Quaternion(base[3:7]).matrix(), base[:3]
        soles = np.array([origin + rotation @ position for _, position in places])
        turned = np.array([rotation @ r for r, _ in places])
        self.filter.reset(rotation @ mount, origin + rotation @ arm, soles, turned, bias)
        self.contact.reset(standing)
        self._observer.reset()
        self.bias_watch.reset()
        self._taken = -math.inf
        self._last = replace(self._state(last), contact=self.contact.probability.copy())
        return self._last

    def update(self, reading: SensorReading) -> RobotState:
        """The state at a reading.

        One that was taken in before, by its stamp, or is older, or in which a number is none, changes nothing: the last
        state comes back, whose stamp tells that it is no new one.

        Raises:
            ConfigError: it has not been calibrated.
        """
        if self._last is None:
            raise ConfigError("estimator", "not calibrated", "calibrated with readings of the robot at rest")
        dt = min(reading.stamp - self._last.stamp, LONGEST_STEP)
        if dt < 0.0 or reading.stamp == self._taken or not _is_sound(reading):
            self.refused += 1
            return self._last
        self._taken = reading.stamp
        standing = self.contact.probability
        if dt > 0.0:
            self.filter.predict(reading.gyro, reading.accelerometer, standing, dt)
        self._q[7:] = reading.joint_position
        self._kin.update_geometry(self._q)
        mount, arm = self._base_to_imu
        for foot, sole in enumerate(self._soles):
            rotation, position = self._kin.frame_placement(sole)
            self._sole_places[foot], self._sole_turns[foot] = mount.T @ (position - arm), mount.T @ rotation
        ground = np.zeros(2) if self.settings.level_ground else None
        self.filter.correct(self._sole_places, self._sole_turns, standing > STANDS, ground)
        state = self._state(reading)
        if dt > 0.0:
            self.wrenches = self._observer.update(state.q, state.v, reading.torque, dt)
            planned = None if self._plan is None else self._plan()
            moved, turned = self._observer.sole_velocities[:, :3], self._observer.sole_velocities[:, 3:]
            self.contact.update(self.wrenches[:, 2], np.sqrt(np.vecdot(moved, moved)), planned, dt)
            if self.bias_watch.update(self._sole_turns, turned, self.contact.probability > STANDS, dt):
                self.filter.doubt_gyro_bias(self.settings.bias_doubt.deviation)
        forces, contact = self.wrenches[:, 2].copy(), self.contact.probability.copy()
        self._last = replace(state, foot_forces=forces, contact=contact)
        return self._last

    def _state(self, reading: SensorReading) -> RobotState:
        """The filter's state as that of the base."""
        kept, (mount, arm) = self.filter, self._base_to_imu
        nj = len(self.robot.joints)
        q, v = np.empty(7 + nj), np.empty(6 + nj)
        rotation = kept.rotation @ mount.T
        rate = mount @ (reading.gyro - kept.gyro_bias)
        q[:3] = kept.position - rotation @ arm
        q[3:7] = pin.Quaternion(rotation).coeffs()
        v[:3] = rotation.T @ kept.velocity - skew(rate) @ arm
        v[3:6] = rate
        q[7:], v[6:] = reading.joint_position, reading.joint_velocity
        return RobotState(q, v, reading.torque, reading.stamp)


def _is_sound(reading: SensorReading) -> bool:
    """Whether every number is one."""
    joints = reading.joint_position, reading.joint_velocity, reading.torque
    return all_finite(*joints, reading.gyro, reading.accelerometer)


def _upright(up: Array) -> Array:
    """Rotation (3, 3) of a base that looks along x and in whose axes ``up`` (3,) points upwards."""
    up = up / np.linalg.norm(up)
    forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(up, forward), up])
