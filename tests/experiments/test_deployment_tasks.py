"""What a robot can be told to do: a scenario without what only a simulation has."""

import dataclasses

import numpy as np
import pytest

from experiments.running.deployment_tasks import build, name_of
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.hardware_options import MotorCheckOptions
from experiments.scenarios.options import FilterOptions, PlantOptions, SensingOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        (Walk(plant=PlantOptions(mass_scale=1.2)), "mass_scale = 1.2"),
        (Stand(plant=PlantOptions(link_mass={"pelvis": 2.0})), "link_mass"),
        (Stand(sensing=SensingOptions(state="estimated")), "state = 'estimated'"),
        (Stand(nan_at=3.0), "nan_at = 3.0"),
        (Walk(push=("80,left,5",)), "pushes"),
        (HandTracking(obstacle=True), "obstacles"),
        (Stand(robot="tocabi"), "robot = 'tocabi'"),
        (Stand(control_rate=1000.0), "control_rate = 1000.0"),
        (Stand(safety=FilterOptions(filter="none")), "filter = 'none'"),
        (Taichi(torque="pd-only"), "torque = 'pd-only'"),
    ],
)
def test_what_a_robot_cannot_be_told_is_refused_by_name(scenario: Scenario, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        build(scenario)


def test_both_agents_drive_hardware_and_the_posture_is_the_tasks() -> None:
    for scenario in (Stand(), HandTracking(), Walk()):
        built = build(scenario)
        for agent in (built.standing, built.task):
            assert agent.controller.config.drives == "hardware" and agent.dt == 0.002
        posture = scenario.setup(built.robot).posture
        np.testing.assert_array_equal(built.posture, built.robot.posture(posture).joints)
        assert built.duration == scenario.duration and built.motor is None
        assert built.scenario["scenario"] == scenario.name == name_of(scenario)


def test_a_motor_check_is_a_task_of_its_own() -> None:
    built = build(MotorCheckOptions(torque=1.5))
    assert built.motor is not None and built.motor.settings.torque == 1.5
    assert name_of(MotorCheckOptions()) == "motor-check"
    assert built.scenario == dataclasses.asdict(MotorCheckOptions(torque=1.5))
