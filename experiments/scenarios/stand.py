"""Standing still on both feet."""

from collections.abc import Callable

from experiments.recording.recording import RunResult
from experiments.running.run import run
from experiments.scenarios.options import StandOptions
from experiments.scenarios.scenario import Scenario


def run_stand(options: StandOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Stand for ``options.duration``; see :func:`experiments.running.run.run`."""
    return run(Scenario("stand"), options, progress)
