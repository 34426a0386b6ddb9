"""Situations that lead a tick down each of its paths, to be gone through before the first tick that counts."""

from collections.abc import Iterator, Sequence

import numpy as np

from controllers.balance.dcm_plan import DcmReference
from controllers.reference import WholeBodyReference, reference_here
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.geometry.shapes import Obstacle
from wbc.wrench import GRAVITY

Situation = tuple[RobotState, WholeBodyReference, tuple[Obstacle, ...]]
"""What a tick is given."""

CONTACTS = ((True, True), (True, False), (False, True), (False, False))
"""Which foot is meant to be on the ground: all there is."""

BEYOND = 2.0
"""How far joints are past their limits where no velocity within bounds can keep the conditions [rad]."""

AWAY = 100.0
"""Where obstacles are that are too far away to matter [m]."""

ROUNDS = 4
"""How often to go through the situations: the interpreter adapts a function to its arguments in the first calls."""


def situations(kin: Kinematics, with_hands: bool, kinds: Sequence[str]) -> Iterator[Situation]:
    """States, references and obstacles that take a controller down its paths, ``ROUNDS`` times over.

    At rest, on both feet, on either, on none; feet that turn and share the load, with the feedback of the DCM, and with
    measured forces; obstacles at the hands while these are sent to the torso, so that the filter acts; all joints
    straight, where tasks lose rank; joints past their limits, where no velocity keeps all conditions.

    Args:
        kin: of the controller; left at some configuration.
        with_hands: whether the hands are tasks.
        kinds: of the obstacles that every tick is given.

    Yields:
        State, reference, obstacles.
    """
    standing = standing_configuration(kin.robot)
    upper = kin.position_limits[1]
    straight, limits, beyond = standing.copy(), standing.copy(), standing.copy()
    straight[7:], limits[7:], beyond[7:] = 0.0, upper, upper + BEYOND
    far = obstacles_at(np.full(3, AWAY), kinds)
    for _ in range(ROUNDS):
        for in_contact in CONTACTS:
            for q in (standing, straight):
                yield at_rest(kin, q), _here(kin, q, with_hands, in_contact), far
            yield _moving(kin, standing), _stepping(kin, standing, with_hands, in_contact), far
        torso = kin.frame_placement(kin.frame_id(kin.robot.roles["torso"]))[1].copy()
        hand = kin.frame_placement(kin.frame_id(kin.robot.roles["left_hand"]))[1].copy()
        for q in (standing, limits, beyond):
            reference = _here(kin, standing, with_hands, CONTACTS[0])
            for point in reference.hands or ():
                point.position[:] = torso
            yield _moving(kin, q), reference, obstacles_at(hand, kinds)


def at_rest(kin: Kinematics, q: Array) -> RobotState:
    """The state of rest at a configuration (nq,)."""
    return RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.0)


def obstacles_at(point: Array, kinds: Sequence[str]) -> tuple[Obstacle, ...]:
    """An obstacle of each of the ``kinds`` 10 cm in front of a point (3,) [m], moving and turning towards it."""
    towards, angular_velocity = np.array([-0.5, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    place = point + np.array([0.1, 0.0, 0.0])
    end, half_sizes = place + np.array([0.0, 0.1, 0.1]), np.array([0.05, 0.1, 0.1])
    made = {
        "sphere": lambda: Obstacle.sphere(place, 0.05, towards),
        "capsule": lambda: Obstacle.capsule(place, end, 0.05, towards, angular_velocity),
        "box": lambda: Obstacle.box(place, np.eye(3), half_sizes, towards, angular_velocity),
        "half_space": lambda: Obstacle.half_space(place, towards, towards, angular_velocity),
    }
    return tuple(made[kind]() for kind in kinds)


def _moving(kin: Kinematics, q: Array) -> RobotState:
    """A state with every rate above zero and forces measured under both feet."""
    half = 0.5 * kin.robot.total_mass * GRAVITY
    return RobotState(q, np.full(kin.nv, 0.1), np.zeros(kin.nv - 6), 0.0, np.full(2, half))


def _here(kin: Kinematics, q: Array, with_hands: bool, in_contact: tuple[bool, bool]) -> WholeBodyReference:
    """The reference to stay at a configuration (nq,)."""
    kin.update(q, np.zeros(kin.nv))
    reference = reference_here(kin, with_hands)
    reference.in_contact[:] = in_contact
    return reference


def _stepping(kin: Kinematics, q: Array, with_hands: bool, in_contact: tuple[bool, bool]) -> WholeBodyReference:
    """A reference that uses all a gait may use."""
    reference = _here(kin, q, with_hands, in_contact)
    reference.dcm = DcmReference(
        reference.com.position[:2].copy(), np.full(2, 0.1), float(np.sqrt(GRAVITY / kin.com[2]))
    )
    reference.load_limits[:] = 0.7, 0.4
    reference.sole_turns[:] = 0.1
    reference.turn_rate = 0.1
    return reference
