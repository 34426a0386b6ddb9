"""A short rehearsal as with a robot: twin, controller, guardian as processes over DDS, by the twin's clock."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from controllers.deployment.stages import Stage
from experiments.rehearsal.fault_cases import FAULT_CASES
from experiments.rehearsal.judge import last_stage
from experiments.rehearsal.performance import Performance, braked_after, upright
from experiments.rehearsal.processes import Pair, Place
from experiments.rehearsal.rehearse import DURING, TO_THE_TASK

DOMAIN = 88


def play(folder: Path) -> tuple[Performance, Pair]:
    """Stand on the ground by the controller, then L2 + B."""
    case = next(case for case in FAULT_CASES if case.name == "remote: L2 + B")
    with Pair(folder, Place(DOMAIN, lockstep=True), ("--mass-scale", "1.2"), DURING["stand"].words) as pair:
        pair.begin()
        if pair.run_to(Stage.TASK, TO_THE_TASK):
            pair.wait(1.0)
            pair.order(case.orders[0])
            pair.run_to_the_end(20.0)
        return pair.finish(), pair


def test_a_heavier_robot_stands_and_is_braked_when_a_person_asks_for_it(tmp_path: Path) -> None:
    performance, pair = play(tmp_path)
    assert pair.deployment is not None
    told = f"{pair.twin.text}\n{pair.deployment.text}"
    assert "L2 + B" in performance.cause, told
    since, asked = performance.said_at(Stage.STANDING.value), performance.orders[-1][0]
    assert upright(performance.truth, since, asked), told
    # on its own feet: the rope is slack before the task begins
    truth = performance.truth
    standing = (truth["monotonic"] > performance.said_at(Stage.TASK.value)) & (truth["monotonic"] < asked)
    assert truth["rope_tension"][standing].max() == 0.0
    weight = truth["foot_wrench"][standing][:, :, 2].sum(axis=1)
    assert weight.mean() == pytest.approx(1.2 * 33.34 * 9.81, rel=0.03)
    assert np.isfinite(braked_after(performance)), told
    assert last_stage(performance) == Stage.DAMPED.value
    # and stays so
    after = truth["monotonic"] > asked + braked_after(performance) + 0.01
    assert truth["damped"][after].all()
