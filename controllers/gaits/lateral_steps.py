"""Side steps there and back, whose trailing foot is sent to where the other one stands."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.footholds import LEFT, Foothold
from controllers.gaits.walking import Walking, WalkTuning
from controllers.reference import WholeBodyReference
from robots.checks import require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.messages import RobotState


@dataclass(frozen=True, slots=True)
class LateralStepTuning:
    """Side steps of a robot, with the table ``[tuning.lateral_steps]`` of its description.

    Attributes:
        apart: distance of the soles' centres at which the trailing foot is sent down, above 0 [m].
        stride: distance of the soles' centres after the leading foot's step, above ``apart`` [m].
        steps: touchdowns to the left, and then as many to the right, 1 or more.
        single_support: time on one foot, above 0 [s].
        double_support: time on both feet between steps, above 0 [s].
    """

    apart: float
    stride: float
    steps: int = 5
    single_support: float = 0.7
    double_support: float = 0.4

    def __post_init__(self) -> None:
        for name in ("apart", "stride", "single_support", "double_support"):
            require_positive(f"lateral_steps {name}", getattr(self, name))
        if not (isinstance(self.steps, int) and self.steps >= 1):
            raise ConfigError("lateral_steps steps", self.steps, "a whole number, 1 or above")
        if self.stride <= self.apart:
            raise ConfigError("lateral_steps stride", self.stride, f"above apart, which is {self.apart}")


def lateral_step_tuning(robot: RobotDescription) -> LateralStepTuning:
    """The side steps of ``[tuning.lateral_steps]`` in the description.

    Raises:
        DescriptionError: the table, or one of the fields without a default, is missing, or there is an unknown one.
        ConfigError: a value is not allowed.
    """
    table = robot.tuning.get("lateral_steps", {})
    entry, known = "tuning.lateral_steps", dataclasses.fields(LateralStepTuning)
    if not isinstance(table, Mapping):
        raise DescriptionError(robot.file, entry, table, "a table")
    if unknown := sorted(set(table) - {f.name for f in known}):
        raise DescriptionError(robot.file, entry, unknown, "among " + ", ".join(f.name for f in known))
    if missing := [f.name for f in known if f.default is dataclasses.MISSING and f.name not in table]:
        raise DescriptionError(robot.file, f"{entry}: missing", missing, "given: " + ", ".join(missing))
    return LateralStepTuning(**table)


class SideSteps:
    """Footholds straight to the side: the leading foot ``stride`` from the standing one, the trailing foot ``apart``.

    Which foot leads is what the sign of ``command.vy`` says, and nothing else in a command counts; without it the feet
    go side by side.

    Args:
        apart: distance of the soles' centres after a step of the trailing foot [m].
        stride: after a step of the leading foot [m].
        width: side by side [m].
    """

    def __init__(self, apart: float, stride: float, width: float) -> None:
        self._apart, self._stride, self._width = apart, stride, width

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        """See :meth:`controllers.gaits.walking.footsteps.FootstepPlanner.next_foothold`."""
        if command.vy == 0:
            distance = self._width
        else:
            distance = self._stride if (swing == LEFT) == (command.vy > 0) else self._apart
        return stance.compose(0.0, distance if swing == LEFT else -distance, 0.0)


class LateralSteps:
    """Side steps to the left, as many to the right, and a closing step: a gait.

    Nothing here looks at what the safety filter does. Where it keeps a foot from coming down where it was sent, walking
    goes on from where the foot came down, and the next one is sent too close again.

    Args:
        kin: kinematics of the robot standing, both feet down.
        tuning: the steps.
        walk: how to walk; its times and its bounds on the distance of the feet are those of ``tuning``, where its
            ``swing_acceleration`` does not ask for longer times.

    Attributes:
        walking: takes the steps.
    """

    def __init__(self, kin: BodyKinematics, tuning: LateralStepTuning, walk: WalkTuning) -> None:
        width = Feet(kin).width
        # bounds that hold every foothold of the side steps, or walking would move them apart
        self._tuning = tuning
        walk = dataclasses.replace(
            walk,
            single_support=tuning.single_support,
            double_support=tuning.double_support,
            narrowest=min(tuning.apart / width, 1.0),
            widest=max(walk.widest, 1.25 * tuning.stride / width),
        )
        self.walking = Walking(kin, walk, SideSteps(tuning.apart, tuning.stride, width))
        self._speed = (tuning.stride - tuning.apart) / (2.0 * (tuning.single_support + tuning.double_support))

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: BodyKinematics) -> None:
        """See :meth:`controllers.gaits.gait.Gait.apply`."""
        there, done = self._tuning.steps, self.walking.steps
        direction = 1.0 if done < there else -1.0 if done < 2 * there else 0.0
        self.walking.command = VelocityCommand(vy=direction * self._speed)
        self.walking.apply(reference, t, state, kin)

    def stop(self) -> None:
        """See :meth:`controllers.gaits.gait.Gait.stop`."""
        self.walking.stop()
