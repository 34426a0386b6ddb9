"""Tuning: what is measured of a run, and what is made of it, on systems whose answer is known."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.whole_body.tuning_file import Tuning, read_tuning, write_tuning
from experiments.recording.plain import plain
from experiments.recording.recording import GUARANTEED
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.resolve import plant_config
from experiments.studies import tune as tuning
from experiments.studies.index import read_study
from experiments.studies.store import RowStore
from experiments.studies.study_options import TuneOptions
from experiments.studies.tune import check_tune, possible_runs, slopes, start_choices
from experiments.studies.tuner import GROWTH, SPARE, Choice, Tuner, rounded_down, rounded_up
from experiments.studies.tuning_measure import Measured, family_epsilon, weighed_push
from experiments.studies.tuning_rounds import MeasuredRun, Seen, margins_of, row_of, seen_in
from experiments.studies.tuning_scenarios import TuningRun, corner_plants, payload, posture_ratios, torso_targets
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.mujoco_spec import build_mujoco_spec
from robots.pinocchio_model import standing_configuration

DT = 0.002


def held_row(alpha: float, epsilon: float, squared: float, push: float, ticks: int = 1500) -> tuple[Any, Any, Any]:
    """h, squared gradient and rate asked of a row that comes to its limit and is held there against a steady push."""
    h, asked = np.empty((ticks, 1)), np.empty((ticks, 1))
    now = 0.2
    for k in range(ticks):
        # the nominal velocity wants in at 0.3 m/s
        asked[k] = max(-0.3, -alpha * now + squared / epsilon)
        h[k] = now
        now += DT * (asked[k, 0] - push)
    return h, np.full((ticks, 1), squared), asked


@pytest.mark.parametrize(("alpha", "epsilon"), [(5.0, 2.0), (8.0, 20.0), (3.0, 0.5)])
def test_the_push_against_a_held_row_is_found_whatever_was_in_force(alpha: float, epsilon: float) -> None:
    squared, push, margin = 0.08, 0.05, 0.002
    h, lengths, asked = held_row(alpha, epsilon, squared, push)
    best, seen, size, ticks = family_epsilon(h, lengths, asked, alpha, epsilon, DT, margin, 1e-9)
    assert seen == pytest.approx(push, rel=0.02)
    assert size == pytest.approx(squared)
    assert 100 < ticks < len(h)
    # pushed in for ever: |J|^2/epsilon makes up for the push and holds the margin
    assert best == pytest.approx(squared / (alpha * margin + push), rel=0.02)


def test_a_row_that_was_never_held_says_nothing() -> None:
    h, lengths, asked = held_row(5.0, 2.0, 0.08, 0.0, ticks=50)
    best, push, size, ticks = family_epsilon(h, lengths, asked + 1.0, 5.0, 2.0, DT, 0.002, 1e-9)
    assert (math.isinf(best), push, math.isnan(size), ticks) == (True, 0.0, True, 0)


def test_the_weighed_push_is_the_steady_one_that_takes_as_much() -> None:
    assert weighed_push(5.0, np.full(4000, -0.07), DT) == pytest.approx(0.07, rel=1e-6)
    assert weighed_push(5.0, np.full(4000, 0.07), DT) == 0.0
    # a blow of one period counts by what it takes of h, times alpha
    assert weighed_push(5.0, np.r_[-1.0, np.zeros(50)], DT) == pytest.approx(5.0 * DT)


Model = Callable[[str, float, float], tuple[float, float]]

Parameters = Mapping[str, Mapping[str, float]]


def tuner(
    folder: Path,
    model: Model,
    falls: Callable[[float, float], bool],
    start: float = 4.0,
    ratios: dict[str, float] | None = None,
    unbound: Callable[[float, float], float] | None = None,
    fraction: Callable[[str], float] = lambda name: 1.0,
    begins: str = "",
    **options: Any,
) -> tuple[dict[str, Choice], list[dict[str, dict[str, float]]]]:
    """Tunes robots that are formulas: ``model`` gives the push and the squared gradient of a family at alpha, epsilon.

    ``unbound`` gives the smallest self-collision barrier of runs in which no condition of that family binds,
    ``fraction`` the fraction of the push that reaches a run of that name; only runs whose name ``begins`` like this are
    made.

    Returns:
        The choice, and the parameters of each round.
    """
    robot = load_robot("g1")
    rounds: list[dict[str, dict[str, float]]] = []

    def make_round(runs: Sequence[TuningRun], parameters: Parameters, tuned: Sequence[str]) -> list[Seen]:
        assert all(set(tuned) & set(run.families) for run in runs)
        rounds.append({f: dict(v) for f, v in parameters.items()})
        return [come_to(run) for run in runs]

    def come_to(run: TuningRun) -> Seen:
        measured = []
        for family in run.families:
            alpha, epsilon = (rounds[-1][family][key] for key in ("alpha", "epsilon"))
            push, squared = model(family, alpha, epsilon)
            push *= fraction(run.name)
            margin = margins[family]
            least = (squared / epsilon - push) / alpha
            measured.append(Measured(family, least, squared / (alpha * margin + push), push, squared, 100))
        own = rounds[-1]["self_collision"]
        if unbound is not None and run.name.startswith("cross"):
            measured = [m for m in measured if m.family != "self_collision"]
            least = unbound(own["alpha"], own["epsilon"])
            measured.append(Measured("self_collision", least, math.inf, 0.0, math.nan, 0))
        legs = rounds[-1]["leg_collision"]
        fell = "leg_collision" in run.families and falls(legs["alpha"], legs["epsilon"])
        return Seen(run, "fell" if fell else "", tuple(measured))

    begin = folder / "start.toml"
    write_tuning(begin, Tuning({f: {"alpha": 5.0, "epsilon": start} for f in GUARANTEED}))
    chosen_options = TuneOptions(start=begin, **options)
    before, margins = start_choices(robot, chosen_options), margins_of(chosen_options)
    alphas = slopes(robot, chosen_options)
    possible = [run for run in possible_runs(robot, chosen_options) if run.name.startswith(begins)]
    return Tuner(possible, alphas, ratios or {}, chosen_options, make_round).run(before), rounds


@pytest.mark.parametrize("start", [0.2, 2.0, 20.0])
def test_each_family_ends_with_the_largest_epsilon_that_keeps_its_margin(start: float, tmp_path: Path) -> None:
    """The push grows with the speed that epsilon asks for, so that what is measured first is not the answer."""

    def model(family: str, alpha: float, epsilon: float) -> tuple[float, float]:
        return (0.1 if family == "workspace" else 0.02) * (1.0 + 0.1 / epsilon), 0.06

    chosen, rounds = tuner(tmp_path, model, lambda alpha, epsilon: False, start, rounds=15)
    for family, choice in chosen.items():
        push, squared = model(family, choice.alpha, choice.epsilon)
        margin = TuneOptions().margin_angle if family == "joint_limit" else TuneOptions().margin
        assert choice.settled
        assert choice.note == "keeps its margin"
        assert (squared / choice.epsilon - push) / choice.alpha == pytest.approx(choice.least)
        assert choice.least >= margin
        # a quarter more would not have kept it, or is not worth a round
        larger = 1.3 * choice.epsilon
        assert (squared / larger - model(family, choice.alpha, larger)[0]) / choice.alpha < margin
    # a push that does not grow with alpha takes the less the larger alpha is
    assert {c.alpha for c in chosen.values()} == {8.5}
    # nothing leaps beyond where it was measured
    for family in GUARANTEED:
        values = [r[family]["epsilon"] for r in rounds if r[family]["alpha"] == 8.5]
        assert max(b / a for a, b in itertools.pairwise(values)) <= GROWTH + 1e-9


def test_the_run_that_is_pushed_most_decides(tmp_path: Path) -> None:
    def model(family: str, alpha: float, epsilon: float) -> tuple[float, float]:
        return 0.02, 0.06

    def alone(name: str) -> float:
        return 1.0 if name.endswith("loaded") else 0.0

    for folder in ("all", "one"):
        (tmp_path / folder).mkdir()
    everywhere, _ = tuner(tmp_path / "all", model, lambda alpha, epsilon: False, rounds=15)
    somewhere, _ = tuner(tmp_path / "one", model, lambda alpha, epsilon: False, rounds=15, fraction=alone)
    arms = ("self_collision", "workspace", "joint_limit")
    assert {f: somewhere[f].epsilon for f in arms} == {f: everywhere[f].epsilon for f in arms}
    assert all(somewhere[f].where.endswith("loaded") for f in arms)
    # no run that steps carries a load: nothing pushes its legs
    assert somewhere["leg_collision"].epsilon > everywhere["leg_collision"].epsilon


@given(st.floats(0.01, 100.0))
def test_numbers_of_a_file_have_two_digits_and_are_not_above_what_was_found(value: float) -> None:
    rounded = rounded_down(value)
    assert 0.9 * value < rounded <= value * (1.0 + 1e-11)
    assert rounded == float(f"{rounded:.2g}")
    assert rounded_down(rounded) == rounded
    up = rounded_up(value)
    assert value * (1.0 - 1e-11) <= up < 1.11 * value
    assert up == float(f"{up:.2g}")


def test_a_slope_whose_overshoot_costs_more_is_not_taken(tmp_path: Path) -> None:
    chosen, _ = tuner(tmp_path, lambda f, alpha, epsilon: (2e-4 * alpha**3, 0.06), lambda alpha, epsilon: False)
    assert {c.alpha for c in chosen.values()} <= {3.0, 5.0}


def test_parameters_with_which_a_robot_falls_are_not_taken(tmp_path: Path) -> None:
    chosen, _ = tuner(tmp_path, lambda f, a, e: (0.02, 0.06), lambda alpha, epsilon: alpha > 4.0)
    assert chosen["leg_collision"].alpha == 3.0
    assert chosen["self_collision"].alpha == 8.5
    chosen, _ = tuner(tmp_path, lambda f, a, e: (0.02, 0.06), lambda alpha, epsilon: True)
    own = chosen["leg_collision"]
    assert (own.alpha, own.epsilon) == (5.0, 4.0)
    assert own.note.startswith("kept: ")


def test_postures_are_left_alone_even_where_the_margin_is_missed(tmp_path: Path) -> None:
    ratios = {"self_collision": 8.0}
    chosen, rounds = tuner(tmp_path, lambda f, a, e: (0.05, 0.06), lambda a, e: False, ratios=ratios, rounds=9)
    own = chosen["self_collision"]
    assert own.note == "margin missed at the least epsilon that leaves the robot's postures alone"
    assert own.alpha * own.epsilon >= SPARE * 8.0
    assert own.settled
    assert own.alpha * rounds[-1]["self_collision"]["epsilon"] >= SPARE * 8.0
    assert chosen["obstacle"].note == "keeps its margin"


def test_no_posture_of_a_robot_is_pushed_by_its_filter(robot_name: str) -> None:
    """The parameters that the robots come with: at rest in a posture every condition holds for zero velocity."""
    robot = load_robot(robot_name)
    ratios = posture_ratios(robot)
    for family, choice in start_choices(robot, TuneOptions(robot=robot_name)).items():
        assert choice.alpha * choice.epsilon >= ratios[family]


def test_other_families_are_left_alone(tmp_path: Path) -> None:
    chosen, rounds = tuner(tmp_path, lambda f, a, e: (0.02, 0.06), lambda a, e: False, only=("self_collision",))
    for family in set(GUARANTEED) - {"self_collision"}:
        assert (chosen[family].alpha, chosen[family].epsilon) == (5.0, 4.0)
        assert all(r[family] == rounds[0][family] for r in rounds)


@pytest.mark.parametrize("scenarios", ["all", "cross"])
def test_a_barrier_below_its_margin_counts_where_no_condition_bound(scenarios: str, tmp_path: Path) -> None:
    margin = TuneOptions().margin

    def unbound(alpha: float, epsilon: float) -> float:
        return 0.02 / (alpha * epsilon)

    start = "cross" if scenarios == "cross" else ""
    chosen, rounds = tuner(
        tmp_path, lambda f, a, e: (0.001, 0.06), lambda a, e: False, unbound=unbound, begins=start, rounds=15
    )
    own = chosen["self_collision"]
    assert own.note == "keeps its margin"
    assert own.least == pytest.approx(unbound(own.alpha, own.epsilon))
    assert own.least >= margin
    assert own.where.startswith("cross")
    assert {"alpha": own.alpha, "epsilon": own.epsilon} in [r["self_collision"] for r in rounds]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("start", [0.5, 4.0, 20.0])
def test_what_is_written_when_rounds_end_is_what_a_run_has_tried(count: int, start: float, tmp_path: Path) -> None:
    # the push grows with what epsilon asks for, so that it sinks round after round
    def model(family: str, alpha: float, epsilon: float) -> tuple[float, float]:
        return 0.02 * (1.0 + 1.0 / epsilon), 0.06

    chosen, rounds = tuner(tmp_path, model, lambda a, e: False, start, rounds=count)
    for family, choice in chosen.items():
        assert {"alpha": choice.alpha, "epsilon": choice.epsilon} in [r[family] for r in rounds]
        push, squared = model(family, choice.alpha, choice.epsilon)
        assert choice.least == pytest.approx((squared / choice.epsilon - push) / choice.alpha)
        margin = TuneOptions().margin_angle if family == "joint_limit" else TuneOptions().margin
        assert choice.note.startswith("keeps its margin" if choice.least >= margin else "margin missed")
        if not choice.settled:
            assert ("rounds ended before epsilon" in choice.note) == (count == 1 or choice.least < margin)


def test_what_cannot_be_reached_is_said(tmp_path: Path) -> None:
    chosen, _ = tuner(tmp_path, lambda f, a, e: (5.0, 0.01), lambda a, e: False, rounds=3)
    for choice in chosen.values():
        assert choice.note == "margin missed at the least epsilon that is tried"
        assert choice.least < 0


def test_a_whole_tuning_writes_a_file_that_runs_take(tmp_path: Path) -> None:
    """One short run whose hands come to the torso."""
    short = HandTracking(motion="target", duration=0.8, plant=PlantOptions(mass_scale=1.2))
    run = TuningRun("target", ("self_collision", "joint_limit"), short)
    options = TuneOptions(alphas=(5.0,), rounds=2, work=WorkOptions(jobs=1, out=tmp_path / "tuned"))
    robot = load_robot("g1")
    code = tuning.tune_with(robot, [run], options)
    found = read_tuning(tmp_path / "tuned" / "tuning.toml", "g1")
    assert set(found.families) == set(GUARANTEED)
    assert found.tuned["runs"] == ["target"]
    assert found.tuned["masses"] == [0.8, 1.3]
    assert code == (0 if found.tuned["self_collision_note"] == "keeps its margin" else 1)
    with pytest.raises(ConfigError, match="robot"):
        read_tuning(tmp_path / "tuned" / "tuning.toml", "tocabi")
    # the same again takes what is there, and comes to the same
    rows = {path: path.stat().st_mtime_ns for path in (tmp_path / "tuned" / "rows").iterdir()}
    assert tuning.tune_with(robot, [run], options) == code
    assert read_tuning(tmp_path / "tuned" / "tuning.toml", "g1") == found
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "tuned" / "rows").iterdir()} == rows
    study = read_study(tmp_path / "tuned")
    assert [row.labels["run"] for row in study.rows()] == ["target"] * len(rows)


def test_a_run_is_made_with_its_parameters_and_known_by_all_that_decides_its_row(tmp_path: Path) -> None:
    run = TuningRun("target", ("self_collision",), HandTracking(motion="target", duration=1.2))
    margins = margins_of(TuneOptions())
    bold, shy = ({"self_collision": {"alpha": 8.0, "epsilon": epsilon}} for epsilon in (20.0, 0.5))
    store = RowStore(tmp_path)
    least = [MeasuredRun(run, p, margins, "g1")(store)["self_collision_least"] for p in (bold, shy)]
    # the smaller epsilon keeps more room
    assert least[1] > least[0] + 1e-3
    assert len(list((tmp_path / "parameters").glob("*.toml"))) == 2
    other = TuningRun("target", ("self_collision", "joint_limit"), run.options)
    longer = TuningRun("target", run.families, dataclasses.replace(run.options, duration=1.3))
    keys = [
        MeasuredRun(*content, "g1").key
        for content in (
            (run, bold, margins),
            (run, shy, margins),
            (run, bold, margins | {"self_collision": 0.005}),
            (other, bold, margins),
            (longer, bold, margins),
        )
    ]
    assert len(set(keys)) == len(keys)


def test_what_a_row_of_a_run_keeps_is_what_was_measured() -> None:
    run = TuningRun("target", ("self_collision", "joint_limit", "obstacle"), HandTracking(motion="target"))
    for measured in (
        (Measured("self_collision", 0.003, 2.5, 0.04, 0.06, 17), Measured("joint_limit", 0.1, math.inf, 0.0, 0.5, 0)),
        (Measured("obstacle", -0.001, 0.2, 0.3, 0.07, 3),),
        (),
    ):
        assert seen_in(run, plain(row_of(measured, {"fell": False, "stop_cause": None}))) == Seen(run, "", measured)
    # what was not a number is not one again
    nothing = Measured("self_collision", 0.2, math.inf, 0.0, math.nan, 0)
    again = seen_in(run, plain(row_of((nothing,), {"fell": True, "stop_cause": "x"})))
    assert again.ended == "fell"
    assert dataclasses.replace(again.measured[0], squared=0.0) == dataclasses.replace(nothing, squared=0.0)
    assert math.isnan(again.measured[0].squared)


@pytest.mark.parametrize(
    "change",
    [
        {"masses": (1.2, 0.8)},
        {"joint_friction": (-1.0, 2.0)},
        {"payload": math.nan},
        {"delay": -0.001},
        {"margin": 0.0},
        {"margin_angle": -1.0},
        {"alphas": ()},
        {"alphas": (50.0,)},
        {"rounds": 0},
        {"work": WorkOptions(jobs=0)},
        {"only": ("elbows",)},
    ],
)
def test_options_that_are_not_allowed_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change)).replace("work", "jobs")):
        check_tune(TuneOptions(**change))


def test_slopes_that_motors_cannot_follow_are_left_out(robot_name: str) -> None:
    """T h'' + h' + alpha h = 0 has real poles for those that are left, complex ones for the next."""
    robot = load_robot(robot_name)
    for delay in (0.0, 0.004, 0.02):
        options = TuneOptions(alphas=tuple(np.arange(0.5, 40.0, 0.5)), delay=delay)
        kept, lag = slopes(robot, options), tuning.lag(robot, delay)
        assert (np.abs(np.imag([np.roots([lag, 1.0, a]) for a in kept])) < 1e-9).all()
        assert np.abs(np.imag(np.roots([lag, 1.0, max(kept) + 0.5]))).max() > 0


