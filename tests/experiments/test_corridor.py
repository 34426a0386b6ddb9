"""The corridor: the conflict is real, p-SSA gives up the least, and what is said of it is read from the data."""

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from controllers.policies.nominal import benchmark_limits
from experiments.cli import main as cli
from experiments.metrics.metric import Metric
from experiments.metrics.scores import control_score, feasible_rate, safety_score, tracking_score
from experiments.recording.store import DATA
from experiments.reports.corridor import corridor_frames, write_corridor_report
from experiments.reports.media import obstacle_shapes, rotation_to
from experiments.running.corridor_loop import DT, NAIVE, VARIANTS, CorridorLoop, CorridorRun, variant_title
from experiments.scenarios.corridor import (
    CLOSING,
    D_MIN,
    GOALS,
    HAND_RADIUS,
    INSTANTS,
    WIDE_GAP,
    Corridor,
    corridor_robot,
    ramp,
)
from experiments.studies.corridor import corridor_table, figure_text, is_bad
from experiments.studies.corridor_findings import findings
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.barrier_set import standard_barriers
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import SET_MARGINS, BarrierParameters, ssa
from safety.filters.safety_filter import SafetyFilter
from safety.geometry.shapes import Obstacle
from sims.rendering import RobotRenderer
from sims.shapes import Shape

DURATION = 8.0
"""The boards have closed, the goal has moved into one of them and the sphere is at the elbow [s]."""

COMPARED = ("pssa", "rssa", NAIVE, "ssa", "cbf")


@pytest.fixture(scope="module")
def g1() -> RobotDescription:
    return corridor_robot()


@pytest.fixture(scope="module")
def loops(g1: RobotDescription) -> dict[str, CorridorLoop]:
    return {name: CorridorLoop(g1, Corridor(), name) for name in COMPARED}


@pytest.fixture(scope="module")
def runs(loops: dict[str, CorridorLoop]) -> dict[str, CorridorRun]:
    return {name: loop.run(DURATION) for name, loop in loops.items()}


def conditions(loop: CorridorLoop, run: CorridorRun, tick: int) -> tuple[BarrierRows, HalfSpaces, Array]:
    """Rows and SSA's conditions at a tick of a run, evaluated anew, and the bound of each velocity."""
    loop.kin.update_geometry(run.series["q"][tick])
    loop.obstacles.set_obstacles(loop.scene.obstacles(float(run.series["time"][tick])))
    rows = loop.barriers.evaluate(loop.kin)
    spaces = ssa(rows, BarrierParameters().of_rows(rows.family, SET_MARGINS))
    return rows, spaces, benchmark_limits(loop.kin)


# --- the scene


@pytest.mark.parametrize("t", [0.7, 2.4, 2.75, 3.4, 5.2, 5.9, 7.0, 8.8, 9.3, 10.3, 10.9, 13.0])
def test_obstacles_move_as_fast_as_they_say(t: float) -> None:
    scene = Corridor(0.13)
    after, before, now = (scene.obstacles(t + step) for step in (1e-6, -1e-6, 0.0))
    for a, b, o in zip(after, before, now, strict=True):
        np.testing.assert_allclose(o.velocity, (a.position - b.position) / 2e-6, rtol=0, atol=1e-8)


def test_the_scene_s_kinds_are_those_of_its_obstacles() -> None:
    scene = Corridor()
    assert tuple(o.kind for o in scene.obstacles(0.0)) == scene.kinds


def test_a_ramp_is_at_rest_at_both_ends() -> None:
    assert ramp(0.0, 1.0, 3.0) == (0.0, 0.0)
    assert ramp(2.0, 1.0, 3.0)[0] == pytest.approx(0.5)
    assert ramp(4.0, 1.0, 3.0) == (1.0, 0.0)


@pytest.mark.parametrize("gap", [0.11, 0.14, 0.19])
def test_closed_boards_are_both_too_near_and_neither_touches_the_hand_in_the_middle(
    g1: RobotDescription, gap: float
) -> None:
    """The conflict of figure 2(b): both phi >= 0, both distances above 0."""
    loop = CorridorLoop(g1, Corridor(gap), "none")
    assert loop.obstacles.bodies is not None
    hand = g1.collisions[loop.obstacles.bodies.names.index("left_hand")]
    assert hand.radius == HAND_RADIUS
    boards = loop.scene.obstacles(CLOSING[1])[:2]
    for board, side in zip(boards, (-1, 1), strict=True):
        face = board.position[2] - side * board.half_sizes[2]
        distance = side * (face - GOALS[0, 2]) - HAND_RADIUS
        assert distance == pytest.approx(gap / 2 - HAND_RADIUS, abs=1e-12)
        assert 0 < distance < D_MIN["obstacle"]


