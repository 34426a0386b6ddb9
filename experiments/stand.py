"""Standing still on both feet."""

from collections.abc import Callable

from experiments.options import StandOptions
from experiments.results import RunResult
from experiments.scenario import Scenario
from experiments.session import run


def run_stand(options: StandOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Stand for ``options.duration``; see :func:`experiments.session.run`."""
    return run(Scenario("stand"), options, progress)
