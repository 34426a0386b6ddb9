"""Recorded motion for the comparison of filters: the robot acts, obstacles keep away from it or crowd it."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from experiments.benchmarks.filter_scenes import RADIUS, Moment, Problem
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.geometry.shapes import Obstacle
from wbc.qp import UNBOUNDED, make_solver

DT = 0.01
"""Period of the recording [s]."""

SPEED = 0.4
"""Largest speed of an obstacle [m/s]."""

CLEARANCE = 0.06
"""Where obstacles keep away, they come no closer to a body than this [m]: only the robot itself gets closer."""

CAUTION, YIELDING = 2.0, 10.0
"""Where obstacles keep away: their speed towards a body is at most the first times the room left, and they leave one
that came closer at the second times what is missing [1/s]."""

PATIENCE = 50
"""Ticks to try for each that is kept."""

GOAL_TICKS = 100
"""Ticks until the hands are sent elsewhere, and until crowding obstacles press from another side."""

GOAL_LOW, GOAL_HIGH = np.array([0.2, -0.05, 0.0]), np.array([0.4, 0.3, 0.3])
"""Box of the left hand's goals from the base body's origin at the start [m]; the right hand's is its mirror image."""

CLOSE_FRACTION = 0.4
"""This fraction of the obstacles waits around the hands' goals, or where crowding presses against the robot."""

GOAL_SPREAD = 0.15
"""Distance from a goal, on each axis, at which obstacles wait [m]."""

GOAL_GAIN, HOME_GAIN, DAMPING = 3.0, 0.3, 0.05
"""Of the nominal motion: hands to goals [1/s], everything to the posture at the start [1/s], and its damping."""

POSTURE = "hands_front"
"""At the start."""


class Hands:
    """Nominal motion: both hands go to goals that change, the rest drifts back to where it began.

    Attributes:
        goals: shape (2, 3) of the left and right hand [m].
    """

    def __init__(self, kin: Kinematics, rng: np.random.Generator) -> None:
        """Goals are drawn from ``rng``."""
        self._kin = kin
        self._rng = rng
        self._frames = [kin.frame_id(kin.robot.roles[role]) for role in ("left_hand", "right_hand")]
        self._home = kin.posture(POSTURE)
        kin.update_geometry(self._home)
        self._origin = kin.frame_placement(kin.frame_id(kin.robot.roles["base"]))[1].copy()
        self.goals = np.zeros((2, 3))
        self._meet = False

    def change_goals(self) -> None:
        """Draw new goals: in turn one for both hands, where they meet, and one for each."""
        boxes = self._rng.uniform(GOAL_LOW, GOAL_HIGH, (2, 3)) * [[1, 1, 1], [1, -1, 1]]
        self._meet = not self._meet
        self.goals = self._origin + (boxes.mean(axis=0) if self._meet else boxes) * np.ones((2, 1))

    def velocity(self) -> Array:
        """Velocity (nv,) at the kinematics' configuration, by damped least squares; not bounded."""
        kin = self._kin
        rest: Array = HOME_GAIN * pin.difference(kin.model, kin.q, self._home)
        jacobian = np.vstack([kin.frame_jacobian(f)[:3] for f in self._frames])
        here = np.concatenate([kin.frame_placement(f)[1] for f in self._frames])
        error = GOAL_GAIN * (self.goals.ravel() - here) - jacobian @ rest
        damped = jacobian @ jacobian.T + DAMPING**2 * np.eye(6)
        step: Array = rest + jacobian.T @ np.linalg.solve(damped, error)
        return step


class Spheres:
    """Obstacles of ``RADIUS`` that move at ``SPEED`` at most, either keeping away from the robot or crowding it."""

    def __init__(self, problem: Problem, crowding: bool, rng: np.random.Generator) -> None:
        """They start anywhere in the box where they move, at rest."""
        n = problem.n_obstacles
        self._bodies, self._crowding, self._rng = problem.bodies, crowding, rng
        reach = 0.5 if problem.kin.base == "fixed" else 1.0
        self._low, self._high = np.array([-reach, -reach, 0.5]), np.array([reach, reach, 1.3])
        self.position = rng.uniform(self._low, self._high, (n, 3))
        self.velocity = np.zeros((n, 3))
        self._body = rng.permutation(np.arange(n) % problem.bodies.radius.size)
        self._close = rng.permutation(n)[:, None] < CLOSE_FRACTION * n

    def change_course(self, goals: Array) -> None:
        """Draw where to go next: about the goals or anywhere; where crowding, new sides of the bodies and distances."""
        shape = self.position.shape
        side = self._rng.normal(size=shape)
        self._side = side / np.linalg.norm(side, axis=1, keepdims=True)
        self._gap = self._rng.uniform(-0.01, 0.04, len(side))
        near = goals[np.arange(len(side)) % 2] + self._rng.uniform(-GOAL_SPREAD, GOAL_SPREAD, shape)
        self._place = np.where(self._close, near, self._rng.uniform(self._low, self._high, shape))

    def choose_velocity(self) -> None:
        """Choose how to move until the next tick, from where the bodies are."""
        self.velocity = self._keep_away()
        if self._crowding:
            self.velocity = np.where(self._close, self._press(), self.velocity)

    def _press(self) -> Array:
        distance = self._bodies.radius[self._body] + RADIUS + self._gap
        return self._towards(self._bodies.origin[self._body] + distance[:, None] * self._side)

    def _towards(self, place: Array) -> Array:
        return _slowed((place - self.position) / (10 * DT))

    def _keep_away(self) -> Array:
        velocity = self._towards(self._place)
        for center, radius in zip(self._bodies.origin, self._bodies.radius, strict=True):
            away = self.position - center
            distance = np.linalg.norm(away, axis=1)
            away /= distance[:, None]
            room = distance - radius - RADIUS - CLEARANCE
            least = -np.where(room > 0, CAUTION, YIELDING) * room
            excess = np.maximum(0.0, least - np.vecdot(velocity, away))
            velocity += excess[:, None] * away
        return _slowed(velocity)

    def obstacles(self) -> tuple[Obstacle, ...]:
        """As the barrier takes them."""
        pairs = zip(self.position, self.velocity, strict=True)
        return tuple(Obstacle.sphere(p, RADIUS, v) for p, v in pairs)

    def step(self) -> None:
        """Move on by one tick."""
        self.position = self.position + DT * self.velocity


