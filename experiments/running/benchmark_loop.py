"""One episode of a benchmark's case: the closed loop on one of its plants, what is kept of it, and its scores.

Commands are of first order, velocities in, or of second order, accelerations in, as the case says. For the second
the index is SPARK's of first power with a gain of 1 s: h less its margin, plus its rate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.policies.hand_ik import HandIk
from controllers.policies.ik_pid import IkPidPolicy
from controllers.policies.kinematic_agent import KinematicAgent, KinematicOutput
from controllers.policies.nominal import benchmark_limits
from experiments.metrics.scores import TOUCH, control_score, feasible_rate, goal_score, safety_score, tracking_score
from experiments.running.loop import ClosedLoop, Observer
from experiments.scenarios.benchmark_case import HANDS, BenchmarkCase, CaseBook
from experiments.scenarios.benchmark_motions import motion_of
from experiments.scenarios.benchmark_scene import (
    START,
    DrawnScene,
    benchmark_kinematics,
    benchmark_robot,
    draw_scene,
    redraw_goals,
    robot_spheres,
)
from robots.checks import require_between, require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array, RobotState
from robots.mujoco_spec import PhysicalChanges
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, ObstacleBarrier, SelfCollisionBarrier
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import KINDS, FilterSettings, FilterStatus, SafetyFilter
from safety.geometry.shapes import Obstacle
from sims.held_plant import HeldConfig, HeldPlant
from sims.kinematic import KinematicPlant

DT = 0.01
"""Control period [s]: 100 Hz."""

EPISODE = 200
"""Steps of an episode at most, as in SPARK's study of success."""

NAIVE = "-naive"
"""Behind the name of a filter: the nominal velocity is passed on where no velocity keeps all conditions."""

HARD = tuple(name for name in ("ssa", "sss", "cbf", "issf") if name in KINDS)
"""Filters that have a naive form."""

FILTERS = ("none", *(n for n in KINDS if n != "none"), *(n + NAIVE for n in HARD))
"""Names of filters that cases can be run with; some are for one of both orders only."""

KNOWN_VELOCITIES = ("none", "true")
"""What filters are told of the velocity of obstacles: nothing, as in SPARK's first order, or what it is."""

PLANTS: dict[str, HeldConfig | None] = {
    "integrator": None,
    "torque": HeldConfig(),
    "torque-heavy": HeldConfig(changes=PhysicalChanges(mass_scale=1.2)),
}
"""What commands move: an integrator, which does what it is told; or motors, by torques, with the joints' friction, on a
base that is held or driven, by the model's masses or 20 % heavier."""

HAND_SCALE, BASE_SCALE = 0.002, 0.05
"""Of the squared distances in the scores of hands and base, in SPARK's code [m^2]."""

HAND_OFFSET = np.array([0.05, 0.0, 0.0])
"""Centre of a hand's sphere, in the axes of its body [m]."""

HAND_BODIES = {"left": "left_wrist_yaw_link", "right": "right_wrist_yaw_link"}


@dataclass(frozen=True)
class BenchmarkRig:
    """What all episodes of a case share: made once, its drawing of scenes and its robot.

    Attributes:
        book: that the case is of.
        case: which one.
        robot: with the benchmark's spheres and posture.
        spheres: centres and radii of all of them at the start, for scenes.
        number: of obstacles.
    """

    book: CaseBook
    case: BenchmarkCase
    robot: RobotDescription
    spheres: tuple[Array, Array]
    number: int

    def scene(self, seed: int) -> DrawnScene:
        """The scene of a seed."""
        return draw_scene(self.case, seed, self.spheres, self.book.robot.base_height, self.number)


def rig_of(book: CaseBook, name: str, counts: str = "code") -> BenchmarkRig:
    """The rig of a case.

    Args:
        book: of cases.
        name: of one.
        counts: ``code`` or ``paper``: whose number of obstacles.

    Raises:
        SafeWbcError: there is no such case, or the robot does not have what it says.
        ConfigError: another count, or a base that walks.
    """
    case = book.case(name)
    require_one_of("counts", counts, ("code", "paper"))
    if case.configuration.base == "walking":
        raise ConfigError("base", "walking", "fixed or planar on an integrator")
    robot = benchmark_robot(book.robot)
    drawn = case.obstacles
    number = drawn.number if counts == "code" else drawn.paper_number
    return BenchmarkRig(book, case, robot, robot_spheres(book, robot), number)


