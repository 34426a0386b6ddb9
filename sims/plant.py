"""The plant: MuJoCo with a model that may differ from the controller's, motors, sensors."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from robots.checks import require_between, require_non_negative, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array, MotorCommand, RobotState
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec
from robots.pinocchio_model import standing_configuration
from sims.kernels import ground_loads, read_state
from sims.physical import add_bodies, quaternion
from sims.shapes import Shape

UNSTABLE_ACCELERATION = 1e7
"""Acceleration [m/s^2, rad/s^2] from which the simulation counts as numerically unstable."""


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Standard deviations of white noise on the measured state; all zero for exact measurement.

    Attributes:
        joint_position: [rad].
        joint_velocity: [rad/s].
        base_position: [m].
        base_orientation: rotation vector [rad].
        base_linear_velocity: [m/s].
        base_angular_velocity: [rad/s].
    """

    joint_position: float = 0.0
    joint_velocity: float = 0.0
    base_position: float = 0.0
    base_orientation: float = 0.0
    base_linear_velocity: float = 0.0
    base_angular_velocity: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_non_negative(f"noise {name}", getattr(self, name))

    @property
    def none(self) -> bool:
        """Whether every deviation is zero."""
        return not any(getattr(self, name) for name in self.__slots__)


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """How the simulated robot differs from its description, and how it is stepped.

    Attributes:
        dt: physics step [s], above 0.
        changes: mismatch of masses, friction, armature.
        actuator_delay: time from command to torque [s], 0 or above; rounded to whole steps.
        noise: of the measured state.
    """

    dt: float = 0.001
    changes: PhysicalChanges = field(default_factory=PhysicalChanges)
    actuator_delay: float = 0.0
    noise: SensorNoise = field(default_factory=SensorNoise)

    def __post_init__(self) -> None:
        require_positive("dt", self.dt)
        require_non_negative("actuator_delay", self.actuator_delay)
        require_between("mass_scale", self.changes.mass_scale, 0.1, 10.0)
        require_positive("sole_friction", self.changes.sole_friction)
        for name, value in self.changes.link_mass_scale.items():
            require_between(f"link_mass_scale of {name}", value, 0.1, 15.0)
        for name in ("joint_friction_scale", "armature_scale"):
            require_non_negative(name, getattr(self.changes, name))
        if len(self.changes.com_shift) != 3 or not np.isfinite(self.changes.com_shift).all():
            raise ConfigError("com_shift", self.changes.com_shift, "three finite numbers [m]")


@dataclass(frozen=True, slots=True)
class ImuReading:
    """IMU in its own axes: ``gyro`` (3,) [rad/s], ``accelerometer`` (3,) [m/s^2], ``quaternion`` (4,) x, y, z, w."""

    gyro: Array
    accelerometer: Array
    quaternion: Array


