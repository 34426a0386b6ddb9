"""Plans from footholds: the DCM goes on without a jump from one plan to the next, and ends between closed feet."""

import numpy as np
import pytest

from controllers.balance.dcm_plan import DcmPlan
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import VelocityFootsteps, WalkTuning
from controllers.gaits.walking import plan as step_plan
from controllers.gaits.walking.plan import CLOSED_DISTANCE, CLOSED_TURN, StepPlan
from robots.errors import ConfigError

OMEGA, WIDTH = 3.8, 0.24
TUNING = WalkTuning(single_support=0.5, double_support=0.2, stop_time=0.4)
LIMITS = TUNING.limits(WIDTH)
PLANNER = VelocityFootsteps(LIMITS, TUNING.timing)
PLANS = StepPlan(PLANNER, LIMITS, TUNING, OMEGA)
STANCE = Foothold(0.3, -0.1, 0.5)
AHEAD = VelocityCommand(0.25, 0.05, 0.1)
FAST = VelocityCommand(0.45)
STOP = VelocityCommand()


def side_by_side(stance: Foothold, swing: int) -> Foothold:
    return stance.compose(0.0, WIDTH if swing == LEFT else -WIDTH, 0.0)


def holds(swing: int) -> list[Foothold]:
    """Both feet down, the one that is to swing a step behind."""
    other = STANCE.compose(-0.2, WIDTH if swing == LEFT else -WIDTH, 0.0)
    return [other, STANCE] if swing == LEFT else [STANCE, other]


def zmps(plan: DcmPlan, times: np.ndarray) -> np.ndarray:
    return np.array([plan.evaluate(float(t)).zmp for t in times])


