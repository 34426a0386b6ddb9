"""A robot that is driven through whole ticks while an adversary plays around it: what the worst case is measured on."""

from dataclasses import dataclass
from time import thread_time

import numpy as np

from controllers.motions.hands import HandCircles, circle_settings
from controllers.reference import WholeBodyReference, reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from experiments.benchmarks.worst_scenes import Adversary, Scene
from experiments.scenarios.hand_motions import start_posture
from experiments.scenarios.options import BenchOptions
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, Indices, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import CollisionBodies, ObstacleBarrier
from safety.geometry.shapes import Obstacle
from sims.kinematic import KinematicPlant

STARTS = 60
"""States of the undisturbed run, evenly over one turn of the hands' circles."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where the robot is put: configuration ``q`` (nq,), and ``t`` [s], how long its hands have been on their way."""

    q: Array
    t: float


class Course:
    """A robot that follows its filtered velocity exactly, tick by tick, while an adversary plays one scene around it.

    Args:
        robot: the description, with ``[tuning.hand_tracking]``.
        options: filter and solver are read.
        scene: what happens.
        starts: states to put the robot into; ``None`` before there are any: it then starts in its posture.
        seed: of all that is drawn.
    """

    def __init__(
        self,
        robot: RobotDescription,
        options: BenchOptions,
        scene: Scene,
        starts: tuple[Start, ...] | None = None,
        seed: int = 0,
    ) -> None:
        config = controller_config(robot, filter=options.filter, dynwbc_solver=options.solver)
        kin = Kinematics(robot)
        q = standing_configuration(robot, start_posture(robot))
        kin.update(q, np.zeros(kin.nv))
        bodies = CollisionBodies(kin)
        bodies.place(kin)
        hand = kin.frame_placement(kin.frame_id(robot.roles["left_hand"]))[1]
        nearest = nearest_bodies(bodies, hand)[: scene.nearest or None]
        self._spots = nearest_bodies(bodies, hand)
        names = [bodies.names[i] for i in nearest]

        def own_barrier(own: Kinematics) -> list[ObstacleBarrier]:
            return [ObstacleBarrier(CollisionBodies(own), scene.kinds, names)]

        announced = () if scene.nearest else scene.kinds
        extra = own_barrier if scene.nearest else None
        self.controller = WholeBodyController(robot, config, True, announced, thread_time, extra)
        self.reference: WholeBodyReference = reference_here(kin, with_hands=True)
        assert self.reference.hands is not None
        left, right = self.reference.hands
        self._motion = HandCircles(circle_settings(robot), (left.position.copy(), right.position.copy()))
        self._com = self.reference.com.position.copy()
        self._starts = starts or (Start(q, 0.0),)
        self._bodies, self._dt = CollisionBodies(self.controller.kin), config.dt
        self._rng = np.random.default_rng(seed)
        self.adversary = Adversary(scene, config.dt, self._rng)
        self.stamp = 0.0
        self.restart()

    def restart(self) -> None:
        """Put the robot into one of the states, at rest, under a new supervisor."""
        start = self._starts[self._rng.integers(len(self._starts))]
        self.plant, self.phase = KinematicPlant(self.controller.kin, start.q), start.t
        zero = np.zeros(self.controller.kin.nv - 6)
        self.controller.reset(RobotState(self.plant.q, self.plant.v, zero, self.stamp))
        self.supervisor, self._tau = Supervisor(self.controller), zero
        self.adversary.restart()

    def prepare(self) -> tuple[RobotState, WholeBodyReference, list[Obstacle]]:
        """What the next tick is given."""
        self._bodies.place(self.controller.kin)
        obstacles = self.adversary.obstacles(self._bodies.origin[self._spots])
        self.reference.com.position = self._com
        self._motion.apply(self.reference, self.phase)
        self.adversary.retarget(self.reference)
        return RobotState(self.plant.q, self.plant.v, self._tau, self.stamp), self.reference, obstacles

    def follow(self, result: TickResult) -> None:
        """Move on as the tick decided."""
        self.plant.step(result.safety.v, self._dt)
        self._tau = result.command.tau
        self.stamp, self.phase = self.stamp + self._dt, self.phase + self._dt


def nearest_bodies(bodies: CollisionBodies, point: Array) -> Indices:
    """Indices of the bodies by the distance of their starts from ``point`` (3,), those first that move."""
    distance = np.linalg.norm(bodies.origin - point, axis=1)
    return np.argsort(np.where(bodies.is_movable, distance, np.inf))


def undisturbed(robot: RobotDescription, options: BenchOptions) -> tuple[Start, ...]:
    """States of a closed-loop run with hands on their circles and nothing else around."""
    course = Course(robot, options, Scene("undisturbed", ()))
    ticks = round(circle_settings(robot).period / course.controller.config.dt)
    starts = []
    for i in range(ticks):
        result = course.supervisor.tick(*course.prepare())[1]
        assert result is not None
        course.follow(result)
        if i % max(1, ticks // STARTS) == 0:
            starts.append(Start(course.plant.q, course.phase))
    return tuple(starts)
