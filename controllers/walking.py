"""Walking on command: when each foot lifts and comes down, and the references of feet, CoM and heading meanwhile."""

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from controllers.footsteps import LEFT, RIGHT, Foothold, FootstepPlanner, VelocityCommand, VelocityFootsteps
from controllers.lipm import DcmPlan, DcmReference, ZmpPhase, shifted_start
from controllers.reference import PointReference, WholeBodyReference
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
        self._sensor = SupportSensor(tuning.touch_share * robot.total_mass * GRAVITY)
        self._com = kin.com[:2].copy()
        self._command = VelocityCommand()
        self._stopped = False
        self.support = Support.STAND
        self.steps = 0
        self._swing = RIGHT
        self._since = 0.0
        self._time: float | None = None
        self._path: SwingPath | None = None
        self._target = self._feet[RIGHT]
        self._nominal = self._target
        self._plan = self._standing_plan()

    @property
    def command(self) -> VelocityCommand:
        """Velocity of the body; may be set at any time, is heeded from the next step on, and not after a stop."""
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
            phases.append(ZmpPhase(standing.point, landing.point, double))
            phases.append(ZmpPhase(landing.point, landing.point, single))
            standing, side = landing, 1 - side
            landing = self._planner.next_foothold(standing, side, self.command)
        phases.append(ZmpPhase(standing.point, 0.5 * (standing.point + landing.point), double))
        return phases

    def _plan_single(self, target: Foothold) -> DcmPlan:
        return DcmPlan(self._phases_from(self._feet[self._stance], self._swing, target), self.omega)

    # -- changes of support

    def _start(self, t: float) -> None:
        """From standing into the first double support: the load goes to the first standing foot."""
        command = self.command
        sideways = command.vy + 0.1 * command.wz
        self._swing = LEFT if sideways > 0 else RIGHT
        self._enter_double(t, self._tuning.start_time, from_dcm=self._plan.evaluate(0.0).position)

    def _enter_double(self, t: float, duration: float, from_dcm: Array | None = None) -> None:
        """Load goes to the foot that stands next; ``from_dcm`` is where the DCM is, where the ZMP is not known."""
        stance = self._feet[self._stance]
        target = self._planner.next_foothold(stance, self._swing, self.command)
        phases = self._phases_from(stance, self._swing, target)
        shift = ZmpPhase(self._feet[self._swing].point, stance.point, duration)
        if from_dcm is not None:
            at_lift = DcmPlan(phases, self.omega).evaluate(0.0).position
            shift = ZmpPhase(shifted_start(shift, from_dcm, at_lift, self.omega), stance.point, duration)
        self._plan = DcmPlan([shift, *phases], self.omega)
        self.support, self._since, self._double = Support.DOUBLE, t, duration

    def _lift(self, t: float) -> None:
        stance = self._feet[self._stance]
        foot = self._feet[self._swing]
        self._nominal = self._target = self._planner.next_foothold(stance, self._swing, self.command)
        start = np.array([foot.x, foot.y, self._heights[self._swing], foot.yaw])
        self._path = SwingPath(start, self._goal(), self._tuning.step_height, self._tuning.single_support)
        self._plan = self._plan_single(self._target)
        self.support, self._since = Support.SINGLE, t

    def _goal(self) -> Array:
        """Where the swinging foot is to come down, with its yaw near that of its start, (4,)."""
        yaw = self._feet[self._swing].yaw
        turned = yaw + math.remainder(self._target.yaw - yaw, math.tau)
        return np.array([self._target.x, self._target.y, self._heights[self._stance], turned])

    def _touch_down(self, t: float) -> None:
        foot = self._swing
        self._feet[foot], self._heights[foot] = self._measured_foothold(foot), float(self._sole(foot)[1][2])
        stance = self._stance
        self._feet[stance], self._heights[stance] = self._measured_foothold(stance), float(self._sole(stance)[1][2])
        self._path = None
        self.steps += 1
        self._swing = stance
        if not self.command.walks and self._closed():
            self._come_to_rest(t)
        else:
            self._enter_double(t, self._tuning.double_support)

    def _closed(self) -> bool:
        """Whether a closing step would leave the foot where it is."""
        would = self._planner.next_foothold(self._feet[self._stance], self._swing, VelocityCommand())
        x, y, yaw = self._feet[self._swing].relative(would)
        return math.hypot(x, y) < CLOSED_DISTANCE and abs(yaw) < CLOSED_TURN

    def _come_to_rest(self, t: float) -> None:
        middle = 0.5 * (self._feet[LEFT].point + self._feet[RIGHT].point)
        shift = ZmpPhase(self._feet[self._swing].point, middle, self._tuning.double_support)
        self._plan = DcmPlan([shift], self.omega)
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
        self._advance(t, self._touching(t, state))
        dcm = self._plan.evaluate(t - self._since)
        if self.support is Support.SINGLE:
            self._adjust_step(t, dcm)
            dcm = self._plan.evaluate(t - self._since)
        self._write(reference, t, dcm)

    def _touching(self, t: float, state: RobotState) -> Sequence[bool]:
        """Which feet touch the ground: by their forces, or where they are not measured, by the clock."""
        if state.foot_forces is not None:
            return self._sensor.update(state.foot_forces)
        landed = t - self._since >= self._tuning.single_support
        return [landed or self.support is not Support.SINGLE or foot != self._swing for foot in (LEFT, RIGHT)]

    def _advance(self, t: float, touching: Sequence[bool]) -> None:
        elapsed = t - self._since + 1e-9
        if self.support is Support.STAND:
            if self.command.walks and elapsed > self._tuning.double_support:
                self._start(t)
        elif self.support is Support.DOUBLE:
            if elapsed >= self._double:
                self._lift(t)
        elif (elapsed >= 0.5 * self._tuning.single_support and touching[self._swing]) or (
            elapsed >= self._tuning.single_support + self._tuning.late_limit
        ):
            self._touch_down(t)

    def _adjust_step(self, t: float, dcm: DcmReference) -> None:
        """Move the foothold with the part of the DCM's error that the ZMP cannot take back within the sole."""
        tuning, left = self._tuning, self._tuning.single_support - (t - self._since)
        if left < tuning.frozen_share * tuning.single_support or self._path is None:
            return
        stance = self._feet[self._stance]
        nominal = self._plan_single(self._nominal).evaluate(t - self._since)
        error = (self._kin.com[:2] + self._kin.com_velocity[:2] / self.omega - nominal.position) @ stance.axes
        room = np.array(tuning.adjust_margin)
        excess = np.sign(error) * np.maximum(np.abs(error) - room, 0.0)
        turn = self.omega * tuning.double_support
        growth = math.exp(self.omega * left) * turn / (1.0 - math.exp(-turn))
        x, y = stance.axes @ (growth * excess)
        wanted = Foothold(self._nominal.x + x, self._nominal.y + y, self._nominal.yaw)
        wanted = self.limits.clamp(stance, wanted, self._swing)
        if math.hypot(wanted.x - self._target.x, wanted.y - self._target.y) > 0.003:
            self._target = wanted
            self._plan = self._plan_single(wanted)
            self._path.send_to(self._goal(), t - self._since)

    def _write(self, reference: WholeBodyReference, t: float, dcm: DcmReference) -> None:
        reference.dcm = dcm
        reference.in_contact = np.array([True, True])
        yaws = [foot.yaw for foot in self._feet]
        rate = 0.0
        for foot in (LEFT, RIGHT):
            point = self._feet[foot]
            reference.soles[foot].position = np.array([point.x, point.y, self._heights[foot]])
            reference.soles[foot].velocity = reference.soles[foot].acceleration = np.zeros(3)
        if self.support is Support.SINGLE and self._path is not None:
            swing, elapsed = self._swing, t - self._since
            p, v, a = self._path.evaluate(elapsed)
            if (late := elapsed - self._tuning.single_support) > 0:
                p[2] -= self._tuning.late_speed * late
                v[2] = -self._tuning.late_speed
            reference.soles[swing].position, reference.soles[swing].velocity = p[:3], v[:3]
            reference.soles[swing].acceleration = a[:3]
            reference.in_contact[swing] = False
            yaws[swing], rate = float(p[3]), float(v[3])
        reference.sole_rotations = (_about_z(yaws[LEFT]), _about_z(yaws[RIGHT]))
        heading = yaws[LEFT] + 0.5 * math.remainder(yaws[RIGHT] - yaws[LEFT], math.tau)
        turn = _about_z(heading)
        reference.base_rotation, reference.torso_rotation = turn @ self._upright[0], turn @ self._upright[1]
        reference.turn_rate = 0.5 * rate
        self._write_com(reference, t, dcm)

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