def test_open_boards_leave_the_hand_its_margin() -> None:
    assert WIDE_GAP / 2 - HAND_RADIUS > D_MIN["obstacle"]


def test_nothing_is_random_without_a_seed_and_everything_repeats_with_one() -> None:
    np.testing.assert_array_equal(Corridor().goals, GOALS)
    np.testing.assert_array_equal(Corridor().goals, Corridor().goals)
    a, again, b = Corridor(seed=1), Corridor(seed=1), Corridor(seed=2)
    np.testing.assert_array_equal(a.goals, again.goals)
    np.testing.assert_array_equal(a.sphere_nearest, again.sphere_nearest)
    assert not np.allclose(a.goals, b.goals)
    assert not np.allclose(a.goals, GOALS)


def test_a_run_repeats_exactly(g1: RobotDescription, runs: dict[str, CorridorRun]) -> None:
    again = CorridorLoop(g1, Corridor(), "rssa").run(3.5)
    for name, values in again.series.items():
        if name != "filter_ms":
            np.testing.assert_array_equal(values, runs["rssa"].series[name][: len(values)], err_msg=name)


# --- the conflict


def test_hard_ssa_has_no_solution_and_an_independent_solver_agrees(
    loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun]
) -> None:
    run = runs["pssa"]
    for tick in range(0, len(run.series["time"]), 40):
        _, spaces, limits = conditions(loops["pssa"], run, tick)
        A, b = spaces.A[spaces.active], spaces.b[spaces.active]
        bounds = np.column_stack([-limits, limits])
        found = linprog(np.zeros(limits.size), A_ub=-A, b_ub=-b, bounds=bounds) if b.size else None
        assert (found is not None and found.status == 2) == bool(run.series["infeasible"][tick]), tick
    assert run.series["infeasible"][400:].all()


def test_the_boards_are_a_conflict_of_conditions_that_could_each_be_met(
    loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun]
) -> None:
    """Method infeasibility: each condition of the hand alone can be met, both boards together cannot."""
    loop, run = loops["pssa"], runs["pssa"]
    _, spaces, limits = conditions(loop, run, 450)
    rows = [loop.labels.index(f"left hand - {board} board") for board in ("lower", "upper")]
    assert spaces.active[rows].all()
    bounds = np.column_stack([-limits, limits])
    for chosen, status in ((rows[:1], 0), (rows[1:], 0), (rows, 2)):
        found = linprog(np.zeros(limits.size), A_ub=-spaces.A[chosen], b_ub=-spaces.b[chosen], bounds=bounds)
        assert found.status == status


@pytest.mark.parametrize("tick", [300, 450, 610, 700])
def test_the_violation_of_p_ssa_is_the_least(
    loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun], tick: int
) -> None:
    run = runs["pssa"]
    _, spaces, limits = conditions(loops["pssa"], run, tick)
    A, b = spaces.A[spaces.active], spaces.b[spaces.active]

    def cost(v: Array) -> tuple[float, Array]:
        short = np.maximum(0.0, b - A @ v)
        return 0.5 * float(short @ short), -A.T @ short

    found = minimize(
        cost, run.series["v_safe"][tick], jac=True, bounds=np.column_stack([-limits, limits]), method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10},
    )  # fmt: skip
    assert run.series["violation_norm"][tick] == pytest.approx(np.sqrt(2 * found.fun), abs=1e-6)


@pytest.mark.parametrize("name", ["rssa", NAIVE])
def test_on_the_same_rows_p_ssa_violates_less_than_the_others(
    loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun], name: str
) -> None:
    loop, run = loops[name], runs[name]
    limits = benchmark_limits(loop.kin)
    pssa = SafetyFilter("pssa", loop.barriers.size, BarrierParameters(), limits)
    other = run.series["violation_norm"]
    worse = 0
    for tick in range(0, len(other), 5):
        rows, _, _ = conditions(loop, run, tick)
        least = float(np.linalg.norm(pssa.apply(rows, run.series["v_des"][tick]).shortfall))
        assert least <= other[tick] + 1e-6
        worse += other[tick] > least + 1e-3
    assert worse > 0
    assert (run.series["least_norm"] <= other + 1e-6).all()


