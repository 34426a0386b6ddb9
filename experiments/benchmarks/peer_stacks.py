r"""Inverse kinematics with self-collision avoidance by other libraries, set up through their public interfaces.

All get the robot's model made from the same description, the same capsules and pairs, the same targets (a target's
velocity enters by moving its position ahead), gains per second, bounds of joint positions and velocities, and the
condition :math:`n^T (J_A - J_B) v \ge -\alpha h` on each pair.

They do not solve the same problem. Ours has strict priorities (feet, CoM, base, torso, hands, posture) and then filters
the velocity with an input-to-state safe condition on 290 rows, the ends of the capsules and the workspace among them.
mink and pink put weights on the same tasks and solve one quadratic program with the pairs as rows.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from controllers.reference import PointReference, WholeBodyReference
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.controller import STAGES, WholeBodyController
from robots.description import RobotDescription
from robots.messages import Array, RobotState
from robots.mujoco_spec import build_mujoco_spec
from robots.pinocchio_model import build_pinocchio_model

COSTS = {"foot": 100.0, "com": 30.0, "base": 10.0, "torso": 10.0, "hand": 3.0, "posture": 0.1}
"""Weights on errors [m, rad]: the order of our priorities, as far as the problem stays well conditioned."""

NEAR, ALL = 0.2, 10.0
"""Distances beyond which mink leaves a pair out [m]. At ``NEAR`` a pair may close at 1 m/s (alpha times it), which none
here does: the answer is the same. At ``ALL`` it does what the others do."""

FRAMES = (
    ("left_sole", "foot", True, True),
    ("right_sole", "foot", True, True),
    ("base", "base", False, True),
    ("torso", "torso", False, True),
    ("left_hand", "hand", True, False),
    ("right_hand", "hand", True, False),
)
"""Tasks on frames: role, whose cost and gain, whether they are about position and orientation."""


class Solver(Protocol):
    """One library's problem, ready to be solved again and again."""

    def velocity(self, state: RobotState, reference: WholeBodyReference) -> Array | None:
        """Joint velocities (nj,) [rad/s]; ``None`` where the library has no answer."""
        ...


@dataclass(frozen=True, slots=True)
class Peer:
    """A library that ours is compared with.

    Attributes:
        name: in the table.
        module: that is imported.
        distribution: that is installed.
        make: its problem for a robot and our settings.
        work: what it does, in words.
    """

    name: str
    module: str
    distribution: str
    make: Callable[[RobotDescription, ControllerConfig], Solver]
    work: str

    def version(self) -> str | None:
        """The installed version; ``None`` where the library is not installed, or does not load."""
        try:
            import_module(self.module)
            return metadata.version(self.distribution)
        except (ImportError, metadata.PackageNotFoundError):
            return None


class OurIk:
    """Our tick, of which the stages up to the filtered velocity count.

    Attributes:
        seconds: of those stages, then of the whole tick with its torques, of the last call [s].
    """

    def __init__(self, robot: RobotDescription, config: ControllerConfig) -> None:
        self._controller = WholeBodyController(robot, config, with_hands=True)
        self._controller.warm_up()
        self._stages = STAGES.index("safety_qp") + 1
        self.seconds = (0.0, 0.0)

    def velocity(self, state: RobotState, reference: WholeBodyReference) -> Array:
        """Joint velocities (nj,) [rad/s]."""
        start = time.perf_counter()
        result = self._controller.tick(state, reference)
        self.seconds = (float(result.stage_seconds[: self._stages].sum()), time.perf_counter() - start)
        return result.safety.v[6:]


