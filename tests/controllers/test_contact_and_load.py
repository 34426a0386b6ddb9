"""Touching feet and the robot's weight, from measured forces."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from controllers.gaits.contact_detection import ContactDetector
from controllers.reference import reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.mass_estimator import HEAVIEST, LIGHTEST, MassEstimator
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import RobotState
from tests.support.states import at_rest
from wbc.wrench import GRAVITY


def test_contacts_of_the_state_go_before_its_forces() -> None:
    """Forces alone need two ticks; a probability is what it says at once; without either there is nothing to read."""
    detector, nothing = ContactDetector(20.0), np.zeros(1)
    loaded, empty = np.array([300.0, 300.0]), np.zeros(2)
    told = RobotState(nothing, nothing, nothing, 0.0, loaded, np.array([0.9, 0.1]))
    assert detector.read(told) == (True, False)
    assert detector.read(replace(told, foot_forces=empty)) == (True, False)
    assert detector.read(replace(told, foot_forces=None)) == (True, False)
    by_force = replace(told, contact=None)
    assert [detector.read(by_force), detector.read(by_force)] == [(False, False), (True, True)]
    assert detector.read(replace(by_force, foot_forces=None)) is None


def test_a_foot_touches_after_two_ticks_above_the_threshold() -> None:
    detector = ContactDetector(20.0)
    forces = [[0.0, 300.0], [25.0, 300.0], [0.0, 10.0], [25.0, 300.0], [25.0, 300.0]]
    found = [detector.update(np.array(f)) for f in forces]
    assert found == [(False, False), (False, True), (False, False), (False, False), (True, True)]


def test_the_estimate_goes_to_the_ratio_of_the_weights() -> None:
    load = MassEstimator(30.0, 0.5)
    dt = 0.002
    for _ in range(round(0.5 / dt)):
        load.update(np.array([100.0, 36.0 * GRAVITY - 100.0]), dt)
    # one time constant: 1 - 1/e of the way
    assert load.scale == pytest.approx(1.0 + 0.2 * (1.0 - np.exp(-1.0)), abs=1e-3)
    for _ in range(round(10 / dt)):
        load.update(np.array([100.0, 36.0 * GRAVITY - 100.0]), dt)
    assert load.scale == pytest.approx(1.2, abs=1e-6)


@pytest.mark.parametrize(("force", "bound"), [(0.0, LIGHTEST), (1e5, HEAVIEST)])
def test_the_estimate_stays_in_its_bounds(force: float, bound: float) -> None:
    load = MassEstimator(30.0, 0.1)
    for _ in range(3000):
        load.update(np.array([force, force]), 0.002)
        assert LIGHTEST <= load.scale <= HEAVIEST
    assert load.scale == pytest.approx(bound, abs=1e-6)


def test_settings_are_checked() -> None:
    with pytest.raises(ConfigError, match="mass"):
        MassEstimator(0.0, 1.0)
    with pytest.raises(ConfigError, match="time constant"):
        MassEstimator(30.0, float("nan"))
    with pytest.raises(ConfigError, match="threshold"):
        ContactDetector(-1.0)


def test_the_load_estimate_survives_forces_that_are_not_numbers(robot: RobotDescription) -> None:
    config = controller_config(robot)
    balance = replace(config.balance, mass_time_constant=1.0)
    controller = WholeBodyController(robot, replace(config, balance=balance), with_hands=False)
    state = at_rest(robot)
    controller.reset(state)
    reference = reference_here(controller.kin, with_hands=False)
    good, bad = (replace(state, foot_forces=np.array([force, 300.0])) for force in (300.0, np.nan))
    # a state that is refused leaves nothing behind either
    with suppress(ValueError):
        controller.tick(bad, reference)
    result = controller.tick(good, reference)
    assert np.isfinite(result.command.tau).all()
    assert controller.load is not None
    assert 0.6 <= controller.load.scale <= 1.6
