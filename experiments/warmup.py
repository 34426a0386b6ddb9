"""Compiles the kernels before anything is timed or a person waits for it unawares."""

import numpy as np
from rich.console import Console

from controllers.config import controller_config
from controllers.reference import reference_here
from controllers.whole_body import WholeBodyController
from robots.description import RobotDescription
from robots.messages import RobotState
from robots.pinocchio_model import standing_configuration
from safety.obstacles import Obstacle


def warm_up(console: Console, robot: RobotDescription) -> None:
    """Run one tick of the controller, which compiles every kernel; later runs find them in numba's cache."""
    with console.status("preparing (the first run compiles its kernels, which takes some 10 seconds)"):
        controller = WholeBodyController(robot, controller_config(robot), with_hands=True, obstacle_kinds=("sphere",))
        q = standing_configuration(robot)
        kin = controller.kin
        kin.update(q, np.zeros(kin.nv))
        reference = reference_here(kin, with_hands=True)
        state = RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.0)
        far = Obstacle.sphere(np.array([100.0, 0.0, 0.0]), 0.1)
        controller.tick(state, reference, [far])
