"""Settings of the whole-body controller: defaults and checks."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from controllers.motion_limits import MotionLimits
from controllers.whole_body.feedforward import TORQUE_MODES
from robots.checks import require_between, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES
from safety.filters import own_parameters
from safety.filters.adaptation import AdaptationTuning
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.recovery import RecoverySettings
from safety.filters.registry import filter_kind
from safety.filters.settings import INFEASIBLE, MetricWeights
from wbc.dynwbc import DynWbcWeights

DRIVES = ("simulation", "hardware")
"""What motor commands may go to."""

HAND_TASKS = ("position", "pose")
"""What of a hand may be a task."""


@dataclass(frozen=True, slots=True)
class TaskTuning:
    """Gains of KinWBC's tasks [1/s] and their bounds, each above 0.

    Attributes:
        foot: pose of the soles.
        com: centre of mass.
        base: orientation of the base.
        torso: orientation of the torso.
        hand: position of the hands, and their orientation where it is a task.
        posture: joint positions.
        max_linear: largest correction of a position task [m/s].
        max_angular: largest correction of an orientation or of the posture task [rad/s].
        hand_acceleration: fastest change of a hand's correction [m/s^2]: what becomes of a target that jumps.
        singular: what is done with small singular values: ``damped``, the velocity is continuous (see
            :mod:`wbc.damped_priorities`), or ``cut``, eq. (13) of Lee et al.
        sigma_min: singular values below it count as zero where they are cut.
        damped_foot: below which singular values of the feet are damped [m/rad; 1 for turning]; in stance they are above
            0.12, with straight knees they fall to 0.
        damped_com: the same of the CoM [1]; its height has 0.04 to 0.06 beside the feet.
        damped_turn: the same of the orientations of base and torso [1].
        damped_hand: the same of the hands [m/rad]; 0.08 is an elbow bent by some 20 degrees.
    """

    foot: float = 10.0
    com: float = 8.0
    base: float = 10.0
    torso: float = 10.0
    hand: float = 10.0
    posture: float = 5.0
    max_linear: float = 0.5
    max_angular: float = 2.0
    hand_acceleration: float = 10.0
    singular: str = "damped"
    sigma_min: float = 0.03
    damped_foot: float = 0.05
    damped_com: float = 0.03
    damped_turn: float = 0.1
    damped_hand: float = 0.08

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if name != "singular":
                require_positive(f"task {name}", getattr(self, name))
        require_one_of("task singular", self.singular, ("damped", "cut"))


def _family(alpha: float, epsilon: float) -> FamilyParameters:
    """Parameters of a family in the whole-body controller.

    The papers' eta (0.5 m/s), slack weight (10) and pushes (0.1, 40) belong to joint velocities that are followed
    exactly and to a cost in which all joints weigh the same. Here motors follow them with torques, and feet, balance
    and hands weigh 100 to 1000 times as much as a joint. Torques rattle where a condition switches at the margin, so
    SSA and its kin have a layer, whose slope eta / layer = 20 1/s is half of DynWBC's velocity gain.
    """
    own = {"eta": 0.1, "layer": 0.005, "slack_weight": 1e4, "push_cartesian": 1.0, "push_joint": 100.0}
    return FamilyParameters(alpha, epsilon, **own)


@dataclass(frozen=True, slots=True)
class FilterTuning:
    """Settings of the safety filter: parameters of each constraint family, bounds and weights.

    Attributes:
        joint_limit: joint limits; at rest ISSf-CBF keeps 1 / (alpha epsilon) [rad].
        self_collision: self-collision, legs apart.
        leg_collision: self-collision of legs.
        obstacle: obstacles.
        workspace: workspace bounds.
        custom: barriers of one's own.
        foot_weight: weight on velocity given to feet on the ground, and on turning one in the air, 0 or above.
        swing_weight: the same for the position of a foot in the air, 0 or above; with 0 it gives way to everything, a
            leg in its way as well as hands that pull. Without ``foot_weight`` it does not count.
        balance_weight: weight on changes of the tasks between feet and hands (CoM, base, torso), 0 or above.
        hand_weight: weight on changes of the hands' tasks, 0 or above.
        velocity_scale: fraction of the joints' velocity limits that may be used, in (0, 1].
        base_linear: bound on the base's linear velocity [m/s].
        base_angular: bound on the base's angular velocity [rad/s].
        recovery_weight: how much leaving a broken barrier weighs against changes of velocity; 0 asks for it without
            bounds, see :mod:`safety.filters.recovery`.
        recovery_acceleration: largest change of the nominal velocity meanwhile [rad/s^2, m/s^2], above 0.
        own: parameters of a filter that brings its own, see :class:`safety.filters.filter_kind.FilterKind`: one
            instance of its dataclass for all families, or instances by family; ``None``: the filter's defaults.
    """

    joint_limit: FamilyParameters = _family(10.0, 10.0)
    self_collision: FamilyParameters = _family(5.0, 2.0)
    leg_collision: FamilyParameters = _family(5.0, 10.0)
    obstacle: FamilyParameters = _family(5.0, 5.0)
    workspace: FamilyParameters = _family(5.0, 5.0)
    custom: FamilyParameters = _family(5.0, 5.0)
    foot_weight: float = 1000.0
    swing_weight: float = 0.0
    balance_weight: float = 1000.0
    hand_weight: float = 100.0
    velocity_scale: float = 0.5
    base_linear: float = 2.0
    base_angular: float = 4.0
    recovery_weight: float = 20.0
    recovery_acceleration: float = 25.0
    own: Any = None

    def __post_init__(self) -> None:
        for name in FAMILIES:
            if not isinstance(getattr(self, name), FamilyParameters):
                raise ConfigError(name, getattr(self, name), "parameters of a constraint family")
        for name in ("foot_weight", "swing_weight", "balance_weight", "hand_weight", "recovery_weight"):
            require_non_negative(name, getattr(self, name))
        for name in ("velocity_scale", "base_linear", "base_angular", "recovery_acceleration"):
            require_positive(name, getattr(self, name))
        require_between("velocity_scale", self.velocity_scale, 0.0, 1.0)
        own_parameters.check_given(self.own)

    def parameters(self) -> BarrierParameters:
        """The families' parameters in the form of the conditions."""
        return BarrierParameters(own=self.own, **{f: getattr(self, f) for f in FAMILIES})

    def weights(self) -> MetricWeights:
        """The weights in the form of the filter."""
        return MetricWeights(self.foot_weight, self.balance_weight, self.hand_weight)

    def velocity_bounds(self, joint_limits: Array) -> Array:
        """Bounds (6 + nj,) on the size of each velocity, for velocity limits (nj,) of the joints [m/s, rad/s]."""
        base = [self.base_linear] * 3, [self.base_angular] * 3
        return np.concatenate([*base, self.velocity_scale * joint_limits])

    def recovery(self) -> RecoverySettings | None:
        """How the filter comes back from behind a barrier; ``None`` for no bounds on it."""
        if self.recovery_weight == 0:
            return None
        return RecoverySettings(self.recovery_weight, self.recovery_acceleration)


