"""Walking on command: when each foot lifts and comes down, and the references of feet, CoM and heading meanwhile."""

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from controllers.balance import clip_to_support
from controllers.footsteps import LEFT, RIGHT, Foothold, FootstepPlanner, VelocityCommand, VelocityFootsteps
from controllers.lipm import DcmPlan, DcmReference, ZmpPhase, waypoint
from controllers.reference import PointReference, WholeBodyReference
from controllers.step_adjustment import StepAdjustment
from controllers.support import SupportSensor
from controllers.swing import SwingPath
from controllers.walking_config import WalkTuning
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from wbc.wrench import GRAVITY

LOOKAHEAD = 3
"""Steps that the plan of the DCM looks ahead: what lies beyond moves it by less than a hundredth of a millimetre."""

CLOSED_DISTANCE, CLOSED_TURN = 0.025, 0.06
"""Feet this close [m, rad] to where a closing step would put them stand side by side."""


class Support(Enum):
    """What the robot stands on, by plan."""

    STAND = 0
    DOUBLE = 1
    SINGLE = 2


class Walking:
    """Walks as commanded: a gait.

    Single and double support follow each other; in double support the ZMP goes from one sole's centre to the next, in
    single support it stays. Footholds are chosen when a foot lifts; under a disturbance they move with the DCM. The
    plan is made anew, from where the feet really are, at every touchdown and lift-off.

    A foot that touches the ground in the second half of its way ends its step early; one that does not touch in time
    goes on down.

    Attributes:
        support: what the robot stands on, by plan.
        steps: number of touchdowns so far.
    """

    def __init__(
        self, robot: RobotDescription, tuning: WalkTuning, state: RobotState, planner: FootstepPlanner | None = None
    ) -> None:
        """Begin standing in ``state``, both feet down."""
        self._tuning = tuning
        self._kin = kin = Kinematics(robot)
        self._sole_ids = [kin.frame_id(robot.roles[r]) for r in ("left_sole", "right_sole")]
        kin.update_center_of_mass(state.q, state.v)
        roles = robot.roles
        self._feet = [self._measured_foothold(i) for i in (LEFT, RIGHT)]
        self._heights = [float(self._sole(i)[1][2]) for i in (LEFT, RIGHT)]
        yaw = self._heading()
        turn_back = _about_z(-yaw)
        self._upright = [turn_back @ kin.frame_placement(kin.frame_id(roles[r]))[0] for r in ("base", "torso")]
        self._com_height = float(kin.com[2]) - 0.5 * sum(self._heights)
        self.omega = math.sqrt(GRAVITY / self._com_height)
        self.limits = tuning.limits(self._width())
        self._planner = planner or VelocityFootsteps(self.limits, tuning.period)
        room = tuning.zmp_share * np.array([robot.soles[0].half_length, robot.soles[0].half_width])
        self._adjustment = StepAdjustment(self.limits, self.omega, room, tuning.double_support)
        self._sensor = SupportSensor(tuning.touch_share * robot.total_mass * GRAVITY)
        self._com = kin.com[:2].copy()
        self._dcm = self._com
        self._command = self._heeded = VelocityCommand()
        self._stopped = False
        self.support = Support.STAND
        self.steps = 0
        self._swing = RIGHT
        self._since = 0.0
        self._time: float | None = None
        self._path: SwingPath | None = None
        self._target = self._feet[RIGHT]
        self._nominal = self._target
        self._single = tuning.single_support
        self._double = tuning.double_support
        self._wanted = self._com
        self._last = False
        self._landed = RIGHT
        self._plan = self._standing_plan()

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

    # -- measurement

    def _sole(self, foot: int) -> tuple[Array, Array]:
        return self._kin.frame_placement(self._sole_ids[foot])

    def _measured_foothold(self, foot: int) -> Foothold:
        rotation, position = self._sole(foot)
        return Foothold(float(position[0]), float(position[1]), math.atan2(rotation[1, 0], rotation[0, 0]))

    def _width(self) -> float:
        return abs(self._feet[RIGHT].relative(self._feet[LEFT])[1])

    def _heading(self) -> float:
        left, right = self._feet
        return left.yaw + 0.5 * math.remainder(right.yaw - left.yaw, math.tau)

    @property
    def _stance(self) -> int:
        return 1 - self._swing

    # -- plans

    def _standing_plan(self) -> DcmPlan:
        middle = 0.5 * (self._feet[LEFT].point + self._feet[RIGHT].point)
        return DcmPlan([ZmpPhase(middle, middle, 1.0)], self.omega)

    def _phases_from(self, stance: Foothold, swing: int, target: Foothold) -> list[ZmpPhase]:
        """Phases of the ZMP from the moment the foot ``swing`` lifts: it goes to ``target``, others follow."""
        single, double = self._tuning.single_support, self._tuning.double_support
        phases = [ZmpPhase(stance.point, stance.point, single)]
        standing, landing, side = stance, target, swing
        for _ in range(LOOKAHEAD):
            if not self._heeded.walks and self._closed(standing, landing, side):
                middle = 0.5 * (standing.point + landing.point)
                return [*phases, ZmpPhase(standing.point, middle, self._tuning.stop_time)]
            phases.append(ZmpPhase(standing.point, landing.point, double))
            phases.append(ZmpPhase(landing.point, landing.point, single))
            standing, side = landing, 1 - side
            landing = self._planner.next_foothold(standing, side, self._heeded)
        phases.append(ZmpPhase(standing.point, 0.5 * (standing.point + landing.point), double))
        return phases

    def _plan_single(self) -> DcmPlan:
        """From lift-off on, with the present foothold and landing time."""
        phases = self._phases_from(self._feet[self._stance], self._swing, self._target)
        phases[0] = replace(phases[0], duration=self._single)
        return DcmPlan(phases, self.omega)

    # -- changes of support

    def _start(self, t: float) -> None:
        """From standing into the first double support: the load goes to the first standing foot."""
        command = self.command
        sideways = command.vy + 0.1 * command.wz
        self._swing = LEFT if sideways > 0 else RIGHT
        self._enter_double(t, self._tuning.start_time, from_dcm=self._plan.evaluate(t - self._since).position)

    def _catch(self, t: float) -> None:
        """From standing into a step that catches the robot: the foot away from which it falls lifts."""
        left, right = self._feet
        to_left = float((self._dcm - 0.5 * (left.point + right.point)) @ (left.point - right.point))
        self._swing = RIGHT if to_left > 0 else LEFT
        self._enter_double(t, self._tuning.catch_time, from_dcm=self._dcm)

    def _enter_double(self, t: float, duration: float, from_dcm: Array | None = None) -> None:
        """Load goes to the foot that stands next; ``from_dcm`` is where the DCM is, where the ZMP is not known."""
        self._heeded = self._heeded.towards(self._command, self._tuning.speed_change, self._tuning.turn_change)
        stance = self._feet[self._stance]
        target = self._planner.next_foothold(stance, self._swing, self._heeded)
        phases = self._phases_from(stance, self._swing, target)
        shift = [ZmpPhase(self._feet[self._swing].point, stance.point, duration)]
        if from_dcm is not None:
            at_lift = DcmPlan(phases, self.omega).evaluate(0.0).position
            halves = (0.5 * duration, 0.5 * duration)
            middle = waypoint(from_dcm, from_dcm, stance.point, at_lift, halves, self.omega)
            shift = [ZmpPhase(from_dcm, middle, halves[0]), ZmpPhase(middle, stance.point, halves[1])]
        self._plan = DcmPlan([*shift, *phases], self.omega)
        self.support, self._since, self._double = Support.DOUBLE, t, duration

    def _lift(self, t: float) -> None:
        stance = self._feet[self._stance]
        foot = self._feet[self._swing]
        self._nominal = self._target = self._planner.next_foothold(stance, self._swing, self._heeded)
        start = np.array([foot.x, foot.y, self._heights[self._swing], foot.yaw])
        tuning = self._tuning
        self._path = SwingPath(start, self._goal(), tuning.step_height, tuning.single_support, tuning.touch_speed)
        self._single = self._tuning.single_support
        self._plan = self._plan_single()
        self._wanted = self._plan.evaluate(self._single).position
        self._last = not self._heeded.walks and self._closed(stance, self._target, self._swing)
        self.support, self._since = Support.SINGLE, t

    def _goal(self) -> Array:
        """Where the swinging foot is to come down, with its yaw near that of its start, (4,)."""
        yaw = self._feet[self._swing].yaw
        turned = yaw + math.remainder(self._target.yaw - yaw, math.tau)
        height = self._heights[self._stance] - self._tuning.touch_depth
        return np.array([self._target.x, self._target.y, height, turned])

    def _touch_down(self, t: float) -> None:
        foot, falling = self._swing, self._falling(t - self._since)
        self._feet[foot], self._heights[foot] = self._measured_foothold(foot), float(self._sole(foot)[1][2])
        stance = self._stance
        self._feet[stance], self._heights[stance] = self._measured_foothold(stance), float(self._sole(stance)[1][2])
        self._path = None
        self._landed = foot
        self.steps += 1
        self._swing = stance
        if self._last and not self._command.walks and not falling:
            self._come_to_rest(t)
        else:
            self._enter_double(t, self._tuning.double_support)

    def _closed(self, stance: Foothold, foothold: Foothold, foot: int) -> bool:
        """Whether a step on the spot would leave ``foot`` where it is."""
        would = self._planner.next_foothold(stance, foot, VelocityCommand())
        x, y, yaw = foothold.relative(would)
        return math.hypot(x, y) < CLOSED_DISTANCE and abs(yaw) < CLOSED_TURN

    def _come_to_rest(self, t: float) -> None:
        middle = 0.5 * (self._feet[LEFT].point + self._feet[RIGHT].point)
        shift = ZmpPhase(self._feet[self._swing].point, middle, self._tuning.stop_time)
        self._plan = DcmPlan([shift], self.omega)
        self._heeded = VelocityCommand()
        self.support, self._since = Support.STAND, t

    # -- every tick

    def stop(self) -> None:
        """See :meth:`Gait.stop`."""
        self._stopped = True
        self._command = VelocityCommand()

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState) -> None:
        """See :meth:`Gait.apply`."""
        kin = self._kin
        kin.update_center_of_mass(state.q, state.v)
        self._dcm = kin.com[:2] + kin.com_velocity[:2] / self.omega
        self._advance(t, self._touching(t, state))
        if self.support is Support.SINGLE:
            self._adjust_step(t)
        self._write(reference, t, self._planned_dcm(t - self._since))

    def _planned_dcm(self, elapsed: float) -> DcmReference:
        """The plan's DCM; while a foot waits to lift, where it was to lift."""
        if self.support is Support.DOUBLE and elapsed > self._double:
            return DcmReference(self._plan.evaluate(self._double).position, np.zeros(2), self.omega)
        return self._plan.evaluate(elapsed)

    def _touching(self, t: float, state: RobotState) -> Sequence[bool]:
        """Which feet touch the ground: by their forces, or where they are not measured, by the clock."""
        if state.foot_forces is not None:
            return self._sensor.update(state.foot_forces)
        landed = t - self._since >= self._single
        return [landed or self.support is not Support.SINGLE or foot != self._swing for foot in (LEFT, RIGHT)]

    def _advance(self, t: float, touching: Sequence[bool]) -> None:
        elapsed = t - self._since + 1e-9
        if self.support is Support.STAND:
            if self._falling(elapsed):
                self._catch(t)
            elif self.command.walks and elapsed > self._tuning.stop_time:
                self._start(t)
        elif self.support is Support.DOUBLE:
            if (elapsed >= self._double and self._ready(elapsed)) or self._falling(elapsed):
                self._lift(t)
        elif (elapsed >= 0.5 * self._single and touching[self._swing]) or (
            elapsed >= self._single + self._tuning.late_limit
        ):
            self._touch_down(t)

    def _falling(self, elapsed: float) -> bool:
        """Whether the DCM is off the plan, and where no ZMP between the feet brings it back."""
        error = self._dcm - self._planned_dcm(elapsed).position
        if float(error @ error) < self._tuning.catch_error**2:
            return False
        centres = np.array([foot.point for foot in self._feet])
        yaws = np.array([foot.yaw for foot in self._feet])
        near = clip_to_support(self._dcm, centres, yaws, np.tile(self._adjustment.room, (2, 1)), np.array([True, True]))
        return float(np.abs(near - self._dcm).max()) > 1e-9

    def _ready(self, elapsed: float) -> bool:
        """Whether the step ahead needs no shift of its foothold, or has been waited for long enough."""
        if elapsed > self._double + self._tuning.wait_limit:
            return True
        stance = self._feet[self._stance]
        lead = self._plan.evaluate(self._double + self._tuning.single_support).position
        shift = self._adjustment.shift(self._dcm, stance, lead, self._tuning.single_support)
        return float(np.abs(shift).max()) < self._tuning.wait_shift

    def _adjust_step(self, t: float) -> None:
        """Let foothold and landing time follow the measured DCM."""
        elapsed = t - self._since
        left = self._single - elapsed
        if left < self._tuning.frozen_time or self._path is None:
            return
        shortest = min(left, max(self._tuning.frozen_time, self._tuning.shortest_step - elapsed))
        stance = self._feet[self._stance]
        target, time = self._adjustment.adjust(
            self._dcm, stance, self._swing, self._nominal, self._wanted, left, shortest
        )
        moved = math.hypot(target.x - self._target.x, target.y - self._target.y)
        if moved > 0.003 or left - time > 0.004:
            self._target, self._single = target, elapsed + time
            self._plan = self._plan_single()
            self._path.send_to(self._goal(), elapsed, time)

    def _write(self, reference: WholeBodyReference, t: float, dcm: DcmReference) -> None:
        reference.dcm = dcm
        reference.in_contact = np.array([True, True])
        reference.sole_turns = np.zeros((2, 2))
        reference.load_limits = self._load_limits(t - self._since)
        yaws = [foot.yaw for foot in self._feet]
        for foot in (LEFT, RIGHT):
            point = self._feet[foot]
            reference.soles[foot].position = np.array([point.x, point.y, self._heights[foot]])
            reference.soles[foot].velocity = reference.soles[foot].acceleration = np.zeros(3)
        if self.support is Support.SINGLE and self._path is not None:
            swing, elapsed = self._swing, t - self._since
            p, v, a = self._path.evaluate(elapsed)
            reference.soles[swing].position, reference.soles[swing].velocity = p[:3], v[:3]
            reference.soles[swing].acceleration = a[:3]
            reference.in_contact[swing] = False
            yaws[swing] = float(p[3])
            reference.sole_turns[swing] = v[3], a[3]
        reference.sole_rotations = (_about_z(yaws[LEFT]), _about_z(yaws[RIGHT]))
        heading = yaws[LEFT] + 0.5 * math.remainder(yaws[RIGHT] - yaws[LEFT], math.tau)
        turn = _about_z(heading)
        reference.base_rotation, reference.torso_rotation = turn @ self._upright[0], turn @ self._upright[1]
        reference.turn_rate = 0.5 * float(reference.sole_turns[:, 0].sum())
        self._write_com(reference, t, dcm)

    def _load_limits(self, elapsed: float) -> Array:
        """Share of the weight that each foot may carry: a foot that has landed takes it on, one that lifts gives it up.

        Each in ``load_time``, and so without a jump of the torques.
        """
        limits = np.ones(2)
        if self.support is not Support.SINGLE and self.steps > 0:
            limits[self._landed] = elapsed / self._tuning.load_time
        if self.support is Support.DOUBLE:
            limits[self._swing] = (self._double - elapsed) / self._tuning.load_time
        return np.clip(limits, 0.0, 1.0)

    def _write_com(self, reference: WholeBodyReference, t: float, dcm: DcmReference) -> None:
        """The CoM that the plan has: it follows the DCM."""
        dt = 0.0 if self._time is None else t - self._time
        self._time = t
        velocity = self.omega * (dcm.position - self._com)
        self._com = dcm.position + (self._com - dcm.position) * math.exp(-self.omega * dt)
        height = self._com_height + 0.5 * (self._heights[LEFT] + self._heights[RIGHT])
        reference.com = PointReference(np.array([*self._com, height]), np.array([*velocity, 0.0]))


def _about_z(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
