"""From one phase of walking to the next: functions of the phase, of what is measured, and of the rules of a walk."""

import math
from dataclasses import dataclass, replace

import numpy as np

from controllers.balance.dcm_feedback import clip_to_support
from controllers.balance.dcm_plan import DcmPlan
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.foot_state import Feet
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking.adjustment import StepAdjustment
from controllers.gaits.walking.config import WalkTuning
from controllers.gaits.walking.footsteps import StepLimits
from controllers.gaits.walking.phases import LONG_LOADED, DoubleSupport, SingleSupport, Standing
from controllers.gaits.walking.plan import StepPlan
from controllers.gaits.walking.swing_path import SwingPath
from robots.messages import Array

REPLAN_DISTANCE, REPLAN_TIME = 0.003, 0.004
"""Thresholds of a new plan: changes of a foothold [m] and of the time of its touchdown [s]."""

TIME_ROUNDING = 1e-9
"""A phase that is to end at a tick ends there, although the tick's time is rounded [s]."""


@dataclass(frozen=True, slots=True)
class WalkRules:
    """What stays the same over a walk.

    Attributes:
        tuning: times, heights, thresholds.
        limits: of footholds.
        plans: makes plans of the DCM.
        adjustment: moves footholds.
        zmp_ranges: half length and half width of each sole that the ZMP may use against a disturbance [m].
    """

    tuning: WalkTuning
    limits: StepLimits
    plans: StepPlan
    adjustment: StepAdjustment
    zmp_ranges: tuple[tuple[float, float], tuple[float, float]]


# -- on both feet


def leave_standing(
    rules: WalkRules, phase: Standing, feet: Feet, t: float, command: VelocityCommand
) -> Standing | DoubleSupport:
    """Standing as it is, or the way to a first step: because the robot falls, or is told to walk."""
    elapsed = t - phase.since + TIME_ROUNDING
    if is_falling(rules, phase.plan, feet, elapsed):
        # where the DCM is, not where it should be: there is no time to take it back to the plan
        swing = _foot_to_catch_with(feet)
        return _begin_double_support(rules, feet, t, swing, command, rules.tuning.catch_time, feet.dcm)
    # the last plan is to have come to rest: a start from its middle would make the ZMP jump
    if command.walks and elapsed > rules.tuning.stop_time:
        # a side step begins with the foot on that side; a turn, with the inner foot
        swing = LEFT if command.vy + 0.1 * command.wz > 0 else RIGHT
        begin = phase.plan.evaluate(t - phase.since).position
        return _begin_double_support(rules, feet, t, swing, command, rules.tuning.start_time, begin)
    return phase


def leave_double_support(
    rules: WalkRules, phase: DoubleSupport, feet: Feet, t: float, dt: float
) -> DoubleSupport | SingleSupport:
    """Double support as it is, its time held, or the step that follows.

    Args:
        rules: of the walk.
        phase: the present one.
        feet: measured.
        t: of this tick [s].
        dt: since the last tick [s].
    """
    held = _wait(rules, phase, feet, t, dt)
    elapsed = t - held.since + TIME_ROUNDING
    # a robot that falls has to step now, whatever its load
    if elapsed >= held.duration or is_falling(rules, phase.plan, feet, t - phase.since + TIME_ROUNDING):
        return _lift(rules, held, feet, t)
    return held


def is_falling(rules: WalkRules, plan: DcmPlan, feet: Feet, elapsed: float) -> bool:
    """Whether the DCM is off the plan, and where no ZMP between the feet brings it back.

    Args:
        rules: of the walk.
        plan: of the phase.
        feet: measured.
        elapsed: time since the plan began [s].
    """
    (x, y), (planned_x, planned_y) = feet.dcm.tolist(), plan.position(elapsed)
    # most ticks end here; and a DCM that is out of the soles by plan, in a fast walk, is no fall
    if math.hypot(x - planned_x, y - planned_y) < rules.tuning.catch_error:
        return False
    centres = [(foot.x, foot.y) for foot in feet.footholds]
    within = clip_to_support(feet.dcm, centres, feet.yaws, rules.zmp_ranges, np.array([True, True]))
    return math.hypot(within[0] - x, within[1] - y) > 1e-9


