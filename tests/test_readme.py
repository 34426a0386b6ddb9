"""The Python example of the README, read out of the page, does what the page says; what it links to is there."""

import re
from pathlib import Path

import numpy as np
import pytest

from controllers.agent import Agent
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def example() -> str:
    """The only Python block of the page."""
    found = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_closed_loop_of_the_readme_moves_the_left_hand_and_stands(capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    exec(compile(example(), "README.md", "exec"), scope)
    body, agent = scope["body"], scope["agent"]
    assert isinstance(body, MujocoPlant)
    assert isinstance(agent, Agent)
    assert agent.stop_cause is None
    assert body.time == pytest.approx(2.0)
    assert body.total_mass == pytest.approx(1.2 * body.robot.total_mass, rel=1e-12)
    moved = body.frame_position(body.robot.roles["left_hand"])
    assert f"left hand at {moved} stopped because None" in capsys.readouterr().out
    body.reset(standing_configuration(body.robot, "hands_front"))
    assert np.linalg.norm(moved - body.frame_position(body.robot.roles["left_hand"])) > 0.05


def test_the_first_script_is_about_ten_lines() -> None:
    assert len(example().splitlines()) <= 12


def test_every_file_that_the_readme_links_to_exists() -> None:
    links = re.findall(r"\]\(([^)#]+)", README)
    assert "docs/output.md" in links
    assert not [link for link in links if "://" not in link and not (ROOT / link).exists()]
