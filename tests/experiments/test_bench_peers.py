"""Beside peers: same geometry and targets, figures as defined, and what is missing is named."""

import io
import json
import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from rich.console import Console

from controllers.reference import PointReference, WholeBodyReference, reference_here
from controllers.whole_body.robot_config import controller_config
from experiments.benchmarks import peers as bench_peers
from experiments.benchmarks.peer_stacks import COSTS, FRAMES, PEERS, OurIk, Peer, Targets, collision_geometry
from experiments.benchmarks.peers import BLOCK, OUR_TICK, OURS, WARM_UP, Line, figures, measure, notes, table
from experiments.benchmarks.tick import prepared, recorded
from experiments.cli import main as cli
from experiments.scenarios.options import BenchOptions
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers

OFFSET = 0.25
"""Of the stub's joint velocities from ours [rad/s]."""


class Shifted:
    """Answers as ours does, every joint faster by ``OFFSET``; every other time not at all."""

    def __init__(self, robot: RobotDescription, config: object) -> None:
        assert robot.name == "g1"
        self._ours, self._calls = OurIk(robot, controller_config(robot)), 0

    def velocity(self, state: RobotState, reference: WholeBodyReference) -> Array | None:
        v = self._ours.velocity(state, reference)
        self._calls += 1
        return None if self._calls % 2 else v + OFFSET


PRESENT = Peer("stub", "numpy", "numpy", Shifted, "ours, shifted")
ABSENT = Peer("absent", "no_such_module_anywhere", "no-such-distribution", Shifted, "nothing")


def text(lines: list[Line]) -> str:
    stream = io.StringIO()
    Console(width=200, file=stream).print(table(lines, "title"))
    return stream.getvalue()


def test_pairs_and_distances_are_those_of_our_rows(robot: RobotDescription) -> None:
    """Of every pair of the description, at random configurations, by coal."""
    kin = Kinematics(robot)
    barriers = standard_barriers(kin)
    geometry = collision_geometry(robot, kin.model)
    names = [
        (geometry.geometryObjects[p.first].name, geometry.geometryObjects[p.second].name)
        for p in geometry.collisionPairs
    ]
    assert names == list(robot.self_collision_pairs)
    data, rng = geometry.createData(), np.random.default_rng(0)
    rows = np.concatenate([barriers.representative["self_collision"], barriers.representative["leg_collision"]])
    for _ in range(20):
        q = standing_configuration(robot)
        q[7:] += rng.uniform(-0.3, 0.3, q.size - 7)
        kin.update(q, np.zeros(kin.nv))
        h = barriers.evaluate(kin).h
        expected = {barriers.labels[i]: h[i] for i in rows}
        pin.computeDistances(kin.model, kin.model.createData(), geometry, data, q)
        for (a, b), result in zip(names, data.distanceResults, strict=True):
            if (label := f"{a} - {b}") in expected and expected[label] > 0:
                assert result.min_distance == pytest.approx(expected[label], abs=1e-6)
    assert isinstance(geometry.geometryObjects[0].geometry, coal.Capsule)


def test_a_target_is_ahead_by_what_makes_the_error_feed_the_velocity_forward(robot: RobotDescription) -> None:
    """k (target - p) = k (p_ref - p) + v_ref for every p."""
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot), np.zeros(kin.nv))
    reference, rng = reference_here(kin, with_hands=True), np.random.default_rng(1)
    assert reference.hands is not None
    points: list[PointReference] = [*reference.soles, *reference.hands, reference.com]
    for point in points:
        point.velocity[:] = rng.normal(size=3)
    config = controller_config(robot)
    targets = Targets(robot, config)
    aims = targets.frames(reference)
    assert len(aims) == len(FRAMES)
    moved = [
        (aims[0][1], points[0], "foot"),
        (aims[5][1], points[3], "hand"),
        (targets.com(reference), points[4], "com"),
    ]
    for aim, point, kind in moved:
        k = getattr(config.tasks, kind)
        np.testing.assert_allclose(k * (aim - point.position), point.velocity, rtol=1e-12)
    np.testing.assert_array_equal(aims[2][0], reference.base_rotation)
    np.testing.assert_array_equal(aims[3][0], reference.torso_rotation)
    assert {k for _, k, _, _ in FRAMES} | {"com", "posture"} == set(COSTS)


