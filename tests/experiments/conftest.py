"""Runs that several files look at, made once."""

import pytest

from experiments.running.corridor_loop import CorridorLoop, CorridorRun
from experiments.scenarios.corridor import (
    Corridor,
    corridor_robot,
)
from robots.description import RobotDescription
from tests.support.corridor import COMPARED, DURATION


@pytest.fixture(scope="session")
def corridor_g1() -> RobotDescription:
    return corridor_robot()


@pytest.fixture(scope="session")
def corridor_loops(corridor_g1: RobotDescription) -> dict[str, CorridorLoop]:
    return {name: CorridorLoop(corridor_g1, Corridor(), name) for name in COMPARED}


@pytest.fixture(scope="session")
def corridor_runs(corridor_loops: dict[str, CorridorLoop]) -> dict[str, CorridorRun]:
    return {name: loop.run(DURATION) for name, loop in corridor_loops.items()}
