"""A filter's conditions, with the parameters that each row has."""

from collections.abc import Callable

import numpy as np

from robots.messages import Array, Indices
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, RowParameters
from safety.filters.filter_kind import FilterKind
from safety.filters.second_order import without_margin
from wbc.qp import UNBOUNDED


class RowConditions:
    """Conditions of one filter; lays the families' parameters out row by row, once as long as both stay the same.

    Attributes:
        kind: the filter.
        parameters: by family; see :meth:`set_parameters`.
        of_rows: row by row, of the rows that were prepared for last.
    """

    def __init__(
        self, kind: FilterKind, parameters: BarrierParameters, tell: Callable[[RowParameters, bool], None]
    ) -> None:
        """``tell`` is called with new parameters of the rows, and whether the rows are others than those before.

        Raises:
            ConfigError: parameters of another filter.
        """
        kind.check(parameters)
        self.kind, self.parameters, self._tell = kind, parameters, tell
        self.of_rows: RowParameters
        self._key: bytes | None = None
        self._families: Indices | None = None

    def set_parameters(self, parameters: BarrierParameters) -> None:
        """Take other parameters.

        Raises:
            ConfigError: they are no :class:`BarrierParameters`, or have parameters of another filter; nothing changes.
        """
        self.kind.check(parameters)
        self.parameters = parameters
        if self._families is not None:
            self._lay_out(self._families, others=False)

    def prepare(self, family: Indices) -> str:
        """Make ready for rows of these families (n_rows,); why not, in words."""
        if self.kind.condition is None:
            return ""
        # a fraction of the time of numpy's comparison
        if (key := family.tobytes()) == self._key:
            return ""
        if family.dtype.kind not in "iu" or not ((family >= 0) & (family < len(FAMILIES))).all():
            return f"family of the barrier rows has to be integers from 0 to {len(FAMILIES) - 1}"
        others = self._families is not None
        self._key, self._families = key, family.copy()
        self._lay_out(self._families, others)
        return ""

    def _lay_out(self, family: Indices, others: bool) -> None:
        self.of_rows = self.kind.of_rows(self.parameters, family)
        self._without_margin = without_margin(self.of_rows)
        self._tell(self.of_rows, others)

    def spaces(self, rows: BarrierRows, velocity: Array | None, parameters: RowParameters) -> HalfSpaces:
        """The conditions on the input, those that are not active out of reach of any.

        Args:
            rows: of the families that were prepared for.
            velocity: shape (nv,) measured, where the input is an acceleration; ``None`` where it is a velocity.
            parameters: ``of_rows``, or these with other numbers for this tick.
        """
        assert self.kind.condition is not None
        if velocity is not None:
            rows, parameters = self.kind.index(rows, velocity, parameters), self._without_margin
        spaces = self.kind.condition(rows, parameters)
        if spaces.active.all():
            return spaces
        return HalfSpaces(spaces.A, np.where(spaces.active, spaces.b, -UNBOUNDED), spaces.active)
