"""docs/output.md names every file, figure and array of a run, with the shapes and orders that a run has."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from controllers.whole_body.controller import STAGES
from experiments.cli.output_page import with_tables
from experiments.metrics.declared_motion import DRAWN
from experiments.recording.recording import FILTER_STATUSES, STOPPED, Recording, save_recording
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import PlantOptions, SensingOptions
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from safety.barriers.barrier import Barrier, JointLimitBarrier
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, SelfCollisionBarrier

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "output.md").read_text(encoding="utf-8")


def rows(section: str) -> dict[str, list[str]]:
    """Cells of every table row of a section by the name in its first cell, which stands there once."""
    text = PAGE.split(f"\n## {section}\n")[1].split("\n## ")[0]
    found = [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| `")]
    names = [cells[0].strip("`") for cells in found]
    assert len(set(names)) == len(names)
    return {name: cells[1:] for name, cells in zip(names, found, strict=True)}


@pytest.fixture(scope="module")
def hands() -> Recording:
    """A run with everything in it: a hand task and an obstacle."""
    return run(HandTracking(duration=0.3, motion="hold", obstacle=True))


@pytest.fixture(scope="module")
def estimated() -> Recording:
    """A run on what an estimator makes of the robot's own sensors."""
    return run(Stand(duration=0.3, sensing=SensingOptions(state="estimated")))


@pytest.fixture(scope="module")
def filtered() -> Recording:
    """Into the conflict, on a robot that strays from the filter's velocity; a tick is a step, so each state is kept."""
    options = HandTracking(duration=2.2, control_rate=1000.0, plant=PlantOptions(mass_scale=1.2))
    result = run(options)
    assert len(result.series["step_time"]) == len(result.series["time"])
    acted = result.series["filter_status"] == FILTER_STATUSES.index("filtered")
    assert np.count_nonzero(acted) > 200
    assert np.linalg.norm((result.series["v_safe"] - result.series["v_des"])[acted], axis=1).max() > 0.5
    return result


@pytest.fixture(scope="module")
def stand() -> Recording:
    """A run without either."""
    return run(Stand(duration=0.2))


@pytest.fixture(scope="module")
def stepping() -> list[Recording]:
    """The runs that lift feet; the walk so long that it comes to steps."""
    walk = run(Walk(duration=5.5))
    return [run(Taichi(duration=0.2)), run(LateralSteps(duration=0.2)), walk]


@dataclass(frozen=True)
class OwnBarrier(Stand):
    """Standing, with a barrier of one's own."""

    name: ClassVar[str] = "own-barrier"

    def extra_barriers(self, kin: Kinematics) -> Sequence[Barrier]:
        return (JointLimitBarrier(kin),)


@pytest.fixture(scope="module")
def own_barrier() -> Recording:
    """A run that keeps a barrier of one's own."""
    return run(OwnBarrier(duration=0.1))


def test_the_tables_of_the_page_are_those_of_the_declarations() -> None:
    assert with_tables(PAGE) == PAGE, "make docs-output writes them anew"


def test_a_table_that_has_no_place_is_missed() -> None:
    with pytest.raises(ConfigError, match="arrays per step"):
        with_tables(PAGE.replace("<!-- arrays per step", "<!-- arrays per stop"))


def test_every_figure_is_in_the_page_and_nothing_else(
    hands: Recording, stepping: list[Recording], own_barrier: Recording, estimated: Recording
) -> None:
    drawn, made = {metric.key for metric in DRAWN}, (*stepping, own_barrier, estimated)
    assert set(rows("summary.json")) == set(hands.summary).union(drawn, *(m.summary for m in made))


def test_figures_of_single_experiments_are_said_to_be_theirs(hands: Recording, stepping: list[Recording]) -> None:
    said = {
        name: re.findall(r"`([\w-]+)`", cells[0]) for name, cells in rows("summary.json").items() if len(cells) == 3
    }
    assert not set(said) & set(hands.summary)
    for made in stepping:
        own = {name for name, experiments in said.items() if made.summary["scenario"] in experiments}
        assert own == set(made.summary) - set(hands.summary)


def test_figures_that_standing_lacks_are_marked_absent(hands: Recording, stand: Recording) -> None:
    said = {name for name, cells in rows("summary.json").items() if "absent without a hand task" in cells[-1]}
    assert said == set(hands.summary) - set(stand.summary)