class MinkIk:
    """mink: one weighted quadratic program over MuJoCo's kinematics, DAQP behind qpsolvers."""

    def __init__(self, robot: RobotDescription, config: ControllerConfig, detection: float) -> None:
        """``detection``: distance beyond which a pair is left out [m]."""
        self._mink: Any = import_module("mink")
        # it tells on every call of a joint at its limit
        logging.getLogger("mink").setLevel(logging.ERROR)
        spec = build_mujoco_spec(robot)
        for geom in spec.geoms:
            if geom.name.endswith("_collision"):
                # it drops pairs that could not touch in the simulation
                geom.contype, geom.conaffinity = 1, 1
        model = spec.compile()
        mink, self._dt = self._mink, config.dt
        self._configuration = mink.Configuration(model)
        self._targets = Targets(robot, config)
        gains = self._targets.gains
        self._frames = [
            mink.FrameTask(robot.roles[role], "site", moved * COSTS[k], turned * COSTS[k], gain=gains[k] * self._dt)
            for role, k, moved, turned in FRAMES
        ]
        self._com = mink.ComTask(COSTS["com"], gain=gains["com"] * self._dt)
        self._posture = mink.PostureTask(model, COSTS["posture"], gain=gains["posture"] * self._dt)
        pairs = [([f"{a}_collision"], [f"{b}_collision"]) for a, b in robot.self_collision_pairs]
        alpha, limits = (
            config.safety.self_collision.alpha,
            dict(zip(robot.joint_names, speeds(robot, config), strict=True)),
        )
        self._limits = [
            mink.ConfigurationLimit(model, gain=config.safety.joint_limit.alpha * self._dt),
            mink.VelocityLimit(model, limits),
            # its bound on a displacement is gain h / dt
            mink.CollisionAvoidanceLimit(model, pairs, alpha * self._dt**2, 0.0, detection),
        ]
        # it drops pairs of neighbours without a word
        assert self._limits[-1].max_num_contacts == len(pairs)

    def velocity(self, state: RobotState, reference: WholeBodyReference) -> Array | None:
        """See :meth:`Solver.velocity`."""
        mink, q = self._mink, state.q
        # MuJoCo's order: w, x, y, z
        self._configuration.update(np.concatenate([q[:3], q[6:7], q[3:6], q[7:]]))
        for task, (rotation, position) in zip(self._frames, self._targets.frames(reference), strict=True):
            task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position))
        self._com.set_target(self._targets.com(reference))
        self._posture.set_target(np.concatenate([q[:7], reference.joints]))
        try:
            v = mink.solve_ik(
                self._configuration, [*self._frames, self._com, self._posture], self._dt, "daqp", limits=self._limits
            )
        except mink.NoSolutionFound:
            return None
        return v[6:]


class PinkIk:
    """pink: one weighted quadratic program over pinocchio's kinematics and coal's distances, DAQP behind qpsolvers."""

    def __init__(self, robot: RobotDescription, config: ControllerConfig) -> None:
        self._pink: Any = import_module("pink")
        tasks, barriers = import_module("pink.tasks"), import_module("pink.barriers")
        self._dt, self._targets = config.dt, Targets(robot, config)
        model = build_pinocchio_model(robot)
        lower, upper = robot.position_limits
        model.lowerPositionLimit = np.concatenate([np.full(7, -1e30), lower])
        model.upperPositionLimit = np.concatenate([np.full(7, 1e30), upper])
        model.velocityLimit = np.concatenate([np.zeros(6), speeds(robot, config)])
        geometry = collision_geometry(robot, model)
        self._configuration = self._pink.Configuration(
            model, model.createData(), pin.neutral(model), copy_data=False, collision_model=geometry
        )
        gains = self._targets.gains
        self._frames = [
            tasks.FrameTask(robot.roles[role], moved * COSTS[k], turned * COSTS[k], gain=gains[k] * self._dt)
            for role, k, moved, turned in FRAMES
        ]
        self._com = tasks.ComTask(COSTS["com"], gain=gains["com"] * self._dt)
        self._posture = tasks.PostureTask(COSTS["posture"], gain=gains["posture"] * self._dt)
        pairs = len(geometry.collisionPairs)
        self._barriers = [
            barriers.SelfCollisionBarrier(
                pairs, gain=config.safety.self_collision.alpha, safe_displacement_gain=0.0, d_min=0.0
            )
        ]

    def velocity(self, state: RobotState, reference: WholeBodyReference) -> Array | None:
        """See :meth:`Solver.velocity`."""
        self._configuration.update(state.q)
        for task, (rotation, position) in zip(self._frames, self._targets.frames(reference), strict=True):
            task.set_target(pin.SE3(rotation, position))
        self._com.set_target(self._targets.com(reference))
        self._posture.set_target(np.concatenate([state.q[:7], reference.joints]))
        try:
            v = self._pink.solve_ik(
                self._configuration,
                [*self._frames, self._com, self._posture],
                self._dt,
                "daqp",
                barriers=self._barriers,
                safety_break=False,
            )
        except self._pink.exceptions.NoSolutionFound:
            return None
        return v[6:]


