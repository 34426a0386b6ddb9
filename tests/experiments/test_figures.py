import pytest

from experiments.metrics.declared import METRICS
from experiments.metrics.metric import Metric


@pytest.mark.parametrize(
    ("bad", "value", "expected"),
    [
        ("", -1.0, False),
        ("negative", -1e-9, True),
        ("negative", 0.0, False),
        ("negative", None, False),
        ("true", True, True),
        ("true", False, False),
        ("false", False, True),
        ("false", True, False),
        ("false", None, False),
        ("given", "a cause", True),
        ("given", None, False),
        ("positive", 1, True),
        ("positive", 0, False),
    ],
)
def test_what_stands_out(bad: str, value: object, expected: bool) -> None:
    assert Metric("key", "words", bad=bad).is_bad(value) is expected


def test_values_are_shown_in_their_unit() -> None:
    assert Metric("x_m", "x", "mm", 1e3).text(0.0033149) == "3.31"
    assert Metric("n", "n").text(12) == "12"
    assert Metric("fell", "fell").text(True) == "yes"
    assert Metric("x", "x").text(None) == "-"


def test_each_figure_is_shown_once() -> None:
    keys = [figure.key for figure in METRICS]
    assert len(set(keys)) == len(keys)
