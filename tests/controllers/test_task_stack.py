"""What a reference sets in the tasks: the CoM's acceleration under the feedback of the DCM."""

import numpy as np
import pytest

from controllers.balance.dcm_feedback import clip_to_support, zmp_command
from controllers.balance.dcm_plan import DcmReference
from controllers.reference import reference_here
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.whole_body_tasks import WholeBodyTasks
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from wbc.tasks import CenterOfMassTask

HALF = np.array([[0.07, 0.02], [0.07, 0.02]])
OMEGA = 3.8


def asked_acceleration(robot: RobotDescription, dcm: Array, limits: Array, contact: tuple[bool, bool]) -> Array:
    """The horizontal acceleration that eq. (15) makes of the CoM task's command, and the pendulum's: rows of (2, 2)."""
    config = controller_config(robot)
    kin = Kinematics(robot)
    rng = np.random.default_rng(3)
    kin.update(standing_configuration(robot), 0.05 * rng.standard_normal(kin.nv))
    tasks = WholeBodyTasks(kin, config, False, HALF)
    reference = reference_here(kin, with_hands=False)
    reference.dcm = DcmReference(dcm, np.array([0.1, -0.05]), OMEGA)
    reference.in_contact, reference.load_limits = np.array(contact), limits
    tasks.set_references(reference)
    task = tasks.stack["com"]
    assert isinstance(task, CenterOfMassTask)
    _, command = task.evaluate(kin)
    gains = config.dynwbc
    asked = (gains.kd + gains.kp * config.dt) * command[:2] - gains.kd * kin.com_velocity[:2]
    measured = kin.com[:2] + kin.com_velocity[:2] / OMEGA
    zmp = zmp_command(measured, reference.dcm, config.balance.dcm_gain)
    centres = np.array([point.position[:2] for point in reference.soles])
    zmp = clip_to_support(zmp, centres, np.zeros(2), HALF, reference.in_contact, limits)
    return np.array([asked, OMEGA**2 * (kin.com[:2] - zmp)])


@pytest.mark.parametrize("limits", [(1.0, 1.0), (1.0, 0.0), (0.3, 1.0)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.0, 0.3), (0.2, -0.3)])
def test_the_com_is_accelerated_by_the_zmp_that_the_feet_may_take(
    robot: RobotDescription, limits: tuple[float, float], offset: tuple[float, float]
) -> None:
    asked, wanted = asked_acceleration(robot, np.array(offset), np.array(limits), (True, True))
    assert asked == pytest.approx(wanted, abs=1e-9)


def test_limits_of_the_load_move_the_zmp_to_the_other_foot(robot: RobotDescription) -> None:
    free, _ = asked_acceleration(robot, np.zeros(2), np.ones(2), (True, True))
    left_only, _ = asked_acceleration(robot, np.zeros(2), np.array([1.0, 0.0]), (True, True))
    alone, _ = asked_acceleration(robot, np.zeros(2), np.ones(2), (True, False))
    assert abs(left_only[1] - free[1]) > 0.5
    assert left_only == pytest.approx(alone, abs=1e-9)
