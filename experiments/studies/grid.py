"""The scenarios of a sweep: every combination of the values of its parameters, or a random sample of them."""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.running.run import prepare
from experiments.scenarios.scenario import Scenario
from experiments.studies.case import Case
from experiments.studies.parameters import SEED, parameters, value_of, with_values
from experiments.studies.runs import run_case, run_key
from experiments.studies.values import Choices, Values, parse_values
from robots.checks import require_between
from robots.errors import ConfigError, WithoutEffectError

MOST_CASES = 100_000
"""Most combinations of one sweep."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """What a sweep comes to.

    Attributes:
        cases: each content once.
        notes: what a person should know of them, in sentences.
    """

    cases: tuple[Case, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Point:
    """One combination: the scenario, its parameters' values, and which of them have no effect beside the others."""

    scenario: Scenario
    values: Mapping[str, Any]
    idle: frozenset[str]

    def labels(self) -> dict[str, Any]:
        """Values by name; ``None`` for one without effect."""
        return {name: None if name in self.idle else value for name, value in self.values.items()}


def read_values(scenario: type[Scenario], texts: Mapping[str, str], sampled: bool) -> dict[str, Values]:
    """The values of every parameter that the command line gives some for.

    Raises:
        ConfigError: one is not as it should be; names the option.
    """
    known = parameters(scenario)
    # every combination of a sample is run with the same seeds
    return {name: parse_values(known[name], text, sampled and name != SEED) for name, text in texts.items()}


def make_sweep(
    scenario: Scenario,
    values: Mapping[str, Values],
    sample: int | None = None,
    sample_seed: int = 0,
    series: bool = True,
) -> Sweep:
    """The cases of a sweep, checked before anything runs.

    Args:
        scenario: what is not swept stays as it is here.
        values: of the parameters, by name.
        sample: how many combinations to draw, each with all seeds; ``None`` for all combinations.
        sample_seed: of the draw. A larger sample with the same seed begins with the smaller one.
        series: whether the runs keep their time series.

    Raises:
        SafeWbcError: a combination is refused by the scenario, or a parameter has no effect in any.
    """
    drawn = {name: of_one for name, of_one in values.items() if name != SEED}
    combinations = _grid(drawn) if sample is None else _sample(drawn, sample, sample_seed)
    seeds = _single_values(values[SEED]) if SEED in values else ()
    points = [point for combination in combinations for point in _points(scenario, combination, seeds)]
    _refuse_idle(points)
    cases = _cases(points, series)
    return Sweep(cases, tuple(_notes(points, len(cases))))


def _single_values(values: Values) -> tuple[Any, ...]:
    assert isinstance(values, Choices), "an interval is read in a random sample only, and never of seeds"
    return values.values


def _grid(values: Mapping[str, Values]) -> Iterator[dict[str, Any]]:
    lists = {name: _single_values(of_one) for name, of_one in values.items()}
    count = math.prod(map(len, lists.values()))
    if count > MOST_CASES:
        raise ConfigError("number of combinations", count, f"at most {MOST_CASES}; --sample draws some of them")
    for combination in itertools.product(*lists.values()):
        yield dict(zip(lists, combination, strict=True))


def _sample(values: Mapping[str, Values], sample: int, sample_seed: int) -> Iterator[dict[str, Any]]:
    require_between("sample", sample, 1, MOST_CASES)
    require_between("sample_seed", sample_seed, 0, 2**63 - 1)
    for index in range(sample):
        # a generator for each: what is drawn for one does not depend on how many there are
        rng = np.random.default_rng([sample_seed, index])
        yield {name: of_one.draw(rng) for name, of_one in values.items()}


def _points(scenario: Scenario, values: Mapping[str, Any], seeds: Sequence[Any]) -> Iterator[Point]:
    """A combination with each of its seeds; the scenario checks it once."""
    full = with_values(scenario, values)
    idle: set[str] = set()
    while True:
        try:
            prepared = prepare(full)
            break
        except WithoutEffectError as error:
            if error.name not in values or error.name in idle:
                raise
            idle.add(error.name)
            full = with_values(full, {error.name: value_of(scenario, parameters(type(scenario))[error.name])})
    if not seeds:
        yield Point(full, values, frozenset(idle))
    for seed in seeds:
        random = full.is_random(prepared.robot)
        seeded = with_values(full, {SEED: seed}) if random else full
        yield Point(seeded, {**values, SEED: seed}, frozenset(idle if random else idle | {SEED}))


def _refuse_idle(points: Sequence[Point]) -> None:
    """A parameter that is nowhere of effect was given by mistake; seeds may be given all the same."""
    for name in points[0].values:
        if name != SEED and all(name in point.idle for point in points):
            option = parameters(type(points[0].scenario))[name].option
            given = ",".join(sorted({str(point.values[name]) for point in points}))
            raise ConfigError(option, given, "left out: it has no effect on any of these runs")


def _cases(points: Sequence[Point], series: bool) -> tuple[Case, ...]:
    """A case for each content; a label in which equal contents differ has no effect there."""
    labels: dict[str, dict[str, Any]] = {}
    cases = [run_case(point.scenario, point.labels(), f"runs/{run_key(point.scenario)}", series) for point in points]
    for case in cases:
        shared = labels.setdefault(case.key, dict(case.labels))
        shared.update({name: None for name in shared if shared[name] != case.labels[name]})
    distinct = {case.key: case for case in cases}
    return tuple(dataclasses.replace(case, labels=labels[key]) for key, case in distinct.items())


def _notes(points: Sequence[Point], count: int) -> Iterator[str]:
    idle = sum(SEED in point.idle for point in points)
    if idle == len(points):
        yield "nothing is random in any of these runs (no sensor noise, no obstacle): one run each, whatever the seeds"
    elif idle:
        yield f"nothing is random in {idle} of {len(points)} combinations: those are run once, whatever the seeds"
    for name in points[0].values:
        if name != SEED and (without := sum(name in point.idle for point in points)):
            yield f"{name} has no effect in {without} of {len(points)} combinations: it is not set there"
    if count < len(points):
        yield f"{len(points)} combinations, {count} of them different"
