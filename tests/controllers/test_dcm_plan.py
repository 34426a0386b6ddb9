"""The DCM plan: it solves its differential equation, is continuous, and ends at rest on the ZMP."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.balance.dcm_plan import DcmPlan, ZmpPhase, waypoint
from robots.errors import ConfigError

OMEGA = 3.8


def walk(seed: int, count: int = 5) -> list[ZmpPhase]:
    """Phases between random points, every second one with the ZMP at rest."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(-0.2, 0.3, (count + 1, 2)), axis=0)
    out = []
    for a, b in pairwise(points):
        out += [ZmpPhase(a, a, rng.uniform(0.3, 0.8)), ZmpPhase(a, b, rng.uniform(0.1, 0.4))]
    return out


def zmp_at(phases: list[ZmpPhase], t: float) -> np.ndarray:
    for phase in phases:
        if t < phase.duration:
            return phase.start + t / phase.duration * (phase.end - phase.start)
        t -= phase.duration
    return phases[-1].end


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_plan_solves_the_pendulum(seed: int) -> None:
    phases = walk(seed)
    plan, step = DcmPlan(phases, OMEGA), 1e-6
    edges = np.cumsum([p.duration for p in phases])
    for t in np.random.default_rng(seed).uniform(0.0, edges[-1], 20):
        if np.abs(edges - t).min() < 1e-4:
            continue
        here = plan.evaluate(t)
        rate = (plan.evaluate(t + step).position - plan.evaluate(t - step).position) / (2 * step)
        assert here.velocity == pytest.approx(rate, abs=1e-7)
        assert here.velocity == pytest.approx(OMEGA * (here.position - zmp_at(phases, t)), abs=1e-12)
        assert here.zmp == pytest.approx(zmp_at(phases, t), abs=1e-12)


def test_the_plan_is_continuous_and_ends_on_the_zmp() -> None:
    phases = walk(3)
    plan = DcmPlan(phases, OMEGA)
    for edge in np.cumsum([p.duration for p in phases]):
        before, after = plan.evaluate(edge - 1e-10), plan.evaluate(edge + 1e-10)
        assert before.position == pytest.approx(after.position, abs=1e-8)
    end = plan.evaluate(1e3)
    assert end.position == pytest.approx(phases[-1].end, abs=0)
    assert not end.velocity.any()


def test_an_integrated_pendulum_stays_on_the_plan() -> None:
    """Integrating the CoM under the planned ZMP gives the planned DCM: the solution is the bounded one."""
    phases = walk(7, 3)
    plan, dt = DcmPlan(phases, OMEGA), 1e-4
    first = plan.evaluate(0.0)
    com = first.position.copy()
    velocity = np.zeros(2)
    for k in range(round(0.9 * sum(p.duration for p in phases) / dt)):
        # midpoint in time; the error that is left grows with exp(omega t)
        acceleration = OMEGA**2 * (com + 0.5 * dt * velocity - zmp_at(phases, (k + 0.5) * dt))
        com = com + dt * velocity + 0.5 * dt**2 * acceleration
        velocity = velocity + dt * acceleration
        if k * dt > 0.5:
            break
    reached = plan.evaluate((k + 1) * dt).position
    assert com + velocity / OMEGA == pytest.approx(reached, abs=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_a_waypoint_takes_the_dcm_where_it_is_wanted(seed: int) -> None:
    """In front of a plan, the two phases make the DCM start where it is, and the plan goes on as it was."""
    rng = np.random.default_rng(seed)
    start, zmp = rng.uniform(-0.3, 0.3, (2, 2))
    rest = walk(seed, 3)
    first, second = rng.uniform(0.2, 0.8, 2)
    after = DcmPlan(rest, OMEGA)
    point = waypoint(start, zmp, rest[0].start, after.evaluate(0.0).position, (first, second), OMEGA)
    plan = DcmPlan([ZmpPhase(zmp, point, first), ZmpPhase(point, rest[0].start, second), *rest], OMEGA)
    assert plan.evaluate(0.0).position == pytest.approx(start, abs=1e-9)
    assert plan.evaluate(first + second + 0.1).position == pytest.approx(after.evaluate(0.1).position, abs=1e-9)


def test_bad_plans_are_refused() -> None:
    here = np.zeros(2)
    with pytest.raises(ConfigError, match="phases"):
        DcmPlan([], OMEGA)
    with pytest.raises(ConfigError, match="omega"):
        DcmPlan([ZmpPhase(here, here, 1.0)], -1.0)
    with pytest.raises(ConfigError, match="duration"):
        DcmPlan([ZmpPhase(here, here, 0.0)], OMEGA)
