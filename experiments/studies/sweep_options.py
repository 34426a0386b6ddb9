"""Options of ``safewbc sweep``, made from those of the scenarios; nothing heavy is imported here."""

import dataclasses
import functools
import operator
from typing import Annotated, Any, ClassVar

import tyro

from experiments.scenarios.registry import SCENARIOS, own_scenario
from experiments.scenarios.scenario import Scenario
from experiments.studies.parameters import SEED, describe, members, parameters
from experiments.studies.work import WorkOptions
from robots.checks import require_between
from robots.errors import ConfigError

SWEEP_TEXT = "Run a scenario over every combination of values of its options, or over a random sample of them."


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """Run a scenario over every combination of values of its options, or over a random sample.

    Any option of `safewbc run` takes a list a,b,c or a range low:high:n (evenly spread; low:high:n:log by factors);
    with --sample also an interval low:high or low:high:log. Where one value has several entries, values are apart by
    `;`. Given the same --out again, the sweep goes on where it was.
    """

    scenario: ClassVar[type[Scenario]]

    seeds: int | None = None
    """Run every combination with the seeds 0, 1, ... of this number; --seed takes single ones [-]."""
    sample: int | None = None
    """Draw this number of combinations instead of running all [-]."""
    sample_seed: int = 0
    """Seed of the draw; a larger sample begins with the smaller one [-]."""
    metrics: tuple[str, ...] = ()
    """Metrics of the table and the plots, by their names in summary.json; a usual choice if not given."""
    series: bool = True
    """Keep the time series of every run, some megabytes each; configuration and summary are always kept."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = dataclasses.field(default_factory=WorkOptions)

    def texts(self) -> dict[str, str]:
        """Values of the parameters as they were given, by name.

        Raises:
            ConfigError: seeds are given in two ways.
        """
        given = {name: getattr(self, name) for name in parameters(self.scenario)}
        texts = {name: text for name, text in given.items() if text is not None}
        if self.seeds is None:
            return texts
        require_between("seeds", self.seeds, 1, 100_000)
        if SEED in texts:
            raise ConfigError("--seeds", self.seeds, "left out where --seed is given")
        return texts | {SEED: ",".join(map(str, range(self.seeds)))}


def sweep_of(name: str, scenario: type[Scenario]) -> type[SweepOptions]:
    """The options of a sweep over a scenario: those of every sweep, and the scenario's own, each as a text."""
    fields: list[Any] = [
        (p.name, Annotated[str | None, tyro.conf.arg(metavar="VALUES", help=_help(p.kind))], None)
        for p in parameters(scenario).values()
    ]
    doc = f"{SweepOptions.__doc__} `safewbc run {name} --help` says what the options mean."
    namespace = {"scenario": scenario, "__doc__": doc, "__module__": __name__}
    title = "".join(word.capitalize() for word in name.split("-")) + "Sweep"
    return dataclasses.make_dataclass(
        title, fields, bases=(SweepOptions,), namespace=namespace, frozen=True, kw_only=True
    )


def _help(kind: Any) -> str:
    return "Each " + " or ".join(describe(k) for k in members(kind)) + "."


def sweep_command(own: str | None = None) -> Any:
    """The command ``sweep`` as tyro sees it; ``own``: ``module:Class`` of a scenario from outside the project."""
    scenarios = {scenario.name: scenario for scenario in SCENARIOS}
    if own is not None:
        scenarios[own] = own_scenario(own)
    kinds = [Annotated[sweep_of(name, scenario), tyro.conf.subcommand(name)] for name, scenario in scenarios.items()]
    choices = functools.reduce(operator.or_, kinds)
    return dataclasses.make_dataclass(
        "Sweep",
        [("experiment", Annotated[choices, tyro.conf.arg(name="")])],
        namespace={"__doc__": SWEEP_TEXT},
        frozen=True,
    )
