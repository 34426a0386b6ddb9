"""The corridor: the conflict is real, and p-SSA gives up the least."""

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from controllers.policies.nominal import benchmark_limits
from experiments.reports.corridor_table import corridor_table
from experiments.running.corridor_loop import DT, NAIVE, VARIANTS, CorridorLoop, CorridorRun, variant_title
from experiments.scenarios.corridor import (
    D_MIN,
    Corridor,
)
from robots.description import RobotDescription
from robots.messages import Array
from safety.barriers.barrier_set import standard_barriers
from safety.filters.conditions import BarrierParameters
from safety.filters.safety_filter import SafetyFilter
from tests.support.corridor import DURATION, conditions


def test_a_run_repeats_exactly(corridor_g1: RobotDescription, corridor_runs: dict[str, CorridorRun]) -> None:
    again = CorridorLoop(corridor_g1, Corridor(), "rssa").run(3.5)
    for name, values in again.series.items():
        if name != "filter_ms":
            np.testing.assert_array_equal(values, corridor_runs["rssa"].series[name][: len(values)], err_msg=name)


def test_hard_ssa_has_no_solution_and_an_independent_solver_agrees(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun]
) -> None:
    run = corridor_runs["pssa"]
    for tick in range(0, len(run.series["time"]), 40):
        _, spaces, limits = conditions(corridor_loops["pssa"], run, tick)
        A, b = spaces.A[spaces.active], spaces.b[spaces.active]
        bounds = np.column_stack([-limits, limits])
        found = linprog(np.zeros(limits.size), A_ub=-A, b_ub=-b, bounds=bounds) if b.size else None
        assert (found is not None and found.status == 2) == bool(run.series["infeasible"][tick]), tick
    assert run.series["infeasible"][400:].all()


def test_the_boards_are_a_conflict_of_conditions_that_could_each_be_met(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun]
) -> None:
    """Method infeasibility: each condition of the hand alone can be met, both boards together cannot."""
    loop, run = corridor_loops["pssa"], corridor_runs["pssa"]
    _, spaces, limits = conditions(loop, run, 450)
    rows = [loop.labels.index(f"left hand - {board} board") for board in ("lower", "upper")]
    assert spaces.active[rows].all()
    bounds = np.column_stack([-limits, limits])
    for chosen, status in ((rows[:1], 0), (rows[1:], 0), (rows, 2)):
        found = linprog(np.zeros(limits.size), A_ub=-spaces.A[chosen], b_ub=-spaces.b[chosen], bounds=bounds)
        assert found.status == status


@pytest.mark.parametrize("tick", [300, 450, 610, 700])
def test_the_violation_of_p_ssa_is_the_least(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun], tick: int
) -> None:
    run = corridor_runs["pssa"]
    _, spaces, limits = conditions(corridor_loops["pssa"], run, tick)
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
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun], name: str
) -> None:
    loop, run = corridor_loops[name], corridor_runs[name]
    limits = benchmark_limits(loop.kin)
    pssa = SafetyFilter("pssa", loop.barriers.size, BarrierParameters(), limits)
    other = run.series["violation_norm"]
    worse = 0
    for tick in range(0, len(other), 5):
        rows, _, _ = conditions(loop, run, tick)
        least = float(np.linalg.norm(pssa.apply(rows, run.series["v_des"][tick]).violation))
        assert least <= other[tick] + 1e-6
        worse += other[tick] > least + 1e-3
    assert worse > 0
    assert (run.series["least_norm"] <= other + 1e-6).all()


def test_p_ssa_passes_without_a_collision_and_bounds_phi_best(corridor_runs: dict[str, CorridorRun]) -> None:
    """Figure 10: p-SSA below r-SSA below naive SSA, which goes through the board."""
    phi = [corridor_runs[name].summary["phi_hand_max_m"] for name in ("pssa", "rssa", NAIVE)]
    assert phi == sorted(phi)
    assert phi[-1] > D_MIN["obstacle"]
    assert corridor_runs["pssa"].summary["collision_ticks"] == 0
    assert corridor_runs["pssa"].summary["min_h_obstacle_m"] > 0
    assert corridor_runs["pssa"].summary["min_joint_limit_rad"] > 0


def test_naive_ssa_passes_the_nominal_velocity_on_and_collisions_are_counted(
    corridor_runs: dict[str, CorridorRun],
) -> None:
    series, summary = corridor_runs[NAIVE].series, corridor_runs[NAIVE].summary
    conflict = series["infeasible"]
    np.testing.assert_array_equal(series["v_safe"][conflict], series["v_des"][conflict])
    touched = (series["h_obstacle"] < -1e-6).any(axis=(1, 2)) | (series["h_self_collision"] < -1e-6).any(axis=1)
    assert summary["collision_ticks"] == np.count_nonzero(touched) > 0
    assert "left hand - upper board" in summary["collisions"]