def test_p_ssa_passes_without_a_collision_and_bounds_phi_best(runs: dict[str, CorridorRun]) -> None:
    """Metric 10: p-SSA below r-SSA below naive SSA, which goes through the board."""
    phi = [runs[name].summary["phi_hand_max_m"] for name in ("pssa", "rssa", NAIVE)]
    assert phi == sorted(phi)
    assert phi[-1] > D_MIN["obstacle"]
    assert runs["pssa"].summary["collision_ticks"] == 0
    assert runs["pssa"].summary["min_h_obstacle_m"] > 0
    assert runs["pssa"].summary["min_joint_limit_rad"] > 0


def test_naive_ssa_passes_the_nominal_velocity_on_and_collisions_are_counted(runs: dict[str, CorridorRun]) -> None:
    series, summary = runs[NAIVE].series, runs[NAIVE].summary
    conflict = series["infeasible"]
    np.testing.assert_array_equal(series["v_safe"][conflict], series["v_des"][conflict])
    touched = (series["h_obstacle"] < -1e-6).any(axis=(1, 2)) | (series["h_self_collision"] < -1e-6).any(axis=1)
    assert summary["collision_ticks"] == np.count_nonzero(touched) > 0
    assert "left hand - upper board" in summary["collisions"]


def test_ssa_that_relaxes_by_least_slack_is_p_ssa(runs: dict[str, CorridorRun]) -> None:
    np.testing.assert_allclose(runs["ssa"].series["q"], runs["pssa"].series["q"], rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def bare_cbf(g1: RobotDescription) -> CorridorRun:
    """CBF without a margin, as in its own paper."""
    return CorridorLoop(g1, Corridor(), "cbf", margins="own").run(DURATION)


def test_cbf_without_a_margin_meets_its_conditions_where_ssa_cannot(bare_cbf: CorridorRun) -> None:
    assert not bare_cbf.series["infeasible"].any()
    assert bare_cbf.summary["feasible_rate"] == 1.0
    assert bare_cbf.summary["C"] is None
    assert bare_cbf.summary["min_h_obstacle_m"] > -1e-4


def test_with_the_margin_of_the_others_cbf_is_in_conflict_too_and_hits_nothing(runs: dict[str, CorridorRun]) -> None:
    assert runs["cbf"].series["infeasible"].any()
    assert runs["cbf"].summary["min_h_obstacle_m"] > 0


def test_the_robot_moves_exactly_as_the_filter_says(runs: dict[str, CorridorRun]) -> None:
    for run in runs.values():
        moved = np.diff(run.series["q"], axis=0)
        np.testing.assert_allclose(moved, DT * run.series["v_safe"][:-1], rtol=0, atol=1e-12)


def test_a_heavier_weight_brings_r_ssa_nearer_to_the_least_violation(g1: RobotDescription) -> None:
    excess = [CorridorLoop(g1, Corridor(), "rssa", weight).run(4.5).summary["excess_mean"] for weight in (1, 10, 1e3)]
    assert excess == sorted(excess, reverse=True)


def test_every_variant_runs_and_has_a_title_of_its_own(g1: RobotDescription) -> None:
    results = [CorridorLoop(g1, Corridor(), name).run(0.05) for name in VARIANTS]
    assert len({variant_title(name) for name in VARIANTS}) == len(VARIANTS)
    for run in results:
        assert len(run.series["time"]) == 5
        assert run.explanation == "every tick had a velocity that met all conditions"
    assert corridor_table(results).row_count > 0


def test_labels_and_distances_belong_together(loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun]) -> None:
    """Against the distance of the body's centre to the sphere, computed by hand."""
    loop, run = loops["pssa"], runs["pssa"]
    conditions(loop, run, 700)
    bodies = loop.obstacles.bodies
    assert bodies is not None
    ball = loop.scene.obstacles(float(run.series["time"][700]))[2]
    expected = np.linalg.norm(bodies.origin - ball.position, axis=1) - bodies.radius - ball.radius
    np.testing.assert_allclose(run.series["h_obstacle"][700, :, 2], expected, rtol=0, atol=1e-12)
    flat = [f"{name.replace('_', ' ')} - sphere" for name in bodies.names]
    assert list(loop.labels[loop.barriers.slices["obstacle"]][2::3]) == flat


# --- scores