def _foot_to_catch_with(feet: Feet) -> int:
    """The foot away from which the robot falls: the other one carries it already, and legs do not cross."""
    left, right = feet.footholds
    to_left = float((feet.dcm - feet.middle) @ (left.point - right.point))
    return RIGHT if to_left > 0 else LEFT


def _begin_double_support(
    rules: WalkRules, feet: Feet, t: float, swing: int, command: VelocityCommand, duration: float, dcm: Array
) -> DoubleSupport:
    """From standing: the load goes to one foot while the DCM goes on from ``dcm`` (2,) [m]."""
    limited, single = _next_step(rules, VelocityCommand(), command)
    plan = rules.plans.from_double_support(feet.footholds, swing, duration, single, limited, dcm)
    # the foot that landed last has long had its load
    return DoubleSupport(t, duration, swing, plan, limited, single, LONG_LOADED)


def _next_step(rules: WalkRules, before: VelocityCommand, command: VelocityCommand) -> tuple[VelocityCommand, float]:
    """The command of the next step, limited in its change, and the step's time on one foot [s]."""
    tuning, width = rules.tuning, rules.limits.width
    limited = before.towards(command, tuning.speed_change, tuning.turn_change)
    # the foot that lifts stands where the velocity before has left it: its way is that of the faster one
    speed = max(before.foot_speed(width), limited.foot_speed(width))
    return limited, tuning.timing.single(speed)


def _wait(rules: WalkRules, phase: DoubleSupport, feet: Feet, t: float, dt: float) -> DoubleSupport:
    """Hold the plan's time while the next step would need another foothold at once, before its foot unloads.

    Both feet take an error of the DCM back better than one.
    """
    tuning = rules.tuning
    unloads_after = phase.duration - tuning.load_transfer_time
    # once decided it stays so: a foot that has begun to give up its load is not loaded again
    if phase.may_lift or t - phase.since < unloads_after:
        return phase
    if phase.waited > tuning.wait_limit or not _needs_shift(rules, phase, feet, unloads_after):
        return replace(phase, may_lift=True)
    return replace(phase, waited=phase.waited + dt, since=phase.since + dt)


def _needs_shift(rules: WalkRules, phase: DoubleSupport, feet: Feet, elapsed: float) -> bool:
    """Whether the DCM's error, carried on to lift-off, would move the next foothold by ``wait_shift`` or more."""
    plan, single = phase.plan, phase.next_single_support
    error = feet.dcm - plan.evaluate(elapsed).position
    at_lift = plan.evaluate(phase.duration).position + error
    at_touchdown = plan.evaluate(phase.duration + single).position
    shift = rules.adjustment.shift(at_lift, feet.footholds[1 - phase.swing], at_touchdown, single)
    return max(abs(s) for s in shift) >= rules.tuning.wait_shift


# -- on one foot


def _lift(rules: WalkRules, phase: DoubleSupport, feet: Feet, t: float) -> SingleSupport:
    """The foot lifts, to where the planner wants it: asked anew, because the feet are where they are measured to be."""
    tuning, swing, command, duration = rules.tuning, phase.swing, phase.command, phase.next_single_support
    stance, foot = feet.footholds[1 - swing], feet.footholds[swing]
    target = rules.plans.next_foothold(stance, swing, command)
    start = np.array([foot.x, foot.y, float(feet.centres[swing][2]), foot.yaw])
    path = SwingPath(start, _end_of_path(rules, feet, swing, target), tuning.step_height, duration, tuning.touch_speed)
    plan = rules.plans.from_lift(stance, swing, target, duration, command)
    return SingleSupport(
        since=t,
        duration=duration,
        swing=swing,
        chosen=target,
        target=target,
        path=path,
        plan=plan,
        dcm_at_touchdown=plan.evaluate(duration).position,
        command=command,
        closes=_closes(rules, stance, target, swing, command),
    )


