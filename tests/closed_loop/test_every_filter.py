"""Every filter on the whole stack: the hands' circles into the torso on a robot heavier than its model."""

from functools import cache

import numpy as np
import pytest

from experiments.recording.recording import FILTER_STATUSES, Recording
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from safety.filters.conditions import SET_MARGINS
from safety.filters.safety_filter import FILTERS

CONFLICT = 2.4
"""Until then the reference has gone 1.5 cm into the torso, and every filter has acted for at least 0.1 s [s]."""

FREE = 1.0
"""Until then the reference is too far from the torso for any of the filters to act [s]."""

KEEPING = ("cbf", "issf", "ecbf", "ssa", "rssa", "pssa", "sss", "pfm", "sma")


@cache
def into_the_torso(
    name: str, mass_scale: float = 1.2, layer: float | None = None, alpha: float | None = None
) -> Recording:
    return run(
        HandTracking(
            duration=CONFLICT,
            plant=PlantOptions(mass_scale=mass_scale),
            safety=FilterOptions(filter=name, layer=layer, alpha=alpha),
        )
    )


def statuses(result: Recording) -> set[str]:
    return {FILTER_STATUSES[code] for code in result.series["filter_status"]}


def test_the_list_of_filters_is_complete() -> None:
    assert set(KEEPING) | {"none"} == set(FILTERS)


@pytest.mark.parametrize("name", FILTERS)
def test_the_robot_stands_and_every_tick_has_an_answer(name: str) -> None:
    result = into_the_torso(name)
    summary, series = result.summary, result.series
    assert summary["filter"] == name
    assert (summary["alpha"] is not None) == (name in {"cbf", "issf", "ecbf"})
    assert (summary["epsilon"] is not None) == (name == "issf")
    assert summary["duration_s"] == pytest.approx(CONFLICT)
    assert summary["stop_cause"] is None
    assert not summary["fell"]
    assert summary["qp_failures"] == 0
    assert summary["foot_slide_max_m"] < 0.005
    assert summary["com_error_settled_max_m"] < 0.02
    assert summary["min_h_reference_m"] < -0.01
    for key in ("q", "v", "torque", "v_des", "v_safe", "filter_slack", "com", "disturbance"):
        assert np.isfinite(series[key]).all(), key


@pytest.mark.parametrize("name", KEEPING)
def test_a_filter_acts_in_the_conflict_and_nowhere_else(name: str) -> None:
    result = into_the_torso(name)
    series = result.series
    # the slack of r-SSA has a price, so it is always taken; the others meet their conditions
    assert statuses(result) == {"unchanged", "relaxed" if name == "rssa" else "filtered"}
    assert (result.summary["first_relaxed"] is not None) == (name == "rssa")
    acted = series["filter_status"] > 0
    assert not acted[series["time"] < FREE].any()
    assert np.count_nonzero(acted) > 50
    if name != "ecbf":
        # that of the eCBF is the velocity of DynWBC's acceleration
        np.testing.assert_array_equal(series["v_safe"][~acted], series["v_des"][~acted])
    assert (series["v_safe"][acted] != series["v_des"][acted]).any(axis=1).all()


def test_without_a_filter_nothing_is_changed_and_the_hands_go_in() -> None:
    result = into_the_torso("none")
    assert statuses(result) == {"unchanged"}
    np.testing.assert_array_equal(result.series["v_safe"], result.series["v_des"])
    assert result.summary["min_h_self_collision_m"] < -0.01


@pytest.mark.parametrize("name", KEEPING)
def test_nothing_touches(name: str) -> None:
    summary = into_the_torso(name).summary
    assert summary["min_h_self_collision_m"] > 0
    assert summary["min_h_joint_limit_rad"] > 0
    assert summary["min_h_workspace_m"] > 0


@pytest.mark.parametrize("name", ["ssa", "rssa", "pssa", "sss"])
def test_filters_with_a_margin_keep_more_than_half_of_it(name: str) -> None:
    summary = into_the_torso(name).summary
    assert summary["min_h_self_collision_m"] > 0.5 * SET_MARGINS["self_collision"]


@pytest.mark.parametrize("name", ["ssa", "rssa", "pssa", "sss"])
def test_filters_with_a_layer_step_little_more_than_a_control_barrier(name: str) -> None:
    # inside the layer of 5 mm it is a control barrier whose slope is that of eta = 0.1 m/s over it
    layered, control = into_the_torso(name).summary, into_the_torso("cbf", alpha=20.0).summary
    assert layered["command_step_max"] < 2 * control["command_step_max"]
    assert layered["max_torque_fraction"] < 1.05 * control["max_torque_fraction"]
    switched = into_the_torso(name, layer=0.0).summary
    assert switched["command_step_max"] > 10 * layered["command_step_max"]


@pytest.mark.parametrize(("name", "mass_scale"), [("cbf", 1.2), ("issf", 1.2), ("issf", 1.4)])
def test_the_bound_that_is_guaranteed_is_kept(name: str, mass_scale: float) -> None:
    """Recomputed: h of every family of own rows against its running bound, which begins at zero and falls below it."""
    result = into_the_torso(name, mass_scale)
    summary, series = result.summary, result.series
    assert not summary["fell"]
    assert summary["bound_held"] is True
    assert summary["relaxed_fraction"] == 0.0
    arms = series["h_self_collision"].shape[1] - len(result.robot.leg_pairs)
    bound = series["h_bound"][:, 1]
    assert (series["h_self_collision"][:, :arms].min(axis=1) >= bound).all()
    assert (series["h_joint_limit"] >= series["h_bound"][:, 0]).all()
    assert bound.max() <= 0
    # the bound of the largest error, forgotten at rate alpha: no less than it, and most of it
    assert summary["bound_m"] <= bound.min() < 0.5 * summary["bound_m"]


def test_a_heavier_robot_strays_further_and_is_guaranteed_less() -> None:
    light, heavy = (into_the_torso("issf", scale).summary for scale in (1.2, 1.4))
    assert heavy["disturbance_rms"] > light["disturbance_rms"]
    assert heavy["bound_running_min_m"] < light["bound_running_min_m"]
