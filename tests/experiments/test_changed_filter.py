"""A filter that is changed while a run is recorded: the change is told, and bounds of the first one end there."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from experiments.recording.recording import GUARANTEED
from experiments.running.loop import ClosedLoop, Observer
from experiments.running.run import run
from experiments.scenarios.stand import Stand
from robots.loader import load_robot
from robots.messages import RobotState
from safety.filters.guarantee import safety_bounds

Change = Callable[[WholeBodyController], None]
BOUNDS = ("bound_m", "bound_running_min_m", "row_bound_min_m", "bound_held", "margin_self_collision_m")


class Changes(Observer):
    """Changes the controller once, after the tick at ``since`` [s] or before the first one."""

    def __init__(self, change: Change, since: float | None) -> None:
        self._change, self._since, self._done = change, since, False

    def began(self, loop: ClosedLoop[Any]) -> None:
        if self._since is None:
            self._change(loop.agent.controller)

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: Any, seconds: float) -> None:
        if self._since is not None and not self._done and loop.time > self._since - 1e-9:
            self._change(loop.agent.controller)
            self._done = True


def more_cautious(controller: WholeBodyController) -> None:
    safety = controller.config.safety
    controller.set_safety(replace(safety, self_collision=replace(safety.self_collision, epsilon=1.0)))


@pytest.mark.parametrize("change", [lambda c: c.set_filter("none"), more_cautious])
def test_bounds_end_where_the_filter_changes(change: Change) -> None:
    result = run(Stand(duration=0.2), [Changes(change, 0.1)])
    summary, series = result.summary, result.series
    # observers come after the tick, so that the next one is the first with the change
    assert summary["filter"] == "issf" and summary["filter_changed_at_s"] == pytest.approx(0.102)
    late = series["step_time"] > 0.102 + 1e-6
    assert late.sum() == 98
    column = GUARANTEED.index("self_collision")
    for bound in (series["h_bound"][:, column], series["h_row_bound"]):
        np.testing.assert_array_equal(np.isnan(bound), late)
    assert np.isfinite(series["disturbance"]).all()
    guarantee = safety_bounds("issf", controller_config(load_robot("g1")).safety.parameters())["self_collision"]
    largest = float(series["disturbance"][~late].max())
    assert summary["bound_m"] == pytest.approx(guarantee.bound(largest, 0.0))


def test_a_filter_that_never_ran_guarantees_nothing() -> None:
    result = run(Stand(duration=0.1), [Changes(lambda c: c.set_filter("none"), None)])
    assert result.summary["filter_changed_at_s"] == 0.0
    assert {result.summary[name] for name in BOUNDS} == {None}
    assert np.isnan(result.series["h_bound"]).all() and np.isnan(result.series["h_row_bound"]).all()


def test_gains_are_no_part_of_the_filter() -> None:
    result = run(Stand(duration=0.1), [Changes(lambda c: c.set_gains(c.config.tasks), 0.05)])
    assert result.summary["filter_changed_at_s"] is None
    assert result.summary["bound_held"] is True
