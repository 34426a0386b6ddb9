"""Walking on command: when each foot lifts and comes down."""

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.contact_detection import ContactDetector
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.walking.adjustment import StepAdjustment
from controllers.gaits.walking.config import WalkTuning
from controllers.gaits.walking.footsteps import FootstepPlanner, VelocityFootsteps
from controllers.gaits.walking.phases import DoubleSupport, Phase, SingleSupport, Standing, Support
from controllers.gaits.walking.plan import StepPlan
from controllers.gaits.walking.references import WalkingReferences
from controllers.gaits.walking.transitions import (
    WalkRules,
    adjust_step,
    has_landed,
    leave_double_support,
    leave_standing,
    touch_down,
)
from controllers.reference import WholeBodyReference
from robots.description import RobotDescription
from robots.messages import RobotState
from wbc.wrench import GRAVITY


class Walking:
    """Walks as commanded: a gait.

    Single and double support follow each other. Footholds are chosen when a foot lifts; under a disturbance they, and
    the time of touchdown, move with the DCM. The plan is made anew at every touchdown, from where the feet then really
    are, and at every lift-off.

    A foot that touches the ground in the second half of its way ends its step early; one that does not touch in time
    goes on down. A foot does not lift while the DCM's error would ask for another foothold at once: both feet take the
    error back better than one. Where the DCM has left the feet, standing or in double support, a step is made at once.

    What each phase knows is in :mod:`controllers.gaits.walking.phases`, how one becomes the next in
    :mod:`controllers.gaits.walking.transitions`.

    Args:
        kin: kinematics of the robot standing, both feet down.
        tuning: how it walks.
        planner: chooses footholds; those that follow the velocity if not given.

    Attributes:
        limits: bounds of footholds, of those that the planner chooses and of those that a disturbance moves.
        steps: number of touchdowns so far.
    """

    def __init__(self, kin: BodyKinematics, tuning: WalkTuning, planner: FootstepPlanner | None = None) -> None:
        self._feet = feet = Feet(kin)
        self._rules = _rules(kin.robot, tuning, feet, planner)
        self.limits = self._rules.limits
        self._references = WalkingReferences(kin, feet)
        self._detector = ContactDetector(tuning.touch_fraction * kin.robot.total_mass * GRAVITY)
        self._command = VelocityCommand()
        self._stopped = False
        self._time = 0.0
        self._phase: Phase = Standing(0.0, self._rules.plans.standing(feet.middle))
        self.steps = 0

    @property
    def command(self) -> VelocityCommand:
        """Velocity of the body; may be set at any time, and the next step follows it; ignored after a stop.

        From one step to the next the velocity changes by no more than the tuning's ``speed_change``, ``turn_change``.
        """
        return self._command

    @command.setter
    def command(self, command: VelocityCommand) -> None:
        if not self._stopped:
            self._command = command

    @property
    def support(self) -> Support:
        """What the robot stands on, by plan."""
        return self._phase.support

    def stop(self) -> None:
        """See :meth:`controllers.gaits.gait.Gait.stop`."""
        self._stopped = True
        self._command = VelocityCommand()

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: BodyKinematics) -> None:
        """See :meth:`controllers.gaits.gait.Gait.apply`."""
        self._feet.update(kin)
        phase, swing = self._next_phase(t, state, kin), None
        if isinstance(phase, SingleSupport):
            phase = adjust_step(self._rules, phase, self._feet, t)
            swing = phase.swing, phase.path.evaluate(t - phase.since)
        limits = phase.load_limits(t, self._rules.tuning.load_transfer_time)
        self._references.write(reference, t, phase.dcm(t), self._feet, swing, limits)
        self._phase, self._time = phase, t

    def _next_phase(self, t: float, state: RobotState, kin: BodyKinematics) -> Phase:
        """The phase of this tick: another one when it is time, or when the feet or the DCM say so."""
        rules, phase, feet = self._rules, self._phase, self._feet
        # in every phase: a foot counts as touching only after some ticks
        contact = self._detector.read(state)
        if isinstance(phase, Standing):
            return leave_standing(rules, phase, feet, t, self._command)
        if isinstance(phase, DoubleSupport):
            return leave_double_support(rules, phase, feet, t, t - self._time)
        if not has_landed(rules, phase, t, None if contact is None else contact[phase.swing]):
            return phase
        feet.latch(kin)
        self.steps += 1
        return touch_down(rules, phase, feet, t, self._command)


def _rules(robot: RobotDescription, tuning: WalkTuning, feet: Feet, planner: FootstepPlanner | None) -> WalkRules:
    """The rules of a walk that begins with the feet as they are."""
    limits = tuning.limits(feet.width)
    plans = StepPlan(planner or VelocityFootsteps(limits, tuning.timing), limits, tuning, feet.omega)
    left, right = ((tuning.zmp_fraction * s.half_length, tuning.zmp_fraction * s.half_width) for s in robot.soles)
    adjustment = StepAdjustment(limits, feet.omega, left, tuning.double_support)
    return WalkRules(tuning, limits, plans, adjustment, (left, right))
