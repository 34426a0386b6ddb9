"""Kinematics and dynamics of one tick: computed once, read by every layer."""

import numpy as np
import pinocchio as pin

from robots.description import RobotDescription
from robots.errors import UnknownNameError
from robots.messages import Array
from robots.pinocchio_model import build_pinocchio_model

SE3_BYTES = 96
"""Size of pinocchio's SE3: rotation (9 doubles, column-major), then translation (3 doubles)."""


class _Borrowed:
    """Memory of pinocchio's, and a hold on its owner: pinocchio's own views outlive it and then read rubbish."""

    def __init__(self, owner: pin.Data, interface: dict[str, object]) -> None:
        self.owner = owner
        self.__array_interface__ = interface


class Kinematics:
    """All model quantities at one state (q, v), for a floating-base robot.

    :meth:`update` computes everything; the attributes are views into pinocchio's memory, valid until the next
    update, and must not be written to.

    Attributes:
        robot: the description.
        model: pinocchio model.
        data: pinocchio data.
        q: shape (nq,) configuration of the last update.
        v: shape (nv,) velocity of the last update.
        mass_matrix: shape (nv, nv), rotor inertia included [kg, kg m, kg m^2].
        bias: shape (nv,) Coriolis, centrifugal and gravity terms [N, N m].
        world_jacobian: shape (6, nv); column k is the velocity that joint rate k gives to a body it carries, as
            [velocity of the point at the world's origin; angular velocity], world axes.
        joint_transforms: shape (njoints, 12); row i is rotation (column-major) and translation of joint i's frame in
            the world.
        com: shape (3,) centre of mass in the world [m].
        com_velocity: shape (3,) its velocity [m/s].
        com_jacobian: shape (3, nv).
    """

    def __init__(self, robot: RobotDescription, model: pin.Model | None = None) -> None:
        """Build the model's work space; ``model`` replaces the one built from the description."""
        self.robot = robot
        self.model = build_pinocchio_model(robot) if model is None else model
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
        self.joint_transforms = self._joint_transforms_view()
        self._frame_ids: dict[str, int] = {f.name: i for i, f in enumerate(self.model.frames)}
        self._placements = self._frame_placement_views()
        self.support = self._support_mask()

    def _borrow(self, view: Array) -> Array:
        """The same memory as ``view``, kept for as long as the array returned is in use."""
        return np.asarray(_Borrowed(self.data, view.__array_interface__))

    def _joint_transforms_view(self) -> Array:
        """One array over the joint placements, which pinocchio keeps side by side in memory."""
        first = self.data.oMi[0].rotation
        address = first.__array_interface__["data"][0]
        for i in range(self.model.njoints):
            placement = self.data.oMi[i]
            rotation = placement.rotation.__array_interface__["data"][0]
            translation = placement.translation.__array_interface__["data"][0]
            if rotation != address + i * SE3_BYTES or translation != rotation + 72:
                raise RuntimeError("pinocchio's SE3 layout changed: joint placements are not 12 doubles side by side")
        shape = (self.model.njoints, 12)
        interface = {"data": (address, False), "shape": shape, "typestr": first.dtype.str, "version": 3}
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

    def frame_velocity(self, frame_id: int) -> Array:
        """Velocity (6,) of a frame: of its origin [m/s], then angular [rad/s], world axes."""
        motion = pin.getFrameVelocity(self.model, self.data, frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        return motion.vector

    def integrate(self, q: Array, v: Array, dt: float) -> Array:
        """Configuration (nq,) after moving at ``v`` (nv,) for ``dt`` [s]."""
        return pin.integrate(self.model, q, v * dt)
