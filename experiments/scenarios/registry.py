"""The scenarios by name, and how one from outside the project is found; nothing heavy is imported here."""

import sys
from pathlib import Path
from typing import Any

from experiments.scenarios.content import from_plain
from experiments.scenarios.corridor_case import CorridorCase
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.pushed import Pushed
from experiments.scenarios.random_walk import RandomWalk
from experiments.scenarios.scenario import Runnable, Scenario, reference_to, split_table
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError, UnknownNameError
from robots.own_modules import import_own

SCENARIOS: tuple[type[Scenario], ...] = (
    Stand,
    HandTracking,
    Taichi,
    LateralSteps,
    Walk,
    RandomWalk,
    Pushed,
)
"""In the order of the command line."""

RUNNABLE: tuple[type[Runnable], ...] = (*SCENARIOS, CorridorCase)
"""What folders of runs may hold."""

SCENARIO_FOLDER = "scenario_folder"
"""Entry of a configuration that says where the module of a scenario from outside the project came from."""


def scenario_called(name: str, folder: str | None = None) -> type[Runnable]:
    """The scenario of this name; ``module:Class`` is one from outside the project.

    Args:
        name: of the scenario.
        folder: where a module is looked for before the working directory: see :func:`folder_reference`.

    Raises:
        UnknownNameError: there is none of this name.
        ConfigError: the module cannot be imported, or has no such scenario.
    """
    known = {scenario.name: scenario for scenario in RUNNABLE}
    if name in known:
        return known[name]
    if ":" not in name:
        raise UnknownNameError("scenario", name, [*known, "or module:Class of one's own"])
    return _imported(name, folder)


def own_scenario(reference: str) -> type[Scenario]:
    """A scenario of the whole body from outside the project, by its ``module:Class``.

    Raises:
        ConfigError: the module cannot be imported, or has no such scenario.
    """
    found = _imported(reference)
    if not issubclass(found, Scenario):
        raise ConfigError("scenario", reference, "a subclass of experiments.scenarios.scenario.Scenario")
    return found


def folder_reference(scenario: type[Runnable]) -> dict[str, str]:
    """Entry of a configuration by which a scenario from outside the project is found from any working directory."""
    # one of a script that was read, not imported, has no module
    top = sys.modules.get(scenario.__module__.partition(".")[0])
    # a package without __init__.py has folders only
    places = [*getattr(top, "__path__", ()), getattr(top, "__file__", None)]
    if ":" not in reference_to(scenario) or places[0] is None:
        return {}
    return {SCENARIO_FOLDER: str(Path(places[0]).resolve().parent)}


def _imported(reference: str, folder: str | None = None) -> type[Runnable]:
    module, name = import_own("scenario", reference, folder)
    found = getattr(module, name, None)
    if not (isinstance(found, type) and issubclass(found, Runnable)):
        raise ConfigError("scenario", reference, "a subclass of experiments.scenarios.scenario.Runnable")
    return found


def read_scenario(table: Any, folder: str | None = None) -> Runnable:
    """A scenario from the table that :meth:`Runnable.to_json` made of it.

    Args:
        table: that names the scenario, and holds its fields.
        folder: as of :func:`scenario_called`.

    Raises:
        SafeWbcError: no such scenario, or a field is unknown or not of its type; names it and what is allowed.
    """
    reference, fields = split_table(table)
    return from_plain(scenario_called(reference, folder), fields, reference)
