"""What a resolution is: it picks the input, given the conditions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robots.messages import Array, Indices
from safety.barriers.rows import BarrierRows
from safety.filters.conditions import RowParameters
from safety.filters.conflict import Candidates
from safety.filters.working_set import Problem


@dataclass(frozen=True, slots=True)
class Resolved:
    """What a resolution found.

    Attributes:
        v: shape (nv,) input between its bounds; ``None`` where no solver had an answer.
        unsafe: whether it is the nominal input, because no solution was found.
        candidates: rows among which the conflict is; ``None`` where there is none.
        cause: why there is no v, where more can be said than that.
        spent: whether v is the best that was found before a budget was spent, or as far as rounding let it be found:
            between its bounds, but not proved to be the one that the resolution asks for.
    """

    v: Array | None
    unsafe: bool = False
    candidates: Candidates | None = None
    cause: str = ""
    spent: bool = False


class Resolution(Protocol):
    """Finds an input for one tick's problem; keeps its buffers and warm starts from one to the next."""

    def set_parameters(self, parameters: RowParameters) -> None:
        """Take over the parameters of the rows; called before the first problem, and between two where they change."""
        ...

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """Find it; ``rows`` are those that the conditions were made of."""
        ...


@dataclass(frozen=True, slots=True)
class ResolutionKind:
    """A resolution by name, and how to make one.

    Attributes:
        name: in texts and benchmarks.
        make: from nv, the number of rows and what to do where no input satisfies the conditions (one of
            :data:`safety.filters.settings.INFEASIBLE`).
        joint: whether it looks at all conditions together, so that lost ones may be eased on the way back from behind
            a barrier (:mod:`safety.filters.recovery`).
        acts_when_met: whether it is asked as soon as a condition is active, even where the nominal input satisfies all.
    """

    name: str
    make: Callable[[int, int, str], Resolution]
    joint: bool = True
    acts_when_met: bool = False


def candidates(problem: Problem, working: Indices, lost: Indices | tuple[()] = ()) -> Candidates:
    """The rows that a solver saw and those it was not shown, kept for later."""
    if len(lost):
        working = np.union1d(working, lost)
    A, b = problem.spaces.A[working], problem.spaces.b[working]
    return Candidates(working, A, b, problem.lower, problem.upper)
