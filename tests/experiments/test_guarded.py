"""An observer that raises: the run up to there is whole, and can be saved and replayed."""

from pathlib import Path
from typing import Any

import pytest

from experiments.cli.replay import array_differences
from experiments.recording.recording import load_recording, save_recording
from experiments.running.guarded import ObserverError
from experiments.running.loop import ClosedLoop, Observer
from experiments.running.run import run
from experiments.scenarios.stand import Stand
from robots.messages import RobotState


class Broken(Observer):
    """Raises at a tick."""

    def __init__(self, at: int) -> None:
        self.at = at

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: Any, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        if loop.ticks == self.at:
            raise KeyError("left hand")


class Counting(Observer):
    """Counts ticks, and ends."""

    ticks = ends_told = 0

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: Any, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        self.ticks += 1

    def ended(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.ended`."""
        self.ends_told += 1


@pytest.mark.parametrize("at", [0, 30])
def test_what_was_simulated_before_an_observer_raised_is_kept_and_says_why_it_ended(tmp_path: Path, at: int) -> None:
    counting = Counting()
    with pytest.raises(ObserverError, match="Broken raised KeyError: 'left hand'") as caught:
        run(Stand(duration=0.2), (Broken(at), counting))
    assert isinstance(caught.value.__cause__, KeyError)
    save_recording(caught.value.recording, tmp_path)
    kept = load_recording(tmp_path)
    assert kept.summary["stop_cause"] == "Broken raised KeyError: 'left hand'"
    assert kept.summary["stop_time_s"] == pytest.approx(0.002 * (at + 1))
    assert len(kept.series["time"]) == counting.ticks == at + 1
    assert counting.ends_told == 1
    whole = run(Stand(duration=0.2)).series
    cut = {name: whole[name][: at + 1] for name in ("q", "v", "torque", "v_safe")}
    assert array_differences({name: kept.series[name] for name in cut}, cut) == []
