"""Conditions that may be violated: the least sum of squares, by Newton steps that never increase it."""

import numpy as np

from robots.messages import Array, Indices
from wbc.active_set import OPTIMAL, SPENT
from wbc.descent import Violated, descend

STEPS = 36
"""Budget: Newton steps of one search for the least slack."""

DIRECT = 12
"""Steps after which a search that has not ended starts anew with the cost in the foreground,"""

STAGES = (1e4, 1e2, 1.0)
"""times these factors in turn: each answer is a good start for the next, and together they take fewer steps."""

ROUNDS = 300
"""Budget: changes of the active set in all of them together."""


class LeastSlack:
    """Solves problems of one size, each from the last one's point and active set; see :func:`wbc.descent.descend`.

    Attributes:
        short: shape (k,) by how much each row falls short at the last answer; below 0 where it does not.
        steps: made for it.
        rounds: changes of the active set in these.
    """

    def __init__(self, n: int, k: int, m: int = 0, steps: int = STEPS, rounds: int = ROUNDS) -> None:
        """For ``n`` variables, ``k`` rows that may be violated and ``m`` that must hold."""
        self.short = np.zeros(k)
        self.steps = self.rounds = 0
        self._guess = np.zeros(n + 1, dtype=np.int64)
        self._violated = Violated(np.zeros((n, n)), np.zeros(n), np.zeros(k, dtype=bool))
        self._steps, self._rounds = steps, rounds
        self._cost, self._limits = (np.zeros((n, n)), np.zeros(n)), (np.zeros((m, n)), np.zeros(n + m), np.zeros(n + m))
        self._soft, self._best = (np.zeros((k, n)), np.zeros(k), np.zeros(k)), np.zeros(n)

    def solve(
        self,
        hessian: Array,
        gradient: Array,
        soft: tuple[Array, Array, Array],
        rows: Array,
        lower: Array,
        upper: Array,
        start: Array,
        guess: Indices | None = None,
        *,
        direct: bool = False,
    ) -> tuple[int, Array]:
        """Outcome and x (n,), new.

        Args:
            hessian: shape (n, n).
            gradient: shape (n,).
            soft: the rows (k, n) that may be violated, their demands (k,) and weights (k,).
            rows: shape (m, n) that must hold.
            lower: shape (n + m,).
            upper: shape (n + m,).
            start: shape (n,) a point that meets the limits.
            guess: limits active there, as :func:`wbc.active_set.search` has them; ``None`` for those of last time.
            direct: whether to make the first ``DIRECT`` steps only; :meth:`go_on` makes the rest.
        """
        if guess is not None:
            self._guess[:] = guess
        self.steps = self.rounds = 0
        for part in self._violated:
            part.fill(0)
        self._cost, self._soft, self._limits = (hessian, gradient), soft, (rows, lower, upper)
        outcome, self._best = self._descend(1.0, start, min(DIRECT, self._steps))
        return (outcome, self._best) if direct or outcome == OPTIMAL else self.go_on()

    def go_on(self) -> tuple[int, Array]:
        """The rest of :meth:`solve`, for the problem that it was given last and from where it has ended."""
        outcome, best, x = SPENT, self._best, self._best
        best_short, least = self.short.copy(), self._value(best)
        for stage in STAGES:
            outcome, x = self._descend(stage, x, self._steps - self.steps)
            value = self._value(x)
            if value < least or (outcome == OPTIMAL and stage == 1.0):
                best, best_short, least = x, self.short.copy(), value
            if outcome != OPTIMAL:
                break
        self.short[:] = best_short
        return outcome, best

    def _descend(self, stage: float, start: Array, steps: int) -> tuple[int, Array]:
        """Outcome and x (n,), new, after so many steps at most, with the cost times ``stage``."""
        x, budget = start.copy(), (steps, max(0, self._rounds - self.rounds))
        hessian, gradient = self._cost
        cost = (hessian, gradient) if stage == 1.0 else (stage * hessian, stage * gradient)
        outcome, made, rounds = descend(
            cost, self._soft, self._limits, self._guess, budget, self._violated, x, self.short
        )
        self.steps += made
        self.rounds += rounds
        return outcome, x

    def _value(self, x: Array) -> float:
        """What the point found last costs."""
        (hessian, gradient), weights, violation = self._cost, self._soft[2], np.maximum(self.short, 0.0)
        return float(x @ (0.5 * (hessian @ x) + gradient) + 0.5 * (weights * violation) @ violation)
