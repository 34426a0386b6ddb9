"""DynWBC: joint torques from a quadratic program with full dynamics and contact wrench cones."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from robots.checks import require_non_negative, require_positive
from robots.kinematics import Kinematics
from robots.messages import Array, Indices, Mask
from wbc.contact import SoleContact
from wbc.kernels import eliminate_base, local_jacobians, motion_and_torques, torque_cost
from wbc.qp import QpStatus
from wbc.torque_qp import DynWbcProblem, TorqueQp
from wbc.wrench import GRAVITY


@dataclass(frozen=True, slots=True)
class DynWbcWeights:
    r"""Weights of the cost, eq. (16) of Lee et al., and the gains of eq. (15).

    Attributes:
        acceleration: w_qdd on :math:`\|\ddot q - \ddot q^{safe}\|^2`, above 0.
        force: w_c on the force part of :math:`\|F_c - F_c^{des}\|^2` [1/N^2], above 0.
        moment: w_c on its moment part [1/(N m)^2], above 0.
        torque_rate: w_tau on :math:`\|\tau - \tau_{prev}\|^2` [1/(N m)^2], 0 or above.
        energy: w_M on :math:`\ddot q^T M \ddot q` [1/(kg m^2/s^4)], 0 or above.
        contact: weight of :math:`\|J_c \ddot q + \dot J_c \dot q\|^2` on feet in contact; 0 is the paper's form.
        kp: K_p of eq. (15) [1/s^2], 0 or above.
        kd: K_d of eq. (15) [1/s], above 0.
    """

    acceleration: float = 1.0
    force: float = 1e-2
    moment: float = 1.0
    torque_rate: float = 1e-3
    energy: float = 1e-3
    contact: float = 0.0
    kp: float = 400.0
    kd: float = 40.0

    def __post_init__(self) -> None:
        for name in ("acceleration", "force", "moment", "kd"):
            require_positive(f"dynwbc {name}", getattr(self, name))
        for name in ("torque_rate", "energy", "contact", "kp"):
            require_non_negative(f"dynwbc {name}", getattr(self, name))


@dataclass(frozen=True, slots=True)
class DynWbcResult:
    """What DynWBC found.

    Attributes:
        torque: tau^opt, shape (nj,) [N m].
        acceleration: shape (nv,) generalised acceleration.
        wrench: shape (6 n,) contact wrenches, [force; moment about the sole's centre] in sole axes [N, N m].
        status: of the solver; unless ``optimal`` the numbers are those of the last optimal tick.
        iterations: of the solver.
        relaxed: whether the conditions on the acceleration could not all hold, so that they were violated by the least
            sum of squares.
        spent: whether a budget was spent before that sum was proved to be the least; it is that of the best found.
    """

    torque: Array
    acceleration: Array
    wrench: Array
    status: QpStatus
    iterations: int
    relaxed: bool = False
    spent: bool = False


class DynWbc:
    r"""The torque QP of eqs. (16)-(18) of Lee et al., base dynamics and torques eliminated.

    .. math:: \min w_{\ddot q}\|\ddot q-\ddot q^{safe}\|^2 + \|F_c-F_c^{des}\|^2_{w_c}
        + w_\tau\|\tau-\tau_{prev}\|^2 + w_M\,\ddot q^T M \ddot q
        \;\text{s.t.}\; U F_c \le 0,\; M\ddot q + h = S^T\tau + J_c^T F_c,\; |\tau| \le \tau_{max}

    The six rows of the base give its acceleration as a function of joint accelerations and wrenches, the others give
    the torques; a foot in the air has no wrench. The G1 then has 29 + 12 variables on two feet and 29 + 6 on one,
    instead of the 76 of the full form, with the same optimum.

    Conditions :math:`A \ddot q \ge b` may be added, for barriers at the level of accelerations (eq. (55)). Where they
    contradict each other, the cone or the torque limits, they are violated by the least sum of squares, those never.

    Args:
        kin: kinematics of the robot (for sizes and frames).
        contacts: soles that may touch the ground.
        weights: weights and gains.
        solver: name of the QP solver.
        condition_count: k, number of conditions on the acceleration that every problem has.

    Raises:
        ConfigError: unknown solver.
        UnknownNameError: a sole's frame does not exist.
    """

    def __init__(
        self,
        kin: Kinematics,
        contacts: Sequence[SoleContact],
        weights: DynWbcWeights,
        solver: str = "daqp",
        condition_count: int = 0,
    ) -> None:
        self.frame_ids = [kin.frame_id(c.frame) for c in contacts]
        self._frames = np.array(self.frame_ids)
        self._joints = np.array([kin.frame_joint(i) for i in self.frame_ids])
        self.nj = kin.nv - 6
        self.nf = 6 * len(self.frame_ids)
        self._weight = kin.robot.total_mass * GRAVITY
        self._make = partial(_torque_qps, tuple(contacts), kin.robot.joint_array("effort"), solver)
        self._prepared = {condition_count: self._make(condition_count)}
        self.expect_conditions(condition_count)
        self.set_weights(weights)
        self._last = DynWbcResult(np.zeros(self.nj), np.zeros(kin.nv), np.zeros(self.nf), "failed", 0)

    @property
    def weights(self) -> DynWbcWeights:
        """Weights and gains; see :meth:`set_weights`."""
        return self._weights

    def set_weights(self, weights: DynWbcWeights) -> None:
        """Take other weights and gains, from the next problem on; warm starts stay."""
        self._weights = weights
        self._wrench_weight = np.tile([weights.force] * 3 + [weights.moment] * 3, len(self.frame_ids))

    def prepare_conditions(self, count: int) -> None:
        """Make ready for ``count`` conditions on the acceleration, which takes some ms; nothing else changes."""
        if count not in self._prepared:
            self._prepared[count] = self._make(count)

    def expect_conditions(self, count: int) -> None:
        """Every problem has ``count`` conditions from the next one on; the last torques stay where they are."""
        self.prepare_conditions(count)
        self._condition_count, self._qps = count, self._prepared[count]
        feet = range(len(self.frame_ids))
        # by the bytes of the mask: a tuple of the feet takes longer to make, and counts towards the next collection
        self._by_contact = {np.isin(feet, standing).tobytes(): qp for standing, qp in self._qps.items()}

    def reset(self, torque: Array) -> None:
        """Start from these torques (nj,) [N m] as tau_prev."""
        self._last = DynWbcResult(torque.copy(), np.zeros(self.nj + 6), np.zeros(self.nf), "failed", 0)

    def acceleration_reference(self, v_safe: Array, v: Array, dt: float) -> Array:
        r"""Acceleration command (nv,) of a safe velocity (nv,), at measured velocity ``v`` (nv,).

        Eq. (15) of Lee et al. with :math:`q^{safe} - q = \dot q^{safe} dt`.
        """
        return (self._weights.kp * dt) * v_safe + self._weights.kd * (v_safe - v)

    def velocity_command(self, acceleration: Array, v: Array, dt: float) -> Array:
        """Velocity (nv,) whose acceleration command is ``acceleration`` (nv,): eq. (15) of Lee et al. turned round."""
        return (acceleration + self._weights.kd * v) / (self._weights.kd + self._weights.kp * dt)

    def contact_jacobian(self, kin: Kinematics, in_contact: Mask) -> Array:
        """Stacked Jacobians (6 c, nv), in their own axes, of the soles that are in contact."""
        return self._stacked_jacobian(kin, np.flatnonzero(in_contact))

    def _stacked_jacobian(self, kin: Kinematics, feet: Sequence[int] | Indices) -> Array:
        jacobian = np.empty((6 * len(feet), kin.nv))
        feet = np.asarray(feet, dtype=np.int64)
        local_jacobians(
            kin.frame_transforms, self._frames, self._joints, kin.world_jacobian, kin.support, feet, jacobian
        )
        return jacobian

    def build(
        self,
        kin: Kinematics,
        acceleration: Array,
        wrench: Array,
        in_contact: Mask,
        contact_bias: Array | None = None,
        conditions: tuple[Array, Array] | None = None,
        joint_bounds: tuple[Array, Array] | None = None,
        load_scale: float = 1.0,
        load_limits: Array | None = None,
    ) -> DynWbcProblem:
        """Assemble the reduced QP.

        Args:
            kin: kinematics at the measured state.
            acceleration: shape (nv,) commanded acceleration.
            wrench: shape (6 n,) reference wrenches in sole axes [N, N m].
            in_contact: shape (n,) bool; a foot that is not in contact has no wrench.
            contact_bias: shape (6 n,) J_c_dot q_dot in sole axes; used with the soft contact term only.
            conditions: A (k, nv) and b (k,) of A q_ddot >= b, as many as announced.
            joint_bounds: lower and upper bound of the joints' accelerations, (nj,) each [rad/s^2]; given up where
                contacts and torques cannot keep them.
            load_scale: factor on the model's masses and inertias, for a robot found to be heavier or lighter.
            load_limits: shape (n,) bound on each foot's normal force, as fraction of the robot's weight, 0 or above; 1
                and above is no bound. What loads and unloads a foot smoothly.

        Returns:
            The problem and the maps back to base acceleration and torques.

        Raises:
            ValueError: another number of conditions than announced.
        """
        qp = self._by_contact[np.asarray(in_contact, dtype=bool).tobytes()]
        nj, nx, w = self.nj, qp.nx, self._weights
        jacobian = self._stacked_jacobian(kin, qp.feet)
        base, torque = np.empty((6, nx + 1)), np.empty((nj, nx + 1))
        mass_matrix, bias = kin.mass_matrix, kin.bias
        if load_scale != 1.0:
            mass_matrix, bias = load_scale * mass_matrix, load_scale * bias
        eliminate_base(mass_matrix, bias, jacobian, base, torque)
        hessian, gradient = np.empty((nx, nx)), np.empty(nx)
        torque_cost(
            base,
            torque,
            jacobian,
            acceleration,
            wrench[qp.wrenches],
            self._last.torque,
            self._wrench_weight[qp.wrenches],
            w.acceleration,
            w.torque_rate,
            w.energy,
            hessian,
            gradient,
        )
        if w.contact > 0:
            contact_bias = None if contact_bias is None else contact_bias[qp.wrenches]
            self._add_contact_term(hessian, gradient, base, jacobian, contact_bias)
        lower, upper = qp.limits(torque)
        if load_limits is not None:
            for i, foot in enumerate(qp.feet):
                if (limit := float(load_limits[foot])) < 1.0:
                    upper[nj + 6 * i + 2] = limit * load_scale * self._weight
        if joint_bounds is not None:
            lower[:nj], upper[:nj] = joint_bounds
        count = 0 if conditions is None else len(conditions[1])
        if count != self._condition_count:
            raise ValueError(f"{count} conditions on the acceleration given, {self._condition_count} announced")
        if conditions is not None and count:
            qp.write_conditions(*conditions, base, lower)
        return DynWbcProblem(qp.feet, hessian, gradient, qp.rows, lower, upper, base, torque)

    def _add_contact_term(
        self,
        hessian: Array,
        gradient: Array,
        base: Array,
        jacobian: Array,
        contact_bias: Array | None,
    ) -> None:
        """Soft contact constraint: w_contact ||J_c q_dd + J_c_dot q_dot||^2."""
        motion = jacobian[:, :6] @ base[:, :-1]
        motion[:, : self.nj] += jacobian[:, 6:]
        offset = jacobian[:, :6] @ base[:, -1] + (0.0 if contact_bias is None else contact_bias)
        hessian += self._weights.contact * (motion.T @ motion)
        gradient += self._weights.contact * (offset @ motion)

    def solve(self, problem: DynWbcProblem) -> DynWbcResult:
        """Solve an assembled problem.

        Returns:
            The optimum; when the solver gives none, the last optimal torques with the solver's status.
        """
        qp = self._qps[problem.feet]
        solution, relaxed = qp.solve(problem)
        if solution.status != "optimal":
            return replace(self._last, status=solution.status, iterations=solution.iterations)
        x = np.ascontiguousarray(solution.x)
        acceleration, torque, wrench = np.empty(self.nj + 6), np.empty(self.nj), np.zeros(self.nf)
        motion_and_torques(problem.base, problem.torque, x, acceleration, torque)
        wrench[qp.wrenches] = x[self.nj :]
        found = solution.iterations, relaxed, solution.spent
        self._last = DynWbcResult(torque, acceleration, wrench, "optimal", *found)
        return self._last


def _torque_qps(
    contacts: Sequence[SoleContact], effort: Array, solver: str, count: int
) -> dict[tuple[int, ...], TorqueQp]:
    """The problems of each set of feet on the ground, with ``count`` conditions on the acceleration."""
    feet = range(len(contacts))
    sets = itertools.chain.from_iterable(itertools.combinations(feet, size) for size in range(len(contacts) + 1))
    return {standing: TorqueQp(standing, contacts, effort, solver, count) for standing in sets}


def contact_bias_acceleration(kin: Kinematics, frame_ids: Sequence[int]) -> Array:
    """J_c_dot q_dot (6 n,) of frames, in their own axes: classical acceleration at zero joint acceleration."""
    pin.forwardKinematics(kin.model, kin.data, kin.q, kin.v, np.zeros(kin.nv))
    local = pin.ReferenceFrame.LOCAL
    return np.concatenate([pin.getFrameClassicalAcceleration(kin.model, kin.data, i, local).vector for i in frame_ids])
