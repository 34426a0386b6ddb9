"""Errors say the same wherever they are raised: a worker process hands them on whole."""

import pickle

import pytest

from robots.errors import ConfigError, DescriptionError, SafeWbcError, UnknownNameError


@pytest.mark.parametrize(
    "error",
    [
        ConfigError("alpha", -1.0, "above 0"),
        DescriptionError("g1.toml", "body 'torso_link': mass", -2.0, "above 0"),
        UnknownNameError("robot", "atlas", ["g1", "tocabi"]),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_survive_the_way_between_processes(error: SafeWbcError) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)
