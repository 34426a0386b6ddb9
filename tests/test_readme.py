"""The Python example of the README, read out of the page, does what the page says; what it links to is there."""

import re
from pathlib import Path

import pytest

from controllers.supervisor import Supervisor
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def example() -> str:
    """The only Python block of the page."""
    found = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_closed_loop_of_the_readme_lifts_the_left_hand_and_stands() -> None:
    code, changed = re.subn(r"duration, dt = 2\.0,", "duration, dt = 0.4,", example())
    assert changed == 1
    scope: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), scope)
    plant, supervisor = scope["plant"], scope["supervisor"]
    assert isinstance(plant, MujocoPlant)
    assert isinstance(supervisor, Supervisor)
    assert supervisor.cause is None
    assert round(plant.time, 9) == 0.4
    assert plant.total_mass == pytest.approx(1.2 * plant.robot.total_mass, rel=1e-12)
    lifted = plant.frame_position(plant.robot.roles["left_hand"])[2]
    plant.reset(standing_configuration(plant.robot))
    assert lifted > plant.frame_position(plant.robot.roles["left_hand"])[2]


def test_every_file_that_the_readme_links_to_exists() -> None:
    links = re.findall(r"\]\(([^)#]+)", README)
    assert "docs/output.md" in links
    assert not [link for link in links if "://" not in link and not (ROOT / link).exists()]
