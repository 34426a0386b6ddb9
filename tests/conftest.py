"""What all tests share: the robots that come with the project, and repeatable random cases."""

import pytest
from hypothesis import settings

from robots.description import RobotDescription
from robots.loader import BUILT_IN, load_robot

# Repeatable: a commit passes or fails, whatever the day. No deadline: a first call may compile a kernel.
settings.register_profile("project", derandomize=True, deadline=None)
settings.load_profile("project")


@pytest.fixture(scope="session", params=BUILT_IN)
def robot_name(request: pytest.FixtureRequest) -> str:
    """Name of each robot in turn."""
    return str(request.param)


@pytest.fixture(scope="session")
def robot(robot_name: str) -> RobotDescription:
    """Each robot in turn; immutable, so one is enough for the session."""
    return load_robot(robot_name)