class Targets:
    """Where the tasks of a library without feed-forward are to go, so that they move as ours do.

    Attributes:
        gains: of each kind of task [1/s].
    """

    def __init__(self, robot: RobotDescription, config: ControllerConfig) -> None:
        self.gains: dict[str, float] = {k: getattr(config.tasks, k) for k in COSTS}

    def frames(self, reference: WholeBodyReference) -> list[tuple[Array, Array]]:
        """Rotation (3, 3) and position (3,) [m] for each of ``FRAMES``; what a task is not about is arbitrary."""
        assert reference.hands is not None
        feet = [(r, self._ahead(p, "foot")) for r, p in zip(reference.sole_rotations, reference.soles, strict=True)]
        turned = [(r, np.zeros(3)) for r in (reference.base_rotation, reference.torso_rotation)]
        return [*feet, *turned, *((np.eye(3), self._ahead(p, "hand")) for p in reference.hands)]

    def com(self, reference: WholeBodyReference) -> Array:
        """Position (3,) of the CoM [m]."""
        return self._ahead(reference.com, "com")

    def _ahead(self, point: PointReference, kind: str) -> Array:
        """Where a task has to aim for its velocity, gain times error, to hold the reference's own."""
        return point.position + point.velocity / self.gains[kind]


def speeds(robot: RobotDescription, config: ControllerConfig) -> Array:
    """Largest joint velocities (nj,) that our filter allows [rad/s]."""
    return config.safety.velocity_scale * robot.joint_array("velocity")


def collision_geometry(robot: RobotDescription, model: pin.Model) -> pin.GeometryModel:
    """The description's spheres and capsules, and its pairs, for pinocchio's distances."""
    geometry = pin.GeometryModel()
    for shape in robot.collisions:
        frame = model.frames[model.getFrameId(shape.body)]
        axis, middle = shape.end - shape.start, 0.5 * (shape.start + shape.end)
        length = float(np.linalg.norm(axis))
        body = pin.coal.Sphere(shape.radius) if shape.is_sphere else pin.coal.Capsule(shape.radius, length)
        # a capsule lies along its own z axis
        turn = np.eye(3) if shape.is_sphere else pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        placement = frame.placement * pin.SE3(turn, middle)
        geometry.addGeometryObject(pin.GeometryObject(shape.name, frame.parentJoint, placement, body))
    for a, b in robot.self_collision_pairs:
        geometry.addCollisionPair(pin.CollisionPair(geometry.getGeometryId(a), geometry.getGeometryId(b)))
    return geometry


PEERS = (
    Peer("mink, near pairs", "mink", "mink", partial(MinkIk, detection=NEAR), "one weighted QP, pairs within 0.2 m"),
    Peer("mink, all pairs", "mink", "mink", partial(MinkIk, detection=ALL), "the same, every pair"),
    Peer("pink", "pink", "pin-pink", PinkIk, "one weighted QP, every pair"),
)
"""What ours is compared with; the extra ``bench`` installs it."""