@dataclass(frozen=True)
class Episode:
    """What one episode came to.

    ``series`` holds per tick (T of them): ``hands`` (T, m), distances to their goals [m]; ``base`` (T,) [m], NaN
    without a goal; ``h_obstacle`` (T, 19 n) and ``h_self_collision`` (T, p), distances [m]; ``violation`` (T,), sum of
    the amounts by which the filter's conditions are violated [m/s], NaN for filters that have none of all rows;
    ``status`` (T,) of the filter; ``filter_ms`` (T,).

    Attributes:
        seed: of the scene.
        series: as above.
        goals_reached: how often all goals were.
        saturated: share of physics steps with a motor at its limit; 0 on an integrator.
        unstable: whether the simulation blew up.
    """

    seed: int
    series: Mapping[str, Array]
    goals_reached: int
    saturated: float = 0.0
    unstable: bool = False


class BenchmarkEpisode(Observer):
    """Drives one episode, and keeps every tick of it.

    Args:
        rig: of the case.
        name: one of ``FILTERS``.
        seed: of the scene.
        velocity: one of ``KNOWN_VELOCITIES``.
        plant: one of ``PLANTS``.

    Raises:
        ConfigError: no such filter, one of another order than the case's, or no such word.
        CrowdedError: the scene cannot be drawn.
    """

    def __init__(
        self, rig: BenchmarkRig, name: str, seed: int, velocity: str = "none", plant: str = "integrator"
    ) -> None:
        require_one_of("filter", name, FILTERS)
        require_one_of("velocity", velocity, KNOWN_VELOCITIES)
        require_one_of("plant", plant, tuple(PLANTS))
        self._rig, self._tells = rig, velocity == "true"
        case, scene = rig.case, rig.scene(seed)
        self.scene, self.motion = scene, motion_of(case.obstacles, scene, DT)
        kin = benchmark_kinematics(rig.robot, case)
        q0 = kin.posture(START)
        kin.update_geometry(q0)
        bodies = CollisionBodies(kin)
        self._obstacles = ObstacleBarrier(bodies, ["sphere"] * rig.number, bodies.names)
        own = SelfCollisionBarrier("self_collision", bodies, rig.robot.self_collision_pairs)
        self.barriers = BarrierSet(kin, bodies, [own, self._obstacles])
        limits = benchmark_limits(kin, case.order)
        self._hands = tuple(case.configuration.hands)
        points = [(HAND_BODIES[hand], HAND_OFFSET) for hand in self._hands]
        self._ik = HandIk(rig.robot, case.configuration.joints, points, START)
        self.policy = IkPidPolicy(kin, self._ik, limits)
        self.filter = SafetyFilter(
            name.removesuffix(NAIVE),
            self.barriers.size,
            parameters_of(case),
            limits,
            settings=FilterSettings(
                infeasible="unsafe_pass_nominal" if name.endswith(NAIVE) else "least_slack", order=case.order, dt=DT
            ),
        )
        self.agent = KinematicAgent(kin, self.policy, self.barriers, self.filter, DT, self)
        held = PLANTS[plant]
        self.plant = KinematicPlant(kin, q0, case.order) if held is None else HeldPlant(kin, q0, case.order, held)
        self._kin, self._chosen = kin, [HANDS.index(hand) for hand in self._hands]
        self._ticks: list[tuple[Any, ...]] = []
        self.goals_reached, self._ends = 0, False
        self._told = np.full((rig.number, 6), np.nan)
        self._spheres = [Obstacle.sphere(np.zeros(3), 1.0)] * rig.number
        self.move_goals(0.0)

    # -- what the agent knows

    def move_goals(self, t: float) -> None:
        """See :meth:`controllers.policies.kinematic_agent.Surroundings.move_goals`: goals ride with the base."""
        self.policy.hand_goals = self.scene.hand_goals[self._chosen]
        self.policy.base_goal = self.scene.base_goal

    def obstacles(self, t: float) -> Sequence[Obstacle]:
        """See :meth:`controllers.policies.kinematic_agent.Surroundings.obstacles`."""
        radius, motion = self._rig.case.obstacles.radius, self.motion
        now = np.hstack([motion.positions, motion.velocities if self._tells else np.zeros_like(motion.positions)])
        # one that is as it was is not made anew: most of the time of a step would go there
        for i in np.flatnonzero((now != self._told).any(axis=1)):
            self._spheres[i] = Obstacle.sphere(now[i, :3], radius, now[i, 3:])
        self._told = now
        return self._spheres

    # -- what is kept

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: KinematicOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        h, slices, result = output.rows.h, self.barriers.slices, output.result
        q = state.q[self._kin.nq_base :]
        hands = np.linalg.norm(self._ik.places(q) - self.policy.hand_goals, axis=1)
        base = self._base_distance(state.q)
        self._ticks.append(
            (
                hands,
                base,
                h[slices["obstacle"]].copy(),
                h[slices["self_collision"]].copy(),
                float(result.violation.sum()) if self.filter.kind.joint else math.nan,
                int(result.status),
                1e3 * output.filter_seconds,
            )
        )
        goals = self._rig.case.goals
        if (hands <= goals.hand_size).all() and not base > goals.base_size:
            self.goals_reached += 1
            if goals.respawn:
                self._draw_goals()
            else:
                self._ends = True
        self.motion.step()

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        return self._ends

    def _base_distance(self, q: Array) -> float:
        """Of the base to its goal, level [m]; NaN without one."""
        goal = self.scene.base_goal
        return math.nan if goal is None else math.hypot(q[0] - goal[0], q[1] - goal[1])

    def _draw_goals(self) -> None:
        base = self._kin.frame_placement(self._kin.frame_id(self._rig.robot.roles["base"]))
        self.scene = redraw_goals(self._rig.case, self.scene, self.motion.positions, base)

    def run(self, steps: int = EPISODE) -> Episode:
        """Run it to its end, at most ``steps`` periods.

        Raises:
            ConfigError: not from 1 to 100000 steps.
        """
        require_between("steps", steps, 1, 100_000)
        ClosedLoop(self.plant, self.agent, observers=[self]).run(steps * DT)
        names = ("hands", "base", "h_obstacle", "h_self_collision", "violation", "status", "filter_ms")
        series = {name: np.array(column) for name, column in zip(names, zip(*self._ticks, strict=True), strict=True)}
        held = self.plant if isinstance(self.plant, HeldPlant) else None
        steps_taken = 1 if held is None else round(held.time / held.config.dt)
        return Episode(
            self.scene.seed,
            series,
            self.goals_reached,
            0.0 if held is None else held.saturated / steps_taken,
            held is not None and held.unstable,
        )


