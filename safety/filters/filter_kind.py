"""What makes one filter differ from another."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters import own_parameters
from safety.filters.conditions import NO_MARGINS, BarrierParameters, RowParameters
from safety.filters.resolution import ResolutionKind
from safety.filters.second_order import index_rows

Condition = Callable[[BarrierRows, RowParameters], HalfSpaces]
"""Half-spaces that the rows ask for; it must not change the rows."""

Index = Callable[[BarrierRows, Array, RowParameters], BarrierRows]
"""Rows on the acceleration, of rows with curvature and the velocity (nv,)."""


@dataclass(frozen=True, slots=True)
class FilterKind:
    """A condition, a resolution and what belongs to them.

    Example:
        A CBF that asks for a rate of its own besides, one number for each family of barriers::

            @dataclass(frozen=True)
            class Eager:
                rate: float = 0.05

            def eager_cbf(rows, parameters):
                spaces = cbf(rows, parameters)
                return HalfSpaces(spaces.A, spaces.b + parameters.own["rate"], spaces.active)

            register(FilterKind("eager", "eager CBF", eager_cbf, NEAREST, "ours", parameters=Eager()))

    Attributes:
        name: in configurations, on the command line.
        title: in texts and figures.
        condition: half-spaces of the rows; ``None``: no condition, the input passes.
        resolution: which input is taken.
        source: paper and equations.
        margins: margin by family where the parameters give none; families that are not named have 0.
        orders: relative degrees it is defined for: 1, input velocity; 2, input acceleration. A filter of order 2 alone
            is no filter before DynWBC, its conditions are rows of DynWBC's QP.
        index: rows on the acceleration, to which the condition is applied for order 2.
        parameters: defaults of parameters of its own, an instance of a frozen dataclass of numbers; the condition finds
            them row by row in :attr:`safety.filters.conditions.RowParameters.own`. ``None``: it has none.

    Raises:
        ConfigError: a name that cannot be one, an order other than 1 and 2, a margin of no known family, or parameters
            that are not as above.
    """

    name: str
    title: str
    condition: Condition | None
    resolution: ResolutionKind
    source: str
    margins: Mapping[str, float] = field(default_factory=lambda: NO_MARGINS)
    orders: tuple[int, ...] = (1, 2)
    index: Index = index_rows
    parameters: Any = None

    def __post_init__(self) -> None:
        if not self.name or not self.name.replace("-", "_").isidentifier():
            raise ConfigError("name of a filter", self.name, "letters, digits, hyphens and underscores")
        if not self.orders or not set(self.orders) <= {1, 2}:
            raise ConfigError(f"orders of filter {self.name}", self.orders, "(1,), (2,) or (1, 2)")
        if unknown := sorted(set(self.margins) - set(FAMILIES)):
            raise ConfigError(f"margins of filter {self.name}", unknown, "among " + ", ".join(FAMILIES))
        object.__setattr__(self, "margins", dict(NO_MARGINS) | dict(self.margins))
        if self.parameters is not None:
            own_parameters.check_default(self.parameters)

    @property
    def joint(self) -> bool:
        """Whether it looks at all conditions together."""
        return self.resolution.joint

    @property
    def acts_in_dynamics(self) -> bool:
        """Whether its conditions are on the acceleration only, so that they belong into DynWBC's QP."""
        return 1 not in self.orders

    def check(self, parameters: BarrierParameters) -> None:
        """Check that parameters can be this filter's.

        Raises:
            ConfigError: they are no :class:`BarrierParameters`, or those of its own are another filter's.
        """
        if not isinstance(parameters, BarrierParameters):
            raise ConfigError("parameters", parameters, "a BarrierParameters")
        own_parameters.by_family(self.parameters, parameters.own)

    def of_rows(self, parameters: BarrierParameters, family: Indices) -> RowParameters:
        """The parameters row by row, those of its own among them; ``family`` (n,) indexes ``FAMILIES``."""
        own = own_parameters.of_rows(self.parameters, parameters.own, family)
        return parameters.of_rows(family, self.margins, own)