def test_scores_are_those_of_the_paper() -> None:
    d = np.array([[0.0, 0.1], [0.02, 0.05]])
    by_hand = np.mean([1.0, np.exp(-0.01 / 0.002), np.exp(-0.0004 / 0.002), np.exp(-0.0025 / 0.002)])
    assert tracking_score(d) == pytest.approx(by_hand, rel=1e-12)
    s = np.array([0.0, 0.3, 0.0, 0.1])
    assert control_score(s) == pytest.approx(0.5 * (np.exp(-0.09 / 0.2) + np.exp(-0.01 / 0.2)), rel=1e-12)
    assert feasible_rate(s) == 0.5
    depth = np.array([[0.01, -0.2], [-0.1, 0.03]])
    expected = 0.5 * (np.exp(-0.0001 / 0.0002) + np.exp(-0.0009 / 0.0002))
    assert safety_score(depth) == pytest.approx(expected, rel=1e-12)


def test_figures_are_those_of_the_series(loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun]) -> None:
    for name, run in runs.items():
        series, summary = run.series, run.summary
        bodies = loops[name].obstacles.bodies
        assert bodies is not None
        left, right = (series["h_obstacle"][:, bodies.names.index(f"{side}_hand")] for side in ("left", "right"))
        assert summary["phi_hand_max_m"] == pytest.approx(0.05 - left.min(), abs=1e-15)
        assert summary["min_h_hand_m"] == min(left.min(), right.min())
        phi = np.concatenate([(0.05 - series["h_obstacle"]).ravel(), (0.01 - series["h_self_collision"]).ravel()])
        assert summary["S"] == pytest.approx(np.mean(np.exp(-(phi[phi > 0] ** 2) / 0.0002)), rel=1e-12)
        error = np.linalg.norm(series["hands"] - series["goals"], axis=2)
        assert summary["J"] == pytest.approx(np.mean(np.exp(-(error**2) / 0.002)), rel=1e-12)
        assert summary["infeasible_ticks"] == np.count_nonzero(series["infeasible"])
        violated = series["violation"] > 0
        assert summary["C"] == pytest.approx(np.mean(np.exp(-(series["violation"][violated] ** 2) / 0.2)), rel=1e-12)
        assert summary["feasible_rate"] == pytest.approx(1 - violated.mean(), rel=1e-12)
        assert summary["violation_mean"] == pytest.approx(series["violation"].mean(), rel=1e-12)


@pytest.mark.parametrize("name", ["pssa", "ssa", "rssa", NAIVE])
def test_the_violation_is_the_sum_over_conditions_and_its_norm_the_root_of_the_squares(
    loops: dict[str, CorridorLoop], runs: dict[str, CorridorRun], name: str
) -> None:
    run = runs[name]
    several = 0
    for tick in range(0, len(run.series["time"]), 50):
        _, spaces, _ = conditions(loops[name], run, tick)
        gap = spaces.A @ run.series["v_safe"][tick] - spaces.b
        short = np.maximum(-gap[spaces.active], 0.0)
        assert run.series["violation"][tick] == pytest.approx(short.sum(), abs=1e-5)
        assert run.series["violation_norm"][tick] == pytest.approx(np.sqrt(np.sum(short**2)), abs=1e-5)
        several += int(np.count_nonzero(short > 1e-3) > 1)
    assert several > 0


def test_without_a_filter_the_violation_is_that_of_ssa_s_conditions(g1: RobotDescription) -> None:
    loop = CorridorLoop(g1, Corridor(), "none")
    run = loop.run(4.0)
    np.testing.assert_array_equal(run.series["v_safe"], run.series["v_des"])
    for tick in (100, 300, 399):
        _, spaces, _ = conditions(loop, run, tick)
        gap = spaces.A @ run.series["v_safe"][tick] - spaces.b
        short = -np.minimum(gap[spaces.active], 0.0).sum()
        assert run.series["violation"][tick] == pytest.approx(short, abs=1e-5)
    assert run.series["violation"][300] > 0.5


def test_scores_of_nothing_are_none() -> None:
    assert control_score(np.zeros(3)) is None
    assert safety_score(-np.ones((3, 2))) is None


def test_a_score_without_anything_to_score_reads_none(bare_cbf: CorridorRun) -> None:
    assert figure_text(Metric("C", "C"), bare_cbf) == "none"


def test_rounding_is_no_overlap_and_an_overlap_stands_out(runs: dict[str, CorridorRun]) -> None:
    figure = Metric("min_h_hand_m", "nearest hand", "mm", 1e3, "negative")
    for value, text, bad in ((-1e-9, "0.0", False), (-0.0012, "-1.2", True), (0.0012, "1.2", False)):
        run = dataclasses.replace(runs["cbf"], summary={"min_h_hand_m": value})
        assert (figure_text(figure, run), is_bad(figure, run)) == (text, bad)


