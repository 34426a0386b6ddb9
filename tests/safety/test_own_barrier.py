"""The worked examples of docs/safety.md, read out of the page, do what the page says."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from controllers.reference import reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import Barrier, standard_barriers
from safety.barriers.rows import FAMILIES
from safety.filters.safety_filter import KINDS, FilterStatus

PAGE = (Path(__file__).parents[2] / "docs" / "safety.md").read_text(encoding="utf-8")
TILT = np.radians(15)


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_hand_gives_way_to_the_ball(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, Any] = {}
    exec(compile(next(b for b in blocks() if "explain(" in b), "docs/safety.md", "exec"), scope)
    result, kin = scope["result"], scope["kin"]
    assert result.status in {FilterStatus.FILTERED, FilterStatus.RELAXED}
    assert kin.frame_jacobian(kin.frame_id("left_palm"))[0] @ result.v < -0.2
    assert "the hand gives way" in capsys.readouterr().out


@pytest.fixture(scope="module")
def upright() -> Callable[..., Barrier]:
    code = next(b for b in blocks() if "class UprightBarrier" in b)
    scope: dict[str, Any] = {}
    exec(compile(code, "docs/safety.md", "exec"), scope)
    return scope["UprightBarrier"]


@pytest.mark.parametrize("name", ["g1", "tocabi"])
def test_gradient_is_that_of_central_differences(upright: Callable[..., Barrier], name: str) -> None:
    kin = Kinematics(load_robot(name))
    barriers = standard_barriers(kin, extra=[upright(kin, "torso", TILT)])
    row = barriers.labels.index("torso upright")
    rng = np.random.default_rng(0)
    q = kin.integrate(standing_configuration(kin.robot), 0.3 * rng.normal(size=kin.nv), 1.0)

    def value(at: np.ndarray) -> float:
        kin.update_geometry(at)
        return float(barriers.evaluate(kin).h[row])

    h = value(q)
    assert h == pytest.approx(kin.frame_placement(kin.frame_id("torso"))[0][2, 2] - np.cos(TILT), abs=1e-15)
    rows = barriers.evaluate(kin)
    assert FAMILIES[rows.family[row]] == "custom"
    gradient, step = rows.jac[row].copy(), 1e-6
    for k in range(kin.nv):
        move = step * np.eye(kin.nv)[k]
        assert (value(kin.integrate(q, move, 1.0)) - value(kin.integrate(q, -move, 1.0))) / (2 * step) == pytest.approx(
            gradient[k], abs=1e-8
        )


@pytest.mark.parametrize("filter_name", ["cbf", "issf"])
def test_a_torso_that_is_asked_to_lean_stays_within_the_bound(
    upright: Callable[..., Barrier], filter_name: str
) -> None:
    """Kinematic closed loop: the robot follows the filter exactly."""
    robot = load_robot("g1")
    lean = {}
    for guarded in (False, True):
        extra = (lambda kin: [upright(kin, "torso", TILT)]) if guarded else None
        controller = WholeBodyController(
            robot, controller_config(robot, filter=filter_name), with_hands=False, extra_barriers=extra
        )
        kin, q = controller.kin, standing_configuration(robot)
        kin.update(q, np.zeros(kin.nv))
        reference = reference_here(kin, with_hands=False)
        reference.torso_rotation = pin.utils.rotate("y", 0.45) @ reference.torso_rotation
        angles = []
        for i in range(400):
            state = RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.002 * i)
            v = controller.tick(state, reference).safety.v
            q = kin.integrate(q, v, 0.002)
            kin.update_geometry(q)
            z = kin.frame_placement(kin.frame_id("torso"))[0][:, 2]
            angles.append(np.arccos(np.clip(z[2], -1, 1)))
        lean[guarded] = max(angles)
    assert lean[False] > np.radians(20)
    assert np.radians(10) < lean[True] < TILT + 1e-4


@pytest.mark.parametrize("filter_name", [name for name, kind in KINDS.items() if 1 in kind.orders])
def test_upright_the_barrier_leaves_every_filter_in_peace(upright: Callable[..., Barrier], filter_name: str) -> None:
    """Its gradient vanishes there: a margin that h never exceeds would keep filters busy with what nothing can help."""
    robot = load_robot("g1")
    results = []
    for extra in (None, lambda kin: [upright(kin, "torso", TILT)]):
        config = controller_config(robot, filter=filter_name)
        controller = WholeBodyController(robot, config, with_hands=False, extra_barriers=extra)
        kin, q = controller.kin, standing_configuration(robot)
        kin.update(q, np.zeros(kin.nv))
        reference = reference_here(kin, with_hands=False)
        state = RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.0)
        results.append(controller.tick(state, reference).safety)
    assert results[1].status == results[0].status != FilterStatus.RELAXED
    np.testing.assert_allclose(results[1].v, results[0].v, rtol=0, atol=1e-9)


def test_a_barrier_with_too_few_labels_is_refused(upright: Callable[..., Barrier]) -> None:
    kin = Kinematics(load_robot("g1"))
    barrier = upright(kin, "torso", TILT)
    barrier.size = 2
    with pytest.raises(ConfigError, match="labels of UprightBarrier"):
        standard_barriers(kin, extra=[barrier])
