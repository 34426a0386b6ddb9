"""The hoist: a robot hangs still, is lowered and raised, is caught where it falls, and is not held where it stands."""

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.mujoco_spec import PhysicalChanges
from sims.plant import MujocoPlant, PlantConfig
from sims.twin.hoist import Hoist, HoistConfig, holding_torque

ROBOT = load_robot("g1")
DT = 0.001


class Hung:
    """A robot on the hoist, its joints held by its own gains."""

    def __init__(self, mass_scale: float = 1.2) -> None:
        self.plant = MujocoPlant(ROBOT, PlantConfig(changes=PhysicalChanges(mass_scale=mass_scale)))
        self.hoist = Hoist(self.plant)
        self.torso = self.plant.data.body("torso_link").id
        zero = np.zeros(len(ROBOT.joints))
        torque = holding_torque(self.plant, self.hoist.step(0.0))
        kp, kd = ROBOT.joint_array("kp"), ROBOT.joint_array("kd")
        self.plant.send(MotorCommand(ROBOT.posture("standing").joints, zero, torque, kp, kd, 0.0))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.plant.data.xfrc_applied[self.torso] = self.hoist.step(DT)
            self.plant.step()

    def lowest(self) -> float:
        return float(self.plant.sole_corners()[..., 2].min())


@pytest.mark.parametrize("mass_scale", [1.0, 1.2])
def test_it_hangs_at_rest_upright_and_clear_of_the_ground(mass_scale: float) -> None:
    hung = Hung(mass_scale)
    weight = hung.plant.total_mass * 9.81
    assert hung.hoist.tension == pytest.approx(weight)
    # its posture has the soles 0.1 mm below the ground
    assert hung.lowest() == pytest.approx(0.15, abs=2e-4)
    hung.run(2.0)
    state = hung.plant.true_state()
    assert np.abs(state.v).max() < 1e-4
    assert np.abs(state.q[3:6]).max() < 1e-5
    assert hung.hoist.tension == pytest.approx(weight, rel=1e-5)


def test_the_rope_is_tied_right_above_the_centre_of_mass() -> None:
    hung = Hung()
    point, centre = hung.hoist.point(), hung.plant.center_of_mass()
    np.testing.assert_allclose(point[:2], centre[:2], atol=1e-12)
    assert point[2] > centre[2] + 0.2
    np.testing.assert_allclose(hung.hoist.anchor[:2], point[:2], atol=1e-12)


def test_a_wrench_is_the_ropes_force_at_its_point() -> None:
    hung = Hung()
    hung.plant.data.qvel[:3] = 0.1, -0.2, 0.0
    hung.hoist.anchor += [0.1, 0.0, 0.0]
    wrench = hung.hoist.step(0.0)
    arm = hung.hoist.point() - hung.plant.data.xipos[hung.torso]
    np.testing.assert_allclose(wrench[3:], np.cross(arm, wrench[:3]), atol=1e-9)
    assert wrench[0] > 0.0


def test_lowering_goes_on_at_its_speed_until_the_rope_is_slack_and_raising_undoes_it() -> None:
    hung = Hung()
    start = hung.plant.true_state().q[2]
    hung.hoist.lower()
    hung.run(1.0)
    assert start - hung.plant.true_state().q[2] == pytest.approx(0.05, abs=0.003)
    # until it stands, and then until rope lies about; what stands by its joints alone is held upright by a hand
    for _ in range(14000):
        hung.plant.data.xfrc_applied[hung.torso] = hung.hoist.step(DT)
        hung.plant.data.xfrc_applied[hung.torso, 3:] -= 300.0 * np.array([*hung.plant.true_state().q[3:5], 0.0]) * 2.0
        hung.plant.step()
        if not hung.hoist.moving:
            break
    assert hung.hoist.slack == pytest.approx(0.35, abs=0.01)
    assert hung.hoist.tension == 0.0
    hung.hoist.lift()
    hung.run(8.0)
    assert not hung.hoist.moving
    assert hung.lowest() == pytest.approx(0.15, abs=0.01)
    assert hung.hoist.tension == pytest.approx(hung.plant.total_mass * 9.81, rel=0.02)


def test_a_slack_rope_pulls_nothing_and_its_anchor_follows() -> None:
    hung = Hung()
    hung.hoist.length += 0.2
    hung.plant.data.qvel[0] = 1.0
    for _ in range(50):
        np.testing.assert_array_equal(hung.hoist.step(DT), np.zeros(6))
        hung.plant.step()
    assert hung.hoist.anchor[0] == pytest.approx(hung.hoist.point()[0], abs=2e-3)
    assert hung.hoist.anchor[0] > 0.03


def test_a_rope_never_pushes() -> None:
    hung = Hung()
    hung.plant.data.qvel[2] = 5.0
    tensions = []
    for _ in range(300):
        wrench = hung.hoist.step(DT)
        tensions.append(hung.hoist.tension)
        hung.plant.data.xfrc_applied[hung.torso] = wrench
        hung.plant.step()
    assert min(tensions) == 0.0


def test_swinging_and_turning_die_away() -> None:
    hung = Hung()
    hung.plant.data.qvel[:2], hung.plant.data.qvel[5] = [0.3, 0.2], 0.5
    hung.run(6.0)
    v = hung.plant.true_state().v
    assert np.linalg.norm(v[:2]) < 0.03 and abs(v[5]) < 0.03


def test_numbers_that_are_none_are_refused() -> None:
    with pytest.raises(ConfigError, match="hoist stretch"):
        HoistConfig(stretch=0.0)
