"""What a run records while it runs, and where its time goes."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from experiments.benchmarks import loop as bench_loop
from experiments.benchmarks.loop import case, loop_figures
from experiments.benchmarks.tick import bench
from experiments.recording.columns import Columns
from experiments.recording.recording import GUARANTEED
from experiments.running.ground_truth import TrueBarriers
from experiments.running.laps import LOOP_PARTS, PARTS, Laps
from experiments.scenarios.options import BenchOptions
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.geometry.shapes import Obstacle

ROOT = Path(__file__).resolve().parents[2]

# --- columns


def test_columns_are_what_a_list_of_rows_would_stack_to() -> None:
    rng = np.random.default_rng(0)
    rows = [
        {"x": float(i), "n": i, "v": rng.standard_normal(3), "m": rng.random((2, 2)).astype(np.float32)}
        for i in range(5)
    ]
    columns = Columns(8)
    for row in rows:
        columns.append(row)
    found = columns.arrays()
    assert list(found) == ["x", "n", "v", "m"]
    for name, values in found.items():
        right = np.array([row[name] for row in rows])
        assert values.dtype == right.dtype
        np.testing.assert_array_equal(values, right)


def test_a_row_is_copied() -> None:
    columns, v = Columns(2), np.zeros(3)
    columns.append({"v": v})
    v[:] = 1.0
    columns.append({"v": v})
    np.testing.assert_array_equal(columns.arrays()["v"], [[0, 0, 0], [1, 1, 1]])


def test_columns_refuse_a_row_too_many_and_one_that_lacks_a_name() -> None:
    columns = Columns(1)
    columns.append({"x": 1.0, "y": 2.0})
    with pytest.raises(IndexError):
        columns.append({"x": 1.0, "y": 2.0})
    columns = Columns(2)
    columns.append({"x": 1.0, "y": 2.0})
    with pytest.raises(KeyError):
        columns.append({"x": 1.0})


# --- true barriers


def random_configuration(robot: RobotDescription, rng: np.random.Generator) -> Array:
    q = standing_configuration(robot)
    lower, upper = robot.position_limits
    q[7:] = rng.uniform(lower, upper)
    return q


@pytest.mark.parametrize("kinds", [(), ("sphere",), ("capsule", "box", "half_space")])
def test_true_rows_are_the_distances_among_all_rows(robot: RobotDescription, kinds: tuple[str, ...]) -> None:
    """And the largest gradient of each family is that of its rows."""
    rng, kin = np.random.default_rng(3), Kinematics(robot)
    every, truth = standard_barriers(kin, kinds, keep_fixed=True), TrueBarriers(robot, kinds)
    made = {
        "sphere": Obstacle.sphere(np.array([0.4, 0.1, 1.0]), 0.1),
        "capsule": Obstacle.capsule(np.array([0.4, 0.1, 1.0]), np.array([0.5, 0.3, 1.1]), 0.1),
        "box": Obstacle.box(np.array([0.5, 0.0, 1.0]), np.eye(3), np.array([0.1, 0.2, 0.3])),
        "half_space": Obstacle.half_space(np.array([0.8, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])),
    }
    obstacles = [made[kind] for kind in kinds]
    for barrier in (b for b in every.barriers if b.family == "obstacle"):
        barrier.set_obstacles(obstacles)  # type: ignore[attr-defined]
    for _ in range(5):
        q = random_configuration(robot, rng)
        kin.update_geometry(q)
        rows, found = every.evaluate(kin), truth.evaluate(q, obstacles)
        gradients = dict(zip(GUARANTEED, truth.gradients(found), strict=True))
        assert sum(cut.stop - cut.start for cut in truth.slices.values()) == found.h.size
        for family, chosen in every.representative.items():
            np.testing.assert_array_equal(found.h[truth.slices[family]], rows.h[chosen])
            np.testing.assert_array_equal(found.jac[truth.slices[family]], rows.jac[chosen])
            longest = np.linalg.norm(rows.jac[chosen], axis=1)
            np.testing.assert_allclose(gradients.pop(family), longest.max() if chosen.size else np.nan, rtol=1e-12)
        assert np.isnan(list(gradients.values())).all()


# --- time


def test_laps_add_up_to_the_time_that_passed() -> None:
    before = time.perf_counter()
    laps = Laps()
    for part in (*PARTS, "tick", "tick"):
        laps.book(part)
    assert all(seconds >= 0 for seconds in laps.seconds.values())
    assert 0 < sum(laps.seconds.values()) <= time.perf_counter() - before
    with pytest.raises(KeyError):
        laps.book("tock")


def test_every_part_of_a_run_is_booked() -> None:
    before = time.perf_counter()
    scenario = case("g1", "hands", 2000.0, "issf", 0.1)
    assert (scenario.control_rate, scenario.plant.physics_dt, scenario.duration) == (2000.0, 0.0005, 0.1)
    figures = loop_figures(scenario)
    passed = 1e3 * (time.perf_counter() - before)
    assert set(figures) == {*PARTS, "loop", "real_time_factor", "processor_ratio"}
    assert all(value > 0 for value in figures.values())
    assert figures["loop"] == pytest.approx(sum(figures[part] for part in LOOP_PARTS))
    assert figures["loop"] * figures["real_time_factor"] == pytest.approx(1e3)
    around = sum(figures[part] for part in PARTS if part != "set-up")
    assert 0.1 * around + figures["set-up"] <= passed


def test_the_bench_prints_and_writes_every_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_loop, "DURATION", 4.1)
    monkeypatch.setattr(bench_loop, "RATES", {250.0: 0.002})
    assert bench(BenchOptions("loop", robots=("g1",), out=tmp_path / "loop.json")) == 0
    figures = json.loads((tmp_path / "loop.json").read_text())
    assert list(figures) == ["g1"]
    assert list(figures["g1"]) == ["hands 250 Hz", "walk 250 Hz"]
    printed = capsys.readouterr().out
    for part in (*PARTS, "loop", "times real time", "processor ratio"):
        assert part in printed


def test_who_tracks_no_obstacle_does_not_wait_for_scipy_s_statistics() -> None:
    program = "import sys, experiments.scenarios.hand_tracking; print('scipy.stats' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "False"
