"""Sweeps: what the command line says becomes these scenarios and no others, each once, checked before anything runs."""

import dataclasses
import itertools
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from experiments.cli.main import command_line as command_line_of_all
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.stand import Stand
from experiments.studies.command import command_line
from experiments.studies.grid import make_sweep, read_values
from experiments.studies.parameters import parameters, value_of, with_values
from experiments.studies.sweep import plan_of
from experiments.studies.sweep_options import SweepOptions, sweep_of
from experiments.studies.values import Choices, Interval, parse_values
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError, UnknownNameError

HANDS = parameters(HandTracking)
HAND_SWEEP = sweep_of("hand-tracking", HandTracking)


def choices(name: str, text: str) -> tuple[Any, ...]:
    values = parse_values(HANDS[name], text)
    assert isinstance(values, Choices)
    return values.values


def test_parameters_are_those_of_the_command_line() -> None:
    assert {"robot", "seed", "mass_scale", "epsilon", "filter", "com_shift", "obstacle_noise"} <= set(HANDS)
    assert {"out", "report", "video", "plant", "safety"}.isdisjoint(HANDS)
    assert HANDS["mass_scale"].option == "--mass-scale"
    changed = with_values(HandTracking(), {"mass_scale": 1.2, "epsilon": 3.0, "seed": 4})
    assert (changed.plant.mass_scale, changed.safety.epsilon, changed.seed) == (1.2, 3.0, 4)
    assert value_of(changed, HANDS["epsilon"]) == 3.0


@dataclass(frozen=True)
class Inner:
    """A group of options."""

    gain: float = 1.0


@dataclass(frozen=True)
class Grouped:
    """Groups with and without a name, and what the command line does not show."""

    flat: Annotated[Inner, tyro.conf.arg(name="")] = field(default_factory=Inner)
    named: Inner = field(default_factory=Inner)
    hidden: Annotated[float, tyro.conf.Suppress] = 0.0


