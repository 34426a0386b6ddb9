"""The filters by name: those that come with the project, and those that are registered from outside.

A filter of one's own is found by its name once :func:`register` was called with it, or where an installed package
names it in its entry points,

.. code-block:: toml

    [project.entry-points."safewbc.filters"]
    eager = "my_package.filters:EAGER"

under the filter's own name, or by ``module:name``, for which the module is imported first, from the working directory
too: it registers the filter as it is imported. The last two work in every process, those of a study's workers too.
"""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType

from robots.errors import ConfigError
from robots.own_modules import import_own
from safety.filters.conditions import SET_MARGINS, cbf, issf_cbf, ssa, sss, worst_row
from safety.filters.filter_kind import FilterKind
from safety.filters.pushes import CARTESIAN_PUSH, JOINT_PUSH, PASS_THROUGH
from safety.filters.resolutions import NEAREST, SLACK, TWO_PHASE
from safety.filters.second_order import ecbf_rows

ENTRY_POINTS = "safewbc.filters"
"""Group of entry points that name filters, each an object of :class:`FilterKind`."""

LEE = "Lee et al., Safety-Critical Whole-Body Control for Humanoid Robots via ISSf-CBFs"
PSSA = "p-SSA paper"
SPARK = "SPARK"

_BUILT_IN = (
    FilterKind("none", "no filter", None, PASS_THROUGH, f"baseline w/o-CBF of {LEE}"),
    FilterKind("cbf", "CBF", cbf, NEAREST, f"{LEE}, eqs. (5), (31), (33); {SPARK}, eq. (6)"),
    FilterKind("issf", "ISSf-CBF", issf_cbf, NEAREST, f"{LEE}, eqs. (32), (33)"),
    FilterKind("ecbf", "eCBF", cbf, NEAREST, f"{LEE}, eqs. (54), (55)", orders=(2,), index=ecbf_rows),
    FilterKind("ssa", "SSA", ssa, NEAREST, f"{PSSA}, eq. (9); {SPARK}, eq. (5)", SET_MARGINS),
    FilterKind("rssa", "r-SSA", ssa, SLACK, f"{PSSA}, eq. (10)", SET_MARGINS),
    FilterKind("pssa", "p-SSA", ssa, TWO_PHASE, f"{PSSA}, eqs. (12), (13)", SET_MARGINS),
    FilterKind("sss", "SSS", sss, NEAREST, f"{SPARK}, eq. (7)", SET_MARGINS),
    FilterKind("pfm", "PFM", worst_row, CARTESIAN_PUSH, f"{SPARK}, eqs. (8)-(10)", SET_MARGINS),
    FilterKind("sma", "SMA", worst_row, JOINT_PUSH, f"{SPARK}, eqs. (12), (13)", SET_MARGINS),
)

FILTERS = tuple(kind.name for kind in _BUILT_IN)
"""Names of the filters that come with the project."""

_kinds: dict[str, FilterKind] = {kind.name: kind for kind in _BUILT_IN}

KINDS: Mapping[str, FilterKind] = MappingProxyType(_kinds)
"""All filters registered so far, by name; :func:`register` adds one."""


def register(kind: FilterKind) -> FilterKind:
    """Make a filter known by its name; returns it.

    Raises:
        ConfigError: it is no :class:`FilterKind`, or the name is that of another filter.
    """
    if not isinstance(kind, FilterKind):
        raise ConfigError("filter", kind, "a FilterKind")
    if _kinds.setdefault(kind.name, kind) is not kind:
        raise ConfigError("name of a filter", kind.name, "one that is not taken: taken are " + ", ".join(_kinds))
    return kind


def unregister(name: str) -> None:
    """Forget a filter that was registered, so that its name can be used again.

    Raises:
        ConfigError: there is none of this name, or it comes with the project.
    """
    registered = [known for known in _kinds if known not in FILTERS]
    if name not in registered:
        raise ConfigError("filter", name, "one that was registered: " + (", ".join(registered) or "there is none"))
    del _kinds[name]


def filter_kind(name: str) -> FilterKind:
    """The filter of a name, or of ``module:name``; looked for among the registered ones, then among entry points.

    Raises:
        ConfigError: there is no such filter, its module cannot be imported, or its entry point has another name.
    """
    if not isinstance(name, str):
        raise ConfigError("filter", name, "a name")
    if (kind := _kinds.get(name)) is not None:
        return kind
    if ":" in name:
        return _of_module(name)
    installed = entry_points(group=ENTRY_POINTS)
    if name in installed.names:
        return _of_package(installed[name])
    known = dict.fromkeys((*_kinds, *installed.names))
    raise ConfigError("filter", name, "one of " + ", ".join(known) + ", or module:name for one of your own")


def _of_module(reference: str) -> FilterKind:
    """A filter that a module registers as it is imported."""
    module, name = import_own("filter", reference)
    if name not in _kinds:
        raise ConfigError(
            "filter", reference, f"a filter that {module.__name__} registers; known are {', '.join(_kinds)}"
        )
    return _kinds[name]


def _of_package(entry: EntryPoint) -> FilterKind:
    """A filter that an installed package names."""
    try:
        kind = register(entry.load())
    except (ImportError, SyntaxError, AttributeError) as error:
        raise ConfigError("filter", entry.name, f"one whose {entry.value} can be imported ({error})") from error
    if kind.name != entry.name:
        raise ConfigError("filter", entry.name, f"named as what its entry point gives: {kind.name}")
    return kind