def parameters_of(case: BenchmarkCase) -> BarrierParameters:
    """Parameters of filters: margins are those of the case for every filter, as in SPARK."""
    p = case.parameters
    obstacle = FamilyParameters(
        margin=case.margin,
        alpha=p.alpha,
        epsilon=p.epsilon,
        eta=p.eta,
        slope=p.slope,
        push_cartesian=p.push_cartesian,
        push_joint=p.push_joint,
        slack_weight=p.slack_weight,
    )
    return BarrierParameters(obstacle=obstacle, self_collision=replace(obstacle, margin=case.self_margin))


def scores(case: BenchmarkCase, episode: Episode) -> dict[str, float | int | bool | None]:
    """Scores of an episode, those of the papers and sane ones beside them.

    ``J_arm``, ``J_base``, ``M_self``, ``M_env`` are SPARK's, a score of safety being 1 where no margin is entered;
    ``J`` (of the hands), ``C``, ``S``, ``R_feas`` those of p-SSA, ``None`` where nothing is counted.
    ``success_paper``: in the last step the mean of the hands' distances and that of the base are within their sizes,
    and nothing was ever touched, as SPARK counts. ``success``: all goals were reached at one time, and nothing was
    touched.
    """
    s, goals = episode.series, case.goals
    h, own, base = s["h_obstacle"], s["h_self_collision"], s["base"]
    depth, own_depth = case.margin - h, case.self_margin - own
    touched = np.any(h < -TOUCH, axis=1) | np.any(own < -TOUCH, axis=1)
    violated = np.any(depth > 0.0, axis=1) | np.any(own_depth > 0.0, axis=1)
    conditions = not np.isnan(s["violation"]).any()
    at_goal = bool(s["hands"][-1].mean() <= goals.hand_size and not base[-1] > goals.base_size)
    m_self, m_env = safety_score(own_depth), safety_score(depth)
    return {
        "steps": len(h),
        "J_arm": goal_score(s["hands"], goals.hand_size, HAND_SCALE),
        "J_base": None if np.isnan(base).all() else goal_score(base[:, None], goals.base_size, BASE_SCALE),
        "M_self": 1.0 if m_self is None else m_self,
        "M_env": 1.0 if m_env is None else m_env,
        "J": tracking_score(s["hands"]),
        "C": control_score(s["violation"]) if conditions else None,
        "S": safety_score(np.concatenate([depth, own_depth], axis=1)),
        "R_feas": feasible_rate(s["violation"]) if conditions else None,
        "success_paper": at_goal and not bool(touched.any()),
        "success": episode.goals_reached > 0 and not bool(touched.any()),
        "goals_reached": episode.goals_reached,
        "saturated": episode.saturated,
        "unstable": episode.unstable,
        "steps_in_margin": float(violated.mean()),
        "steps_in_collision": float(touched.mean()),
        "min_h_obstacle_m": float(h.min()) if h.size else None,
        "min_h_self_collision_m": float(own.min()),
        "starts_in_margin": bool(violated[0]),
        "free": not bool(touched[0]),
        "still": case.obstacles.motion == "still",
        "passed_unsafe": int(np.count_nonzero(s["status"] == FilterStatus.UNSAFE)),
        "filter_ms_median": float(np.median(s["filter_ms"])),
    }
