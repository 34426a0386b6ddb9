"""Settings of walking, with the tables ``[tuning.walking]`` of robot descriptions."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.walking.footsteps import StepLimits
from controllers.gaits.walking.timing import StepTiming
from controllers.whole_body.robot_config import controller_config, from_table
from robots.checks import require_between, require_non_negative, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError

POSITIVE = (
    "single_support",
    "double_support",
    "start_time",
    "stop_time",
    "speed_change",
    "turn_change",
    "load_transfer_time",
    "frozen_time",
    "shortest_step",
    "catch_time",
    "catch_error",
    "wait_shift",
    "step_height",
    "swing_acceleration",
    "force_weight",
    "moment_weight",
    "load_estimate_time",
    "forward",
    "turn",
    "touch_speed",
)
"""Fields of :class:`WalkTuning` that have to be above 0."""


@dataclass(frozen=True, slots=True)
class WalkTuning:
    """How a robot walks.

    Attributes:
        single_support: time on one foot, above 0 [s]; longer in fast walking, by ``swing_acceleration``.
        double_support: time on both feet between steps, above 0 [s].
        start_time: time of the first double support, from standing, above 0 [s].
        step_height: by which a foot is lifted, above 0 [m].
        swing_acceleration: largest horizontal acceleration of a foot on its planned path, as long as no disturbance
            moves its foothold, above 0 [m/s^2].
        forward: longest step forward or back [m].
        narrowest: smallest distance of the feet, as a fraction of that in the standing posture, in (0, 1].
        widest: largest, as a fraction of it, 1 or above.
        turn: largest turn of one foot against the other [rad].
        load_transfer_time: in which a foot takes on and gives up its load, above 0 [s].
        speed_change: largest change of the commanded speed from one step to the next, above 0 [m/s].
        turn_change: largest change of the commanded turning from one step to the next, above 0 [rad/s].
        stop_time: time of the last double support, into standing, above 0 [s].
        zmp_fraction: part of the sole that the ZMP may use against a disturbance before the foothold moves, in [0, 1].
        frozen_time: before a landing in which neither its place nor its time change any more, above 0 [s].
        shortest_step: shortest time on one foot, where a disturbance asks for a quick step, above 0 [s].
        catch_error: error of the DCM from which, if it lies outside the feet as well, a step is made at once, above
            0 [m].
        catch_time: time of the double support before a step that catches a robot pushed in standing, above 0 [s].
        wait_limit: longest wait in double support for a disturbance to decay [s].
        wait_shift: shift of the next foothold from which on a disturbance keeps a foot from lifting, above 0 [m].
        touch_fraction: part of the weight that counts as touching the ground, in (0, 1].
        late_limit: longest wait for a foot that does not touch in time [s].
        touch_speed: downward speed at which a foot comes to the ground, and goes on down where there is none yet,
            above 0 [m/s].
        touch_depth: below the other sole at which the path of a foot ends, for it to be on the ground in time although
            it lags, 0 or above [m].
        gain_scale: factor on the motors' gains of the description while walking, 0 or above.
        force_weight: weight of DynWBC on the reference forces while walking, above 0 [1/N^2].
        moment_weight: on the reference moments, above 0 [1/(N m)^2]: the reference knows nothing of the moment that a
            swinging leg asks for, and weighed as in standing it makes the foot miss its place by a centimetre.
        load_estimate_time: time constant with which the robot's mass is estimated, above 0 [s].
    """

    single_support: float = 0.6
    double_support: float = 0.2
    start_time: float = 0.8
    step_height: float = 0.06
    swing_acceleration: float = 11.0
    forward: float = 0.35
    narrowest: float = 0.42
    widest: float = 1.8
    turn: float = 0.4
    load_transfer_time: float = 0.06
    speed_change: float = 0.15
    turn_change: float = 0.2
    stop_time: float = 0.4
    zmp_fraction: float = 0.7
    frozen_time: float = 0.12
    shortest_step: float = 0.25
    catch_error: float = 0.04
    catch_time: float = 0.15
    wait_limit: float = 0.5
    wait_shift: float = 0.1
    touch_fraction: float = 0.05
    late_limit: float = 0.15
    touch_speed: float = 0.1
    touch_depth: float = 0.0
    gain_scale: float = 0.5
    force_weight: float = 1e-3
    moment_weight: float = 1e-2
    load_estimate_time: float = 1.0

    def __post_init__(self) -> None:
        for name in POSITIVE:
            require_positive(f"walking {name}", getattr(self, name))
        if self.load_transfer_time > 0.5 * self.double_support:
            allowed = f"at most half of double_support, {self.double_support:g} s"
            raise ConfigError("walking load_transfer_time", self.load_transfer_time, allowed)
        for name in ("late_limit", "wait_limit", "touch_depth", "gain_scale"):
            require_non_negative(f"walking {name}", getattr(self, name))
        require_positive("walking touch_fraction", self.touch_fraction)
        for name in ("zmp_fraction", "touch_fraction"):
            require_between(f"walking {name}", getattr(self, name), 0.0, 1.0)
        require_between("walking narrowest", self.narrowest, 0.1, 1.0)
        require_between("walking widest", self.widest, 1.0, 5.0)

    @property
    def timing(self) -> StepTiming:
        """How long a step takes at each velocity."""
        return StepTiming(self.single_support, self.double_support, self.swing_acceleration)

    def limits(self, width: float) -> StepLimits:
        """Bounds of footholds for feet that stand ``width`` apart [m]."""
        return StepLimits(width, self.forward, self.narrowest * width, self.widest * width, self.turn)

    def fastest(self, width: float) -> VelocityCommand:
        """Largest velocity in each direction alone that the bounds of footholds allow, feet ``width`` apart [m]."""
        timing, half = self.timing, 0.5 * width
        turning = timing.speed(half * self.turn) / half
        return VelocityCommand(timing.speed(self.forward), timing.speed(self._sideways(width)), turning)

    def require_reachable(self, command: VelocityCommand, width: float) -> None:
        """Check that the longest steps are long enough for a command, feet ``width`` apart [m].

        Raises:
            ConfigError: they are not; names the velocity that is too large, alone or beside the others.
        """
        fastest = self.fastest(width)
        for name in ("vx", "vy", "wz"):
            alone = getattr(fastest, name)
            require_between(name, getattr(command, name), -alone, alone)
        if name := self._too_far(command, width):
            # the largest part of the whole command that is within reach, to a hundredth
            percent = max(i for i in range(100) if not self._too_far(command.scaled(0.01 * i), width))
            allowed = (
                f"smaller beside the other velocities: fast steps take longer; {percent} % of each are within reach"
            )
            raise ConfigError(name, getattr(command, name), allowed)

    def _too_far(self, command: VelocityCommand, width: float) -> str:
        """Name of the velocity for which steps at a command would have to be longer than they can be, or nothing."""
        period = self.timing.period(command.foot_speed(width))
        longest = {"vx": self.forward, "vy": self._sideways(width), "wz": self.turn}
        # the fastest velocity makes exactly the longest step, but for rounding
        return next((n for n, most in longest.items() if abs(getattr(command, n)) * period > most * (1.0 + 1e-9)), "")

    def _sideways(self, width: float) -> float:
        """Distance to the side that a step can make on average [m]."""
        # in widths, at v per step: the leading foot lands 1 + v from the other one; or narrowest + 2 v, where the
        # trailing one stops at the narrowest
        return width * min(self.widest - 1.0, 0.5 * (self.widest - self.narrowest))


def walk_tuning(robot: RobotDescription) -> WalkTuning:
    """How a robot walks: the defaults, then the table ``[tuning.walking]`` of its description.

    Raises:
        DescriptionError: the table has an unknown field.
        ConfigError: a value is not allowed.
    """
    return from_table(WalkTuning, robot, "walking")


def walking_changes(robot: RobotDescription, load_estimate: bool = True) -> dict[str, Any]:
    """Fields of the controller's configuration that walking sets.

    They are for :func:`controllers.whole_body.robot_config.controller_config`.

    Args:
        robot: the description.
        load_estimate: whether the controller's model follows the forces under the feet.

    Raises:
        SafeWbcError: a table of the description has an unknown field, or a value that is not allowed.
    """
    tuning, base = walk_tuning(robot), controller_config(robot)
    return {
        "gain_scale": tuning.gain_scale,
        "compensate_bias": True,
        "balance": dataclasses.replace(
            base.balance, mass_time_constant=tuning.load_estimate_time if load_estimate else 0.0
        ),
        "dynwbc": dataclasses.replace(base.dynwbc, force=tuning.force_weight, moment=tuning.moment_weight),
    }