def test_figures_that_do_not_apply_are_said_to_be_null(
    hands: Recording, stand: Recording, stepping: list[Recording]
) -> None:
    page = rows("summary.json")
    for made in (hands, stand, *stepping):
        for name, value in made.summary.items():
            if value is None:
                assert "`null`" in page[name][-1], name


def test_every_array_is_in_the_page_with_its_shape_and_nothing_else(
    hands: Recording, stepping: list[Recording], own_barrier: Recording, estimated: Recording
) -> None:
    page = rows("series.npz")
    all_runs = (hands, *stepping, own_barrier, estimated)
    assert set(page) == set().union(*(made.series for made in all_runs))
    for made in all_runs:
        nj = len(made.robot.joints)
        sizes = {
            "T": round(500 * made.summary["duration_s"]),
            "P": round(1000 * made.summary["duration_s"]),
            "nj": nj,
            "nq": 7 + nj,
            "nv": 6 + nj,
            "pairs": len(made.robot.self_collision_pairs),
            "bounds": len(made.robot.workspace),
            "bodies": len(made.series.get("obstacles", np.zeros((1, 0)))[0]),
            "rows": len(made.series.get("h_own", np.zeros((1, 0)))[0]),
            "K": len(made.series["support_polygon"]),
        }
        for name, values in made.series.items():
            shape = tuple(sizes.get(n) or int(n) for n in re.findall(r"\w+", page[name][0]))
            assert values.shape == shape, name


def test_barriers_of_ones_own_are_recorded_until_the_robot_stops() -> None:
    result = run(OwnBarrier(duration=0.4, nan_at=0.1))
    series, stopped = result.series, result.series["filter_status"] == STOPPED
    assert stopped.any()
    np.testing.assert_array_equal(np.isnan(series["h_own"]), np.tile(stopped[:, None], series["h_own"].shape[1]))
    # joint limits, which the recorder keeps too: the end of the step before a tick is the tick's instant
    at = np.searchsorted(series["step_time"], series["time"][~stopped] - 1e-9)
    least = series["h_own"][~stopped].min(axis=1)
    np.testing.assert_allclose(least[1:], series["h_joint_limit"][at[1:]], rtol=0, atol=1e-12)
    assert result.summary["min_h_own"] == least.min()


def test_arrays_that_only_some_runs_have_are_marked(
    hands: Recording, stand: Recording, stepping: list[Recording]
) -> None:
    page = rows("series.npz")
    assert set(stand.series) < set(hands.series)
    for name in set(hands.series) - set(stand.series):
        conditions = ("only with a hand task", "only with `--obstacle`")
        # three arrays of the hands are covered by the sentence at the first
        assert any(c in page[name][-1] for c in conditions) or name in {"left_hand_ref", "right_hand", "right_hand_ref"}
    for made in stepping:
        own = {name for name, c in page.items() if re.search(f"only in .*`{made.summary['scenario']}`", c[-1])}
        assert own == set(made.series) - set(hands.series)


def test_corners_are_in_the_order_that_the_page_tells_and_about_the_soles(stepping: list[Recording]) -> None:
    for made in stepping:
        corners = made.series["sole_corners"]
        np.testing.assert_allclose(corners.mean(axis=2), made.series["soles"][:, :, :2], rtol=0, atol=1e-12)
        front_left, rear_left, rear_right, _ = np.moveaxis(corners[0], 1, 0)
        for foot, sole in enumerate(made.robot.soles):
            # the robot faces x; its soles may be turned a little
            np.testing.assert_allclose(front_left - rear_left, [[2 * sole.half_length, 0]] * 2, atol=0.01)
            assert np.linalg.norm((rear_left - rear_right)[foot]) == pytest.approx(2 * sole.half_width, rel=1e-3)
            assert rear_left[foot, 1] > rear_right[foot, 1]


