r"""The way out of a barrier that is broken: at a bounded speed, by commands that change at a bounded rate.

Where :math:`h_i < 0` there is no invariance to keep, only a return, and what the conditions ask for there has no bound: a
start 11 cm inside asks for 0.7 m/s at once, and bodies that deep overlap with several others, whose rows all but
contradict each other; what meets them all is tens of rad/s. So once a row is deeper than its *recovery depth*
:math:`d_i`, what rows with :math:`h_i < 0` ask for is eased. Rows with :math:`h_i \ge 0` are left as they are, and go
before the others. With :math:`D_i(h)` what the condition asks of :math:`\dot h_i`, v' the last command and
:math:`\theta_i = \min(1, -h_i / d_i)`:

.. math::
    D_i' &= \min(D_i(h_i),\; D_i(0) + r_i) \\
    D_i'' &= D_i' - \theta_i \max(0,\; D_i' - (J_i v' + \partial_t h_i + a_i\,dt)) \\
    v^r &= \arg\min_v \|v - \bar v\|_H^2 + \sum_{h_i < 0} \frac{\kappa}{\theta_i J_i H^{-1} J_i^T}
        \max(0,\; D_i'' - J_i v - \partial_t h_i)^2, \quad \bar v = v' + s (v^{des} - v')

with rows of :math:`h_i \ge 0` as constraints, and s at most 1 such that no entry of :math:`\bar v - v'` is above
:math:`u\,dt`. The filter is then given :math:`\bar v` as the nominal velocity and :math:`\min(D_i'', J_i v^r +
\partial_t h_i)` as what the lost rows ask for. So

- nothing is asked to leave faster than :math:`D_i(0) + r_i`, nor to become faster by more than :math:`a_i\,dt` a tick;
- v' itself meets the lost rows to within :math:`a_i\,dt`, so as far as rows with :math:`h \ge 0` leave it alone the
  command moves by at most :math:`\|v - v'\|_H \le 2 \|\bar v - v'\|_H + (\kappa \sum_i (a_i dt)^2 / (\theta_i J_i H^{-1}
  J_i^T))^{1/2}` a tick, however much the lost rows contradict each other;
- all of it is continuous in h, and vanishes for :math:`h_i \to 0`, where a row is as hard as any.

What is left of the return: a row that is alone, or agrees with the others, comes back at
:math:`\kappa / (\kappa + \theta_i)` of D'' or more, once its ramp is over at least as fast as

.. math:: \dot h \ge \frac{\kappa}{\kappa + 1} \min(-\alpha h,\; r)

(for CBF; of ISSf-CBF's :math:`\|J\|^2 / \varepsilon` and SSA's :math:`\eta` the same share comes on top). From
:math:`-h_0` it is therefore within :math:`r/\alpha` of the boundary after :math:`(\kappa + 1)/\kappa\,(h_0/r) + r/a` at
the latest, and approaches it with rate :math:`\alpha` from there. Rows that contradict each other share what can be
had, in the least squares' sense.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from robots.checks import require_positive
from robots.messages import Array, Mask
from safety.conditions import RowParameters
from safety.rows import BarrierRows, HalfSpaces
from wbc.qp import UNBOUNDED, QpSolver, make_solver

SOFT_ROWS = 64
"""So many lost rows are weighed against each other, the deepest; what the others ask for is cut to what comes of it."""

RELEASE = 0.2
"""So long no row has to be lost before nothing is eased any more [s]."""

ROUNDING = 1e-7
"""Room [m/s, rad/s] given to lost rows, so that rounding does not make them contradict each other."""

SHORT = 1e-12
"""Added to the squared length of a row [m^2]: nothing moves a row without length."""


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """How a filter comes back from behind a barrier.

    Attributes:
        stiffness: kappa, above 0: how much what lost rows ask for weighs against the change of velocity. A row alone
            gets the share kappa / (kappa + 1) of it.
        acceleration: u, largest change of the nominal velocity per time [rad/s^2, m/s^2 for the base], above 0.
    """

    stiffness: float = 20.0
    acceleration: float = 25.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"recovery {name}", getattr(self, name))


@dataclass(frozen=True, slots=True)
class Eased:
    """What a filter is given while rows are lost.

    Attributes:
        spaces: the conditions, those of lost rows eased.
        v_des: shape (nv,) nominal velocity near the last command.
    """

    spaces: HalfSpaces
    v_des: Array


class Recovery:
    """Eases what lost rows ask for; remembers the last command."""

    def __init__(self, nv: int, n_rows: int, settings: RecoverySettings, dt: float) -> None:
        """For ``nv`` variables, ``n_rows`` rows and a tick of ``dt`` [s]; the last command is rest."""
        self.settings, self._dt = settings, dt
        self._soft, self._n_rows = min(SOFT_ROWS, n_rows), n_rows
        self._last = np.zeros(nv)
        self._waited = np.inf
        self._solver: QpSolver | None = None

    def note(self, v: Array) -> None:
        """The command (nv,) that was given in the end."""
        self._last = v

    def ease(
        self,
        rows: BarrierRows,
        spaces: HalfSpaces,
        at_zero: Callable[[BarrierRows], HalfSpaces],
        parameters: RowParameters,
        v_des: Array,
        metric: Callable[[], Array],
        limit: Array,
    ) -> Eased | None:
        """What to filter instead; ``None`` where no row is lost, and none has been of late.

        Args:
            rows: n barrier rows.
            spaces: the conditions on the velocity.
            at_zero: the condition.
            parameters: recovery_depth, recovery_speed and recovery_acceleration are read.
            v_des: shape (nv,) nominal velocity.
            metric: gives H, shape (nv, nv).
            limit: shape (nv,) bounds on the size of the velocity.
        """
        lost = spaces.active & (rows.h < 0)
        if not self._is_engaged(rows, lost, parameters):
            return None
        step = v_des - self._last
        largest = float(np.abs(step).max(initial=0.0))
        share = min(1.0, self.settings.acceleration * self._dt / largest) if largest > 0 else 1.0
        nominal = self._last + share * step
        if not lost.any():
            return Eased(spaces, nominal)
        theta = np.clip(-rows.h / parameters.recovery_depth, 0.0, 1.0)
        zero = at_zero(replace(rows, h=np.maximum(rows.h, 0.0))).b
        b = np.where(lost, np.minimum(spaces.b, zero + parameters.recovery_speed), spaces.b)
        ramp = spaces.A @ self._last + parameters.recovery_acceleration * self._dt
        b = b - np.where(lost, theta * np.maximum(0.0, b - ramp), 0.0)
        v = self._compromise(spaces.A, b, lost, theta, nominal, metric(), limit)
        if v is not None:
            b = np.where(lost, np.minimum(b, spaces.A @ v - ROUNDING), b)
        return Eased(HalfSpaces(spaces.A, b, spaces.active), nominal)

    def _is_engaged(self, rows: BarrierRows, lost: Mask, parameters: RowParameters) -> bool:
        if self._waited >= RELEASE and not (lost & (-rows.h > parameters.recovery_depth)).any():
            return False
        self._waited = 0.0 if lost.any() else self._waited + self._dt
        return True

    def _compromise(
        self, A: Array, b: Array, lost: Mask, theta: Array, nominal: Array, hessian: Array, limit: Array
    ) -> Array | None:
        """The velocity (nv,) that weighs the lost rows against each other; ``None`` where the solver has no answer."""
        soft = np.flatnonzero(lost)
        soft = soft[np.argsort(-theta[soft], kind="stable")[: self._soft]]
        length = np.vecdot(A[soft], np.linalg.solve(hessian, A[soft].T).T)
        scale = np.sqrt(self.settings.stiffness / (theta[soft] * (length + SHORT)))
        others = np.where(lost, -UNBOUNDED, b)
        for held in (others, np.full_like(others, -UNBOUNDED)):
            v = self._solve(A, held, A[soft] * scale[:, None], b[soft] * scale, nominal, hessian, limit)
            if v is not None:
                return v
        return None

    def _solve(
        self, A: Array, held: Array, soft: Array, asked: Array, nominal: Array, hessian: Array, limit: Array
    ) -> Array | None:
        n, k, m = nominal.size, self._soft, self._n_rows
        if self._solver is None:
            self._solver = make_solver("daqp", n, k + m, np.concatenate([np.ones(k), np.full(m, np.inf)]))
        matrix = np.concatenate([soft, np.tile(np.eye(1, n), (k - len(soft), 1)), A])
        lower = np.concatenate([-limit, asked, np.full(k - len(soft), -UNBOUNDED), held])
        upper = np.concatenate([limit, np.full(k + m, UNBOUNDED)])
        solution = self._solver.solve(hessian, -(hessian @ nominal), matrix, lower, upper)
        return solution.x if solution.status == "optimal" else None
