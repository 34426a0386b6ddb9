"""Settings of walking, with the tables ``[tuning.walking]`` of robot descriptions."""

from dataclasses import dataclass

from controllers.footsteps import StepLimits
from robots.checks import require_between, require_non_negative, require_positive
from robots.errors import ConfigError


@dataclass(frozen=True, slots=True)
class WalkTuning:
    """How a robot walks.

    Attributes:
        single_support: time on one foot, above 0 [s].
        double_support: time on both feet between steps, above 0 [s].
        start_time: time of the first double support, from standing, above 0 [s].
        step_height: by which a foot is lifted, above 0 [m].
        forward: longest step forward or back [m].
        narrowest: smallest distance of the feet, as a share of that in the standing posture, in (0, 1].
        widest: largest, as a share of it, 1 or above.
        turn: largest turn of one foot against the other [rad].
        adjust_margin: forward and sideways error of the DCM that is left to the ZMP before a foothold moves [m].
        frozen_share: share of the single support at its end in which the foothold stays.
        touch_share: share of the weight that counts as touching the ground.
        late_limit: longest wait for a foot that does not touch in time [s].
        late_speed: at which it goes on down [m/s].
    """

    single_support: float = 0.6
    double_support: float = 0.2
    start_time: float = 0.8
    step_height: float = 0.06
    forward: float = 0.35
    narrowest: float = 0.6
    widest: float = 1.8
    turn: float = 0.4
    adjust_margin: tuple[float, float] = (0.04, 0.015)
    frozen_share: float = 0.25
    touch_share: float = 0.05
    late_limit: float = 0.15
    late_speed: float = 0.15

    def __post_init__(self) -> None:
        positive = ("single_support", "double_support", "start_time", "step_height", "forward", "turn", "late_speed")
        for name in positive:
            require_positive(f"walking {name}", getattr(self, name))
        require_non_negative("walking late_limit", self.late_limit)
        for name in ("frozen_share", "touch_share"):
            require_between(f"walking {name}", getattr(self, name), 0.0, 1.0)
        require_between("walking narrowest", self.narrowest, 0.1, 1.0)
        require_between("walking widest", self.widest, 1.0, 5.0)
        if len(self.adjust_margin) != 2:
            raise ConfigError("walking adjust_margin", self.adjust_margin, "two numbers: forward and sideways")
        for value in self.adjust_margin:
            require_non_negative("walking adjust_margin", value)

    @property
    def period(self) -> float:
        """Time of one step [s]."""
        return self.single_support + self.double_support

    def limits(self, width: float) -> StepLimits:
        """Bounds of footholds for feet that stand ``width`` apart [m]."""
        return StepLimits(width, self.forward, self.narrowest * width, self.widest * width, self.turn)
