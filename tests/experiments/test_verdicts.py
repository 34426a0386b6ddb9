"""What is said of a run is what happened in it."""

import numpy as np

from experiments.recording.recording import (
    Recording,
)
from experiments.reports.verdicts import verdict
from tests.support.made_runs import made_run, with_series


def sentences(result: Recording, good: bool) -> str:
    return "; ".join(text for is_good, text in verdict(result) if is_good is good)


def test_the_verdict_names_what_entered_what() -> None:
    result = made_run()
    k = result.robot.self_collision_pairs.index(("left_hand", "torso_low"))
    h = result.series["h_self_collision"].copy()
    h[20:28, k] = -0.041
    inside = with_series(result, h_self_collision=h)
    assert sentences(inside, good=False) == (
        "left hand entered torso low by 41 mm (at 0.1 s; bodies overlapped for 10 % of the time)"
    )
    h[20:28, k] = 0.0032
    assert "stayed clear of each other by 3.2 mm" in sentences(with_series(result, h_self_collision=h), good=True)
    h[3, k] = np.nan
    assert "not numbers" in sentences(with_series(result, h_self_collision=h), good=False)


def test_the_verdict_tells_falls() -> None:
    result = made_run()
    assert sentences(result, good=True).startswith("stayed upright for 0.4 s")
    fallen = Recording(result.robot, result.config, {"fell": True}, result.series)
    assert "fell over; the run ended after 0.4 s" in sentences(fallen, good=False)


def test_the_verdict_tells_other_violations_and_filter_trouble() -> None:
    result = made_run()
    limit, reach = result.series["h_joint_limit"].copy(), result.series["h_workspace"].copy()
    limit[4], reach[5, 0] = np.radians(-2.0), -0.012
    status = result.series["filter_status"].copy()
    status[:2], status[2] = 2, 3
    text = sentences(with_series(result, h_joint_limit=limit, h_workspace=reach, filter_status=status), good=False)
    assert "a joint went past its limit by 2°" in text
    assert f"{result.robot.workspace[0].name.replace('_', ' ')} went beyond its bound by 12 mm" in text
    assert "relax its conditions in 2 ticks" in text
    assert "failed in 1 tick" in text


def test_the_verdict_tells_broken_barriers_of_ones_own() -> None:
    result = made_run()

    def told(least: float | None) -> str:
        summary = {**result.summary, "min_h_own": least}
        return sentences(Recording(result.robot, result.config, summary, result.series), good=False)

    assert "a barrier of one's own fell to -0.0123" in told(-0.0123)
    assert told(0.0) == told(None) == sentences(result, good=False)


def test_the_verdict_tells_broken_bounds() -> None:
    result = made_run()
    margins = {"margin_joint_limit_rad": np.radians(-1.5), "margin_leg_collision_m": -0.012, "margin_workspace_m": 0.1}
    missing = {"margin_self_collision_m": None, "margin_obstacle_m": -0.3}

    def told(held: bool | None) -> str:
        summary = {**result.summary, **margins, **missing, "bound_held": held}
        return sentences(Recording(result.robot, result.config, summary, result.series), good=False)

    assert told(False) == (
        "the joint limit barrier fell below its guaranteed bound by 1.5°; "
        "the leg collision barrier fell below its guaranteed bound by 12 mm"
    )
    assert told(True) == told(None) == ""