# --- words


def test_findings_follow_the_data(runs: dict[str, CorridorRun]) -> None:
    chosen = [runs[name] for name in ("pssa", "rssa", NAIVE)]
    assert any(s.startswith("That is the paper's order") for s in findings(chosen))
    worse = dataclasses.replace(runs["pssa"], summary=runs["pssa"].summary | {"phi_hand_max_m": 1.0})
    assert any(s.startswith("That is not the paper's order") for s in findings([worse, *chosen[1:]]))


def test_findings_name_what_hit_and_what_did_not(runs: dict[str, CorridorRun]) -> None:
    said = findings([runs[NAIVE], runs["pssa"]])
    (hit,) = [s for s in said if s.startswith("SSA, naive:")]
    assert "left hand - upper board" in hit or "more" in hit
    (clear,) = [s for s in said if s.startswith("Hit nothing")]
    assert "p-SSA" in clear
    assert "naive" not in clear


def test_the_explanation_names_the_boards_that_exclude_each_other(runs: dict[str, CorridorRun]) -> None:
    for name in ("pssa", "rssa", NAIVE):
        words = runs[name].explanation
        assert words.startswith("first, at ")
        closed = words.split("boards closed, at ")[1]
        conflict = next(line for line in closed.splitlines() if "cannot hold" in line)
        assert "lower board" in conflict
        assert "upper board" in conflict
        assert "method infeasibility" in closed


# --- pictures and report


def test_obstacles_become_shapes() -> None:
    turn = rotation_to(np.array([0.6, 0.0, 0.8]))
    obstacles = [
        Obstacle.sphere(np.ones(3), 0.1),
        Obstacle.capsule(np.zeros(3), np.array([0.0, 0.3, 0.4]), 0.05),
        Obstacle.capsule(np.ones(3), np.ones(3), 0.05),
        Obstacle.box(np.zeros(3), turn, np.array([0.1, 0.2, 0.3])),
        Obstacle.half_space(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 2.0])),
    ]
    ball, capsule, point, box, plate = obstacle_shapes(obstacles)
    assert [s.kind for s in (ball, capsule, point, box, plate)] == ["sphere", "capsule", "sphere", "box", "box"]
    assert capsule.size == pytest.approx((0.05, 0.25))
    np.testing.assert_allclose(capsule.center, [0.0, 0.15, 0.2])
    np.testing.assert_allclose(capsule.rotation[:, 2], [0.0, 0.6, 0.8], atol=1e-15)
    np.testing.assert_array_equal(box.rotation, turn)
    # its upper face is the plane
    assert plate.center[2] + plate.size[2] == pytest.approx(1.0)


@pytest.mark.parametrize("z", [(1, 0, 0), (0, -1, 0), (0, 0, -1), (0.6, 0.0, -0.8)])
def test_a_rotation_to_an_axis_is_one(z: Sequence[float]) -> None:
    turn = rotation_to(np.array(z, dtype=float))
    np.testing.assert_allclose(turn[:, 2], z, atol=1e-15)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_bad_shapes_are_refused() -> None:
    for kind, size in (("cone", (1.0,)), ("box", (1.0, 1.0)), ("sphere", (0.0,)), ("capsule", (0.1, np.nan))):
        with pytest.raises(ConfigError, match=r"shape|size"):
            Shape(kind, size, np.zeros(3))
    with pytest.raises(ConfigError, match="center"):
        Shape("sphere", (0.1,), np.array([0.0, np.inf, 0.0]))


@pytest.mark.rendering
def test_every_kind_of_shape_is_drawn_where_it_is(g1: RobotDescription) -> None:
    """A shape in front of the robot changes the picture, one behind the camera does not."""
    kin = CorridorLoop(g1, Corridor(), "none").kin
    q = kin.full_configuration(kin.posture())
    turn = rotation_to(np.array([0.0, 0.6, 0.8]))
    with RobotRenderer(g1, 96, 96) as renderer:
        bare = renderer.image(q)
        for kind, size in (("sphere", (0.1,)), ("capsule", (0.05, 0.1)), ("box", (0.1, 0.05, 0.02))):
            seen = renderer.image(q, shapes=[Shape(kind, size, np.array([0.5, 0.3, 0.8]), turn)])
            hidden = renderer.image(q, shapes=[Shape(kind, size, np.array([50.0, 33.0, 0.8]), turn)])
            assert (seen != bare).any()
            np.testing.assert_array_equal(hidden, bare)