@pytest.mark.parametrize("swing", [LEFT, RIGHT])
def test_the_zmp_goes_from_the_lifting_foot_to_the_standing_one_and_stays(swing: int) -> None:
    feet, double = holds(swing), 0.3
    plan = PLANS.from_double_support(feet, swing, double, TUNING.single_support, AHEAD)
    fractions = np.array([0.0, 0.25, 0.5, 1.0])
    expected = feet[swing].point + fractions[:, None] * (STANCE.point - feet[swing].point)
    np.testing.assert_allclose(zmps(plan, double * fractions), expected, rtol=0, atol=1e-12)
    standing = zmps(plan, np.linspace(double, double + 0.999 * TUNING.single_support, 7))
    np.testing.assert_allclose(standing, np.tile(STANCE.point, (7, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("command", [AHEAD, FAST, STOP, VelocityCommand(stepping=True)])
@pytest.mark.parametrize("swing", [LEFT, RIGHT])
def test_lift_off_goes_on_where_double_support_ended(swing: int, command: VelocityCommand) -> None:
    """The same foothold and time: the two plans are one function of time."""
    # the first step may take longer than those after it: it comes from faster walking
    double, single = TUNING.double_support, 1.1 * TUNING.timing.single(command.foot_speed(WIDTH))
    before = PLANS.from_double_support(holds(swing), swing, double, single, command)
    target = PLANNER.next_foothold(STANCE, swing, command)
    after = PLANS.from_lift(STANCE, swing, target, single, command)
    for t in np.linspace(0.0, 2.0, 21):
        a, b = before.evaluate(double + t), after.evaluate(t)
        np.testing.assert_allclose(a.position, b.position, rtol=0, atol=1e-12)


def test_touchdown_goes_on_where_single_support_ended() -> None:
    """Steady walking: the next plan, one step further ahead, differs by what its end is worth today."""
    before = PLANS.from_lift(STANCE, LEFT, landing := PLANNER.next_foothold(STANCE, LEFT, AHEAD), 0.5, AHEAD)
    after = PLANS.from_double_support([landing, STANCE], RIGHT, TUNING.double_support, TUNING.single_support, AHEAD)
    gap = before.evaluate(0.5).position - after.evaluate(0.0).position
    assert np.linalg.norm(gap) < 2e-4


def test_steps_beyond_the_lookahead_hardly_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """At lift-off: a hundredth of a millimetre or two, against ten further steps."""
    target = PLANNER.next_foothold(STANCE, LEFT, AHEAD)
    short = PLANS.from_lift(STANCE, LEFT, target, TUNING.single_support, AHEAD).evaluate(0.0).position
    monkeypatch.setattr(step_plan, "LOOKAHEAD", 13)
    long = PLANS.from_lift(STANCE, LEFT, target, TUNING.single_support, AHEAD).evaluate(0.0).position
    assert 0.0 < np.linalg.norm(short - long) < 2e-5


@pytest.mark.parametrize("single", [0.2, 0.5, 0.8])
def test_the_landing_is_when_it_is_told_to_be(single: float) -> None:
    target = PLANNER.next_foothold(STANCE, LEFT, AHEAD)
    plan = PLANS.from_lift(STANCE, LEFT, target, single, AHEAD)
    half = 0.5 * TUNING.double_support
    expected = [STANCE.point, STANCE.point, 0.5 * (STANCE.point + target.point), target.point]
    times = np.array([0.0, single - 1e-9, single + half, single + 2 * half + 1e-9])
    np.testing.assert_allclose(zmps(plan, times), expected, rtol=0, atol=1e-6)
    # all later single supports keep their own time
    later = single + TUNING.double_support + TUNING.single_support
    np.testing.assert_allclose(zmps(plan, np.array([later - 1e-9])), [target.point], rtol=0, atol=1e-6)


def test_from_standing_neither_dcm_nor_zmp_jumps() -> None:
    """The plan begins with the DCM given, its ZMP there too; and is the usual plan from lift-off on."""
    feet = [side_by_side(STANCE, LEFT), STANCE]
    for start in (0.5 * (feet[0].point + feet[1].point), STANCE.point + np.array([0.03, 0.08])):
        plan = PLANS.from_double_support(feet, LEFT, 0.8, TUNING.single_support, AHEAD, start)
        first = plan.evaluate(0.0)
        np.testing.assert_allclose(first.position, start, rtol=0, atol=1e-9)
        np.testing.assert_allclose(first.zmp, start, rtol=0, atol=1e-9)
        lift = PLANS.from_lift(STANCE, LEFT, PLANNER.next_foothold(STANCE, LEFT, AHEAD), 0.5, AHEAD)
        np.testing.assert_allclose(plan.evaluate(0.8).position, lift.evaluate(0.0).position, rtol=0, atol=1e-9)
        zmp = zmps(plan, np.linspace(0.0, 1.2, 1201))
        # no jump: piecewise linear, so as fast as its two stretches are
        fastest = max(np.linalg.norm(zmp[400] - zmp[0]), np.linalg.norm(zmp[800] - zmp[400])) / 400
        assert np.linalg.norm(np.diff(zmp, axis=0), axis=1).max() < 1.01 * fastest


@pytest.mark.parametrize("swing", [LEFT, RIGHT])
def test_a_plan_to_stop_ends_at_rest_between_closed_feet(swing: int) -> None:
    """From feet a step apart: the swinging foot closes up, and that is the end."""
    plan = PLANS.from_double_support(holds(swing), swing, TUNING.double_support, TUNING.single_support, STOP)
    rest = plan.evaluate(60.0)
    np.testing.assert_allclose(rest.velocity, 0.0)
    middle = 0.5 * (STANCE.point + side_by_side(STANCE, swing).point)
    np.testing.assert_allclose(rest.position, middle, rtol=0, atol=1e-9)
    end = TUNING.double_support + TUNING.single_support + TUNING.stop_time
    np.testing.assert_allclose(plan.evaluate(end).position, middle, rtol=0, atol=1e-9)


def test_a_foothold_that_is_not_closed_needs_another_step() -> None:
    """Landing far ahead with the command to stop: the other foot has to come up to it."""
    far = side_by_side(STANCE, LEFT).compose(0.2, 0.0, 0.0)
    plan = PLANS.from_lift(STANCE, LEFT, far, 0.5, STOP)
    middle = 0.5 * (far.point + side_by_side(far, RIGHT).point)
    np.testing.assert_allclose(plan.evaluate(60.0).position, middle, rtol=0, atol=1e-9)
    at = 0.5 + TUNING.double_support + 0.5 * TUNING.single_support
    np.testing.assert_allclose(plan.evaluate(at).zmp, far.point, rtol=0, atol=1e-9)


@pytest.mark.parametrize("command", [AHEAD, FAST])
def test_while_walking_a_plan_looks_as_many_steps_ahead_as_it_says(command: VelocityCommand) -> None:
    target, single = PLANNER.next_foothold(STANCE, LEFT, command), TUNING.timing.single(command.foot_speed(WIDTH))
    plan = PLANS.from_lift(STANCE, LEFT, target, single, command)
    points, foot, side = [STANCE, target], target, RIGHT
    for _ in range(step_plan.LOOKAHEAD):
        foot = PLANNER.next_foothold(foot, side, command)
        points.append(foot)
        side = 1 - side
    rest = 0.5 * (points[-2].point + points[-1].point)
    np.testing.assert_allclose(plan.evaluate(60.0).position, rest, rtol=0, atol=1e-9)
    middles = 0.5 * single + TUNING.timing.period(command.foot_speed(WIDTH)) * np.arange(step_plan.LOOKAHEAD + 1)
    np.testing.assert_allclose(zmps(plan, middles), [p.point for p in points[:-1]], rtol=0, atol=1e-9)


class Scripted:
    """A planner that always answers the same, seen from the standing foot."""

    def __init__(self, *answer: float) -> None:
        self._answer = answer

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        return stance.compose(*self._answer)


@pytest.mark.parametrize("answer", [(0.9, WIDTH, 0.0), (-0.9, 5.0, 0.0), (0.1, -WIDTH, 0.0), (0.1, WIDTH, 2.0)])
def test_a_foothold_beyond_the_bounds_is_moved_onto_them(answer: tuple[float, float, float]) -> None:
    plans = StepPlan(Scripted(*answer), LIMITS, TUNING, OMEGA)
    found = plans.next_foothold(STANCE, LEFT, AHEAD)
    low, high = [-LIMITS.forward, LIMITS.narrowest, -LIMITS.turn], [LIMITS.forward, LIMITS.widest, LIMITS.turn]
    np.testing.assert_allclose(STANCE.relative(found), np.clip(answer, low, high), rtol=0, atol=1e-12)


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_foothold_that_is_no_place_is_refused(place: int, value: float) -> None:
    answer = [0.1, WIDTH, 0.0]
    answer[place] = value
    with pytest.raises(ConfigError, match="foothold of the planner"):
        StepPlan(Scripted(*answer), LIMITS, TUNING, OMEGA).from_double_support(holds(LEFT), LEFT, 0.2, 0.5, AHEAD)


def test_standing_and_coming_to_rest() -> None:
    middle, zmp = np.array([0.1, 0.2]), np.array([0.1, 0.3])
    for t in (0.0, 0.3, 5.0):
        here = PLANS.standing(middle).evaluate(t)
        np.testing.assert_allclose(here.position, middle)
        np.testing.assert_allclose(here.velocity, 0.0, rtol=0, atol=1e-12)
    plan = PLANS.to_rest(zmp, middle)
    stretch = TUNING.stop_time * np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(zmps(plan, stretch), [zmp, 0.5 * (zmp + middle), middle], rtol=0, atol=1e-12)


@pytest.mark.parametrize("foot", [LEFT, RIGHT])
def test_closed_is_side_by_side_within_the_tolerances(foot: int) -> None:
    would = side_by_side(STANCE, foot)
    inside, outside = 0.9, 1.1
    for fraction, closed in ((inside, True), (outside, False)):
        for sign in (-1.0, 1.0):
            way = sign * fraction * CLOSED_DISTANCE
            assert PLANS.closed(STANCE, would.compose(way, 0.0, 0.0), foot) is closed
            assert PLANS.closed(STANCE, would.compose(0.0, way, 0.0), foot) is closed
            turned = Foothold(would.x, would.y, would.yaw + sign * fraction * CLOSED_TURN + 2 * np.pi)
            assert PLANS.closed(STANCE, turned, foot) is closed
    assert not PLANS.closed(STANCE, side_by_side(STANCE, 1 - foot), foot)