@dataclass(frozen=True, slots=True)
class ContactTuning:
    """What the controller assumes of the soles.

    Attributes:
        friction: Coulomb coefficient of the contact wrench cone, above 0.
        length_fraction: fraction of the sole's length in the cone, in (0, 1].
        width_fraction: fraction of the sole's width in the cone, in (0, 1].
    """

    friction: float = 0.6
    length_fraction: float = 0.88
    width_fraction: float = 0.8

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"contact {name}", getattr(self, name))
        for name in ("length_fraction", "width_fraction"):
            require_between(f"contact {name}", getattr(self, name), 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class BalanceTuning:
    """Feedback of the divergent component of motion, where the reference gives one, and the robot's load.

    Attributes:
        dcm_gain: rate at which its error decays, above 0 [1/s].
        mass_time_constant: with which the robot's mass is estimated from measured foot forces; 0 keeps the
            model's [s].
    """

    dcm_gain: float = 4.0
    mass_time_constant: float = 0.0

    def __post_init__(self) -> None:
        require_positive("balance dcm_gain", self.dcm_gain)
        require_non_negative("balance mass_time_constant", self.mass_time_constant)


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """The whole-body controller.

    Attributes:
        dt: control period [s].
        filter: name of the safety filter, as :func:`safety.filters.registry.filter_kind` knows it.
        infeasible: what the filter does where no velocity satisfies its conditions; ``unsafe_pass_nominal`` is for
            comparison with the papers' baselines, in simulation only.
        adaptive: whether epsilon of every row follows the disturbance that reaches it; with the filter ``issf`` only.
        drives: what the commands go to, ``simulation`` or ``hardware``.
        gain_scale: factor on the motors' gains of the description.
        torque: what torque the motors are told besides positions and velocities, see
            :data:`controllers.whole_body.feedforward.TORQUE_MODES`; all but ``full`` are for comparison, in simulation
            only.
        compensate_bias: whether the acceleration that feet and CoM have by their velocities alone (the bias
            acceleration) is taken off their commands; the paper's form does not.
        hand_task: what of the hands is a task, where they are: ``position``, or ``pose``, position and orientation.
        tasks: KinWBC.
        safety: safety filter.
        adaptation: of epsilon, where ``adaptive``.
        contact: soles.
        balance: feedback of the DCM.
        dynwbc: DynWBC.
        dynwbc_solver: QP solver of DynWBC.
        limits: of tilt, height and rate, beyond which the motors only brake.
    """

    dt: float = 0.002
    filter: str = "issf"
    infeasible: str = "least_slack"
    adaptive: bool = False
    drives: str = "simulation"
    gain_scale: float = 1.0
    torque: str = "full"
    compensate_bias: bool = False
    hand_task: str = "position"
    tasks: TaskTuning = field(default_factory=TaskTuning)
    safety: FilterTuning = field(default_factory=FilterTuning)
    adaptation: AdaptationTuning = field(default_factory=AdaptationTuning)
    contact: ContactTuning = field(default_factory=ContactTuning)
    balance: BalanceTuning = field(default_factory=BalanceTuning)
    dynwbc: DynWbcWeights = field(default_factory=DynWbcWeights)
    dynwbc_solver: str = "daqp"
    limits: MotionLimits = field(default_factory=MotionLimits)

    def __post_init__(self) -> None:
        require_between("control dt", self.dt, 1e-4, 0.02)
        require_non_negative("gain_scale", self.gain_scale)
        filter_kind(self.filter).check(self.safety.parameters())
        require_one_of("infeasible", self.infeasible, INFEASIBLE)
        require_one_of("drives", self.drives, DRIVES)
        require_one_of("torque", self.torque, TORQUE_MODES)
        require_one_of("hand_task", self.hand_task, HAND_TASKS)
        if self.adaptive and self.filter != "issf":
            raise ConfigError("filter", self.filter, "issf where epsilon is adaptive: no other filter has one")
        if self.drives == "hardware":
            if self.filter == "none":
                raise ConfigError("filter", self.filter, "a filter where the commands drive hardware")
            if self.infeasible == "unsafe_pass_nominal":
                raise ConfigError("infeasible", self.infeasible, "least_slack where the commands drive hardware")
            if self.torque != "full":
                raise ConfigError("torque", self.torque, "full where the commands drive hardware")
