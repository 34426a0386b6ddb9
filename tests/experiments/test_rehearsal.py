"""Rehearsals: the whole deployment against the twin in one process, and how what came of it is judged."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.deployment.deployment import SEEN, Deployment
from controllers.deployment.protection import Surroundings
from controllers.deployment.rest import RestWatch
from controllers.deployment.stages import Stage
from controllers.whole_body.controller import TickResult
from experiments.rehearsal.fault_cases import BEFORE_CASES, FAULT_CASES, PROCESS_CASES, Expected, FaultCase
from experiments.rehearsal.in_process import Rehearsal
from experiments.rehearsal.judge import fault_figures, task_figures
from experiments.rehearsal.performance import Performance, braked_after, upright
from experiments.rehearsal.processes import when_obeyed
from experiments.rehearsal.rehearse import DURING, check, pieces
from experiments.rehearsal.tasks import TASKS, task_called, variants
from experiments.running.deployment_tasks import build
from experiments.scenarios.hardware_options import RehearseOptions
from experiments.scenarios.stand import Stand
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError, UnknownNameError
from robots.loader import load_robot
from robots.unitree.messages import CommandMessage
from sims.twin.orders import read_order

ROBOT = load_robot("g1")


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Performance:
    """From the hoist to a walk of a heavier robot, and back to the hoist."""
    rehearsal = Rehearsal(
        build(Walk(vx=0.2, duration=7.0)).deployment,
        replace(variants(2)[1].config(), seed=3),
        tmp_path_factory.mktemp("walked") / "truth.npz",
    )
    return rehearsal.finish()


def test_a_robot_goes_from_the_hoist_to_a_walk_and_back(walked: Performance) -> None:
    figures = task_figures(ROBOT, walked)
    assert figures["done"] and figures["upright"] and figures["cause"] == "the task is over"
    assert figures["way_m"] > 0.3
    assert figures["min_h_self_collision"] > 0.0 and figures["min_h_leg_collision"] > 0.0
    stages = [text.partition(":")[0] for _, text in walked.said]
    names = [stage.value for stage in Stage][4:]
    assert [text for text in stages if text in names] == names


def test_the_robot_is_handed_over_without_a_jolt(walked: Performance) -> None:
    """While the controller takes over, and while the task begins, the base goes nowhere fast."""
    truth = walked.truth
    for stage in (Stage.STANDING, Stage.TASK):
        began = walked.said_at(stage.value)
        chosen = (truth["monotonic"] > began - 0.1) & (truth["monotonic"] < began + 0.6)
        assert np.abs(truth["v"][chosen][:, :6]).max() < 0.25, stage
    since, until = walked.said_at(Stage.STANDING.value), walked.said_at(Stage.STOPPING.value)
    chosen = (truth["monotonic"] > since) & (truth["monotonic"] < until)
    assert np.abs(np.diff(truth["torque"][chosen], axis=0)).max() < 60.0


def test_before_the_robot_is_lowered_nothing_but_the_rope_carries_it(walked: Performance) -> None:
    truth = walked.truth
    before = truth["monotonic"] < walked.said_at(Stage.LOWERED.value)
    assert not truth["foot_wrench"][before].any()
    assert truth["rope_tension"][before].min() > 100.0


@pytest.mark.parametrize("name", ["remote: L2 + B", "encoder of a leg jumps a turn", "remote: select"])
def test_a_fault_while_standing_is_answered_as_the_table_says(tmp_path: Path, name: str) -> None:
    case = next(case for case in FAULT_CASES if case.name == name)
    rehearsal = Rehearsal(build(Stand(duration=7.0)).deployment, variants(1)[0].config(), tmp_path / "truth.npz")
    assert rehearsal.run_to(Stage.TASK)
    rehearsal.run_for(0.3)
    for order in case.orders:
        rehearsal.order(order)
    rehearsal.run_to(Stage.DAMPED, 20.0)
    rehearsal.run_for(0.5)
    figures = fault_figures(case, rehearsal.performance(), rehearsal.raised_at)
    assert figures["as_expected"], figures
    assert figures["end"] == "latched damping"


# --- judging


def made(said: list[tuple[float, str]], falls_at: float = np.inf, brakes_at: float = np.inf) -> Performance:
    t = np.arange(0.0, 20.0, 0.002)
    q = np.zeros((t.size, 36))
    q[:, 2], q[:, 6] = 0.75, 1.0
    q[t >= falls_at, 2] = 0.3
    truth = {"monotonic": t, "q": q, "damped": t >= brakes_at}
    return Performance(truth, said, [(5.0, "x")])


def case(expected: Expected, cause: str = "why", within: float = 0.1, brakes: float = 0.02) -> FaultCase:
    return FaultCase("x", ("x",), expected, cause, within, brakes)


DONE = (9.0, "stopping: the task is over")


@pytest.mark.parametrize(
    ("expected", "performance", "met"),
    [
        (Expected.GOES_ON, made([DONE]), True),
        (Expected.GOES_ON, made([DONE], falls_at=8.0), False),
        (Expected.GOES_ON, made([(6.0, "stopping: something")]), False),
        (Expected.GOES_ON, made([]), False),
        (Expected.DAMP, made([(5.05, "latched damping: why")], brakes_at=5.06), True),
        (Expected.DAMP, made([(5.05, "latched damping: why")], brakes_at=5.1), False),
        (Expected.DAMP, made([(5.05, "latched damping: why")]), False),
        (Expected.DAMP, made([(5.2, "latched damping: why")], brakes_at=5.2), False),
        (Expected.DAMP, made([(5.05, "latched damping: other")], brakes_at=5.06), False),
        (Expected.DAMP, made([DONE]), False),
        (Expected.HOLD, made([(5.05, "stopping: why"), (12.0, "latched damping: at rest")]), True),
        (Expected.HOLD, made([(5.05, "stopping: why"), (6.0, "latched damping: tilt")]), False),
        (Expected.HOLD, made([(5.05, "stopping: why")], falls_at=6.0), False),
        (Expected.GUARDIAN, made([], brakes_at=5.05), True),
        (Expected.GUARDIAN, made([], brakes_at=5.2), False),
        (Expected.GUARDIAN, made([]), False),
    ],
)
def test_what_came_of_a_fault_is_judged(expected: Expected, performance: Performance, met: bool) -> None:
    assert fault_figures(case(expected), performance, 8.5)["as_expected"] is met


def test_braking_before_the_fault_does_not_count() -> None:
    performance = made([], brakes_at=1.0)
    performance.truth["damped"][performance.truth["monotonic"] >= 2.0] = False
    assert np.isnan(braked_after(performance))


def test_upright_is_neither_low_nor_tilted_nor_unknown() -> None:
    assert upright(made([]).truth, 1.0, 2.0)
    assert not upright(made([], falls_at=1.5).truth, 1.0, 2.0)
    assert not upright(made([]).truth, 30.0, 31.0)
    tilted = made([])
    tilted.truth["q"][600, 3:7] = np.sin(0.3), 0.0, 0.0, np.cos(0.3)
    assert not upright(tilted.truth, 1.0, 2.0)


# --- what is asked for


def test_every_fault_can_be_ordered() -> None:
    for one in (*FAULT_CASES, *BEFORE_CASES):
        for order in one.orders:
            assert read_order(order).fault is not None
    names = [one.name for one in (*FAULT_CASES, *PROCESS_CASES)]
    assert len(set(names)) == len(names)


def test_pieces_are_named_once_and_for_good(tmp_path: Path) -> None:
    options = RehearseOptions("g1", ("tasks", "faults", "before", "kills"), seeds=10)
    keys = [piece.key for piece in pieces(options, tmp_path)]
    assert len(set(keys)) == len(keys)
    assert len(keys) == 10 * len(TASKS) + 2 * (len(FAULT_CASES) + len(PROCESS_CASES)) + len(BEFORE_CASES) + 20
    few = replace(options, what=("faults",), fault=("NaN",), during=("stand",))
    assert [piece.key for piece in pieces(few, tmp_path)] == [key for key in keys if "stand, NaN" in key]


def test_twins_take_masses_and_drifts_in_turn() -> None:
    found = variants(6)
    assert [v.seed for v in found] == list(range(6))
    assert {(v.mass_scale, v.gyro_drift) for v in found} == {(m, d) for m in (0.9, 1.0, 1.2) for d in (0.0, 0.003)}
    config = found[1].config()
    assert config.plant.changes.mass_scale == 1.2 and config.errors.gyro_drift == pytest.approx(0.003 / 60)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (RehearseOptions("g1", ()), "what"),
        (RehearseOptions("g1", ("stand",), seeds=0), "seeds"),
        (RehearseOptions("g1", ("stand",), jobs=2), "jobs"),
        (RehearseOptions("g1", ("stand",), in_process=True, lockstep=True), "lockstep"),
        (RehearseOptions("g1", ("stand",), domain=0), "domain"),
        (RehearseOptions("g1", ("stand",), lockstep=True, jobs=4, domain=229), "domain"),
        (RehearseOptions("g1", ("kills",), in_process=True), "in_process"),
    ],
)
def test_what_cannot_be_rehearsed_is_refused(options: RehearseOptions, name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        check(options)


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="dance"):
        task_called("dance")
    with pytest.raises(ConfigError, match="earthquake"):
        pieces(RehearseOptions("g1", ("faults",), fault=("earthquake",)), tmp_path)
    assert set(DURING) == {"stand", "walk"}


# --- the hand-over, and what a person may do


def is_at(deployment: Deployment, stage: Stage) -> bool:
    return deployment.stage is stage


class ByHand(Rehearsal):
    """A rehearsal in which go is said by the test, and the hoist stops where the feet carry."""

    go = False

    def _around(self) -> Surroundings:
        around = super()._around()
        said, self.go = self.go, False
        early = self.deployment.stage not in (Stage.LOWERED, Stage.STANDING, Stage.TASK, Stage.STOPPING)
        carried = self.deployment.estimator.wrenches[:, 2].sum() / (ROBOT.total_mass * 9.81)
        if self.deployment.stage is Stage.LOWERED and carried > 0.8:
            self.twin.hoist.moving = ""
        return replace(around, go=said or (early and around.go))


def assert_fades_without_a_jump(sent: list[bytes]) -> None:
    """The left knee's set-point stays, and its stiffness goes little by little."""
    message, knees, stiffness = CommandMessage(), [], []
    for data in sent:
        message.read(data)
        stiffness.append(float(message.motors["kp"][3]))
        if stiffness[-1] > 0.0:
            knees.append(float(message.motors["q"][3]))
    assert np.abs(np.diff(knees)).max() < 0.1
    # little by little: no more than what 1.5 s of fading take away in a few periods
    assert np.abs(np.diff(stiffness)).max() < 0.02 * max(stiffness)


