"""Settings of the controller: from the description's tables, checked by name."""

import dataclasses
from dataclasses import replace
from typing import Any

import pytest

from controllers.motions.hands import circle_settings
from controllers.whole_body.config import ContactTuning, ControllerConfig, FilterTuning, TaskTuning
from controllers.whole_body.robot_config import controller_config
from experiments.scenarios.options import FilterOptions
from experiments.scenarios.resolve import filter_changes
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.loader import load_robot
from safety.barriers.rows import FAMILIES
from safety.filters.adaptation import AdaptationTuning

BAD_NUMBERS = (0.0, -1.0, float("nan"), float("inf"), "1", None)


def with_tuning(**tables: Any) -> RobotDescription:
    return replace(load_robot("g1"), tuning=tables)


def test_without_tables_the_defaults_hold() -> None:
    assert controller_config(with_tuning()) == ControllerConfig()


def test_tables_of_the_description_override_defaults_and_changes_override_tables() -> None:
    robot = with_tuning(
        tasks={"com": 3.0},
        safety={"self_collision": {"epsilon": 7.0}},
        contact={"friction": 0.4},
        dynwbc={"kd": 25.0},
        controller={"gain_scale": 0.5, "filter": "cbf"},
    )
    config = controller_config(robot, filter="none", dt=0.001)
    assert config.tasks == TaskTuning(com=3.0)
    assert config.safety == FilterTuning(self_collision=replace(FilterTuning().self_collision, epsilon=7.0))
    assert config.contact == ContactTuning(friction=0.4)
    assert config.dynwbc.kd == 25.0
    assert (config.gain_scale, config.filter, config.dt) == (0.5, "none", 0.001)


@pytest.mark.parametrize("table", ["tasks", "safety", "cbf", "contact", "dynwbc", "controller"])
def test_an_unknown_field_is_refused_with_the_known_ones(table: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        controller_config(with_tuning(**{table: {"colour": 1.0}}))
    assert caught.value.entry == f"tuning.{table}"
    assert caught.value.value == ["colour"]


def test_an_unknown_table_is_refused_with_the_known_ones() -> None:
    with pytest.raises(DescriptionError, match=r"tuning = \['task'\].*tasks, safety"):
        controller_config(with_tuning(task={"com": 3.0}))


def test_settings_with_tables_of_their_own_are_not_taken_from_another_table() -> None:
    with pytest.raises(DescriptionError, match="tasks"):
        controller_config(with_tuning(controller={"tasks": {"com": 3.0}}))


@pytest.mark.parametrize("value", BAD_NUMBERS)
@pytest.mark.parametrize("kind", [TaskTuning, FilterTuning, ContactTuning])
def test_every_number_is_checked_by_name(kind: type, value: Any) -> None:
    for field in dataclasses.fields(kind):
        if (field.name.endswith("_weight") and value == 0.0) or (field.name == "own" and value is None):
            continue
        with pytest.raises(ConfigError, match=field.name) as caught:
            kind(**{field.name: value})
        assert repr(value) in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"dt": 0.0}, "control dt"),
        ({"dt": 0.05}, "control dt"),
        ({"dt": float("nan")}, "control dt"),
        ({"gain_scale": -0.1}, "gain_scale"),
        ({"filter": "magic"}, "filter"),
        ({"filter": None}, "filter"),
    ],
)
def test_bad_settings_of_the_controller_are_refused(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        ControllerConfig(**settings)
    assert caught.value.name == named


@pytest.mark.parametrize("kind", [FilterTuning, ContactTuning])
def test_shares_above_one_are_refused(kind: type) -> None:
    for name in ("velocity_scale",) if kind is FilterTuning else ("length_fraction", "width_fraction"):
        with pytest.raises(ConfigError, match=name):
            kind(**{name: 1.001})


def test_every_family_has_its_own_parameters() -> None:
    tuning = FilterTuning()
    parameters = tuning.parameters()
    for family in FAMILIES:
        values = getattr(parameters, family)
        assert values is getattr(tuning, family)


def test_a_bad_or_unknown_parameter_of_a_family_is_refused_with_its_place() -> None:
    with pytest.raises(ConfigError, match=r"safety\.obstacle\.alpha"):
        controller_config(with_tuning(safety={"obstacle": {"alpha": -1.0}}))
    with pytest.raises(DescriptionError, match=r"tuning\.safety\.obstacle.*beta.*alpha"):
        controller_config(with_tuning(safety={"obstacle": {"beta": 1.0}}))
    with pytest.raises(DescriptionError, match=r"tuning\.safety\.obstacle"):
        controller_config(with_tuning(safety={"obstacle": 3.0}))


def test_a_cbf_may_have_parameters_of_its_own_on_top_of_those_of_all_filters() -> None:
    robot = with_tuning(
        safety={"self_collision": {"alpha": 8.0, "eta": 0.3}, "foot_weight": 3.0},
        cbf={"self_collision": {"alpha": 4.0}},
    )
    others = controller_config(robot).safety
    assert (others.self_collision.alpha, others.foot_weight) == (8.0, 3.0)
    assert controller_config(robot, filter="ecbf").safety == others
    for config in (
        controller_config(robot, filter="cbf"),
        controller_config(with_tuning(**robot.tuning, controller={"filter": "cbf"})),
    ):
        assert config.safety == replace(others, self_collision=replace(others.self_collision, alpha=4.0))
    # also of a filter that does not run the table is looked at
    with pytest.raises(ConfigError, match=r"cbf\.obstacle\.alpha"):
        controller_config(with_tuning(cbf={"obstacle": {"alpha": -1.0}}))
    with pytest.raises(DescriptionError, match=r"tuning\.cbf\.obstacle.*beta.*alpha"):
        controller_config(with_tuning(cbf={"obstacle": {"beta": 1.0}}))


def test_an_epsilon_that_the_description_adapts_is_one_of_issf_alone() -> None:
    robot = with_tuning(controller={"adaptive": True})
    assert controller_config(robot).adaptive
    assert not controller_config(robot, filter="cbf").adaptive
    assert filter_changes(robot, FilterOptions())["adaptive"]
    assert not filter_changes(robot, FilterOptions(filter="ssa"))["adaptive"]
    assert not filter_changes(with_tuning(), FilterOptions())["adaptive"]
    with pytest.raises(ConfigError, match="adaptive"):
        controller_config(robot, filter="cbf", adaptive=True)


def test_bad_values_in_a_description_are_refused() -> None:
    with pytest.raises(ConfigError, match="com"):
        controller_config(with_tuning(tasks={"com": -3.0}))


def test_the_robots_own_tuning_is_accepted(robot: RobotDescription) -> None:
    controller_config(robot)
    circle_settings(robot)


def test_epsilon_is_adapted_only_where_there_is_one() -> None:
    assert not ControllerConfig().adaptive
    ControllerConfig(adaptive=True)
    for name in ("cbf", "none", "pssa", "ecbf"):
        with pytest.raises(ConfigError, match=f"filter = '{name}'.*adaptive"):
            ControllerConfig(filter=name, adaptive=True)
    robot = with_tuning(adaptation={"time": 0.2, "least": 0.5})
    assert controller_config(robot).adaptation == AdaptationTuning(0.2, 0.5)
    with pytest.raises(ConfigError, match="adaptation time"):
        controller_config(with_tuning(adaptation={"time": 0.0}))
