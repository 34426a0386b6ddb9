"""What the corridor leaves is what docs/output.md says."""

from pathlib import Path

import pytest

from experiments.running.corridor_loop import CorridorLoop, CorridorRun
from experiments.scenarios.corridor import Corridor, corridor_robot

SECTION = (Path(__file__).parents[2] / "docs" / "output.md").read_text(encoding="utf-8").split("\n## Corridor\n")[1]


@pytest.fixture(scope="module")
def run() -> CorridorRun:
    return CorridorLoop(corridor_robot(), Corridor(), "pssa").run(0.1)


def test_every_figure_is_explained(run: CorridorRun) -> None:
    assert not [key for key in run.summary if f"`{key}`" not in SECTION]


def test_every_array_is_named(run: CorridorRun) -> None:
    assert not [key for key in run.series if f"`{key}`" not in SECTION]