def test_the_robot_is_handed_over_to_whom_a_person_armed_and_let_go_where_the_hoist_carries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = build(Stand(duration=60.0))
    rehearsal = ByHand(built.deployment, variants(1)[0].config(), tmp_path / "truth.npz")
    deployment = rehearsal.deployment
    rehearsal.run_to(Stage.HUNG)
    # in the air, an estimate from rest goes nowhere
    rehearsal.run_for(0.15)
    assert deployment.state is not None and np.linalg.norm(deployment.state.v[:3]) < 0.03
    assert not deployment.estimator.contact.probability.max() > 0.1
    rehearsal.run_to(Stage.LOWERED)
    rehearsal.run_for(4.5)
    assert rehearsal.twin.plant.contact_wrenches()[:, 2].sum() > 0.5 * ROBOT.total_mass * 9.81
    assert is_at(deployment, Stage.LOWERED)
    with monkeypatch.context() as shaken:
        shaken.setattr(RestWatch, "calm", lambda rest: False)
        rehearsal.go = True
        rehearsal.run_for(0.5)
        assert is_at(deployment, Stage.LOWERED)
    rehearsal.run_for(0.1)
    assert is_at(deployment, Stage.STANDING), rehearsal.said[-3:]
    rehearsal.run_for(1.0)
    # what jumps is not sent, and the motors fade out from what was
    sent: list[bytes] = []
    step = deployment.step

    def kept(around: Surroundings) -> bytes:
        sent.append(step(around))
        return sent[-1]

    monkeypatch.setattr(deployment, "step", kept)
    rehearsal.run_for(0.01)
    # on both feet a go does not drop the robot
    deployment_agent = built.standing
    deployment_agent.hold("a person asks for it")
    rehearsal.run_for(0.01)
    assert is_at(deployment, Stage.STOPPING)
    # nor does one that was meant for the stage before
    rehearsal.go = True
    rehearsal.run_for(0.01)
    assert not any("raise the hoist" in text for _, text in rehearsal.said)
    rehearsal.run_for(SEEN)
    rehearsal.go = True
    rehearsal.run_for(0.01)
    assert is_at(deployment, Stage.STOPPING) and any("raise the hoist" in text for _, text in rehearsal.said)
    controller = deployment_agent.controller
    respond = controller.respond

    def jumps(*arguments: Any) -> TickResult:
        result = respond(*arguments)
        q = result.command.q.copy()
        q[3] += 0.5
        return replace(result, command=replace(result.command, q=q))

    monkeypatch.setattr(controller, "respond", jumps)
    rehearsal.run_for(0.01)
    monkeypatch.setattr(controller, "respond", respond)
    rehearsal.run_for(2.2)
    assert any("left_knee_joint jumps by 0.5" in text for _, text in rehearsal.said)
    assert is_at(deployment, Stage.DAMPED)
    assert_fades_without_a_jump(sent)


def test_an_order_counts_from_when_the_twin_carried_it_out() -> None:
    truth = {
        "time": np.array([0.0, 1.0, 2.0]),
        "monotonic": np.array([100.0, 101.0, 102.0]),
        "event_times": np.array([0.2, 0.5, 1.504]),
        "events": np.array(["remote L2 B", "ready", "remote L2 B"]),
    }
    orders = [(101.49, "remote L2 B"), (101.6, "kill"), (101.7, "remote select")]
    found = when_obeyed(orders, truth)
    assert found[0][0] == pytest.approx(101.504) and found[0][1] == "remote L2 B"
    # what is done to a process, or was never carried out, has the time at which it was given
    assert found[1:] == orders[1:]


def test_a_rehearsal_is_never_taken_for_one_that_was_played_in_another_way(tmp_path: Path) -> None:
    what = ("tasks", "faults", "before", "kills", "short")
    keys = [
        {piece.key for piece in pieces(RehearseOptions("g1", what, seeds=2, lockstep=lockstep), tmp_path)}
        for lockstep in (False, True)
    ]
    assert len(keys[0]) == len(keys[1]) > 80 and not keys[0] & keys[1]
