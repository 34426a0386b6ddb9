"""States of robots: what tests start from."""

import numpy as np

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration


def random_state(kin: Kinematics, seed: int | np.random.Generator) -> tuple[Array, Array]:
    """Configuration and velocity: joints within their limits, any pose of the base, all velocities."""
    rng = np.random.default_rng(seed)
    quaternion, joints = rng.normal(size=4), rng.uniform(*kin.position_limits)
    if kin.base == "floating":
        base = np.concatenate([rng.normal(size=3), quaternion / np.linalg.norm(quaternion)])
    elif kin.base == "planar":
        base = np.concatenate([rng.normal(size=2), quaternion[:2] / np.linalg.norm(quaternion[:2])])
    else:
        base = np.empty(0)
    return np.concatenate([base, joints]), rng.normal(size=kin.nv)


def at_rest(robot: RobotDescription, posture: str = "standing", stamp: float = 0.0) -> RobotState:
    """A robot in a named posture that does not move; forces of the feet are not measured."""
    nj = len(robot.joints)
    return RobotState(standing_configuration(robot, posture), np.zeros(6 + nj), np.zeros(nj), stamp)


def kinematics_of(robot: RobotDescription, state: RobotState) -> Kinematics:
    """Kinematics at a state."""
    kin = Kinematics(robot)
    kin.update(state.q, state.v)
    return kin
