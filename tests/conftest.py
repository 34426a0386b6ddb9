"""What all tests share: the robots that come with the project, repeatable random cases, what needs OpenGL."""

import os

import pytest
from hypothesis import settings

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import BUILT_IN, load_robot
from sims.rendering import rendering_problem

# Repeatable: a commit passes or fails, whatever the day. No deadline: a first call may compile a kernel.
settings.register_profile("project", derandomize=True, deadline=None)
settings.load_profile("project")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that draw are left out where nothing can be drawn, each with what to install; in CI they always run."""
    if os.environ.get("CI") or not (problem := rendering_problem()):
        return
    for item in items:
        if item.get_closest_marker("rendering"):
            item.add_marker(pytest.mark.skip(reason=problem))


@pytest.fixture(scope="session", params=BUILT_IN)
def robot_name(request: pytest.FixtureRequest) -> str:
    """Name of each robot in turn."""
    return str(request.param)


@pytest.fixture(scope="session")
def robot(robot_name: str) -> RobotDescription:
    """Each robot in turn; immutable, so one is enough for the session."""
    return load_robot(robot_name)


@pytest.fixture(scope="module")
def kin(robot: RobotDescription) -> Kinematics:
    """Kinematics of each robot in turn, at no state yet: whoever needs one updates it."""
    return Kinematics(robot)