def test_the_summary_s_steps_are_the_plan_s(stepping: list[Recording]) -> None:
    walk = stepping[-1]
    contact = walk.series["in_contact"]
    assert set(np.unique(contact)) == {0.0, 1.0}
    # every flight of a foot that has ended
    flights = np.diff(contact, axis=0, append=contact[-1:])
    assert walk.summary["steps"] == (flights == 1).sum() >= 2
    # the foot in the air bears nothing half-way
    for foot in (0, 1):
        lifts, lands = np.flatnonzero(flights[:, foot] == -1), np.flatnonzero(flights[:, foot] == 1)
        for lift, land in zip(lifts, lands, strict=False):
            assert walk.series["foot_wrench"][(lift + land) // 2, foot, 2] == 0.0


def test_codes_and_stages_are_in_the_page_in_their_order() -> None:
    page = rows("series.npz")
    codes = re.findall(r"(\d) (\w+)", page["filter_status"][-1])
    assert codes == [(str(i), name) for i, name in enumerate(FILTER_STATUSES)]
    assert re.findall(r"`(\w+)`", page["stages"][-1]) == list(STAGES)


def test_columns_of_pairs_are_in_the_order_that_the_page_tells(hands: Recording) -> None:
    """Each column of the last step against the distance of the two bodies that the page says it belongs to."""
    robot = hands.robot
    legs = robot.leg_pairs
    assert robot.self_collision_pairs[-len(legs) :] == legs
    kin = Kinematics(robot)
    kin.update_geometry(hands.series["q"][-1])
    bodies = CollisionBodies(kin)
    barrier = SelfCollisionBarrier("self_collision", bodies, robot.self_collision_pairs)
    barriers = BarrierSet(kin, bodies, [barrier])
    h = barriers.evaluate(kin).h[barriers.representative["self_collision"]]
    step = int(np.searchsorted(hands.series["step_time"], hands.series["time"][-1] - 1e-9))
    np.testing.assert_allclose(hands.series["h_self_collision"][step], h, rtol=1e-6, atol=1e-9)


def test_the_disturbance_is_the_true_velocity_less_the_filtered_one(hands: Recording) -> None:
    """At the last step before each tick the true velocity is known from the tick's own series."""
    series = hands.series
    size = np.linalg.norm(series["v"][1:] - series["v_safe"][:-1], axis=1)
    np.testing.assert_allclose(series["disturbance"][1:-1:2], size, rtol=1e-12)
    assert hands.summary["disturbance_max"] == series["disturbance"].max()


def test_the_disturbance_is_that_of_every_step_also_where_the_filter_acts(filtered: Recording) -> None:
    """The state after a step is that of the next tick; what counts is the velocity after the filter, not before it."""
    series = filtered.series
    np.testing.assert_allclose(series["step_time"][:-1], series["time"][1:], rtol=0, atol=1e-9)
    size = np.linalg.norm(series["v"][1:] - series["v_safe"][:-1], axis=1)
    np.testing.assert_allclose(series["disturbance"][:-1], size, rtol=1e-12)
    assert filtered.summary["disturbance_max"] == series["disturbance"].max()
    assert filtered.summary["disturbance_rms"] == pytest.approx(np.sqrt(np.mean(series["disturbance"] ** 2)))


@pytest.mark.parametrize("name", ["hands", "filtered"])
def test_running_bounds_solve_the_equation_of_the_page(name: str, request: pytest.FixtureRequest) -> None:
    hands: Recording = request.getfixturevalue(name)
    safety = hands.config["controller"]["safety"]
    for column, family in enumerate(("joint_limit", "self_collision", "leg_collision", "obstacle", "workspace")):
        alpha, epsilon = safety[family]["alpha"], safety[family]["epsilon"]
        bound = hands.series["h_bound"][:, column]
        if family == "obstacle" and name == "filtered":
            assert np.isnan(bound).all()
            continue
        assert bound[0] == 0.0
        # constant forcing over a step of 1 ms: the exponential by its series
        settled = -epsilon * hands.series["disturbance"][1:] ** 2 / (4 * alpha)
        step = sum((-1) ** (k + 1) * (alpha * 0.001) ** k / math.factorial(k) for k in range(1, 6))
        np.testing.assert_allclose(np.diff(bound), step * (settled - bound[:-1]), rtol=1e-9, atol=1e-15)
    assert hands.summary["bound_held"] is True


def arm_rows(result: Recording) -> tuple[Kinematics, BarrierSet]:
    """Barrier of the pairs of arms, torso and head, and the kinematics on which it is evaluated."""
    kin = Kinematics(result.robot)
    bodies = CollisionBodies(kin)
    arms = [pair for pair in result.robot.self_collision_pairs if pair not in result.robot.leg_pairs]
    return kin, BarrierSet(kin, bodies, [SelfCollisionBarrier("self_collision", bodies, arms)])


def test_the_bound_of_the_row_solves_the_equation_of_the_page(filtered: Recording) -> None:
    """Every row anew from the recorded states, the exponential by its series; shown is the row with the smallest h."""
    kin, barriers = arm_rows(filtered)
    tuning, series = filtered.config["controller"]["safety"]["self_collision"], filtered.series
    alpha, epsilon, margin = tuning["alpha"], tuning["epsilon"], tuning["margin"] or 0.0
    step = sum((-1) ** (k + 1) * (alpha * 0.001) ** k / math.factorial(k) for k in range(1, 7))
    disturbance = series["v"][1:] - series["v_safe"][:-1]
    expected: list[float] = []
    bound, undisturbed = np.zeros(0), np.zeros(0)
    taken = 0.0
    for q, d in zip(series["q"][1:], disturbance, strict=True):
        kin.update_geometry(q)
        rows, kept = barriers.evaluate(kin), barriers.representative["self_collision"]
        h, jac = rows.h[kept], rows.jac[kept]
        room = margin + (jac**2).sum(axis=1) / epsilon / alpha
        settled = room + jac @ d / alpha
        undisturbed = undisturbed + step * (room - undisturbed) if expected else h.copy()
        bound = bound + step * (settled - bound) if expected else h.copy()
        taken = max(taken, float((undisturbed - bound)[h.argmin()]))
        expected.append(float(bound[h.argmin()]))
    np.testing.assert_allclose(series["h_row_bound"][:-1], expected, rtol=0, atol=1e-12)
    smallest = series["h_row_bound"].min()
    assert filtered.summary["row_bound_min_m"] == smallest
    # what the disturbance takes can be seen in it: far more than rounding
    assert taken > 1e-4


def test_gradients_and_the_bound_of_the_row_are_those_of_the_true_configuration(hands: Recording) -> None:
    series = hands.series
    kin, rows = arm_rows(hands)
    kin.update_geometry(series["q"][-1])
    jac = rows.evaluate(kin).jac[rows.representative["self_collision"]]
    step = 2 * len(series["time"]) - 3
    assert series["gradient"][step, 1] == pytest.approx(np.linalg.norm(jac, axis=1).max(), rel=1e-12)
    assert series["gradient"][:, 0] == pytest.approx(1.0, rel=1e-15)
    # while no condition is active h has room above its row's bound, from which both start
    h = series["h_self_collision"][:, : len(jac)].min(axis=1)
    assert series["h_row_bound"][0] == pytest.approx(h[0], rel=1e-7)
    assert (series["h_row_bound"][1:] < h[1:]).all()
    assert (series["h_row_bound"] > series["h_bound"][:, 1]).all()


def test_the_example_of_the_page_finds_the_barrier_by_name(
    hands: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    save_recording(hands, tmp_path / "runs" / "mine")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    exec(compile(code, "docs/output.md", "exec"), {})
    column = hands.robot.self_collision_pairs.index(("left_hand", "torso_low"))
    smallest = hands.series["h_self_collision"][:, column].min()
    assert f"smallest barrier {1e3 * smallest:.1f} mm" in capsys.readouterr().out
    assert (tmp_path / "hand_torso.png").stat().st_size > 0


def test_files_of_a_run_are_in_the_page(hands: Recording, tmp_path: Path) -> None:
    save_recording(hands, tmp_path)
    page = rows("Files")
    assert set(page) == {p.name for p in tmp_path.iterdir()} | {"report.html", "video.mp4"}
    config = json.loads((tmp_path / "config.json").read_text(encoding="utf-8"))
    for name in config:
        assert f"`{name}`" in page["config.json"][0], name


def test_steps_and_ticks_share_one_clock(hands: Recording) -> None:
    np.testing.assert_allclose(hands.series["time"], 0.002 * np.arange(150), rtol=0, atol=1e-12)
    np.testing.assert_allclose(hands.series["step_time"], 0.001 * np.arange(1, 301), rtol=0, atol=1e-12)
