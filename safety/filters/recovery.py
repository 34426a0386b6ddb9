r"""The way out of a barrier that is broken: at a bounded speed, by commands that change at a bounded rate.

Where :math:`h_i < 0` there is no invariance to keep, only a return, and what conditions ask for there has no bound: a
start 11 cm inside asks for 0.7 m/s at once, and bodies that deep overlap with several others, whose rows all but
contradict each other: what meets them all is tens of rad/s. So where a row below its *recovery depth*,
:math:`h_i < -d_i`, asks for something sudden (``SUDDEN``), what rows with :math:`h_i < 0` ask for is eased, until none
is left and what came of it is used up. A row that sinks as deep while the command does what is asked eases nothing.
Rows with :math:`h_i \ge 0` go before the others. Of what they ask, what keeps them from falling counts at once, what is
to bring them away from their boundary grows as gradually. With :math:`D_i(h)` what the condition asks of
:math:`\dot h_i`, v' the last command and :math:`\theta_i = \min(1, -h_i / d_i)`, 0 where :math:`h_i \ge 0`:

.. math::
    D_i' &= \min(\max(D_i(h_i),\; \theta_i r_i),\; D_i(0) + r_i) \quad (h_i < 0), \qquad D_i(h_i) \quad (h_i \ge 0) \\
    R_i &= J_i v' + \partial_t h_i + a_i\,dt \\
    D_i'' &= (1 - \theta_i) \min(D_i',\; \max(0, R_i)) + \theta_i \min(D_i', R_i) \\
    v^r &= \arg\min_v \|v - \bar v\|_H^2 + \sum_{h_i < 0} \frac{\kappa}{\theta_i J_i H^{-1} J_i^T}
        \max(0,\; D_i'' - J_i v - \partial_t h_i)^2

with the rows of :math:`h_i \ge 0` as constraints. The nominal velocity :math:`\bar v` is :math:`v^{des}` and what is
left of the last correction, :math:`w' = v' - v^{des\prime}`, after its largest entry has lost :math:`u\,dt` (a fraction
of that, ``HELD``, while a row is lost). The filter is then given :math:`\bar v`, and asks
:math:`\min(D_i'', J_i v^r + \partial_t h_i)` of the lost rows. So

- nothing is asked to leave faster than :math:`D_i(0) + r_i`, nor to become faster by more than :math:`a_i\,dt` a tick
  where it does not fall;
- v' meets rows deeper than :math:`d_i` to within :math:`a_i\,dt`, so as far as turns of :math:`J_i` and the rows that
  hold leave it alone the command moves by at most
  :math:`\|v - v'\|_H \le 2 \|\bar v - v'\|_H + (\kappa \sum_i (a_i\,dt)^2 / (\theta_i J_i H^{-1} J_i^T))^{1/2}` a tick,
  however much the lost rows contradict each other, summed over the rows deeper than :math:`d_i`; shallower ones that
  would fall otherwise are met at once;
- what the rows ask for is continuous in h, and for :math:`h_i \to 0` a row is as hard as any.

What the return keeps, for any filter: where a row is alone or agrees with the others, and
:math:`J_i (\bar v - v') \ge -U\,dt` with :math:`U < \kappa a`, its rate grows by :math:`(\kappa a - U)/(\kappa + 1)`
until it is

.. math:: \dot h \ge \theta\, r',\qquad r' = r - U\,dt/\kappa

to a fraction of :math:`1/\kappa` at most. From :math:`-h_0` the row is at :math:`-d` after
:math:`h_0/r' + r(\kappa + 1)/(\kappa a - U)` at the latest, and comes closer as :math:`e^{-r' t/d}` or faster. A
velocity that is followed to within :math:`\delta < r'` (in the rate of h) brings it to :math:`-d\,\delta/r'`. Rows
that contradict each other share what can be had, in the least squares' sense: of these nothing is guaranteed but the
bounds above. r-SSA relaxes what is asked by its own price on top, as it does everywhere.

Eased rows with :math:`h_i \ge 0` stay eased until they ask for all they do otherwise, lost rows or not. While they are,
the ISSf-CBF's guarantee :math:`h \ge -\varepsilon \delta^2 / (4 \alpha)` is suspended for them: they may not fall by
what the filter asks, but nothing makes up for a disturbance yet.

The search for :math:`v^r` has a budget (``ROUNDS``). Where the rows that hold contradict each other,
it is done once more without those. Where it is spent, lost rows are asked for what the last command gives them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from robots.checks import require_positive
from robots.messages import Array, Mask
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import RowParameters
from safety.filters.filter_kernels import ease
from safety.filters.working_set import NOT_WANTED
from safety.geometry.contact_rows import packed
from wbc.active_set import CONTRADICTION, OPTIMAL, ActiveSet
from wbc.qp import UNBOUNDED
from wbc.triangular import squared_lengths

SOFT_ROWS = 64
"""So many lost rows are weighed against each other, the deepest; what the others ask for is cut to what comes of it."""

SUDDEN = 0.2
"""A deep row that the last command is short of by more than this fraction of its recovery speed is eased."""

ROUNDS, ALONE = 60, 20
"""Budget: changes of the active set in the search for the velocity that weighs lost rows; and in one without the rows
that hold, where these contradict each other, at least: it has what the first one left of its own."""

CARRIED = 3.0
"""Largest entry of the last correction that is carried on [rad/s, m/s]."""

HELD = 0.2
"""Fraction of its acceleration at which the nominal velocity may take over again as long as a row is lost."""

SETTLED = 0.05
"""The last correction counts as used up once less than this fraction of what it may lose in a tick is lost,"""

RELEASE = 2.0
"""or after so long without a lost row [s]."""

ROUNDING = 1e-7
"""Room [m/s, rad/s] given to lost rows, so that rounding does not make them contradict each other."""

SHALLOW = 1e-9
"""Fraction of its recovery depth that a lost row counts as deep at least, as it is weighed."""

SHORT = 1e-12
"""Added to the squared length of a row [m^2]: nothing moves a row without length, and none that is shorter counts."""


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """How a filter comes back from behind a barrier.

    Attributes:
        weight: kappa, above 0: how much what lost rows ask for weighs against the change of velocity. A row alone
            gets the fraction kappa / (kappa + 1) of it.
        acceleration: u, largest change of the nominal velocity per time [rad/s^2, m/s^2 for the base], above 0.
    """

    weight: float = 20.0
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
        self._softness = np.zeros(nv + n_rows)
        self._lower, self._upper = np.zeros(nv + n_rows), np.full(nv + n_rows, UNBOUNDED)
        # each goes on from what it had active itself: with the rows that hold, and without
        self._search, self._search_alone = (
            ActiveSet(nv, n_rows, self._softness, ROUNDS, soft_room=min(SOFT_ROWS, n_rows)) for _ in range(2)
        )
        self._last = self._correction = np.zeros(nv)
        self._moved, self._waited, self._held_back = 0.0, RELEASE, False

    def reset(self) -> None:
        """The last command is rest, and no row was lost."""
        self._last = self._correction = np.zeros_like(self._last)
        self._moved, self._waited, self._held_back = 0.0, RELEASE, False

    def note(self, v_des: Array, v: Array) -> None:
        """The nominal velocity (nv,), and the command (nv,) that was given in the end; both of an earlier tick."""
        correction = v - v_des
        if self._waited < RELEASE:
            self._moved = float(np.abs(correction - self._correction).max(initial=0.0))
        self._last, self._correction = v.copy(), correction

    def ease(
        self,
        rows: BarrierRows,
        spaces: HalfSpaces,
        condition: Callable[[BarrierRows, RowParameters], HalfSpaces],
        parameters: RowParameters,
        v_des: Array,
        metric: Callable[[], Array],
        limit: Array,
    ) -> Eased | None:
        """What to filter instead; ``None`` where no row is lost, and what came of the last that were is used up.

        Args:
            rows: n barrier rows.
            spaces: the conditions on the velocity.
            condition: makes them.
            parameters: recovery_depth, recovery_speed and recovery_acceleration are read.
            v_des: shape (nv,) nominal velocity.
            metric: gives H, shape (nv, nv).
            limit: shape (nv,) bounds on the size of the velocity.
        """
        if self._waited >= RELEASE and not rows.h.min(initial=0.0) < 0.0:
            return None
        lost = spaces.active & (rows.h < 0)
        if not self._is_engaged(lost, rows, spaces, parameters):
            return None
        nominal = v_des + self._carried(lost)
        at_zero = spaces.b
        if any_lost := bool(lost.any()):
            at_zero = condition(replace(rows, h=np.maximum(rows.h, 0.0)), parameters).b
        theta, b = np.empty(lost.size), np.empty(lost.size)
        h, dh_dt, A, asked, at_zero, last = packed(rows.h, rows.dh_dt, spaces.A, spaces.b, at_zero, self._last)
        bounds = parameters.recovery_depth, parameters.recovery_speed, parameters.recovery_acceleration
        self._held_back = ease(h, dh_dt, lost, A, asked, at_zero, last, *bounds, self._dt, theta, b)
        if any_lost:
            v = self._compromise(A, b, lost, theta, nominal, metric(), limit)
            b[lost] = np.minimum(b, A @ (self._last if v is None else v) - ROUNDING)[lost]
        return Eased(HalfSpaces(spaces.A, b, spaces.active), nominal)

    def _carried(self, lost: Mask) -> Array:
        """What is left of the last correction, shape (nv,)."""
        largest, less = float(np.abs(self._correction).max(initial=0.0)), self.settings.acceleration * self._dt
        kept = min(largest, CARRIED) - less * (HELD if lost.any() else 1.0)
        return kept / largest * self._correction if kept > 0.0 else np.zeros_like(self._correction)

    def _is_engaged(self, lost: Mask, rows: BarrierRows, spaces: HalfSpaces, parameters: RowParameters) -> bool:
        if self._waited < RELEASE:
            used_up = not self._held_back and self._moved < SETTLED * self.settings.acceleration * self._dt
            self._waited = 0.0 if lost.any() else RELEASE if used_up else self._waited + self._dt
        elif lost.any():
            sudden = spaces.b - spaces.A @ self._last > SUDDEN * parameters.recovery_speed
            if (lost & sudden & (-rows.h > parameters.recovery_depth)).any():
                # what was changed before has nothing to do with these rows
                self._waited, self._correction = 0.0, np.zeros_like(self._correction)
        return self._waited < RELEASE

    def _compromise(
        self, A: Array, b: Array, lost: Mask, theta: Array, nominal: Array, hessian: Array, limit: Array
    ) -> Array | None:
        """The velocity (nv,) that weighs the lost rows against each other; ``None`` where the solver has no answer."""
        soft = np.flatnonzero(lost)
        if soft.size > SOFT_ROWS:
            soft = np.sort(soft[np.argsort(-theta[soft], kind="stable")[:SOFT_ROWS]])
        length = np.empty(soft.size)
        if not squared_lengths(hessian, A, soft, length):
            # weights too large to reckon with
            return None
        # a row that nothing moves has no say in how to move
        soft, length = soft[length > SHORT], length[length > SHORT]
        n = nominal.size
        self._softness[:] = 0.0
        self._softness[n + soft] = np.maximum(theta[soft], SHALLOW) * (length + SHORT) / self.settings.weight
        self._lower[:n], self._upper[:n] = -limit, limit
        self._lower[n:] = np.where(lost, -UNBOUNDED, b)
        self._lower[n + soft] = b[soft]
        gradient, sides = -(hessian @ nominal), (self._lower, self._upper)
        outcome, v = self._search.solve(hessian, gradient, A, *sides, NOT_WANTED)
        if outcome == CONTRADICTION:
            self._lower[n:] = -UNBOUNDED
            self._lower[n + soft] = b[soft]
            left = max(ALONE, ROUNDS - self._search.changes)
            outcome, v = self._search_alone.solve(hessian, gradient, A, *sides, NOT_WANTED, left)
        return v if outcome == OPTIMAL else None