def test_groups_have_the_names_of_the_command_line() -> None:
    assert [p.option for p in parameters(Grouped).values()] == ["--gain", "--named.gain"]
    assert tyro.cli(Grouped, args=["--gain", "2", "--named.gain", "3"]) == with_values(
        Grouped(), {"gain": 2.0, "named.gain": 3.0}
    )


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("robot", "g1,tocabi", ("g1", "tocabi")),
        ("mass_scale", "1.0,1.1, 1.2", (1.0, 1.1, 1.2)),
        ("mass_scale", "1,1.0", (1.0,)),
        ("epsilon", "1:20:5", (1.0, 5.75, 10.5, 15.25, 20.0)),
        ("epsilon", "0.1:0.3:3", (0.1, 0.2, 0.3)),
        ("epsilon", "0.1:1000:5:log", (0.1, 1.0, 10.0, 100.0, 1000.0)),
        ("epsilon", "none,2", (None, 2.0)),
        ("seed", "3,5", (3, 5)),
        ("seed", "0:8:5", (0, 2, 4, 6, 8)),
        ("obstacle", "false,true", (False, True)),
        ("com_shift", "0,0,0; 0.01 0 -0.02", ((0.0, 0.0, 0.0), (0.01, 0.0, -0.02))),
        ("link_mass", "none; a=1.2 b=0.5", ({}, {"a": 1.2, "b": 0.5})),
        ("tuning", "a.toml", (Path("a.toml"),)),
    ],
)
def test_values(name: str, text: str, values: tuple[Any, ...]) -> None:
    found = choices(name, text)
    assert found == values
    assert [type(a) for a in found] == [type(b) for b in values]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("mass_scale", "heavy"),
        ("mass_scale", "1.0,"),
        ("mass_scale", "none"),
        ("seed", "1.5"),
        ("seed", "0:3:3"),
        ("obstacle", "maybe"),
        ("epsilon", "1:2"),
        ("epsilon", "2:1:3"),
        ("epsilon", "0:1:3:log"),
        ("epsilon", "1:2:1"),
        ("epsilon", "1:2:x"),
        ("epsilon", "1:nan:3"),
        ("epsilon", "1:2:3:lin"),
        ("com_shift", "1,2"),
        ("link_mass", "torso"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_by_the_name_of_its_option(name: str, text: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(HANDS[name].option)):
        parse_values(HANDS[name], text)


@given(st.floats(1e-3, 1e3), st.floats(1.01, 10.0), st.integers(2, 9), st.booleans())
def test_ranges_are_spread_evenly_and_hold_their_ends(low: float, factor: float, n: int, log: bool) -> None:
    values = np.array(choices("epsilon", f"{low!r}:{low * factor!r}:{n}{':log' if log else ''}"))
    assert values[[0, -1]] == pytest.approx([low, low * factor], rel=1e-11)
    steps = np.diff(np.log(values) if log else values)
    assert steps == pytest.approx(np.full(n - 1, steps.mean()), rel=1e-6)


@given(st.integers(0, 50), st.integers(1, 50), st.integers(0, 1000))
def test_intervals_of_whole_numbers_are_drawn_whole_and_within(low: int, length: int, seed: int) -> None:
    interval = parse_values(HANDS["seed"], f"{low}:{low + length}", sampled=True)
    assert isinstance(interval, Interval)
    value = interval.draw(np.random.default_rng(seed))
    assert isinstance(value, int)
    assert low <= value <= low + length


def test_intervals_of_factors_are_drawn_evenly_in_their_logarithm() -> None:
    interval = parse_values(HANDS["epsilon"], "0.01:100:log", sampled=True)
    rng = np.random.default_rng(0)
    logs = np.log10([interval.draw(rng) for _ in range(2000)])
    assert -2 <= logs.min() < -1.9
    assert 1.9 < logs.max() <= 2
    # uniform over 4: five standard deviations of the mean of 2000
    assert abs(logs.mean()) < 5 * 4 / np.sqrt(12 * 2000)


def sweep(texts: dict[str, str], base: Any = None, sample: int | None = None, seed: int = 0) -> list[dict[str, Any]]:
    scenario = HandTracking() if base is None else base
    values = read_values(type(scenario), texts, sample is not None)
    return [dict(case.labels) for case in make_sweep(scenario, values, sample, seed).cases]


def test_a_grid_is_every_combination_once() -> None:
    found = sweep({"robot": "g1,tocabi", "mass_scale": "1.0,1.2", "noise_scale": "1", "seed": "0,1"})
    wanted = itertools.product(("g1", "tocabi"), (1.0, 1.2), (1.0,), (0, 1))
    assert found == [dict(zip(("robot", "mass_scale", "noise_scale", "seed"), w, strict=True)) for w in wanted]


def test_what_has_no_effect_somewhere_is_not_set_there_and_run_once() -> None:
    found = sweep({"filter": "cbf,issf,pssa", "epsilon": "1:20:5"})
    assert found == [
        {"filter": "cbf", "epsilon": None},
        *({"filter": "issf", "epsilon": e} for e in (1.0, 5.75, 10.5, 15.25, 20.0)),
        {"filter": "pssa", "epsilon": None},
    ]


def test_what_has_no_effect_anywhere_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--epsilon.*no effect"):
        sweep({"filter": "cbf,pssa", "epsilon": "1,2"})
    with pytest.raises(ConfigError, match=r"--obstacle-noise.*no effect"):
        sweep({"obstacle_noise": "0.01"})


def test_seeds_without_anything_random_are_run_once_and_that_is_said() -> None:
    values = read_values(HandTracking, {"mass_scale": "1,1.1", "seed": "0,1,2"}, False)
    plan = make_sweep(HandTracking(), values)
    assert len(plan.cases) == 2
    assert any("nothing is random" in note for note in plan.notes)
    assert len(sweep({"noise_scale": "0,1", "seed": "0,1,2"})) == 4


def test_combinations_are_checked_before_anything_runs() -> None:
    with pytest.raises(ConfigError, match="mass_scale"):
        sweep({"mass_scale": "1.0,-1.0"})
    with pytest.raises(ConfigError, match="filter"):
        sweep({"filter": "issf,unknown"})


def test_the_key_belongs_to_the_content() -> None:
    def key(**changes: Any) -> str:
        values = read_values(Stand, {"mass_scale": "1.1"}, False)
        return make_sweep(dataclasses.replace(Stand(), **changes), values).cases[0].key

    assert key() == key(duration=10.0)
    assert key() != key(duration=9.0)


def test_a_sample_belongs_to_its_seed_and_a_larger_one_begins_with_it() -> None:
    texts = {"mass_scale": "0.9:1.3", "epsilon": "1:100:log", "robot": "g1,tocabi", "seed": "0,1", "noise_scale": "1"}
    few, again, many = (sweep(texts, sample=n, seed=7) for n in (5, 5, 8))
    assert few == again
    assert many[: len(few)] == few
    assert len(few) == 10
    assert few != sweep(texts, sample=5, seed=8)
    for pair in zip(few[::2], few[1::2], strict=True):
        # every combination with all seeds
        assert [labels["seed"] for labels in pair] == [0, 1]
        assert {k: v for k, v in pair[0].items() if k != "seed"} == {k: v for k, v in pair[1].items() if k != "seed"}
    assert all(0.9 <= labels["mass_scale"] <= 1.3 and 1 <= labels["epsilon"] <= 100 for labels in many)


def hand_sweep(*words: str) -> SweepOptions:
    options = tyro.cli(HAND_SWEEP, args=list(words))
    assert isinstance(options, SweepOptions)
    return options


def test_the_command_line_of_a_sweep() -> None:
    words = ["--robot", "g1,tocabi", "--mass-scale", "1.0,1.1,1.2", "--filter", "cbf,issf,pssa", "--epsilon", "1:20:5"]
    plan = plan_of(hand_sweep(*words, "--noise-scale", "1", "--seeds", "5"))
    # cbf and pssa once, issf with five epsilons
    assert len(plan.cases) == 2 * 3 * (1 + 5 + 1) * 5
    assert len({case.key for case in plan.cases}) == len(plan.cases)
    with pytest.raises(ConfigError, match="seeds"):
        plan_of(hand_sweep("--seeds", "2", "--seed", "1,2"))


def test_metrics_that_no_run_has_are_refused_before_anything_runs() -> None:
    assert len(plan_of(hand_sweep("--metrics", "fell", "hand_rmse_m")).cases) == 1
    with pytest.raises(UnknownNameError, match=r"'speed': known are .*hand_rmse_m"):
        plan_of(hand_sweep("--metrics", "fell", "speed"))


def test_the_command_that_goes_on_is_the_one_that_was_given() -> None:
    options = hand_sweep(
        "--mass-scale", "1.0,1.1", "--com-shift=-0.01,0,0", "--seeds", "3", "--no-series", "--jobs", "3"
    )
    line = command_line("sweep hand-tracking", options, Path("some folder"))
    assert line.startswith("safewbc sweep hand-tracking ")
    again = hand_sweep(*shlex.split(line)[3:])
    assert again == dataclasses.replace(options, work=dataclasses.replace(options.work, out=Path("some folder")))
    assert WorkOptions().out is None


def commands_on_the_page() -> list[list[str]]:
    """The commands of safewbc in docs/studies.md, lines that go on joined."""
    page = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    lines = page.replace("\\\n", " ").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("    safewbc ") and "..." not in line]


def test_commands_on_the_page_are_understood() -> None:
    commands = commands_on_the_page()
    assert [words[0] for words in commands] == ["sweep", "pivot", "pivot"]
    for words in commands:
        parsed = tyro.cli(command_line_of_all(), args=words)
        options = getattr(parsed, "experiment", parsed)
        if isinstance(options, SweepOptions):
            # two robots, three masses, cbf and pssa once and issf with five epsilons, five seeds
            assert len(plan_of(options).cases) == 2 * 3 * (1 + 5 + 1) * 5