class MujocoPlant:
    """One robot on flat ground. Quaternion order and base-velocity axes are converted here and nowhere else.

    It starts at rest in its posture ``standing``.

    Args:
        robot: the description.
        config: mismatch, delay, noise, step; those of ``PlantConfig`` if not given.
        rng: source of the sensor noise; needed where there is any.
        bodies: of the world, which the robot can touch and which :meth:`place_bodies` moves.

    Attributes:
        unstable: whether the simulation blew up; it then stays at its last finite state.
        sole_poses: shape (2, 4, 3) rotation of each sole and, in the last row, its centre [m], while the contact forces
            of the last physics step acted.

    Raises:
        ConfigError: ``link_mass_scale`` names a body that does not exist, or there is noise without a source.
    """

    def __init__(
        self,
        robot: RobotDescription,
        config: PlantConfig | None = None,
        rng: np.random.Generator | None = None,
        bodies: Sequence[Shape] = (),
    ) -> None:
        config = config or PlantConfig()
        if rng is None and not config.noise.none:
            raise ConfigError("rng", rng, "a generator, such as np.random.default_rng(0), for the sensor noise")
        links = [b.name for b in robot.bodies]
        if unknown := sorted(set(config.changes.link_mass_scale) - set(links)):
            raise ConfigError("link_mass_scale", unknown, "bodies of this robot: " + ", ".join(links))
        self.robot = robot
        self.config = config
        spec = build_mujoco_spec(robot, config.changes)
        spec.option.timestep = config.dt
        add_bodies(spec, bodies)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._rng = rng
        self.effort = robot.joint_array("effort")
        self._pending: deque[tuple[int, MotorCommand]] = deque()
        self._command: MotorCommand | None = None
        self._steps = 0
        self._delay_steps = round(config.actuator_delay / config.dt)
        geom, site = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_SITE
        self._sole_geoms = np.array(
            [mujoco.mj_name2id(self.model, geom, f"{s.frame}_contact") for s in robot.soles], dtype=np.intp
        )
        self._sole_sites = np.array([mujoco.mj_name2id(self.model, site, s.frame) for s in robot.soles], dtype=np.intp)
        self._corners = np.array([sole_outline(s.half_length, s.half_width) for s in robot.soles])
        self._torso = self.data.body(robot.frame(robot.roles["torso"]).body).id
        self.torque = np.zeros(len(robot.joints))
        self._loads, self._wrenches, self._zmp = np.zeros((2, 6)), np.zeros((2, 6)), np.full(2, np.nan)
        self.sole_poses = np.zeros((2, 4, 3))
        self.unstable = False
        self.total_mass = float(self.model.body_mass.sum())
        self.reset(standing_configuration(robot))

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * self.config.dt

    def reset(self, q: Array) -> None:
        """Put the robot at ``q`` (nq,), pinocchio's order, at rest, at time zero."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = q
        self.data.qpos[3:7] = q[[6, 3, 4, 5]]
        self._pending.clear()
        self._command = None
        self._steps = 0
        self.unstable = False
        self.torque[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        self._measure_loads()

    def true_state(self) -> RobotState:
        """State without noise; new arrays."""
        q, v = np.empty(self.model.nq), np.empty(self.model.nv)
        read_state(self.data.qpos, self.data.qvel, q, v)
        return RobotState(q, v, self.torque.copy(), self.time, self._wrenches[:, 2].copy())

    def state(self) -> RobotState:
        """See :meth:`robots.ports.Body.state`: with the configured sensor noise."""
        return self.measured_state()

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`.

        Raises:
            ConfigError: ``dt`` is no whole number of physics steps.
        """
        steps = round(dt / self.config.dt)
        if steps < 1 or abs(steps * self.config.dt - dt) > 1e-9:
            raise ConfigError("dt", dt, f"a whole number of physics steps of {self.config.dt:g} s")
        for _ in range(steps):
            self.step()

    def measured_state(self) -> RobotState:
        """State with the configured sensor noise; new arrays."""
        state, noise, rng = self.true_state(), self.config.noise, self._rng
        if noise.none or rng is None:
            return state
        q, v, nj = state.q, state.v, len(self.robot.joints)
        q[7:] += noise.joint_position * rng.standard_normal(nj)
        v[6:] += noise.joint_velocity * rng.standard_normal(nj)
        q[:3] += noise.base_position * rng.standard_normal(3)
        v[:3] += noise.base_linear_velocity * rng.standard_normal(3)
        v[3:6] += noise.base_angular_velocity * rng.standard_normal(3)
        wxyz = q[[6, 3, 4, 5]]
        mujoco.mju_quatIntegrate(wxyz, noise.base_orientation * rng.standard_normal(3), 1.0)
        q[3:6], q[6] = wxyz[1:], wxyz[0]
        return state

    def send(self, command: MotorCommand) -> None:
        """Send a command; it takes effect after the actuator delay and holds until the next one does."""
        self._pending.append((self._steps + self._delay_steps, command))

    def push(self, force: Array) -> None:
        """Push the torso with ``force`` (3,), world axes, at its body's centre of mass, until another is given [N]."""
        self.data.xfrc_applied[self._torso, :3] = force

    def place_bodies(self, bodies: Sequence[Shape]) -> None:
        """Put the world's bodies where they are now, in the order in which they were given, of the same shapes."""
        for i, body in enumerate(bodies):
            self.data.mocap_pos[i], self.data.mocap_quat[i] = body.center, quaternion(body)

    def step(self) -> None:
        """Advance by one physics step, the motors evaluating eq. (19) of Lee et al. within their effort limits.

        Before the first command takes effect the torques are zero. Where the simulation blows up, ``unstable`` is set
        and nothing moves any more: MuJoCo by itself would go back to its first state, at time zero.
        """
        while self._pending and self._pending[0][0] <= self._steps:
            self._command = self._pending.popleft()[1]
        if self._command is not None:
            torque = self._command.torque(self.data.qpos[7:], self.data.qvel[6:])
            np.maximum(torque, -self.effort, out=torque)
            np.minimum(torque, self.effort, out=self.torque)
            self.data.ctrl[:] = self.torque
        mujoco.mj_forward(self.model, self.data)
        self.unstable = self.unstable or not np.abs(self.data.qacc).max() < UNSTABLE_ACCELERATION
        if not self.unstable:
            self._measure_loads()
            mujoco.mj_implicit(self.model, self.data)
            # frames and CoM of the state just reached; forces and sensors stay those of the step that led there
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            self._steps += 1

    def _measure_loads(self) -> None:
        """Read the contact forces, and remember where the soles are while they act."""
        data, contact = self.data, self.data.contact
        contacts = (contact.efc_address, contact.frame, contact.pos, contact.geom)
        self.sole_poses[:, :3] = data.site_xmat[self._sole_sites].reshape(2, 3, 3)
        self.sole_poses[:, 3] = data.site_xpos[self._sole_sites]
        soles, out = (self._sole_geoms, self.sole_poses), (self._loads, self._wrenches, self._zmp)
        ground_loads(*contacts, data.efc_force, *soles, *out)

    def contact_wrenches(self) -> Array:
        """Ground wrench on each sole (2, 6): force, then moment about the sole's centre, sole axes [N, N m].

        Of the last physics step; zero without contact.
        """
        return self._wrenches.copy()

    def zero_moment_point(self) -> Array:
        """Measured ZMP (2,) on the ground plane [m] from the net contact wrench; NaN without vertical force."""
        return self._zmp.copy()

    def sole_corners(self) -> Array:
        """World positions (2, 4, 3) of the corners of both soles [m]."""
        rotation = self.data.site_xmat[self._sole_sites].reshape(2, 3, 3)
        return self._corners @ rotation.transpose(0, 2, 1) + self.data.site_xpos[self._sole_sites, None]

    def center_of_mass(self) -> Array:
        """True centre of mass (3,) in the world [m], with the plant's own masses."""
        return np.array(self.data.subtree_com[1])

    def frame_position(self, name: str) -> Array:
        """World position (3,) of a named frame's origin [m]."""
        return np.array(self.data.site(name).xpos)

    def imu(self) -> ImuReading:
        """Reading of the IMU during the last physics step."""
        sensor = {n: self.data.sensor(n).data.copy() for n in ("imu_gyro", "imu_accelerometer", "imu_quaternion")}
        return ImuReading(sensor["imu_gyro"], sensor["imu_accelerometer"], sensor["imu_quaternion"][[1, 2, 3, 0]])


def sole_outline(half_length: float, half_width: float) -> Array:
    """Corners (4, 3) of a sole in its own axes [m], anticlockwise from the one in front on the left."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return np.column_stack([signs * [half_length, half_width], np.zeros(4)])