def _slowed(velocity: Array) -> Array:
    """Velocities (n, 3) cut to ``SPEED``."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    slowed: Array = velocity * np.minimum(1.0, SPEED / np.maximum(speed, SPEED))
    return slowed


class Solvable:
    """Whether conditions can hold within the bounds, by a solver of its own."""

    def __init__(self, n_rows: int, bound: Array) -> None:
        """``bound`` (n,) on the size of each input."""
        n = bound.size
        self._solver = make_solver("daqp", n, n_rows)
        self._hessian, self._gradient = np.eye(n), np.zeros(n)
        self._lower = np.concatenate([-bound, np.zeros(n_rows)])
        self._upper = np.concatenate([bound, np.full(n_rows, UNBOUNDED)])

    def __call__(self, spaces: HalfSpaces | None) -> bool:
        """Whether some input meets every active condition."""
        if spaces is None or not spaces.active.any():
            return True
        self._lower[self._gradient.size :] = np.where(spaces.active, spaces.b, -UNBOUNDED)
        solution = self._solver.solve(self._hessian, self._gradient, spaces.A, self._lower, self._upper)
        return solution.status == "optimal"


def record(problem: Problem, scene: str, ticks: int, seed: int = 0) -> tuple[Moment, ...]:
    """Moments of one scene from a run with p-SSA in the loop; those that do not belong to it are left out.

    Args:
        problem: made for the same scene.
        scene: one of ``SCENES``.
        ticks: moments to keep.
        seed: of goals and obstacles.

    Raises:
        RuntimeError: among ``PATIENCE`` times as many ticks there were too few that belong to it.
    """
    kept: list[Moment] = []
    ticks_of_run = run(problem, scene == "infeasible", np.random.default_rng(seed))
    choice = _Choice(problem, scene)
    for _ in range(PATIENCE * ticks):
        moment, rows = next(ticks_of_run)
        if choice.takes(rows, moment.v):
            kept.append(moment)
            if len(kept) == ticks:
                return tuple(kept)
    raise RuntimeError(f"{problem.n_rows} rows, {problem.kin.nv} variables: {len(kept)} {scene} states, not {ticks}")


class _Choice:
    """Which ticks of a run are kept for a scene."""

    def __init__(self, problem: Problem, scene: str) -> None:
        self._problem = problem
        self._infeasible = scene == "infeasible"
        self._can_hold = Solvable(problem.n_rows, problem.v_max)
        self._busy = 0

    def takes(self, rows: BarrierRows, v: Array) -> bool:
        """Whether to keep a tick: of the feasible ones those with nothing to do half as often as the others."""
        ssa, cbf = (self._problem.conditions(name, rows, v) for name in ("ssa", "cbf"))
        if self._infeasible:
            return not self._can_hold(ssa)
        if not (self._can_hold(ssa) and self._can_hold(cbf)):
            return False
        busy = ssa is not None and bool(ssa.active.any())
        if not busy and self._busy < 2:
            return False
        self._busy += 1 if busy else -2
        return True


def run(problem: Problem, crowding: bool, rng: np.random.Generator) -> Iterator[tuple[Moment, BarrierRows]]:
    """The closed loop with p-SSA, tick by tick, without an end.

    Args:
        problem: of any scene.
        crowding: whether obstacles crowd the robot, rather than keep away from it.
        rng: draws goals and the obstacles' courses.

    Yields:
        What the robot finds, and the rows there, which are valid until the next tick.
    """
    kin, v = problem.kin, np.zeros(problem.kin.nv)
    hands, spheres = Hands(kin, rng), Spheres(problem, crowding, rng)
    safety_filter = problem.filter("pssa")
    q, tick = kin.posture(POSTURE), 0
    while True:
        if tick % GOAL_TICKS == 0:
            hands.change_goals()
            spheres.change_course(hands.goals)
        tick += 1
        kin.update_geometry(q)
        problem.bodies.place(kin)
        spheres.choose_velocity()
        v_des = np.clip(hands.velocity(), -problem.v_max, problem.v_max)
        moment = Moment(q, v, v_des, spheres.obstacles())
        rows = problem.rows(moment)
        yield moment, rows
        v = safety_filter.apply(rows, v_des).v
        q = kin.integrate(q, v, DT)
        q[kin.nq_base :] = np.clip(q[kin.nq_base :], *kin.position_limits)
        spheres.step()
