"""Runs of scenarios as cases of a study."""

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from experiments.recording.recording import Recording, description_digest, write_recording
from experiments.running.run import run
from experiments.running.run_rows import run_row
from experiments.scenarios.corridor import corridor_robot
from experiments.scenarios.scenario import Runnable, Scenario
from experiments.studies.case import Case, content_key
from experiments.studies.store import RowStore
from robots.loader import BUILT_IN, load_robot

Measure = Callable[[Recording], Mapping[str, Any]]
"""Metrics of a run; has to survive pickling."""


@dataclass(frozen=True, slots=True)
class Run:
    """Runs a scenario and saves what it left.

    Attributes:
        scenario: with its options.
        folder: below that of the study; ``None``: nothing is saved.
        series: whether the time series are saved too.
        measure: makes the metrics.
    """

    scenario: Runnable
    folder: str | None
    series: bool
    measure: Measure

    def __call__(self, store: RowStore) -> Mapping[str, Any]:
        """Run and save; returns the metrics, and the processor's time [s]."""
        start = time.process_time()
        result = run(self.scenario)
        if self.folder is not None:
            write_recording(result, store.folder / self.folder, self.series)
        return {**self.measure(result), "cpu_s": time.process_time() - start}


def run_case(
    scenario: Runnable,
    labels: Mapping[str, Any],
    folder: str | None,
    series: bool = True,
    measure: Measure = run_row,
    alone: bool = False,
) -> Case:
    """A run as a case.

    Args:
        scenario: with its options.
        labels: of the case.
        folder: of the run, below that of the study; ``None``: it is not saved.
        series: whether the time series are saved too.
        measure: makes the metrics; the summary and how the run ended if not given.
        alone: as of :class:`~experiments.studies.case.Case`; such a run is never taken from one that was not.
    """
    key = f"{'alone-' if alone else ''}{run_key(scenario)}"
    files = ("series.npz",) if series and folder is not None else ()
    return Case(key, dict(labels), Run(scenario, folder, series, measure), folder, alone, files)


def run_key(scenario: Runnable) -> str:
    """The scenario's name, and digits that stand for its content and for all that its robot's description says.

    Raises:
        SafeWbcError: a file that the scenario names cannot be read, or the description is not as it should be.
    """
    return content_key(scenario.name, [scenario.key(), _robot_digest(scenario)])


def _robot_digest(scenario: Runnable) -> str:
    if not isinstance(scenario, Scenario):
        return description_digest(corridor_robot())
    if scenario.robot in BUILT_IN:
        return _built_in_digest(scenario.robot)
    # a file of the user's own may change at any time, and so may a URDF that it names
    return description_digest(load_robot(scenario.robot))


@functools.cache
def _built_in_digest(robot: str) -> str:
    return description_digest(load_robot(robot))


@dataclass(frozen=True, slots=True)
class WarmUp:
    """Compiles, or loads from the cache, what runs of a robot need.

    Attributes:
        robot: name, or path of a description.
    """

    robot: str

    def __call__(self) -> None:
        """Go through the ticks of the robot's controller."""
        from controllers.whole_body.controller import WholeBodyController
        from controllers.whole_body.robot_config import controller_config

        robot = load_robot(self.robot)
        config = controller_config(robot)
        WholeBodyController(robot, config, with_hands=True, obstacle_kinds=("sphere",)).warm_up()
