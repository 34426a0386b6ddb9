"""A robot at torque level whose base is held, or driven over a plane: MuJoCo, motors, and the law that moves them.

It takes what :class:`sims.kinematic.KinematicPlant` takes, velocities or accelerations, and does not do it exactly:
torques are limited, joints rub, and the model that they are computed with may be wrong.
"""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from robots.checks import all_finite, require_non_negative, require_positive
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec
from sims.plant import UNSTABLE_ACCELERATION

BASE_AXES = (
    ("base_x", mujoco.mjtJoint.mjJNT_SLIDE, (1.0, 0.0, 0.0)),
    ("base_y", mujoco.mjtJoint.mjJNT_SLIDE, (0.0, 1.0, 0.0)),
    ("base_yaw", mujoco.mjtJoint.mjJNT_HINGE, (0.0, 0.0, 1.0)),
)
"""Joints of a base that moves over the plane, each with a motor."""


@dataclass(frozen=True, slots=True)
class HeldConfig:
    """How the robot is simulated, and how its motors are driven.

    Attributes:
        dt: physics step, in which motors see joints, above 0 [s].
        period: of the torque law, a whole number of physics steps [s].
        stiffness: k of the acceleration asked for, by what the velocity lacks, above 0 [1/s]; DynWBC's own by default.
        gain_scale: factor on the gains of the motors' own feedback, 0 or above.
        changes: of the simulated robot; the law keeps the description's masses, and knows of no friction.
    """

    dt: float = 0.001
    period: float = 0.002
    stiffness: float = 40.0
    gain_scale: float = 1.0
    changes: PhysicalChanges = field(default_factory=PhysicalChanges)

    def __post_init__(self) -> None:
        require_positive("dt", self.dt)
        require_positive("stiffness", self.stiffness)
        require_non_negative("gain_scale", self.gain_scale)
        _whole("period", self.period, self.dt)