def test_every_line_counts_its_calls_and_differs_by_what_it_does() -> None:
    robot = load_robot("g1")
    agent = prepared(robot, BenchOptions("peers"))
    lines = measure(agent, recorded(robot, agent, 2 * BLOCK), (PRESENT, ABSENT))
    assert [line.name for line in lines] == [OURS, OUR_TICK, "stub", "absent"]
    counted = 2 * (BLOCK - WARM_UP)
    assert [len(line.seconds) for line in lines] == [counted, counted, counted, 0]
    stub = lines[2]
    assert stub.unanswered == len(stub.differences) == counted // 2
    # its filter is the same and starts at the same state: only rounding of the sum is between them
    np.testing.assert_allclose(stub.differences, OFFSET, rtol=1e-9)
    for tick, stages in zip(lines[1].seconds, lines[0].seconds, strict=True):
        assert tick > stages


def test_figures_are_quantiles_and_their_ratio_to_our_first_line() -> None:
    ours = Line(OURS, "1", seconds=[k * 1e-6 for k in range(1, 12)])
    peer = Line("peer", "2", seconds=[3e-6 * k for k in range(1, 12)], differences=[0.1, 0.3, 0.2], unanswered=4)
    missing = Line("absent", None)
    found = figures([ours, peer, missing])
    assert found["peer"]["median_us"] == pytest.approx(18.0)
    assert found["peer"]["p10_us"] == pytest.approx(6.0)
    assert found["peer"]["median_to_ours"] == pytest.approx(3.0)
    assert found["peer"]["p10_to_ours"] == pytest.approx(3.0)
    assert found["peer"]["difference_rad_s"] == 0.2
    assert found["peer"]["unanswered"] == 4
    assert found[OURS]["median_to_ours"] == 1.0
    assert found["absent"]["version"] is None
    assert found["absent"]["median_us"] is None
    shown = text([ours, peer, missing])
    for word in ("version", "median", "10 %", "ratio", "differs", "no answer", "18", "3.00", "0.2", "not installed"):
        assert word in shown


def test_what_is_missing_is_named_with_what_installs_it() -> None:
    lines = [Line(OURS, "1", [1e-6]), Line(PRESENT.name, "2", [1e-6]), Line(ABSENT.name, None)]
    said = notes(lines, 46, 290, (PRESENT, ABSENT))
    assert said[-1] == 'not installed: no-such-distribution; pip install -e ".[bench]" installs what is missing'
    assert "46 pairs" in said[0]
    assert "290 rows" in said[1]
    assert "ours, shifted" in said[1]
    assert not [n for n in notes(lines[:2], 46, 290, (PRESENT,)) if "not installed" in n]


def test_a_library_that_is_not_there_has_no_version() -> None:
    assert ABSENT.version() is None
    assert PRESENT.version() == np.__version__
    assert Peer("", "numpy", "no-such-distribution", Shifted, "").version() is None


def test_the_command_reports_absent_peers_and_succeeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (p.module for p in PEERS):
        # what an import finds for None is that there is no such module
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(sys, "argv", ["safewbc", "bench", "peers", "--ticks", "100", "--out", str(tmp_path / "p.json")])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert 'not installed: mink, pin-pink; pip install -e ".[bench]"' in out
    found = json.loads((tmp_path / "p.json").read_text())
    assert list(found) == [OURS, OUR_TICK, *(p.name for p in PEERS)]
    assert found[OURS]["median_us"] < found[OUR_TICK]["median_us"]
    assert all(found[p.name]["median_us"] is None for p in PEERS)


@pytest.mark.parametrize(
    ("option", "value"), [("--ticks", "99"), ("--robots", "g1"), ("--filter", "cbf"), ("--solver", "x")]
)
def test_what_it_does_not_use_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    monkeypatch.setattr(bench_peers, "measure", None)
    monkeypatch.setattr(sys, "argv", ["safewbc", "bench", "peers", option, value])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 2
    assert option[2:] in capsys.readouterr().err