@pytest.mark.rendering
def test_pictures_are_taken_at_the_three_instants(g1: RobotDescription, runs: dict[str, CorridorRun]) -> None:
    (frames,) = corridor_frames(Corridor(), g1, [runs["pssa"]])
    assert [t for t, _ in frames] == pytest.approx([t for t in INSTANTS if t < DURATION])
    assert all(png.startswith(b"\x89PNG") for _, png in frames)


def test_the_report_is_one_file_with_everything_in_it(
    g1: RobotDescription, runs: dict[str, CorridorRun], tmp_path: Path
) -> None:
    chosen = list(runs.values())
    path = write_corridor_report(tmp_path / "report.html", Corridor(), g1, chosen, note="no <pictures>")
    page = path.read_text(encoding="utf-8")
    assert page.count("data:image/png") == 4
    assert "no &lt;pictures&gt;" in page
    assert "http" not in page.replace("http-equiv", "")
    for run in chosen:
        assert run.title in page
    with pytest.raises(ConfigError, match="report"):
        write_corridor_report(tmp_path / "missing" / "report.html", Corridor(), g1, chosen)


# --- command line


def call(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["safewbc", "run", "corridor", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return caught.value.code


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--filters", "pssa", "foo"], ["filters = 'foo'", "ssa-naive"]),
        (["--filters", "ecbf"], ["filters = 'ecbf'"]),
        (["--filters"], ["filters", "at least one"]),
        (["--filters", "cbf", "cbf"], ["filters", "once"]),
        (["--gap", "-0.1"], ["gap = -0.1", "from 0.11 m", "to 0.3 m"]),
        (["--gap", "0.1"], ["gap = 0.1", "the hand just fits"]),
        (["--gap", "nan"], ["gap = nan"]),
        (["--duration", "0"], ["duration = 0.0"]),
        (["--weight", "0"], ["weight = 0.0", "above 0"]),
        (["--margins", "all"], ["margins = 'all'", "shared, own"]),
        (["--seed", "-1"], ["seed = -1"]),
        (["--out", "plain/below"], ["out = 'plain/below'", "a folder that can be written"]),
    ],
    ids=" ".join,
)
def test_a_bad_option_is_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: Sequence[str],
    told: Sequence[str],
) -> None:
    (tmp_path / "plain").write_text("keep me")
    assert call(tmp_path, monkeypatch, *arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("safewbc: ")
    assert err.count("\n") == 1
    for words in told:
        assert words in err
    assert [p.name for p in tmp_path.iterdir()] == ["plain"]


def test_a_run_leaves_what_is_needed_to_look_at_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--filters", "pssa", NAIVE, "--duration", "0.2", "--gap", "0.15", "--no-report", "--out", "here")
    assert call(tmp_path, monkeypatch, *arguments) == 0
    files = sorted(str(p.relative_to(tmp_path / "here")) for p in (tmp_path / "here").rglob("*") if p.is_file())
    kept = [f"{name}/{file}" for name in ("pssa", NAIVE) for file in DATA]
    assert files == sorted(["filters.json", *kept])
    config = json.loads((tmp_path / "here" / "pssa" / "config.json").read_text())
    assert config["scenario"]["gap"] == 0.15
    summary = json.loads((tmp_path / "here" / "filters.json").read_text())
    assert [entry["name"] for entry in summary] == ["pssa", NAIVE]
    with np.load(tmp_path / "here" / "pssa" / "series.npz") as series:
        assert series["q"].shape == (20, 17)
        assert series["h_obstacle"].shape == (20, 19, 3)
        assert len(config["rows"]) == 19 * 3 + series["h_self_collision"].shape[1]
    out = capsys.readouterr().out
    assert "infeasible ticks" in out
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80


def test_the_rows_are_those_of_the_paper(g1: RobotDescription, loops: dict[str, CorridorLoop]) -> None:
    """Obstacles and the robot's own bodies, nothing else; 19 spheres and 29 pairs."""
    loop = loops["pssa"]
    assert loop.barriers.size == 19 * 3 + 29
    assert set(loop.barriers.slices) == {"obstacle", "self_collision"}
    everything = standard_barriers(loop.kin, loop.scene.kinds)
    assert everything.slices["self_collision"].stop - everything.slices["self_collision"].start == 29