class HeldPlant:
    r"""Moves by torques what a command asks for, period by period.

    With the model of all joints on the same base, mass matrix M and bias h,

    .. math:: \tau^{opt} = M(q)\,a + h(q, \dot q), \quad a = \dot u + k\,(u - \dot q)

    for the velocity u of a command of first order (:math:`\dot u = 0`), or :math:`u = \dot q_0 + \dot u\,t` since a
    command :math:`\dot u` of second order; DynWBC comes to the same where nothing is in contact. Joints that commands
    do not move are held. Motors add their own feedback, eq. (19) of Lee et al., up to their limits. Nothing collides:
    penetration is there to be measured.

    Attributes:
        order: 1 or 2.
        time: since the start [s].
        saturated: physics steps in which a motor was at its limit.
        unstable: whether the simulation blew up; the robot does not move any more then.
    """

    def __init__(self, model: Kinematics, q0: Array, order: int = 1, config: HeldConfig | None = None) -> None:
        """Start at rest.

        Args:
            model: what commands move: some joints, on a fixed or planar base.
            q0: shape (nq,) configuration to start from.
            order: 1: commands are velocities; 2: accelerations.
            config: of plant and law.

        Raises:
            ConfigError: another order, a base that floats, or ``q0`` has another shape or is not finite.
        """
        if order not in (1, 2):
            raise ConfigError("order", order, "1 (velocity) or 2 (acceleration)")
        if model.base == "floating":
            raise ConfigError("base", model.base, "fixed or planar: nothing holds one that floats")
        if np.shape(q0) != (model.nq,) or not all_finite(q0):
            raise ConfigError("q0", q0, f"{model.nq} finite numbers")
        self.order, self.config, self._model = order, config or HeldConfig(), model
        robot, home = model.robot, model.full_configuration(q0)
        self._law = Kinematics(robot, base=model.base)
        self._nb, self._home = self._law.nv_base, home[7:].copy()
        self._moved = self._nb + model.joint_indices
        self.data = mujoco.MjData(self._built(home))
        self._kp, self._kd = (
            self.config.gain_scale * np.concatenate([np.zeros(self._nb), robot.joint_array(name)])
            for name in ("kp", "kd")
        )
        self._limit = np.concatenate([np.full(self._nb, np.inf), robot.joint_array("effort")])
        self.data.qpos[self._nb :] = self._home
        if self._nb:
            self.data.qpos[: self._nb] = q0[0], q0[1], np.arctan2(q0[3], q0[2])
        mujoco.mj_forward(self.data.model, self.data)
        self._command = np.zeros(model.nv)
        self._begun_v = np.zeros(model.nv)
        self.time, self.saturated, self.unstable = 0.0, 0, False

    def _built(self, home: Array) -> mujoco.MjModel:
        robot, config = self._model.robot, self.config
        spec = build_mujoco_spec(robot, config.changes)
        spec.option.timestep = config.dt
        spec.delete(spec.joint("root_joint"))
        root = spec.body(robot.bodies[0].name)
        root.pos = [0.0, 0.0, home[2]]
        for name, kind, axis in BASE_AXES[: self._nb]:
            joint = root.add_joint()
            joint.name, joint.type, joint.axis = name, kind, axis
        for geom in spec.geoms:
            geom.contype, geom.conaffinity = 0, 0
        return spec.compile()

    def state(self) -> RobotState:
        """See :meth:`robots.ports.Body.state`: exact, of what commands move, with all motors' torques."""
        q, v = self._whole_state()
        joints = self._model.joint_indices
        nq = self._law.nq_base
        torque = np.array(self.data.qfrc_applied[self._nb :])
        here = np.concatenate([q[:nq], q[nq + joints]]), np.concatenate([v[: self._nb], v[self._nb + joints]])
        return RobotState(*here, torque, self.time)

    def _whole_state(self) -> tuple[Array, Array]:
        """Configuration and velocity of all joints, as the model of the law has them."""
        qpos, qvel, nb = self.data.qpos, self.data.qvel, self._nb
        if not nb:
            return np.array(qpos), np.array(qvel)
        c, s = np.cos(qpos[2]), np.sin(qpos[2])
        turned = [c * qvel[0] + s * qvel[1], c * qvel[1] - s * qvel[0], qvel[2]]
        return np.concatenate([[qpos[0], qpos[1], c, s], qpos[3:]]), np.concatenate([turned, qvel[3:]])

    def send(self, command: Array) -> None:
        """See :meth:`robots.ports.Body.send`: ``command`` (nv,) is a velocity or an acceleration, by the order.

        Raises:
            ConfigError: it has another shape or is not finite.
        """
        if np.shape(command) != (self._model.nv,) or not all_finite(command):
            raise ConfigError("command", command, f"{self._model.nv} finite numbers")
        self._command, self._begun_v = np.array(command, dtype=float), self.state().v

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`.

        Raises:
            ConfigError: ``dt`` is no whole number of periods.
        """
        period = self.config.period
        for i in range(_whole("dt", dt, period)):
            self._drive(i * period)

    def _drive(self, since: float) -> None:
        """One period of the law, ``since`` so long after the command [s]."""
        config, nb, moved = self.config, self._nb, self._moved
        q, v = self._whole_state()
        self._law.update(q, v)
        wanted, acceleration = np.zeros(self._law.nv), np.zeros(self._law.nv)
        chosen = np.concatenate([np.arange(nb), moved])
        if self.order == 1:
            wanted[chosen] = self._command
        else:
            wanted[chosen] = self._begun_v + since * self._command
            acceleration[chosen] = self._command
        acceleration += config.stiffness * (wanted - v)
        held = np.ones(self._law.nv, dtype=bool)
        held[chosen] = False
        place = np.concatenate([np.zeros(nb), self._home])
        here = np.concatenate([np.zeros(nb), q[self._law.nq_base :]])
        # critically damped, by the same stiffness
        acceleration[held] += 0.25 * config.stiffness**2 * (place - here)[held]
        torque = self._law.mass_matrix @ acceleration + self._law.bias
        target = here + config.period * wanted
        target[held] = place[held]
        for _ in range(round(config.period / config.dt)):
            self._step(torque, target, wanted)

    def _step(self, torque: Array, target: Array, wanted: Array) -> None:
        """One physics step with the motors' own feedback; nothing moves any more once it is unstable."""
        if self.unstable:
            self.time += self.config.dt
            return
        data, nb = self.data, self._nb
        here = np.concatenate([np.zeros(nb), data.qpos[nb:]])
        v = self._whole_state()[1]
        applied = torque + self._kp * (target - here) + self._kd * (wanted - v)
        limited = np.clip(applied, -self._limit, self._limit)
        self.saturated += bool((limited != applied).any())
        if nb:
            c, s = np.cos(data.qpos[2]), np.sin(data.qpos[2])
            limited[:2] = c * limited[0] - s * limited[1], s * limited[0] + c * limited[1]
        data.qfrc_applied[:] = limited
        kept = np.array(data.qpos)
        mujoco.mj_step(data.model, data)
        # MuJoCo itself goes back to its first state where it blows up
        if not np.abs(data.qacc).max() < UNSTABLE_ACCELERATION or not np.isfinite(data.qpos).all():
            self.unstable = True
            data.qpos[:], data.qvel[:] = kept, 0.0
        self.time += self.config.dt


def _whole(name: str, long: float, short: float) -> int:
    """How often one goes into the other.

    Raises:
        ConfigError: not a whole number of times.
    """
    times = round(long / short)
    if times < 1 or abs(times * short - long) > 1e-9:
        raise ConfigError(name, long, f"a whole number of times {short:g} s")
    return times
