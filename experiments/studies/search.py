"""The largest value that still holds: a search on a grid, up or down in strides, then by bisection."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Bracket:
    """Where a search goes, in levels of a grid from 1 on.

    Attributes:
        top: highest level to try; 0 for none.
        start: the first to try, 1 or above.
        stride: levels by which it goes up, or down where the first does not hold, until it has a level that holds and
            one that does not; 1 or above.
    """

    top: int
    start: int
    stride: int


def largest_that_holds(holds: Callable[[int], bool], bracket: Bracket) -> int:
    """The largest level that holds before one that does not, by :class:`Bracket`; no level is tried twice.

    Exact where all levels below one that holds do so too. Otherwise a level found holds, the next does not or is
    above the top, and what does not hold between two levels a stride apart that both do is not found.

    Args:
        holds: whether a level does.
        bracket: where to look.

    Returns:
        From 0, where none holds, to ``bracket.top``.
    """
    if bracket.top < 1:
        return 0
    first = min(bracket.start, bracket.top)
    low, high = _above(holds, first, bracket) if holds(first) else _below(holds, first, bracket)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _above(holds: Callable[[int], bool], low: int, bracket: Bracket) -> tuple[int, int]:
    """Up from a level that holds: the last that does, and the first that does not, at most one above the top."""
    while low < bracket.top:
        high = min(low + bracket.stride, bracket.top)
        if not holds(high):
            return low, high
        low = high
    return low, low + 1


def _below(holds: Callable[[int], bool], high: int, bracket: Bracket) -> tuple[int, int]:
    """Down from a level that does not hold: the first that does, 0 at the least, and the last that does not."""
    while (low := max(high - bracket.stride, 0)) > 0:
        if holds(low):
            return low, high
        high = low
    return 0, high
