"""Every example runs as it stands, shorter, and what it prints is what it guarantees; none is long, none patches."""

import ast
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from safety.filters.registry import KINDS, unregister

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))

PROMISES: dict[str, tuple[dict[str, Any], Callable[[Any], bool]]] = {
    "fixed_arm": ({"duration": 1.5}, lambda found: found[0] > -0.1 and found[1] < 250.0),
    "hands_and_filter": ({"duration": 3.0}, lambda found: found[0] < 0.0 < found[1]),
    "live_changes": ({"duration": 4.0}, lambda found: found[0] > 20.0 and found[1] < 15.0),
    "moving_obstacle": ({"duration": 3.0}, lambda found: found[0] > 0.0 and found[1] < 150.0),
    "own_barrier": ({"duration": 1.5}, lambda smallest: -2.0 < smallest < 10.0),
    "own_body": ({"duration": 0.5}, lambda error: error < 10.0),
    "own_filter": ({"duration": 3.0}, lambda smallest: smallest > -1.0),
    "own_robot": ({"duration": 0.5}, lambda height: abs(height - 0.9) < 0.01),
    "own_scenario": ({"duration": 1.5}, lambda sags: sags[0] < sags[1] < sags[2]),
    "own_task": ({"duration": 2.0}, lambda error: error < 15.0),
    "pushes": ({"duration": 1.8, "forces": (50.0, 600.0)}, lambda found: found[0][0] > 0.95 and found[1][0] < 0.6),
    "read_recording": ({"duration": 1.0}, lambda rms: 0.0 < rms < 30.0),
    "sweep": ({"duration": 3.0, "masses": (1.2,), "jobs": 1}, lambda found: found[0] < 0.0 < found[1]),
    "stand": ({"duration": 1.0}, lambda error: error < 10.0),
    "walk_by_commands": ({"duration": 3.0}, lambda found: found[0] > 0.2 and found[1] >= 3),
}
"""By script: arguments that make it short, and what must hold of what it returns."""


def test_every_script_makes_a_guarantee() -> None:
    assert [script.stem for script in SCRIPTS] == sorted(PROMISES)


@pytest.mark.parametrize("name", PROMISES)
def test_a_script_runs_and_keeps_its_guarantee(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, holds = PROMISES[name]
    known = set(KINDS)
    try:
        found = runpy.run_path(str(FOLDER / f"{name}.py"))["main"](**arguments)
    finally:
        for own in set(KINDS) - known:
            unregister(own)
    printed = capsys.readouterr().out
    assert re.search(r"\d", printed), "nothing that one could judge"
    assert holds(found), printed


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_a_script_is_short_tells_how_it_is_started_and_uses_no_private_name(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) <= 60
    assert f"python examples/{script.name}" in (ast.get_docstring(tree) or "")
    private = [n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and re.match(r"_(?!_)", n.attr)]
    assert not private


def test_the_robot_of_the_example_is_that_of_the_page_about_robots() -> None:
    page = (ROOT / "docs" / "robots.md").read_text(encoding="utf-8")
    for suffix in ("urdf", "toml"):
        assert (FOLDER / "my_robot" / f"my_robot.{suffix}").read_text(encoding="utf-8") in page