def adjust_step(rules: WalkRules, phase: SingleSupport, feet: Feet, t: float) -> SingleSupport:
    """Single support with foothold and time of touchdown where the measured DCM wants them."""
    tuning, elapsed = rules.tuning, t - phase.since
    time_to_touchdown = phase.duration - elapsed
    # so late a change would only make the foot land in motion
    if time_to_touchdown < tuning.frozen_time:
        return phase
    shortest = min(time_to_touchdown, max(tuning.frozen_time, tuning.shortest_step - elapsed))
    stance = feet.footholds[1 - phase.swing]
    target, time = rules.adjustment.adjust(
        feet.dcm, stance, phase.swing, phase.chosen, phase.dcm_at_touchdown, time_to_touchdown, shortest
    )
    moved = math.hypot(target.x - phase.target.x, target.y - phase.target.y)
    # noise of the measured DCM is not worth a new plan and a new path in every tick
    if moved <= REPLAN_DISTANCE and time_to_touchdown - time <= REPLAN_TIME:
        return phase
    duration = elapsed + time
    return replace(
        phase,
        target=target,
        duration=duration,
        plan=rules.plans.from_lift(stance, phase.swing, target, duration, phase.command),
        # a step that a push sends elsewhere may not be the last: the feet would not be side by side
        closes=_closes(rules, stance, target, phase.swing, phase.command),
        path=phase.path.redirected(_end_of_path(rules, feet, phase.swing, target), elapsed, time),
    )


def has_landed(rules: WalkRules, phase: SingleSupport, t: float, touches: bool | None) -> bool:
    """Whether the step is over.

    Args:
        rules: of the walk.
        phase: the present one.
        t: of this tick [s].
        touches: whether the foot touches the ground; ``None`` where that is not measured: then the clock decides.
    """
    elapsed = t - phase.since + TIME_ROUNDING
    if touches is None:
        touches = t - phase.since >= phase.duration
    # in the first half of its way the foot may still scrape the ground that it leaves; and one that finds none is not
    # waited for without end, because the robot falls meanwhile
    return (touches and elapsed >= 0.5 * phase.duration) or elapsed >= phase.duration + rules.tuning.late_limit


def touch_down(
    rules: WalkRules, phase: SingleSupport, feet: Feet, t: float, command: VelocityCommand
) -> Standing | DoubleSupport:
    """From where the feet are now, latched already: on to the next step, or to rest after the last one."""
    loaded_since = (t, -math.inf) if phase.swing == LEFT else (-math.inf, t)
    swing = 1 - phase.swing
    falling = is_falling(rules, phase.plan, feet, t - phase.since)
    if phase.closes and not command.walks and not falling:
        return Standing(t, rules.plans.to_rest(feet.footholds[swing].point, feet.middle), loaded_since)
    limited, single = _next_step(rules, phase.command, command)
    duration = rules.tuning.double_support
    plan = rules.plans.from_double_support(feet.footholds, swing, duration, single, limited)
    return DoubleSupport(t, duration, swing, plan, limited, single, loaded_since)


def _closes(rules: WalkRules, stance: Foothold, target: Foothold, swing: int, command: VelocityCommand) -> bool:
    """Whether the robot may stand after a step: it is to stop, and the feet will be side by side."""
    return not command.walks and rules.plans.closed(stance, target, swing)


def _end_of_path(rules: WalkRules, feet: Feet, swing: int, target: Foothold) -> Array:
    """Where the path of the swinging foot ends: x, y, height, yaw, (4,)."""
    yaw = feet.footholds[swing].yaw
    # near the yaw of its start: the foot turns the shorter way round
    turned = yaw + math.remainder(target.yaw - yaw, math.tau)
    # below the ground, for a foot that lags behind its path to touch in time
    height = float(feet.centres[1 - swing][2]) - rules.tuning.touch_depth
    return np.array([target.x, target.y, height, turned])