def test_the_scenarios_reach_every_family(robot_name: str) -> None:
    robot = load_robot(robot_name)
    runs = possible_runs(robot, TuneOptions(robot=robot_name))
    assert {f for run in runs for f in run.families} == set(GUARANTEED)
    assert len({run.name for run in runs}) == len(runs)
    given = dataclasses.replace(runs[0].options)
    assert runs[0].with_parameters(Path("some.toml")).safety.tuning == Path("some.toml")
    assert runs[0].options == given


def test_targets_lie_in_bodies_of_the_torso(robot_name: str) -> None:
    robot = load_robot(robot_name)
    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot, "standing"))
    origin = kin.frame_placement(kin.frame_id(robot.roles["torso"]))[1]
    targets = torso_targets(robot)
    assert len(targets) >= 2
    for target in targets:
        point = origin + np.array(target)
        depths = []
        for shape in robot.collisions:
            if shape.body == robot.frame(robot.roles["torso"]).body:
                rotation, position = kin.frame_placement(kin.frame_id(shape.body))
                a, b = (position + rotation @ np.asarray(end) for end in (shape.start, shape.end))
                along = np.clip((point - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
                depths.append(shape.radius - np.linalg.norm(point - a - along * (b - a)))
        assert max(depths) > 0.0


def test_a_payload_adds_its_mass_to_each_hand(robot_name: str) -> None:
    robot = load_robot(robot_name)
    for mass_scale in (0.8, 1.3):
        loaded = PlantOptions(mass_scale=mass_scale, link_mass=payload(robot, 0.7, mass_scale))
        masses = []
        for plant in (PlantOptions(mass_scale=mass_scale), loaded):
            model = build_mujoco_spec(robot, plant_config(plant).changes).compile()
            masses.append(float(model.body_mass.sum()))
        assert masses[1] - masses[0] == pytest.approx(1.4)
    assert payload(robot, 0.0) == {}


def test_the_corners_span_what_is_to_be_withstood(robot_name: str) -> None:
    robot, options = load_robot(robot_name), TuneOptions(masses=(0.9, 1.25), joint_friction=(0.5, 1.5), delay=0.003)
    plants = corner_plants(robot, options).values()
    for name, values in (("mass_scale", options.masses), ("joint_friction_scale", options.joint_friction)):
        assert {min(getattr(p, name) for p in plants), max(getattr(p, name) for p in plants)} == set(values)
    assert max(p.actuator_delay for p in plants) == options.delay
    assert any(p.link_mass for p in plants)
    assert not any(p.link_mass for p in corner_plants(robot, dataclasses.replace(options, payload=0.0)).values())
