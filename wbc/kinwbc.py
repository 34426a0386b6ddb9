"""KinWBC: prioritised inverse kinematics by null-space projection."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import lapack

from robots.checks import require_positive
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.damped_priorities import damped_velocity, solve_levels
from wbc.kernels import smallest_block_bound
from wbc.task_block import Level, TaskBlock
from wbc.tasks import PostureTask, Task

NO_POSTURE = np.zeros(0)


def prioritised_velocity(levels: Sequence[Level], nv: int, sigma_min: float) -> Array:
    r"""Generalised velocity that satisfies each level as well as possible without disturbing the ones above.

    .. math:: \dot q_i = \dot q_{i-1} + J_{i|pre}^\dagger (\dot x_i - J_i \dot q_{i-1}),\quad
        J_{i|pre} = J_i N_{i-1}

    The pseudo-inverse sets singular values below ``sigma_min`` to zero; a direction that is cut stays free for the
    levels below, which can then move the task along it by less than ``sigma_min`` times their own step. The recursion
    runs on an orthonormal basis Z of the null space (N = Z Z^T), so that each level decomposes a smaller matrix J_i Z.
    Where triangular factors prove that no singular value is below the cut, one QR of all levels replaces the SVDs; the
    two then agree to rounding.

    Source: Lee et al., "Safety-Critical Whole-Body Control for Humanoid Robots via ISSf-CBFs", eq. (13).

    Args:
        levels: highest priority first; Jacobians (m_i, nv) and commanded velocities (m_i,).
        nv: size of the velocity.
        sigma_min: cut-off of singular values [m or 1, as the rows], above 0.

    Returns:
        Velocity, shape (nv,); its norm is at most the sum over levels of the residual norms over ``sigma_min``.
    """
    velocity, basis, done = _solve_stacked(levels, nv, sigma_min)
    for jacobian, command in levels[done:]:
        if basis.shape[1] == 0:
            break
        step, basis = _solve_level(jacobian, command - jacobian @ velocity, basis, sigma_min)
        velocity = velocity + step
    return velocity


def _solve_stacked(levels: Sequence[Level], nv: int, sigma_min: float) -> tuple[Array, Array, int]:
    """All leading levels that fit in one QR of the stacked Jacobians, if every one of them is regular.

    With J^T = Q R, the diagonal blocks of R are the projected Jacobians J_{i|pre} in the basis Q_i, and forward
    substitution through R^T carries out the recursion. Returns the velocity, the basis of the null space that is
    left and the number of levels solved: 0 where a level is not certainly regular.
    """
    sizes = [command.size for _, command in levels]
    count = 0
    while count < len(sizes) and sum(sizes[: count + 1]) <= nv:
        count += 1
    if count == 0:
        return np.zeros(nv), np.eye(nv), 0
    stacked = np.concatenate([jacobian for jacobian, _ in levels[:count]])
    command = np.concatenate([c for _, c in levels[:count]])
    m = command.size
    # LAPACK directly: numpy's wrapper costs more than the factorisation at this size
    packed, tau, _, _ = lapack.dgeqrf(stacked.T)
    inverse, info = lapack.dtrtri(packed[:m])
    if info != 0 or smallest_block_bound(inverse, np.array(sizes[:count])) <= sigma_min:
        return np.zeros(nv), np.eye(nv), 0
    q = _orthonormal(packed, tau)
    coordinates, _ = lapack.dtrtrs(packed[:m], command, trans=1)
    return q[:, :m] @ coordinates, q[:, m:], count


def _orthonormal(packed: Array, tau: Array) -> Array:
    """The square orthonormal factor (k, k) of a packed QR of a (k, m) matrix, m <= k."""
    k, m = packed.shape
    full = np.zeros((k, k), order="F")
    full[:, :m] = packed
    reflectors = np.zeros(k)
    reflectors[:m] = tau
    q, _, _ = lapack.dorgqr(full, reflectors, overwrite_a=1)
    return q


def _solve_level(jacobian: Array, residual: Array, basis: Array, sigma_min: float) -> tuple[Array, Array]:
    """One level: the step (nv,) inside the span of ``basis`` and the basis of what is left below it."""
    projected = jacobian @ basis
    m, k = projected.shape
    if m > k:
        return _solve_tall(projected, residual, basis, sigma_min)
    return _solve_svd(projected, residual, basis, sigma_min)


def _solve_tall(projected: Array, residual: Array, basis: Array, sigma_min: float) -> tuple[Array, Array]:
    """More rows than freedom left (the posture): least squares through the small normal matrix."""
    gram = projected.T @ projected
    factor, info = lapack.dpotrf(gram)
    if info == 0:
        inverse, info = lapack.dtrtri(factor)
        # squaring halves the digits: singular values above 0.01 still leave the answer good to 1e-12
        if info == 0 and smallest_block_bound(inverse, np.array([gram.shape[0]])) > max(sigma_min, 1e-2):
            solution, _ = lapack.dpotrs(factor, projected.T @ residual)
            return basis @ solution, basis[:, :0]
    return _solve_svd(projected, residual, basis, sigma_min)


def _solve_svd(projected: Array, residual: Array, basis: Array, sigma_min: float) -> tuple[Array, Array]:
    """Truncated SVD: singular values below the cut are set to zero and their directions stay free."""
    u, sigma, vt = np.linalg.svd(projected)
    rank = int((sigma > sigma_min).sum())
    coordinates = (u[:, :rank].T @ residual) / sigma[:rank]
    return basis @ (vt[:rank].T @ coordinates), basis @ vt[rank:].T


class KinWbc:
    """Stack of tasks by priority; evaluates them and solves for the desired generalised velocity.

    Where a level becomes singular, small singular values are damped (:mod:`wbc.damped_priorities`: the velocity is
    continuous, and the default of what drives torques) or cut off (:func:`prioritised_velocity`, eq. (13) of Lee et
    al.: it jumps where one passes the cut, hundreds of times a run where an arm is straight).

    Args:
        nv: size of the velocity.
        levels: tasks of each priority level, highest first; each task in one place.
        sigma_min: cut-off of singular values, above 0.
        damped_below: below which singular values of each level that has tasks are damped, above 0; that of a posture of
            all joints in the last level is not read. ``None``: they are cut off.

    Raises:
        ConfigError: ``sigma_min`` or a threshold is not positive, there is not one threshold a level, or a task stands
            in more than one place.
    """

    def __init__(
        self,
        nv: int,
        levels: Sequence[Sequence[Task]],
        sigma_min: float = 0.03,
        damped_below: Sequence[float] | None = None,
    ) -> None:
        self.nv = nv
        self.levels = tuple(tuple(level) for level in levels if level)
        self.set_thresholds(sigma_min, damped_below)
        self._block = TaskBlock(nv, self.levels)
        last = self.levels[-1] if self.levels else ()
        self._posture = len(last) == 1 and isinstance(last[0], PostureTask) and last[0].nv_base + last[0].rows == nv

    @property
    def sigma_min(self) -> float:
        """Cut-off of singular values; see :meth:`set_thresholds`."""
        return self._sigma_min

    def set_thresholds(self, sigma_min: float, damped_below: Sequence[float] | None) -> None:
        """Treat small singular values in another way from the next solution on; see :class:`KinWbc`.

        Raises:
            ConfigError: one is not positive, or there is not one a level; nothing changes.
        """
        require_positive("sigma_min", sigma_min)
        if damped_below is not None:
            if len(damped_below) != len(self.levels):
                raise ConfigError("damped_below", list(damped_below), f"{len(self.levels)} numbers, one a level")
            for threshold in damped_below:
                require_positive("damped_below", threshold)
        self._sigma_min = sigma_min
        self._thresholds = None if damped_below is None else np.array(damped_below, dtype=float)

    def evaluate(self, kin: Kinematics) -> list[Level]:
        """Jacobian and command of each level, tasks of one level stacked; views that the next call overwrites.

        Raises:
            TargetNotSetError: the target of a task was never set.
        """
        return self._block.evaluate(kin)

    @property
    def jacobian(self) -> Array:
        """Jacobian (m, nv) of all levels, highest priority first, as evaluated last; a view."""
        return self._block.jacobian

    def reset(self) -> None:
        """Forget the last evaluation, see :attr:`wbc.tasks.TaskGains.max_change`."""
        self._block.reset()

    def solve(self, levels: Sequence[Level]) -> Array:
        """Desired generalised velocity (nv,) of evaluated levels, all or the highest ones."""
        if self._thresholds is None:
            return prioritised_velocity(levels, self.nv, self._sigma_min)
        # a posture is the last of all levels
        count = len(levels) - (self._posture and len(levels) == len(self.levels))
        posture = levels[-1][1] if count < len(levels) else NO_POSTURE
        if levels is not self._block.levels:
            return damped_velocity(levels[:count], self.nv, self._thresholds[:count], posture)
        rows = self._block.command.size - posture.size
        block, sizes, thresholds = self._block, self._block.sizes[:count], self._thresholds[:count]
        return solve_levels(block.jacobian[:rows], block.command[:rows], sizes, thresholds, posture)
