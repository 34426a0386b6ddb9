"""The tasks of KinWBC in their order of priority, and what a reference sets in them."""

import math

import numpy as np

from controllers.balance.dcm_feedback import clip_to_support, zmp_command
from controllers.reference import WholeBodyReference
from controllers.whole_body.config import ControllerConfig
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.kinwbc import KinWbc
from wbc.task_kernels import ACCELERATION_AT, ANGULAR, POSITION_AT, ROTATION_AT, VELOCITY_AT
from wbc.tasks import (
    CenterOfMassTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    PostureTask,
    Task,
    TaskGains,
)

POSITION, ROTATION = slice(POSITION_AT, POSITION_AT + 3), slice(ROTATION_AT, ROTATION_AT + 9)
LINEAR, ACCELERATION = slice(VELOCITY_AT, VELOCITY_AT + 3), slice(ACCELERATION_AT, ACCELERATION_AT + 3)
YAW_RATE, YAW_ACCELERATION = VELOCITY_AT + ANGULAR + 2, ACCELERATION_AT + ANGULAR + 2
"""Places in a frame's references, see :func:`wbc.task_kernels.evaluate_frames`."""


class TaskStack:
    """Soles; CoM; orientation of the base; orientation of the torso; hands, where they are tasks; posture.

    Attributes:
        kinwbc: the solver, with the tasks in their levels.
        with_hands: whether the hands are tasks.
    """

    def __init__(self, kin: Kinematics, config: ControllerConfig, with_hands: bool, half_sizes: Array) -> None:
        """For one robot.

        Args:
            kin: kinematics; references are set, and tasks evaluated, at its state.
            config: gains and the laws they go through.
            with_hands: whether the hands are tasks.
            half_sizes: shape (2, 2) half length and half width of each sole that the ZMP may use [m].
        """
        self._kin, self._config, self._half_sizes = kin, config, half_sizes.tolist()
        self.with_hands = with_hands
        t, roles = config.tasks, kin.robot.roles
        rate = config.dynwbc.kd + config.dynwbc.kp * config.dt
        linear = {k: TaskGains(getattr(t, k), t.max_linear, rate) for k in ("foot", "com")}
        hand = TaskGains(t.hand, t.max_linear, rate, t.hand_acceleration * config.dt)
        angular = {k: TaskGains(getattr(t, k), t.max_angular, rate) for k in ("base", "torso", "posture")}
        foot_turn = TaskGains(t.foot, t.max_angular, rate)
        self._feet = [
            FramePoseTask(kin.frame_id(roles[r]), linear["foot"], foot_turn) for r in ("left_sole", "right_sole")
        ]
        self._com = CenterOfMassTask(linear["com"])
        self._base = FrameOrientationTask(kin.frame_id(roles["base"]), angular["base"])
        self._torso = FrameOrientationTask(kin.frame_id(roles["torso"]), angular["torso"])
        self._hands = [FramePositionTask(kin.frame_id(roles[r]), hand) for r in ("left_hand", "right_hand")]
        self._posture = PostureTask(len(kin.joint_names), angular["posture"])
        levels: list[list[Task]] = [[*self._feet], [self._com], [self._base], [self._torso]]
        damped = [t.damped_foot, t.damped_com, t.damped_turn, t.damped_turn]
        if with_hands:
            levels.append([*self._hands])
            damped.append(t.damped_hand)
        levels.append([self._posture])
        for task in (*self._feet, self._com):
            task.without_drift = config.without_drift
        thresholds = [*damped, t.damped_turn] if t.singular == "damped" else None
        self.kinwbc = KinWbc(kin.nv, levels, t.sigma_min, thresholds)
        # written as they are: every tick sets them all
        self._foot_rows = [task.references for task in self._feet]
        self._turn_rows = [task.references for task in (self._base, self._torso)]
        self._hand_rows = [task.references for task in self._hands]

    def set_references(self, reference: WholeBodyReference) -> None:
        """Take over what a reference asks for now.

        Raises:
            ValueError: it gives no hands although they are tasks.
        """
        for i, row in enumerate(self._foot_rows):
            point = reference.soles[i]
            row[POSITION], row[LINEAR], row[ACCELERATION] = point.position, point.velocity, point.acceleration
            row[ROTATION] = reference.sole_rotations[i].ravel()
            row[YAW_RATE], row[YAW_ACCELERATION] = reference.sole_turns[i]
        self._set_com(reference)
        for row, rotation in zip(self._turn_rows, (reference.base_rotation, reference.torso_rotation), strict=True):
            row[ROTATION], row[YAW_RATE] = rotation.ravel(), reference.turn_rate
        self._posture.joints = reference.joints
        if reference.hands is None and self.with_hands:
            raise ValueError("the hands are tasks of this controller, but the reference gives none")
        if reference.hands is not None:
            for row, point in zip(self._hand_rows, reference.hands, strict=True):
                row[POSITION], row[LINEAR], row[ACCELERATION] = point.position, point.velocity, point.acceleration

    def _set_com(self, reference: WholeBodyReference) -> None:
        """The CoM's task: its own reference, or horizontally what the feedback of the DCM asks for."""
        point, dcm, task = reference.com, reference.dcm, self._com
        task.position, task.velocity, task.acceleration = point.position, point.velocity, point.acceleration
        if dcm is None:
            return
        kin, gains = self._kin, self._config.dynwbc
        zmp = zmp_command(kin.com[:2] + kin.com_velocity[:2] / dcm.omega, dcm, self._config.balance.dcm_gain)
        centres = [p.position[:2].tolist() for p in reference.soles]
        yaws = [math.atan2(r[1, 0], r[0, 0]) for r in reference.sole_rotations]
        zmp = clip_to_support(zmp, centres, yaws, self._half_sizes, reference.in_contact, reference.load_limits)
        (x, y, _), (vx, vy, _), squared = kin.com.tolist(), kin.com_velocity.tolist(), dcm.omega**2
        # eq. (15) turns this velocity into exactly the acceleration of the pendulum
        share = gains.kd / (gains.kd + gains.kp * self._config.dt)
        task.position = np.array([x, y, point.position[2]])
        task.velocity = np.array([share * vx, share * vy, point.velocity[2]])
        task.acceleration = np.array([squared * (x - zmp[0]), squared * (y - zmp[1]), point.acceleration[2]])
