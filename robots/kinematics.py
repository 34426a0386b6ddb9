"""Kinematics and dynamics of one tick: computed once, read by every layer."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.messages import Array
from robots.pinocchio_model import (
    BASE_SIZES,
    build_pinocchio_model,
    moving_joint_indices,
    standing_configuration,
)

SE3_BYTES = 96
"""Size of pinocchio's SE3: rotation (9 doubles, column-major), then translation (3 doubles)."""


class _Borrowed:
    """Memory of pinocchio's, and a hold on its owner: pinocchio's own views outlive it and then read rubbish."""

    def __init__(self, owner: pin.Data, interface: dict[str, object]) -> None:
        self.owner = owner
        self.__array_interface__ = interface


class Kinematics:
    """All model quantities at one state (q, v), for a robot on a floating, planar or fixed base.

    :meth:`update` computes everything but the second-order arrays, :meth:`update_motion` what a barrier needs at
    acceleration level, :meth:`update_geometry` what it needs at velocity level. The attributes are views into
    pinocchio's memory, valid until the next update, and must not be written to.

    Attributes:
        robot: the description.
        model: pinocchio model.
        data: pinocchio data.
        base: ``floating``, ``planar`` or ``fixed``; what q and v then hold: see
            :func:`robots.pinocchio_model.build_pinocchio_model`.
        nq: length of q.
        nv: length of v.
        nq_base: how many entries of q belong to the base: 7, 4 or 0.
        nv_base: how many entries of v belong to the base: 6, 3 or 0.
        joint_names: names of the joints that may move, in the order of q and v.
        joint_indices: shape (nj,) their places in ``robot.joints``.
        position_limits: (lower, upper) of the joints that may move, each (nj,) [rad].
        q: shape (nq,) configuration of the last update.
        v: shape (nv,) velocity of the last update.
        mass_matrix: shape (nv, nv), rotor inertia included [kg, kg m, kg m^2].
        bias: shape (nv,) Coriolis, centrifugal and gravity terms [N, N m].
        world_jacobian: shape (6, nv); column k is the velocity that joint rate k gives to a body it carries, as
            [velocity of the point at the world's origin; angular velocity], world axes.
        joint_transforms: shape (njoints, 12); row i is rotation (column-major) and translation of joint i's frame in
            the world; row 0 is the world itself, which carries what does not move.
        frame_transforms: shape (nframes, 12); row i is the placement of frame i in the world, likewise.
        support: shape (njoints, nv); 1 where velocity index k moves joint i's frame, 0 elsewhere.
        joint_velocities: shape (njoints, 6); row i is the spatial velocity of the body that joint i carries, as
            [velocity of its point at the world's origin [m/s]; angular velocity [rad/s]], world axes.
        joint_accelerations: shape (njoints, 6); row i is the time derivative of row i of ``joint_velocities`` at zero
            generalised acceleration [m/s^2, rad/s^2]. With velocity [u; omega] and acceleration [a; alpha], the
            material point at p accelerates by a + alpha x p + omega x (u + omega x p).
        com: shape (3,) centre of mass in the world [m], of the bodies that may move.
        com_velocity: shape (3,) its velocity [m/s].
        com_jacobian: shape (3, nv).
        com_bias_acceleration: shape (3,) what the CoM accelerates by without joint accelerations [m/s^2], after
            :meth:`update_bias_acceleration`.
    """

    def __init__(
        self,
        robot: RobotDescription,
        model: pin.Model | None = None,
        base: str = "floating",
        joints: Sequence[str] | None = None,
        posture: str = "standing",
    ) -> None:
        """Build the model's work space.

        Args:
            robot: a checked description.
            model: replaces the model built from the description; its base and joints must be those given here.
            base: ``floating``, ``planar`` or ``fixed``.
            joints: names of the joints that may move; all of them if not given.
            posture: gives the height of a base that does not float, and the angles of the locked joints.

        Raises:
            ConfigError: no such base, nothing left that moves, or a model of another size.
            UnknownNameError: no such joint.
            DescriptionError: no such posture.
        """
        require_one_of("base", base, tuple(BASE_SIZES))
        self.robot = robot
        self.base = base
        self.nq_base, self.nv_base = BASE_SIZES[base]
        self.joint_indices = moving_joint_indices(robot, joints)
        self.joint_names = tuple(robot.joint_names[i] for i in self.joint_indices)
        lower, upper = robot.position_limits
        self.position_limits = (lower[self.joint_indices], upper[self.joint_indices])
        self._home = robot.posture(posture)
        self.model = build_pinocchio_model(robot, base, joints, posture) if model is None else model
        nj = len(self.joint_names)
        if (self.model.nq, self.model.nv) != (self.nq_base + nj, self.nv_base + nj):
            allowed = f"a model of a {base} base and {nj} joints"
            raise ConfigError("model", f"nq {self.model.nq}, nv {self.model.nv}", allowed)
        self._set_up()

    def _set_up(self) -> None:
        """Allocate the work space and the views into it."""
        self.data = self.model.createData()
        self.nq: int = self.model.nq
        self.nv: int = self.model.nv
        self.q = np.zeros(self.nq)
        self.v = np.zeros(self.nv)
        self.mass_matrix = self._borrow(self.data.M)
        self.bias = self._borrow(self.data.nle)
        self.world_jacobian = self._borrow(self.data.J)
        self.com = self._borrow(self.data.com[0])
        self.com_velocity = self._borrow(self.data.vcom[0])
        self.com_jacobian = self._borrow(self.data.Jcom)
        self.joint_transforms = self._transforms_view(self.data.oMi, self.model.njoints)
        self.frame_transforms = self._transforms_view(self.data.oMf, self.model.nframes)
        self._frame_ids: dict[str, int] = {f.name: i for i, f in enumerate(self.model.frames)}
        self._placements = self._frame_placement_views()
        self.support = self._support_mask()
        self.com_bias_acceleration = self._borrow(self.data.acom[0])
        self._rest = np.zeros(self.nv)
        self._jacobian_rate = self._borrow(self.data.dJ)
        self._rates = np.zeros((self.model.njoints, self.nv))
        self.joint_velocities = np.zeros((self.model.njoints, 6))
        self.joint_accelerations = np.zeros((self.model.njoints, 6))

    def _borrow(self, view: Array) -> Array:
        """The same memory as ``view``, kept for as long as the array returned is in use."""
        return np.asarray(_Borrowed(self.data, view.__array_interface__))

    def _transforms_view(self, placements: Sequence[pin.SE3], count: int) -> Array:
        """One array over placements, which pinocchio keeps side by side in memory."""
        first = placements[0].rotation
        address = first.__array_interface__["data"][0]
        for i in range(count):
            rotation = placements[i].rotation.__array_interface__["data"][0]
            translation = placements[i].translation.__array_interface__["data"][0]
            if rotation != address + i * SE3_BYTES or translation != rotation + 72:
                raise RuntimeError("pinocchio's SE3 layout changed: placements are not 12 doubles side by side")
        interface = {"data": (address, False), "shape": (count, 12), "typestr": first.dtype.str, "version": 3}
        return np.asarray(_Borrowed(self.data, interface))

    def _frame_placement_views(self) -> list[tuple[Array, Array]]:
        placements = [self.data.oMf[i] for i in range(self.model.nframes)]
        return [(self._borrow(p.rotation), self._borrow(p.translation)) for p in placements]

    def _support_mask(self) -> Array:
        """Shape (njoints, nv): 1 where velocity index k moves joint i's frame."""
        mask = np.zeros((self.model.njoints, self.nv))
        for i in range(1, self.model.njoints):
            j = i
            while j > 0:
                start, size = self.model.idx_vs[j], self.model.nvs[j]
                mask[i, start : start + size] = 1.0
                j = self.model.parents[j]
        return mask

    def update(self, q: Array, v: Array) -> None:
        """Compute everything at ``q`` (nq,) and ``v`` (nv,), pinocchio's conventions; both are copied."""
        np.copyto(self.q, q)
        np.copyto(self.v, v)
        pin.computeAllTerms(self.model, self.data, self.q, self.v)
        pin.updateFramePlacements(self.model, self.data)

    def update_geometry(self, q: Array) -> None:
        """Compute placements and Jacobians only, at ``q`` (nq,): enough for barrier values and their gradients."""
        np.copyto(self.q, q)
        pin.computeJointJacobians(self.model, self.data, self.q)
        pin.updateFramePlacements(self.model, self.data)

    def update_motion(self, q: Array, v: Array) -> None:
        """As :meth:`update_geometry`, and the bodies' velocities and accelerations, at ``q`` (nq,) and ``v`` (nv,)."""
        np.copyto(self.q, q)
        np.copyto(self.v, v)
        pin.computeJointJacobiansTimeVariation(self.model, self.data, self.q, self.v)
        pin.updateFramePlacements(self.model, self.data)
        self.update_second_order()

    def update_second_order(self) -> None:
        """Compute ``joint_velocities`` and ``joint_accelerations`` at the state of the last :meth:`update`."""
        np.multiply(self.support, self.v, out=self._rates)
        np.matmul(self._rates, self.world_jacobian.T, out=self.joint_velocities)
        np.matmul(self._rates, self._jacobian_rate.T, out=self.joint_accelerations)

    def update_bias_acceleration(self) -> None:
        """Compute ``com_bias_acceleration`` and what :meth:`frame_bias_acceleration` gives, at the last state."""
        pin.forwardKinematics(self.model, self.data, self.q, self.v, self._rest)
        pin.centerOfMass(self.model, self.data, pin.KinematicLevel.ACCELERATION, False)

    def frame_bias_acceleration(self, frame_id: int) -> Array:
        r"""What a frame accelerates by without joint accelerations, :math:`\dot J v` (6,): origin, then angular.

        World axes [m/s^2, rad/s^2]; after :meth:`update_bias_acceleration`.
        """
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.getFrameClassicalAcceleration(self.model, self.data, frame_id, axes).vector

    def joint_array(self, attribute: str) -> Array:
        """One number per joint that may move, shape (nj,): ``attribute`` is a field of ``Joint``."""
        return self.robot.joint_array(attribute)[self.joint_indices]

    def posture(self, name: str = "standing") -> Array:
        """Configuration (nq,) of a named posture: base over the world's origin; locked joints stay where they are.

        Raises:
            DescriptionError: no such posture.
        """
        full = standing_configuration(self.robot, name)
        base = {"floating": full[:7], "planar": np.array([0.0, 0.0, 1.0, 0.0]), "fixed": np.empty(0)}[self.base]
        return np.concatenate([base, full[7:][self.joint_indices]])

    def full_configuration(self, q: Array) -> Array:
        """The configuration ``q`` (nq,) as one of the floating base and all joints, (7 + number of all joints,)."""
        joints = self._home.joints.copy()
        joints[self.joint_indices] = q[self.nq_base :]
        if self.base == "floating":
            return np.concatenate([q[:7], joints])
        x, y, cosine, sine = q[:4] if self.base == "planar" else (0.0, 0.0, 1.0, 0.0)
        half = 0.5 * math.atan2(sine, cosine)
        base = [x, y, self._home.base_height, 0.0, 0.0, math.sin(half), math.cos(half)]
        return np.concatenate([base, joints])

    def frame_id(self, name: str) -> int:
        """Index of a frame.

        Raises:
            UnknownNameError: no such frame.
        """
        if name not in self._frame_ids:
            raise UnknownNameError("frame", name, sorted(self._frame_ids))
        return self._frame_ids[name]

    def frame_joint(self, frame_id: int) -> int:
        """Index of the joint that carries a frame."""
        return int(self.model.frames[frame_id].parentJoint)

    def frame_placement(self, frame_id: int) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) [m] of a frame in the world, as views."""
        return self._placements[frame_id]

    def frame_jacobian(self, frame_id: int, local: bool = False) -> Array:
        """Jacobian (6, nv) of a frame: velocity of its origin, then angular; world axes, or its own if ``local``."""
        axes = pin.ReferenceFrame.LOCAL if local else pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.getFrameJacobian(self.model, self.data, frame_id, axes)

    def integrate(self, q: Array, v: Array, dt: float) -> Array:
        """Configuration (nq,) after moving at ``v`` (nv,) for ``dt`` [s]."""
        return pin.integrate(self.model, q, v * dt)
