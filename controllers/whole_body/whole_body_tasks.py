"""The tasks of the whole body, and what a reference sets in them."""

import math
from collections.abc import Sequence

import numpy as np

from controllers.balance.dcm_feedback import clip_to_support, zmp_command
from controllers.reference import WholeBodyReference
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.strategy import MetricJacobians
from controllers.whole_body.task_stack import PlacedTask, Priority, TaskStack
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.task_kernels import ACCELERATION_AT, ANGULAR, POSITION_AT, ROTATION_AT, VELOCITY_AT
from wbc.tasks import (
    CenterOfMassTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    FrameTask,
    PostureTask,
    Task,
    TaskGains,
)

POSITION, ROTATION = slice(POSITION_AT, POSITION_AT + 3), slice(ROTATION_AT, ROTATION_AT + 9)
LINEAR, ACCELERATION = slice(VELOCITY_AT, VELOCITY_AT + 3), slice(ACCELERATION_AT, ACCELERATION_AT + 3)
TURN = slice(VELOCITY_AT + ANGULAR, VELOCITY_AT + ANGULAR + 3)
YAW_RATE, YAW_ACCELERATION = VELOCITY_AT + ANGULAR + 2, ACCELERATION_AT + ANGULAR + 2
"""Places in a frame's references, see :func:`wbc.task_kernels.evaluate_frames`."""

FEET, HANDS = ("left_sole", "right_sole"), ("left_hand", "right_hand")
"""Names of tasks, and of the robot's frames."""

Gains = tuple[TaskGains, TaskGains]
"""Of a task's position and orientation."""


class WholeBodyTasks:
    """Soles; CoM; orientation of the base; orientation of the torso; hands, where they are tasks; posture.

    By name: ``left_sole``, ``right_sole``, ``com``, ``base``, ``torso``, ``left_hand``, ``right_hand``, ``posture``.
    Further ones have a place of their own among them.
    """

    def __init__(
        self,
        kin: Kinematics,
        config: ControllerConfig,
        with_hands: bool,
        half_sizes: Array,
        extra: Sequence[PlacedTask] = (),
    ) -> None:
        """For one robot.

        Args:
            kin: kinematics; references are set, and tasks evaluated, at its state.
            config: gains and the laws they go through.
            with_hands: whether the hands are tasks.
            half_sizes: shape (2, 2) half length and half width of each sole that the ZMP may use [m].
            extra: further tasks.

        Raises:
            ConfigError: a further task has the name of another one.
        """
        self._kin, self._config, self._half_sizes = kin, config, half_sizes.tolist()
        self._with_hands, self._posed = with_hands, with_hands and config.hand_task == "pose"
        standard = _standard_tasks(kin, config, with_hands)
        t = config.tasks
        self._stack = TaskStack(kin.nv, [*standard, *extra], t.sigma_min, t.singular == "damped")
        self._own = {p.task.name: p.task for p in extra}
        self._compensates = any(p.task.compensate_bias for p in (*standard, *extra))
        tasks = {p.task.name: p.task for p in standard}
        self._com, self._posture = tasks["com"], tasks["posture"]
        # the same views in every tick, unless a further task stands between those of a role
        self._jacobians: MetricJacobians | None = None
        if all(self._stack.is_contiguous(role) for role in ("feet", "balance", "hands")):
            self._jacobians = self.jacobians()
        # the CoM's target under the feedback of the DCM
        self._pendulum = np.zeros(3), np.zeros(3), np.zeros(3)
        # written as they are: every tick sets them all
        rows = {name: task.references for name, task in tasks.items() if isinstance(task, FrameTask)}
        self._foot_rows = [rows[name] for name in FEET]
        self._turn_rows = [rows[name] for name in ("base", "torso")]
        self._hand_rows = [rows[name] for name in HANDS] if with_hands else []

    @property
    def stack(self) -> TaskStack:
        """The tasks by name."""
        return self._stack

    @property
    def with_hands(self) -> bool:
        """Whether the hands are tasks."""
        return self._with_hands

    @property
    def compensates_bias(self) -> bool:
        """Whether the kinematics' bias accelerations are needed."""
        return self._compensates

    def jacobians(self) -> MetricJacobians:
        """What the filter is to leave alone, as evaluated last."""
        if self._jacobians is not None:
            return self._jacobians
        feet, balance = self._stack.rows("feet"), self._stack.rows("balance")
        assert feet is not None and balance is not None
        return MetricJacobians(feet, balance, self._stack.rows("hands"))

    def set_gains(self, config: ControllerConfig) -> None:
        """Take over the gains, bounds and thresholds of a configuration; those of further tasks stay."""
        self._config = config
        for name, (gains, turn) in _gains(config).items():
            if name not in self._stack:
                continue
            task = self._stack[name]
            if isinstance(task, FrameTask):
                task.set_gains(gains, turn)
            else:
                task.set_gains(gains)
        known = {name: below for name, below in _damped_below(config).items() if name in self._stack}
        self._stack.set_singular(config.tasks.sigma_min, config.tasks.singular == "damped", known)

    def set_references(self, reference: WholeBodyReference) -> None:
        """Take over what a reference asks for now.

        Raises:
            ValueError: it gives no hands, or no rotations of theirs, although they are tasks, or a target of a further
                task that there is none of, or in another shape.
        """
        for i, row in enumerate(self._foot_rows):
            point = reference.soles[i]
            row[POSITION], row[LINEAR], row[ACCELERATION] = point.position, point.velocity, point.acceleration
            row[ROTATION] = reference.sole_rotations[i].ravel()
            row[YAW_RATE], row[YAW_ACCELERATION] = reference.sole_turns[i]
        self._set_com(reference)
        for row, rotation in zip(self._turn_rows, (reference.base_rotation, reference.torso_rotation), strict=True):
            row[ROTATION], row[YAW_RATE] = rotation.ravel(), reference.turn_rate
        self._posture.set_target(reference.joints)
        if self._with_hands:
            self._set_hands(reference)
        for name, target in reference.extra.items():
            if name not in self._own:
                raise ValueError(f"the reference has a target of task {name!r}, which this controller has not")
            self._own[name].set_target(*target)

    def _set_hands(self, reference: WholeBodyReference) -> None:
        if reference.hands is None:
            raise ValueError("the hands are tasks of this controller, but the reference gives none")
        for row, point in zip(self._hand_rows, reference.hands, strict=True):
            row[POSITION], row[LINEAR], row[ACCELERATION] = point.position, point.velocity, point.acceleration
        if not self._posed:
            return
        if reference.hand_rotations is None:
            raise ValueError("the hands' poses are tasks of this controller, but the reference gives no rotations")
        for i, row in enumerate(self._hand_rows):
            row[ROTATION], row[TURN] = reference.hand_rotations[i].ravel(), reference.hand_turns[i]

    def _set_com(self, reference: WholeBodyReference) -> None:
        """The CoM's task: its own reference, or horizontally what the feedback of the DCM asks for."""
        point, dcm = reference.com, reference.dcm
        if dcm is None:
            self._com.set_target(point.position, point.velocity, point.acceleration)
            return
        kin, gains = self._kin, self._config.dynwbc
        zmp = zmp_command(kin.com[:2] + kin.com_velocity[:2] / dcm.omega, dcm, self._config.balance.dcm_gain)
        centres = [p.position[:2].tolist() for p in reference.soles]
        yaws = [math.atan2(r[1, 0], r[0, 0]) for r in reference.sole_rotations]
        zmp = clip_to_support(zmp, centres, yaws, self._half_sizes, reference.in_contact, reference.load_limits)
        (x, y, _), (vx, vy, _), squared = kin.com.tolist(), kin.com_velocity.tolist(), dcm.omega**2
        # eq. (15) turns this velocity into exactly the acceleration of the pendulum
        fraction = gains.kd / (gains.kd + gains.kp * self._config.dt)
        position, velocity, acceleration = self._pendulum
        position[0], position[1], position[2] = x, y, point.position[2]
        velocity[0], velocity[1], velocity[2] = fraction * vx, fraction * vy, point.velocity[2]
        acceleration[0], acceleration[1] = squared * (x - zmp[0]), squared * (y - zmp[1])
        acceleration[2] = point.acceleration[2]
        self._com.set_target(position, velocity, acceleration)


