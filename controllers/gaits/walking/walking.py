"""Walking on command: when each foot lifts and comes down."""

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from controllers.balance.dcm_feedback import clip_to_support
from controllers.balance.dcm_plan import DcmPlan, DcmReference
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.contact_detection import SupportSensor
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.walking.adjustment import StepAdjustment
from controllers.gaits.walking.config import WalkTuning
from controllers.gaits.walking.footsteps import FootstepPlanner, VelocityFootsteps
from controllers.gaits.walking.plan import StepPlan
from controllers.gaits.walking.references import WalkingReference
from controllers.gaits.walking.swing_path import SwingPath
from controllers.reference import WholeBodyReference
from robots.messages import Array, RobotState
from wbc.wrench import GRAVITY

NOTICED_SHIFT, NOTICED_TIME = 0.003, 0.004
"""Changes of a foothold [m] or a landing's time [s] that are worth a new plan."""


class Support(Enum):
    """What the robot stands on, by plan."""

    STAND = 0
    DOUBLE = 1
    SINGLE = 2


class Walking:
    """Walks as commanded: a gait.

    Single and double support follow each other. Footholds are chosen when a foot lifts; under a disturbance they, and
    the landing's time, move with the DCM. The plan is made anew at every touchdown, from where the feet then really
    are, and at every lift-off.

    A foot that touches the ground in the second half of its way ends its step early; one that does not touch in time
    goes on down. A foot does not lift while the DCM's error would ask for another foothold at once: both feet take the
    error back better than one. Where the DCM has left the feet, standing or in double support, a step is made at once.

    Attributes:
        limits: bounds of footholds, of those that the planner chooses and of those that a disturbance moves.
        support: what the robot stands on, by plan.
        steps: number of touchdowns so far.
    """

    def __init__(self, kin: BodyKinematics, tuning: WalkTuning, planner: FootstepPlanner | None = None) -> None:
        """Begin standing at the state of ``kin``, both feet down; without a ``planner`` steps follow the velocity."""
        robot = kin.robot
        self._tuning = tuning
        self._feet = feet = Feet(kin)
        self._reference = WalkingReference(kin, feet)
        self.limits = tuning.limits(feet.width)
        self._timing = tuning.timing
        planner = planner or VelocityFootsteps(self.limits, self._timing)
        self._plans = StepPlan(planner, self.limits, tuning, feet.omega)
        self._room = tuning.zmp_share * np.array([[s.half_length, s.half_width] for s in robot.soles])
        self._adjustment = StepAdjustment(self.limits, feet.omega, self._room[0], tuning.double_support)
        self._sensor = SupportSensor(tuning.touch_share * robot.total_mass * GRAVITY)
        self._command = self._heeded = VelocityCommand()
        self._stopped = False
        self.support = Support.STAND
        self.steps = 0
        self._swing = RIGHT
        self._landed: int | None = None
        self._since = self._time = 0.0
        self._single = self._ahead = tuning.single_support
        self._double = tuning.double_support
        self._waited, self._goes = 0.0, False
        self._path: SwingPath | None = None
        self._target = self._nominal = feet.footholds[RIGHT]
        self._last = False
        self._plan = self._plans.standing(feet.middle)
        self._wanted = feet.middle

    @property
    def command(self) -> VelocityCommand:
        """Velocity of the body; may be set at any time, is heeded from the next step on, and not after a stop.

        From one step to the next the velocity changes by no more than the tuning's ``speed_change``, ``turn_change``.
        """
        return self._command

    @command.setter
    def command(self, command: VelocityCommand) -> None:
        if not self._stopped:
            self._command = command

    def stop(self) -> None:
        """See :meth:`controllers.gaits.gait.Gait.stop`."""
        self._stopped = True
        self._command = VelocityCommand()

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: BodyKinematics) -> None:
        """See :meth:`controllers.gaits.gait.Gait.apply`."""
        self._feet.update(kin)
        self._advance(t, self._touching(t, state), kin)
        if self.support is Support.SINGLE:
            self._adjust_step(t)
        elapsed, swing = t - self._since, None
        if self.support is Support.SINGLE and self._path is not None:
            swing = self._swing, self._path.evaluate(elapsed)
        dcm, limits = self._planned_dcm(elapsed), self._load_limits(elapsed)
        self._reference.write(reference, t, dcm, self._feet, swing, limits)
        self._time = t

    # -- changes of support

    def _advance(self, t: float, touching: Sequence[bool], kin: BodyKinematics) -> None:
        """Go on to the next support when it is time, or when the feet or the DCM say so."""
        elapsed, tuning = t - self._since + 1e-9, self._tuning
        if self.support is Support.STAND:
            if self._falling(elapsed):
                self._catch(t)
            elif self._command.walks and elapsed > tuning.stop_time:
                self._start(t)
        elif self.support is Support.DOUBLE:
            self._wait(t)
            if t - self._since + 1e-9 >= self._double or self._falling(elapsed):
                self._lift(t)
        elif (elapsed >= 0.5 * self._single and touching[self._swing]) or elapsed >= self._single + tuning.late_limit:
            self._touch_down(t, kin)

    def _start(self, t: float) -> None:
        """From standing into the first double support: the load goes to the first standing foot."""
        # a side step begins with the foot on that side; a turn, with the inner foot
        self._swing = LEFT if self._command.vy + 0.1 * self._command.wz > 0 else RIGHT
        self._enter_double(t, self._tuning.start_time, self._plan.evaluate(t - self._since).position)

    def _catch(self, t: float) -> None:
        """From standing into a step that catches the robot: the foot away from which it falls lifts."""
        left, right = self._feet.footholds
        to_left = float((self._feet.dcm - self._feet.middle) @ (left.point - right.point))
        self._swing = RIGHT if to_left > 0 else LEFT
        self._enter_double(t, self._tuning.catch_time, self._feet.dcm)

    def _enter_double(self, t: float, duration: float, start: Array | None = None) -> None:
        """The load goes to the foot that stands next; from standing, ``start`` is the DCM."""
        if start is not None:
            # the foot that landed last has long had its load
            self._landed = None
        before, width = self._heeded, self.limits.width
        self._heeded = before.towards(self._command, self._tuning.speed_change, self._tuning.turn_change)
        # the foot that lifts stands where the velocity before has left it
        self._ahead = self._timing.single(max(before.foot_speed(width), self._heeded.foot_speed(width)))
        self._plan = self._plans.from_double(
            self._feet.footholds, self._swing, duration, self._ahead, self._heeded, start
        )
        self.support, self._since, self._double = Support.DOUBLE, t, duration
        self._waited, self._goes = 0.0, False

    def _wait(self, t: float) -> None:
        """Hold the plan's time while the step ahead would need another foothold at once, before its foot unloads."""
        before = self._double - self._tuning.load_time
        if self._goes or t - self._since < before:
            return
        if self._waited > self._tuning.wait_limit or not self._needs_shift():
            self._goes = True
        else:
            self._waited += t - self._time
            self._since += t - self._time

    def _needs_shift(self) -> bool:
        """Whether the DCM's error would move the next foothold by ``wait_shift`` or more."""
        now = self._plan.evaluate(self._double - self._tuning.load_time).position
        lead = self._plan.evaluate(self._double + self._ahead).position
        stance = self._feet.footholds[1 - self._swing]
        at_lift = self._plan.evaluate(self._double).position + (self._feet.dcm - now)
        shift = self._adjustment.shift(at_lift, stance, lead, self._ahead)
        return max(abs(s) for s in shift) >= self._tuning.wait_shift

    def _lift(self, t: float) -> None:
        stance, foot, tuning = self._feet.footholds[1 - self._swing], self._feet.footholds[self._swing], self._tuning
        self._nominal = self._target = self._plans.next_foothold(stance, self._swing, self._heeded)
        start = np.array([foot.x, foot.y, self._feet.heights[self._swing], foot.yaw])
        self._single = self._ahead
        self._path = SwingPath(start, self._goal(), tuning.step_height, self._single, tuning.touch_speed)
        self._plan = self._plan_single()
        self._wanted = self._plan.evaluate(self._single).position
        self._last = self._closes()
        self.support, self._since = Support.SINGLE, t

    def _touch_down(self, t: float, kin: BodyKinematics) -> None:
        self._feet.latch(kin)
        falling = self._falling(t - self._since)
        self._path = None
        self._landed = self._swing
        self._swing = 1 - self._swing
        self.steps += 1
        if self._last and not self._command.walks and not falling:
            self._plan = self._plans.to_rest(self._feet.footholds[self._swing].point, self._feet.middle)
            self._heeded = VelocityCommand()
            self.support, self._since = Support.STAND, t
        else:
            self._enter_double(t, self._tuning.double_support)

    # -- the step on its way

    def _plan_single(self) -> DcmPlan:
        """From lift-off on, with the present foothold and landing time."""
        stance = self._feet.footholds[1 - self._swing]
        return self._plans.from_lift(stance, self._swing, self._target, self._single, self._heeded)

    def _closes(self) -> bool:
        """Whether the robot may stand after this step: it is to stop, and the feet will be side by side."""
        stance = self._feet.footholds[1 - self._swing]
        return not self._heeded.walks and self._plans.closed(stance, self._target, self._swing)

    def _goal(self) -> Array:
        """Where the swinging foot is to come down, with its yaw near that of its start, (4,)."""
        yaw = self._feet.footholds[self._swing].yaw
        turned = yaw + math.remainder(self._target.yaw - yaw, math.tau)
        height = self._feet.heights[1 - self._swing] - self._tuning.touch_depth
        return np.array([self._target.x, self._target.y, height, turned])

    def _adjust_step(self, t: float) -> None:
        """Let foothold and landing time follow the measured DCM."""
        elapsed, tuning = t - self._since, self._tuning
        left = self._single - elapsed
        if left < tuning.frozen_time or self._path is None:
            return
        shortest = min(left, max(tuning.frozen_time, tuning.shortest_step - elapsed))
        stance = self._feet.footholds[1 - self._swing]
        target, time = self._adjustment.adjust(
            self._feet.dcm, stance, self._swing, self._nominal, self._wanted, left, shortest
        )
        moved = math.hypot(target.x - self._target.x, target.y - self._target.y)
        if moved > NOTICED_SHIFT or left - time > NOTICED_TIME:
            self._target, self._single = target, elapsed + time
            self._plan = self._plan_single()
            self._last = self._closes()
            self._path.send_to(self._goal(), elapsed, time)

    # -- what is measured, and what is planned

    def _touching(self, t: float, state: RobotState) -> Sequence[bool]:
        """Which feet touch the ground: by their forces, or where they are not measured, by the clock."""
        if state.foot_forces is not None:
            return self._sensor.update(state.foot_forces)
        landed = t - self._since >= self._single
        return [landed or self.support is not Support.SINGLE or foot != self._swing for foot in (LEFT, RIGHT)]

    def _falling(self, elapsed: float) -> bool:
        """Whether the DCM is off the plan, and where no ZMP between the feet brings it back."""
        feet = self._feet
        planned = self._planned_dcm(elapsed).position
        if math.hypot(feet.dcm[0] - planned[0], feet.dcm[1] - planned[1]) < self._tuning.catch_error:
            return False
        both, (centres, yaws) = np.array([True, True]), (feet.centres.tolist(), feet.yaws.tolist())
        near = clip_to_support(feet.dcm, centres, yaws, self._room.tolist(), both)
        return math.hypot(near[0] - feet.dcm[0], near[1] - feet.dcm[1]) > 1e-9

    def _planned_dcm(self, elapsed: float) -> DcmReference:
        """The plan's DCM, at rest while a foot waits to lift."""
        planned = self._plan.evaluate(elapsed)
        if self.support is Support.DOUBLE and self._waited > 0.0 and not self._goes:
            return DcmReference(planned.position, np.zeros(2), planned.omega)
        return planned

    def _load_limits(self, elapsed: float) -> Array:
        """Share of the weight that each foot may carry: a foot that has landed takes it on, one that lifts gives it up.

        Each in ``load_time``, and so without a jump of the torques.
        """
        limits = [1.0, 1.0]
        if self.support is not Support.SINGLE and self._landed is not None:
            limits[self._landed] = min(1.0, elapsed / self._tuning.load_time)
        if self.support is Support.DOUBLE:
            gives_up = (self._double - elapsed) / self._tuning.load_time
            limits[self._swing] = max(0.0, min(limits[self._swing], gives_up))
        return np.array(limits)
