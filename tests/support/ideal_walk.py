"""A robot that walks ideally: soles go where they are told, the DCM is the planned one, forces and errors on demand."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import FootstepPlanner, Support, Walking, WalkTuning, walk_tuning
from controllers.reference import WholeBodyReference, reference_here
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from tests.support.states import at_rest, kinematics_of

DT = 0.002
"""Control period [s]."""


@dataclass
class IdealBody:
    """What the ideal robot does: soles follow their references down to the ground, the DCM follows the plan's.

    It stands in for the kinematics that a gait reads: its CoM is at the DCM and does not move.

    Attributes:
        rest: kinematics of the robot standing; whatever is not a sole or the CoM stays as it is there.
        soles: shape (2, 4) x, y, height, yaw.
        dcm: shape (2,).
        error: shape (2,) of the DCM against the plan's.
        ground: height of the ground under each foot.
        force: on a foot that touches the ground [N].
        measured: whether forces are.
    """

    rest: Kinematics
    soles: Array
    dcm: Array
    ground: Array
    error: Array = field(default_factory=lambda: np.zeros(2))
    force: float = 200.0
    measured: bool = True

    @property
    def robot(self) -> RobotDescription:
        return self.rest.robot

    @property
    def com(self) -> Array:
        return np.array([*self.dcm, self.rest.com[2]])

    @property
    def com_velocity(self) -> Array:
        return np.zeros(3)

    def frame_id(self, name: str) -> int:
        return self.rest.frame_id(name)

    def frame_placement(self, frame_id: int) -> tuple[Array, Array]:
        for foot, role in enumerate(("left_sole", "right_sole")):
            if frame_id == self.frame_id(self.robot.roles[role]):
                x, y, z, yaw = self.soles[foot]
                c, s = math.cos(yaw), math.sin(yaw)
                return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z])
        return self.rest.frame_placement(frame_id)

    def follow(self, reference: WholeBodyReference) -> None:
        """Be where a reference says, or on the ground."""
        for foot in (LEFT, RIGHT):
            rotation = reference.sole_rotations[foot]
            self.soles[foot] = [*reference.soles[foot].position, math.atan2(rotation[1, 0], rotation[0, 0])]
        self.soles[:, 2] = np.maximum(self.soles[:, 2], self.ground)
        assert reference.dcm is not None
        self.dcm = reference.dcm.position + self.error

    def forces(self) -> Array | None:
        """Measured under left and right foot [N]."""
        on_ground = self.soles[:, 2] <= self.ground + 1e-9
        return np.where(on_ground, self.force, self.force * 0.0) if self.measured else None


def ideal_body(robot: RobotDescription) -> IdealBody:
    """The ideal robot, standing."""
    kin = kinematics_of(robot, at_rest(robot))
    places = [kin.frame_placement(kin.frame_id(robot.roles[r]))[1] for r in ("left_sole", "right_sole")]
    soles = np.array([[*p, 0.0] for p in places])
    return IdealBody(kin, soles, soles[:, :2].mean(axis=0), soles[:, 2].copy())


@dataclass(frozen=True)
class Tick:
    """What a walk asked for in one tick."""

    t: float
    support: Support
    contact: Array
    soles: Array
    rates: Array
    accelerations: Array
    dcm: Array
    zmp: Array
    limits: Array
    steps: int


class IdealWalk:
    """A walk of the ideal robot, with what happened in each tick.

    Attributes:
        body: the robot.
        walking: the gait.
        reference: that the gait writes.
        ticks: so far.
        by_contact: whether contacts are told as probabilities, and forces that say nothing.
    """

    def __init__(self, tuning: WalkTuning | None = None, planner: FootstepPlanner | None = None) -> None:
        robot = load_robot("g1")
        self.body = ideal_body(robot)
        self.reference = reference_here(self.body.rest, with_hands=False)
        self.tuning = tuning or walk_tuning(robot)
        self.walking = Walking(self.body, self.tuning, planner)
        self.state, self.t, self.ticks = at_rest(robot), 0.0, list[Tick]()
        self.by_contact = False

    def tick(self) -> Tick:
        state = replace(self.state, foot_forces=self.body.forces())
        if self.by_contact:
            stands = self.body.soles[:, 2] <= self.body.ground + 1e-9
            state = replace(state, foot_forces=np.zeros(2), contact=np.where(stands, 0.8, 0.2))
        self.walking.apply(self.reference, self.t, state, self.body)
        reference, dcm = self.reference, self.reference.dcm
        assert dcm is not None
        self.ticks.append(
            Tick(
                self.t,
                self.walking.support,
                reference.in_contact.copy(),
                np.array([p.position for p in reference.soles]),
                np.array([p.velocity for p in reference.soles]),
                np.array([p.acceleration for p in reference.soles]),
                dcm.position,
                dcm.zmp,
                reference.load_limits.copy(),
                self.walking.steps,
            )
        )
        self.body.follow(reference)
        self.t = round(self.t + DT, 9)
        return self.ticks[-1]

    def run(self, seconds: float) -> "IdealWalk":
        for _ in range(round(seconds / DT)):
            self.tick()
        return self

    def until(self, condition: Callable[[Tick], bool], limit: float = 6.0) -> Tick:
        """The first tick from now on of which ``condition`` is true, within ``limit`` [s]."""
        end = self.t + limit
        while self.t < end:
            if condition(tick := self.tick()):
                return tick
        raise AssertionError("it did not happen")

    def until_single(self) -> Tick:
        return self.until(lambda tick: tick.support is Support.SINGLE)

    def until_landed(self) -> Tick:
        return self.until(lambda tick: tick.support is Support.DOUBLE)

    def series(self, name: str) -> Array:
        """One field of every tick so far."""
        return np.array([getattr(tick, name) for tick in self.ticks])

    def foothold(self, foot: int) -> Foothold:
        x, y, _, yaw = self.body.soles[foot]
        return Foothold(float(x), float(y), float(yaw))

    def inwards(self, size: float) -> Array:
        """An error (2,) of the DCM by ``size`` [m] from the foot that has just landed towards the other one."""
        landed = self.foothold(int(np.argmin(self.reference.load_limits)))
        away = self.body.soles[:, :2].mean(axis=0) - landed.point
        return size * away / float(np.linalg.norm(away))

    def apart(self) -> tuple[float, float, float]:
        """The left foot as seen from the right one."""
        return self.foothold(RIGHT).relative(self.foothold(LEFT))


def swinging(tick: Tick) -> int:
    """The foot in the air."""
    (foot,) = np.flatnonzero(~tick.contact)
    return int(foot)


def assert_side_by_side(walk: IdealWalk) -> None:
    """The robot stands, its feet beside each other at the width of its posture."""
    assert walk.walking.support is Support.STAND
    assert walk.reference.in_contact.all()
    np.testing.assert_allclose(walk.apart(), (0.0, walk.walking.limits.width, 0.0), rtol=0, atol=1e-6)
