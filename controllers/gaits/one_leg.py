"""Standing on one leg: the load goes over, the other foot goes up, is held there, and comes down again."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from controllers.gaits.contact_detection import ContactDetector
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.footholds import LEFT
from controllers.motions.quintic import Quintic, quintic
from controllers.reference import PointReference, WholeBodyReference
from robots.checks import require_between, require_non_negative, require_positive
from robots.messages import Array, RobotState
from wbc.wrench import GRAVITY


@dataclass(frozen=True, slots=True)
class OneLegTuning:
    """How a robot stands on one leg; times and height are those of section 5.3.1 of Lee et al.

    Attributes:
        shift_time: in which the CoM goes over the standing foot, above 0 [s].
        ready_error: the foot is not lifted before the measured DCM is this close to the sole's centre, above 0 [m].
        lift_height: by which the foot is lifted, above 0 [m].
        lift_time: in which it goes up, above 0 [s].
        hold_time: for which it stays up, 0 or above [s].
        lower_time: in which it comes down, above 0 [s].
        return_time: in which the load comes back onto both feet, above 0 [s].
        touch_fraction: fraction of the weight that counts as touching the ground, above 0, at most 1.
        late_depth: by which a foot that does not touch in time goes on down at most, 0 or above [m].
        late_time: in which it does so, above 0 [s].
    """

    shift_time: float = 10.0
    ready_error: float = 0.015
    lift_height: float = 0.15
    lift_time: float = 2.0
    hold_time: float = 10.0
    lower_time: float = 2.0
    return_time: float = 4.0
    touch_fraction: float = 0.05
    late_depth: float = 0.05
    late_time: float = 3.0

    def __post_init__(self) -> None:
        positive = ("shift_time", "ready_error", "lift_height", "lift_time", "lower_time", "return_time", "late_time")
        for name in (*positive, "touch_fraction"):
            require_positive(f"taichi {name}", getattr(self, name))
        for name in ("hold_time", "late_depth"):
            require_non_negative(f"taichi {name}", getattr(self, name))
        require_between("taichi touch_fraction", self.touch_fraction, 0.0, 1.0)


LANDING_TIME = 0.3
"""In which the reference of a foot that has touched the ground moves to where the foot is [s]."""


class Phase(Enum):
    """Parts of the sequence, in order."""

    SHIFT = 0
    LIFT = 1
    HOLD = 2
    LOWER = 3
    RETURN = 4


class OneLeg:
    r"""Stands on one leg for a while: a gait.

    The CoM goes over the standing foot on a quintic in time, tracked by the feedback of position and velocity of the
    CoM's task. So slow a path has its ZMP, :math:`c - \ddot c / \omega^2`, within a millimetre of the CoM: "the ZMP
    trajectory was planned to coincide with the CoM trajectory" (Lee et al., section 5.3.1). Feedback of the DCM is no
    better here: the G1 stands the same pushes, and follows the path less closely; TOCABI by centimetres, for its dry
    friction, because an error of the CoM calls for :math:`k \omega`, 15 1/s^2, instead of 320 1/s^2.

    The foot leaves the ground only once the measured DCM, :math:`c + \dot c / \omega`, is over the other one. It is
    down again when its force says so: early in the second half of its way, or later than planned, going on down
    slowly; the load comes back from where it has really landed.

    Attributes:
        phase: of the sequence.
        omega: :math:`\sqrt{g / z}` of the pendulum [1/s].
        return_since: when the load began to come back onto both feet [s]; ``None`` before.
    """

    def __init__(self, kin: BodyKinematics, tuning: OneLegTuning, stance: int = LEFT) -> None:
        """Begin at the state of ``kin``, both feet down and at rest, to stand on ``stance``, ``LEFT`` or ``RIGHT``."""
        self._tuning = tuning
        self._feet = feet = Feet(kin)
        self._stance, self._free = stance, 1 - stance
        self._soles = feet.centres
        self.omega = feet.omega
        self._detector = ContactDetector(tuning.touch_fraction * kin.robot.total_mass * GRAVITY)
        rest = np.zeros(2)
        self._com_path = Quintic((kin.com[:2].copy(), rest, rest), self._soles[stance][:2], tuning.shift_time)
        self._foot_path: Quintic | None = None
        rest3 = np.zeros(3)
        self._late_path = Quintic((rest3, rest3, rest3), np.array([0.0, 0.0, -tuning.late_depth]), tuning.late_time)
        self.phase = Phase.SHIFT
        self.return_since: float | None = None
        self._since = self._com_since = self._foot_since = 0.0
        self._stopped = False

    def stop(self) -> None:
        """See :meth:`controllers.gaits.gait.Gait.stop`."""
        self._stopped = True

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: BodyKinematics) -> None:
        """See :meth:`controllers.gaits.gait.Gait.apply`."""
        self._feet.update(kin)
        self._advance(t, self._touches(t, state), kin)
        self._write(reference, t)

    # -- measurement

    def _touches(self, t: float, state: RobotState) -> bool:
        """Whether the free foot is on the ground: by its force, or where that is not measured, by the clock."""
        contact = self._detector.read(state)
        return t - self._since >= self._tuning.lower_time if contact is None else contact[self._free]

    def _ready(self) -> bool:
        """Whether the measured DCM is over the standing foot."""
        return bool(np.linalg.norm(self._feet.dcm - self._soles[self._stance][:2]) <= self._tuning.ready_error)

    # -- the sequence

    def _advance(self, t: float, touches: bool, kin: BodyKinematics) -> None:
        # times of ticks are rounded: a phase that is to end at a tick ends there
        tuning, elapsed = self._tuning, t - self._since + 1e-9
        if self.phase is Phase.SHIFT:
            # both feet are still down: the load only has to come back
            if self._stopped:
                self._return(t)
            # the clock alone would lift a foot that still carries load where the robot lags behind its reference
            elif elapsed >= tuning.shift_time and self._ready():
                self._move_foot(Phase.LIFT, t)
        elif self.phase is Phase.LIFT:
            # from where the foot is: it need not go up first in order to come down
            if self._stopped:
                self._move_foot(Phase.LOWER, t)
            elif elapsed >= tuning.lift_time:
                self.phase, self._since = Phase.HOLD, t
        elif self.phase is Phase.HOLD:
            if self._stopped or elapsed >= tuning.hold_time:
                self._move_foot(Phase.LOWER, t)
        # in the first half a force is not yet that of the ground: the foot is well above it
        elif self.phase is Phase.LOWER and elapsed >= 0.5 * tuning.lower_time and touches:
            self._land(t, kin)

    def _move_foot(self, phase: Phase, t: float) -> None:
        """Begin to lift or lower the foot, from where its path is now."""
        start = self._foot(t)
        target, duration = self._soles[self._free].copy(), self._tuning.lower_time
        if phase is Phase.LIFT:
            target[2] += self._tuning.lift_height
            duration = self._tuning.lift_time
        self._foot_path = Quintic(start, target, duration)
        self.phase, self._since, self._foot_since = phase, t, t

    def _land(self, t: float, kin: BodyKinematics) -> None:
        """Take the feet as they are; the foot's reference gets there without a jump, which would be one of torques."""
        path = self._foot(t)
        self._feet.latch(kin)
        self._soles = self._feet.centres
        self._foot_path, self._foot_since = Quintic(path, self._soles[self._free], LANDING_TIME), t
        self._return(t)

    def _return(self, t: float) -> None:
        """Bring the CoM between the feet, from where its path is now."""
        here = self._com_path.evaluate(t - self._com_since)
        self._com_path = Quintic(here, self._feet.middle, self._tuning.return_time)
        self.phase, self.return_since, self._since, self._com_since = Phase.RETURN, t, t, t

    # -- references

    def _foot(self, t: float) -> tuple[Array, Array, Array]:
        """Position of the free foot, its rate and second rate, (3,) each."""
        if self._foot_path is None:
            return self._soles[self._free].copy(), np.zeros(3), np.zeros(3)
        elapsed = t - self._foot_since
        position, velocity, acceleration = self._foot_path.evaluate(elapsed)
        late = elapsed - self._tuning.lower_time
        # no ground where it was expected: it is sought slowly, and not without end, for the leg has to bend for it
        if self.phase is Phase.LOWER and late > 0:
            further, velocity, acceleration = self._late_path.evaluate(late)
            position = position + further
        return position.copy(), velocity.copy(), acceleration.copy()

    def _write(self, reference: WholeBodyReference, t: float) -> None:
        for point, sole in zip(reference.soles, self._soles, strict=True):
            point.position, point.velocity, point.acceleration = sole.copy(), np.zeros(3), np.zeros(3)
        free = reference.soles[self._free]
        free.position, free.velocity, free.acceleration = self._foot(t)
        reference.in_contact = np.array([True, True])
        reference.in_contact[self._free] = self.phase in (Phase.SHIFT, Phase.RETURN)
        c, v, a = self._com_path.evaluate(t - self._com_since)
        height = self._feet.com_height + self._soles[self._stance][2]
        reference.com = PointReference(np.array([*c, height]), np.array([*v, 0.0]), np.array([*a, 0.0]))


class HandsThereAndBack:
    """Both hands to targets while the load goes over, and back while it comes back, on quintics in time.

    Args:
        gait: whose times they keep.
        hands: where left and right hand start, (3,) each, world [m].
        targets: where they go [m].
        tuning: of the gait.
    """

    def __init__(
        self, gait: OneLeg, hands: tuple[Array, Array], targets: tuple[Array, Array], tuning: OneLegTuning
    ) -> None:
        self._gait, self._tuning = gait, tuning
        self._hands = hands
        self._displacements = (targets[0] - hands[0], targets[1] - hands[1])

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`controllers.motions.hands.Motion.apply`."""
        fraction, rate, second_rate = quintic(t, self._tuning.shift_time)
        if self._gait.return_since is not None:
            back = quintic(t - self._gait.return_since, self._tuning.return_time)
            fraction, rate, second_rate = fraction - back[0], rate - back[1], second_rate - back[2]
        left, right = (
            PointReference(start + fraction * to_target, rate * to_target, second_rate * to_target)
            for start, to_target in zip(self._hands, self._displacements, strict=True)
        )
        reference.hands = (left, right)
