"""Velocities of frames by pinocchio itself, to compare with."""

import pinocchio as pin

from robots.kinematics import Kinematics
from robots.messages import Array


def frame_velocity(kin: Kinematics, frame_id: int) -> Array:
    """Velocity (6,) of a frame: of its origin [m/s], then angular [rad/s], world axes."""
    velocity = pin.getFrameVelocity(kin.model, kin.data, frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return velocity.vector.copy()
