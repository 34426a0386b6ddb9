"""The examples of docs/scenarios.md, read out of the page, run and print what they compute."""

import re
from pathlib import Path
from typing import Any

import pytest

from experiments.running.world import World
from experiments.scenarios import world as parts

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.parametrize("code", EXAMPLES, ids=range(len(EXAMPLES)))
def test_an_example_runs(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(code, "docs/scenarios.md", "exec"), scope)
    assert capsys.readouterr().out
    if "result" in scope:
        assert not scope["result"].summary["fell"]


def test_every_shape_and_motion_is_on_the_page() -> None:
    named = set(re.findall(r"`(\w+)`", PAGE))
    for kinds in (parts.Shape, parts.Motion):
        assert {kind.__name__ for kind in kinds.__args__} <= named
    assert World((), 0).kinds == ()