def test_ssa_that_relaxes_by_least_slack_is_p_ssa(corridor_runs: dict[str, CorridorRun]) -> None:
    np.testing.assert_allclose(corridor_runs["ssa"].series["q"], corridor_runs["pssa"].series["q"], rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def bare_cbf(corridor_g1: RobotDescription) -> CorridorRun:
    """CBF without a margin, as in its own paper."""
    return CorridorLoop(corridor_g1, Corridor(), "cbf", margins="own").run(DURATION)


def test_cbf_without_a_margin_meets_its_conditions_where_ssa_cannot(bare_cbf: CorridorRun) -> None:
    assert not bare_cbf.series["infeasible"].any()
    assert bare_cbf.summary["feasible_rate"] == 1.0
    assert bare_cbf.summary["C"] is None
    assert bare_cbf.summary["min_h_obstacle_m"] > -1e-4


def test_with_the_margin_of_the_others_cbf_is_in_conflict_too_and_hits_nothing(
    corridor_runs: dict[str, CorridorRun],
) -> None:
    assert corridor_runs["cbf"].series["infeasible"].any()
    assert corridor_runs["cbf"].summary["min_h_obstacle_m"] > 0


def test_the_robot_moves_exactly_as_the_filter_says(corridor_runs: dict[str, CorridorRun]) -> None:
    for run in corridor_runs.values():
        moved = np.diff(run.series["q"], axis=0)
        np.testing.assert_allclose(moved, DT * run.series["v_safe"][:-1], rtol=0, atol=1e-12)


def test_a_heavier_weight_brings_r_ssa_nearer_to_the_least_violation(corridor_g1: RobotDescription) -> None:
    excess = [
        CorridorLoop(corridor_g1, Corridor(), "rssa", weight).run(4.5).summary["excess_mean"] for weight in (1, 10, 1e3)
    ]
    assert excess == sorted(excess, reverse=True)


def test_every_variant_runs_and_has_a_title_of_its_own(corridor_g1: RobotDescription) -> None:
    results = [CorridorLoop(corridor_g1, Corridor(), name).run(0.05) for name in VARIANTS]
    assert len({variant_title(name) for name in VARIANTS}) == len(VARIANTS)
    for run in results:
        assert len(run.series["time"]) == 5
        assert run.explanation == "every tick had a velocity that met all conditions"
    table = corridor_table(results, [run.name for run in results])
    assert [c.heading for c in table.columns[1:]] == list(VARIANTS)


def test_labels_and_distances_belong_together(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun]
) -> None:
    """Against the distance of the body's centre to the sphere, computed by hand."""
    loop, run = corridor_loops["pssa"], corridor_runs["pssa"]
    conditions(loop, run, 700)
    bodies = loop.obstacle_barrier.bodies
    assert bodies is not None
    ball = loop.scene.obstacles(float(run.series["time"][700]))[2]
    expected = np.linalg.norm(bodies.origin - ball.position, axis=1) - bodies.radius - ball.radius
    np.testing.assert_allclose(run.series["h_obstacle"][700, :, 2], expected, rtol=0, atol=1e-12)
    flat = [f"{name.replace('_', ' ')} - sphere" for name in bodies.names]
    assert list(loop.labels[loop.barriers.slices["obstacle"]][2::3]) == flat


def test_the_explanation_names_the_boards_that_exclude_each_other(corridor_runs: dict[str, CorridorRun]) -> None:
    for name in ("pssa", "rssa", NAIVE):
        words = corridor_runs[name].explanation
        assert words.startswith("first, at ")
        closed = words.split("boards closed, at ")[1]
        conflict = next(line for line in closed.splitlines() if "cannot hold" in line)
        assert "lower board" in conflict
        assert "upper board" in conflict
        assert "method infeasibility" in closed


def test_the_rows_are_those_of_the_paper(
    corridor_g1: RobotDescription, corridor_loops: dict[str, CorridorLoop]
) -> None:
    """Obstacles and the robot's own bodies, nothing else; 19 spheres and 29 pairs."""
    loop = corridor_loops["pssa"]
    assert loop.barriers.size == 19 * 3 + 29
    assert set(loop.barriers.slices) == {"obstacle", "self_collision"}
    everything = standard_barriers(loop.kin, loop.scene.kinds)
    assert everything.slices["self_collision"].stop - everything.slices["self_collision"].start == 29