def _standard_tasks(kin: Kinematics, config: ControllerConfig, with_hands: bool) -> list[PlacedTask]:
    """The tasks that every robot has, feet first."""
    gains, below = _gains(config), _damped_below(config)
    frame = {role: kin.frame_id(name) for role, name in kin.robot.roles.items()}
    biased = config.compensate_bias

    def placed(task: Task, role: str, priority: Priority) -> PlacedTask:
        return PlacedTask(task, role, priority, below[task.name])

    out = [
        placed(FramePoseTask(frame[n], *gains[n], name=n, compensate_bias=biased), "feet", Priority.FEET) for n in FEET
    ]
    com = CenterOfMassTask(gains["com"][0], name="com", compensate_bias=biased)
    out.append(placed(com, "balance", Priority.COM))
    for name, priority in (("base", Priority.BASE), ("torso", Priority.TORSO)):
        out.append(placed(FrameOrientationTask(frame[name], *gains[name], name=name), "balance", priority))
    if with_hands:
        kind = FramePoseTask if config.hand_task == "pose" else FramePositionTask
        out += [placed(kind(frame[n], *gains[n], name=n), "hands", Priority.HANDS) for n in HANDS]
    posture = PostureTask(len(kin.joint_names), gains["posture"][0], name="posture")
    return [*out, placed(posture, "other", Priority.POSTURE)]


def _gains(config: ControllerConfig) -> dict[str, Gains]:
    """Gains of position and orientation of each task, by its name."""
    t, rate = config.tasks, config.dynwbc.kd + config.dynwbc.kp * config.dt
    linear = {k: TaskGains(getattr(t, k), t.max_linear, rate) for k in ("foot", "com")}
    angular = {k: TaskGains(getattr(t, k), t.max_angular, rate) for k in ("foot", "base", "torso", "hand", "posture")}
    hand = TaskGains(t.hand, t.max_linear, rate, t.hand_acceleration * config.dt)
    out = dict.fromkeys(FEET, (linear["foot"], angular["foot"])) | dict.fromkeys(HANDS, (hand, angular["hand"]))
    out["com"] = linear["com"], linear["com"]
    return out | {name: (angular[name], angular[name]) for name in ("base", "torso", "posture")}


def _damped_below(config: ControllerConfig) -> dict[str, float]:
    """Threshold of each task's singular values, by its name."""
    t = config.tasks
    turns = dict.fromkeys(("base", "torso", "posture"), t.damped_turn)
    return turns | dict.fromkeys(FEET, t.damped_foot) | dict.fromkeys(HANDS, t.damped_hand) | {"com": t.damped_com}
