"""Parameters set while a filter is in use: in force at the next answer, with what was learned before."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.recovery import RecoverySettings
from safety.filters.registry import FILTERS, KINDS
from safety.filters.resolution import Resolution, ResolutionKind
from safety.filters.safety_filter import FilterSettings, MetricWeights, SafetyFilter

OBSTACLE = FAMILIES.index("obstacle")
CHANGED = FamilyParameters(
    alpha=1.0,
    epsilon=50.0,
    margin=0.2,
    eta=0.1,
    layer=0.1,
    slope=2.0,
    slack_weight=1e3,
    push_cartesian=1.0,
    push_joint=4.0,
)
NV, N = 7, 40


def some_rows(seed: int = 0) -> tuple[BarrierRows, Array]:
    rng = np.random.default_rng(seed)
    jac, h = rng.normal(scale=0.3, size=(N, NV)), rng.uniform(0.02, 0.3, N)
    return BarrierRows(h, jac, np.zeros(N), np.full(N, OBSTACLE)), rng.normal(scale=0.5, size=NV)


@pytest.mark.parametrize("name", [n for n in FILTERS if n != "none" and 1 in KINDS[n].orders])
def test_the_next_answer_is_that_of_a_filter_made_with_them(name: str) -> None:
    changed = BarrierParameters(obstacle=CHANGED)
    used, made = (SafetyFilter(name, N, p, np.full(NV, 3.0)) for p in (BarrierParameters(), changed))
    for seed in range(5):
        rows, v_des = some_rows(seed)
        before = used.apply(rows, v_des).v
    used.set_parameters(changed)
    assert used.parameters == changed
    after = used.apply(rows, v_des)
    np.testing.assert_allclose(after.v, made.apply(rows, v_des).v, rtol=0, atol=1e-6)
    assert np.abs(after.v - before).max() > 1e-3


@pytest.mark.parametrize("name", ["cbf", "rssa"])
def test_weights_and_bounds_are_those_of_the_next_answer(name: str) -> None:
    rows, v_des = some_rows()
    feet = np.eye(2, NV)
    weights, bounds = MetricWeights(5.0, 6.0, 7.0), np.full(NV, 0.3)
    used = SafetyFilter(name, N, BarrierParameters(), np.full(NV, 3.0), MetricWeights(0.0))
    used.apply(rows, v_des, feet)
    used.set_weights(weights)
    used.set_bounds(bounds)
    made = SafetyFilter(name, N, BarrierParameters(), bounds, weights)
    np.testing.assert_allclose(used.apply(rows, v_des, feet).v, made.apply(rows, v_des, feet).v, rtol=0, atol=1e-7)
    assert used.weights == weights
    np.testing.assert_array_equal(used.v_max, bounds)


def test_a_resolution_is_made_once_and_told_of_parameters() -> None:
    """No buffers are made anew, and no warm start is lost, as long as the rows stay the same."""
    made: list[Resolution] = []

    def make(nv: int, n_rows: int, infeasible: str) -> Resolution:
        made.append(KINDS["rssa"].resolution.make(nv, n_rows, infeasible))
        return made[-1]

    kind = replace(KINDS["rssa"], resolution=ResolutionKind("counted", make))
    safety = SafetyFilter(kind, N, BarrierParameters(), np.full(NV, 3.0))
    rows, v_des = some_rows()
    for alpha in (1.0, 2.0, 3.0):
        safety.apply(rows, v_des)
        safety.set_parameters(BarrierParameters(obstacle=FamilyParameters(slack_weight=alpha)))
    safety.apply(rows, v_des)
    assert len(made) == 1


def test_recovery_can_be_set_and_taken_away() -> None:
    rows = BarrierRows(np.array([-0.1]), np.eye(1, NV), np.zeros(1), np.array([OBSTACLE]))
    safety = SafetyFilter("cbf", 1, BarrierParameters(), np.full(NV, 3.0), settings=FilterSettings(dt=0.002))
    strict = safety.apply(rows, np.zeros(NV)).v[0]
    safety.set_recovery(RecoverySettings())
    eased = safety.apply(rows, np.zeros(NV)).v[0]
    safety.set_recovery(None)
    assert eased < 0.1 * strict
    assert safety.apply(rows, np.zeros(NV)).v[0] == pytest.approx(strict, abs=1e-9)
    assert safety.settings.recovery is None


@pytest.mark.parametrize(
    ("method", "value"),
    [
        ("set_parameters", FamilyParameters()),
        ("set_parameters", None),
        ("set_bounds", np.ones(3)),
        ("set_bounds", -np.ones(NV)),
    ],
)
def test_what_is_refused_leaves_the_filter_as_it_was(method: str, value: Any) -> None:
    rows, v_des = some_rows()
    safety = SafetyFilter("issf", N, BarrierParameters(), np.full(NV, 3.0))
    before = safety.apply(rows, v_des).v
    with pytest.raises(ConfigError):
        getattr(safety, method)(value)
    np.testing.assert_array_equal(safety.apply(rows, v_des).v, before)


@pytest.mark.parametrize("name", ["parameters", "weights", "settings", "v_max", "kind", "name", "infeasible", "alpha"])
def test_nothing_can_be_assigned(name: str) -> None:
    safety = SafetyFilter("issf", 1, BarrierParameters(), np.ones(1))
    with pytest.raises(AttributeError):
        setattr(safety, name, None)
    with pytest.raises(ValueError, match="read-only"):
        safety.v_max[0] = 2.0
