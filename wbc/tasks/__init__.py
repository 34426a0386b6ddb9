"""Operational-space tasks of KinWBC: a Jacobian and a commanded task velocity each.

Example:
    The left hand to a point 10 cm above where it is::

        hand = FramePositionTask(kin.frame_id("left_palm"), TaskGains(k=10.0, max_correction=0.5), name="left hand")
        hand.set_target(kin.frame_placement(hand.frame_id)[1] + [0.0, 0.0, 0.1])
        kinwbc = KinWbc(kin.nv, [[hand]])
        velocity = kinwbc.solve(kinwbc.evaluate(kin))
"""

from wbc.tasks.center_of_mass import CenterOfMassTask
from wbc.tasks.frames import FrameOrientationTask, FramePoseTask, FramePositionTask, FrameTask
from wbc.tasks.posture import PostureTask
from wbc.tasks.task import Task, TaskGains

__all__ = [
    "CenterOfMassTask",
    "FrameOrientationTask",
    "FramePoseTask",
    "FramePositionTask",
    "FrameTask",
    "PostureTask",
    "Task",
    "TaskGains",
]
