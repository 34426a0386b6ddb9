"""From the next footholds to the plan of ZMP and DCM."""

import math
from collections.abc import Sequence

from controllers.balance.dcm_plan import DcmPlan, ZmpPhase, waypoint
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import Foothold
from controllers.gaits.walking.config import WalkTuning
from controllers.gaits.walking.footsteps import FootstepPlanner, StepLimits
from robots.errors import ConfigError
from robots.messages import Array

LOOKAHEAD = 3
"""Steps that a plan looks ahead: what lies beyond moves its DCM by less than a millimetre until it is made anew."""

CLOSED_DISTANCE, CLOSED_TURN = 0.025, 0.06
"""Feet this close [m, rad] to where a closing step would put them stand side by side."""


class StepPlan:
    """Plans of the DCM for footholds that a planner chooses.

    In single support the ZMP stays at the standing sole's centre, in double support it goes to the next one. A plan
    ends between the feet, at rest: after the step that closes them where the command is not to walk, else after
    ``LOOKAHEAD`` steps.
    """

    def __init__(self, planner: FootstepPlanner, limits: StepLimits, tuning: WalkTuning, omega: float) -> None:
        """``planner`` chooses footholds within ``limits``; times are those of ``tuning``; ``omega``: pendulum [1/s]."""
        self._planner, self._limits = planner, limits
        self._tuning, self._timing = tuning, tuning.timing
        self._omega = omega

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        """The planner's foothold, moved onto the bounds where it lies beyond them.

        Raises:
            ConfigError: it is not finite.
        """
        foothold = self._planner.next_foothold(stance, swing, command)
        if not math.isfinite(foothold.x + foothold.y + foothold.yaw):
            raise ConfigError("foothold of the planner", foothold, "of finite x, y and yaw")
        return self._limits.clamp(stance, foothold, swing)

    def standing(self, middle: Array) -> DcmPlan:
        """At rest at ``middle`` (2,) [m]."""
        return DcmPlan([ZmpPhase(middle, middle, self._tuning.stop_time)], self._omega)

    def to_rest(self, zmp: Array, middle: Array) -> DcmPlan:
        """The ZMP goes from ``zmp`` (2,) to ``middle`` (2,) and stays [m]."""
        return DcmPlan([ZmpPhase(zmp, middle, self._tuning.stop_time)], self._omega)

    def from_lift(
        self, stance: Foothold, swing: int, target: Foothold, single: float, command: VelocityCommand
    ) -> DcmPlan:
        """From the moment that ``swing`` lifts, to land at ``target`` after ``single`` [s]."""
        return DcmPlan(self._phases(stance, swing, target, single, command), self._omega)

    def from_double_support(
        self,
        footholds: Sequence[Foothold],
        swing: int,
        duration: float,
        single: float,
        command: VelocityCommand,
        start: Array | None = None,
    ) -> DcmPlan:
        """From the moment that both feet are down: ``swing`` lifts after ``duration`` and lands ``single`` later [s].

        The ZMP comes from the foot that lifts; or, from standing, from the DCM ``start`` (2,) [m], by way of one more
        point, so that the plan begins with that DCM.
        """
        stance = footholds[1 - swing]
        target = self.next_foothold(stance, swing, command)
        phases = self._phases(stance, swing, target, single, command)
        # after a touchdown the ZMP is under the foot that landed before, where the last plan has left it
        if start is None:
            return DcmPlan([ZmpPhase(footholds[swing].point, stance.point, duration), *phases], self._omega)
        # from standing it is under the DCM, which it has to move to where the step begins with it
        at_lift = DcmPlan(phases, self._omega).evaluate(0.0).position
        half = 0.5 * duration
        middle = waypoint(start, start, stance.point, at_lift, (half, half), self._omega)
        shift = [ZmpPhase(start, middle, half), ZmpPhase(middle, stance.point, half)]
        return DcmPlan([*shift, *phases], self._omega)

    def closed(self, stance: Foothold, foothold: Foothold, foot: int) -> bool:
        """Whether the feet are side by side: a step on the spot would leave ``foot`` at ``foothold``, where it is."""
        would = self.next_foothold(stance, foot, VelocityCommand())
        x, y, yaw = foothold.relative(would)
        return math.hypot(x, y) < CLOSED_DISTANCE and abs(yaw) < CLOSED_TURN

    def _phases(
        self, stance: Foothold, swing: int, target: Foothold, single: float, command: VelocityCommand
    ) -> list[ZmpPhase]:
        tuning, usual = self._tuning, self._timing.single(command.foot_speed(self._limits.width))
        phases = [ZmpPhase(stance.point, stance.point, single)]
        standing, landing, side = stance, target, swing
        for _ in range(LOOKAHEAD):
            # nothing to come after the step that closes the feet: the ZMP goes between them
            if not command.walks and self.closed(standing, landing, side):
                phases.append(ZmpPhase(standing.point, 0.5 * (standing.point + landing.point), tuning.stop_time))
                break
            phases.append(ZmpPhase(standing.point, landing.point, tuning.double_support))
            phases.append(ZmpPhase(landing.point, landing.point, usual))
            standing, side = landing, 1 - side
            landing = self.next_foothold(standing, side, command)
        else:
            # the end of what is looked at, not of the walk: far enough away for how it ends not to matter
            middle = 0.5 * (standing.point + landing.point)
            phases.append(ZmpPhase(standing.point, middle, tuning.double_support))
        return phases
