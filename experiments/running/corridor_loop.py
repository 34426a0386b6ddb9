"""One filter in the corridor: the closed loop, what is kept of it, and its figures of merit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.policies.kinematic_agent import KinematicAgent, KinematicOutput
from controllers.policies.nominal import NominalPolicy, benchmark_limits
from experiments.metrics.balance import versions
from experiments.metrics.scores import TOUCH, control_score, feasible_rate, safety_score, tracking_score
from experiments.recording.recording import Recording, description_digest
from experiments.running.guarded import Guarded, raise_errors_of
from experiments.running.laps import Laps
from experiments.running.loop import ClosedLoop, Observer
from experiments.scenarios.corridor import (
    CLOSING,
    COLLISION_MODEL,
    D_MIN,
    HAND_BODIES,
    HAND_OFFSETS,
    OBSTACLES,
    Corridor,
    corridor_kinematics,
    corridor_robot,
    rest_posture,
    start_posture,
)
from experiments.scenarios.corridor_case import CorridorCase
from robots.checks import require_between, require_one_of, require_positive
from robots.description import RobotDescription
from robots.messages import Array, RobotState
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, ObstacleBarrier, SelfCollisionBarrier
from safety.barriers.rows import BarrierRows
from safety.filters.conditions import SET_MARGINS, BarrierParameters, FamilyParameters, RowParameters, ssa
from safety.filters.safety_filter import (
    KINDS,
    RELAXED,
    FilterResult,
    FilterSettings,
    FilterStatus,
    SafetyFilter,
    explain,
)
from safety.geometry.shapes import Obstacle
from sims.kinematic import KinematicPlant

DT = 0.01
"""Control period [s]: 100 Hz."""

NAIVE = "ssa-naive"

VARIANTS = (NAIVE, *(name for name, kind in KINDS.items() if 1 in kind.orders))
"""What ``--filters`` takes: SSA as the paper's baseline, and every filter of velocities."""

Conflict = tuple[float, FilterResult]
"""Time [s], and what a filter answered then."""


@dataclass(frozen=True, slots=True)
class CorridorRun:
    """One filter's way through the scene.

    ``series`` holds per tick (T of them): ``time`` (T,) [s]; ``q`` (T, 17) [rad]; ``v_des``, ``v_safe`` (T, 17)
    [rad/s]; ``hands``, ``goals`` (T, 2, 3), left first, world [m]; ``h_obstacle`` (T, 19, 3), distances of bodies to
    lower board, upper board and sphere [m]; ``h_self_collision`` (T, 29), of the robot's pairs [m]; ``violation`` (T,),
    sum of the violations of the filter's conditions, and ``violation_norm`` (T,), root of the sum of their squares
    [m/s]; ``least_norm`` (T,), the least that this could be at the same state [m/s], NaN for conditions other than
    SSA's; ``infeasible`` (T,), whether no velocity meets all conditions; ``status`` (T,), of the filter; ``filter_ms``
    (T,) [ms].

    Attributes:
        name: as ``--filters`` takes it.
        title: for people.
        summary: figures of merit, JSON-able.
        series: as above.
        explanation: of the first tick in which the conditions could not all be met, and of the worst, in words.
    """

    name: str
    title: str
    summary: Mapping[str, Any]
    series: Mapping[str, NDArray[Any]]
    explanation: str


def variant_title(name: str) -> str:
    """One of ``VARIANTS`` as a reader knows it."""
    return {NAIVE: "SSA, naive", "ssa": "SSA, least slack"}.get(name) or KINDS[name].title


MARGINS = ("shared", "own")
"""Whether CBF and ISSf-CBF keep the same margin as SSA and its kin, or none, as in their own paper."""


class CorridorLoop:
    """One filter in closed loop with a robot that follows it exactly; collisions are counted, not prevented."""

    def __init__(
        self, robot: RobotDescription, scene: Corridor, name: str, weight: float = 10.0, margins: str = "shared"
    ) -> None:
        """For one of ``VARIANTS``; ``weight``: Q_s of r-SSA; ``margins``: one of ``MARGINS``.

        Raises:
            ConfigError: no such filter, or a weight that is not above 0.
        """
        require_one_of("filters", name, VARIANTS)
        require_positive("weight", weight)
        require_one_of("margins", margins, MARGINS)
        self.scene, self.name = scene, name
        self.kin = corridor_kinematics(robot)
        start = start_posture(self.kin)
        self.kin.update_geometry(start)
        bodies = CollisionBodies(self.kin)
        self.obstacle_barrier = ObstacleBarrier(bodies, scene.kinds, bodies.names)
        own = SelfCollisionBarrier("self_collision", bodies, robot.self_collision_pairs)
        self.barriers = BarrierSet(self.kin, bodies, [own, self.obstacle_barrier])
        self.labels = tuple(_readable(label) for label in self.barriers.labels)
        limits = benchmark_limits(self.kin)
        points = [(robot.collisions[bodies.names.index(n)].body, offset) for n, offset in HAND_OFFSETS.items()]
        self.policy = NominalPolicy(self.kin, points, rest_posture(self.kin), limits=limits)
        self.plant = KinematicPlant(self.kin, start)
        shared = SET_MARGINS if margins == "shared" else dict.fromkeys(SET_MARGINS)
        family = {f: FamilyParameters(slack_weight=weight, margin=shared[f]) for f in D_MIN}
        parameters = BarrierParameters(**family)
        chosen, action = ("ssa", "unsafe_pass_nominal") if name == NAIVE else (name, "least_slack")
        self.kind = KINDS[chosen]
        n = self.barriers.size
        self.filter = SafetyFilter(chosen, n, parameters, limits, settings=FilterSettings(infeasible=action))
        self.agent = KinematicAgent(self.kin, self.policy, self.barriers, self.filter, DT, self)
        self._probe = SafetyFilter("ssa", n, parameters, limits)
        self._ssa_rows = parameters.of_rows(self.barriers.evaluate(self.kin).family, SET_MARGINS)

    def move_goals(self, t: float) -> None:
        """See :meth:`controllers.policies.kinematic_agent.Surroundings.move_goals`."""
        for task, goal in zip(self.policy.points, self.scene.hand_goals(t), strict=True):
            task.position = goal

    def obstacles(self, t: float) -> list[Obstacle]:
        """See :meth:`controllers.policies.kinematic_agent.Surroundings.obstacles`."""
        return self.scene.obstacles(t)

    def run(self, duration: float, observers: Sequence[Observer] = (), laps: Laps | None = None) -> CorridorRun:
        """Run for ``duration`` [s]; ``observers`` are told of every tick, and may end it before."""
        recorder = CorridorRecorder(self, SsaProbe(self._probe, self._ssa_rows))
        ClosedLoop(self.plant, self.agent, observers=[recorder, *observers], laps=laps).run(duration)
        series, explanation = recorder.series(), recorder.explanation()
        head = {"name": self.name, "filter": self.kind.name, "infeasible_action": self.filter.settings.infeasible}
        cause = next((observer.ended_by for observer in observers if observer.ended_by), None)
        ended = {"stop_cause": cause, "explanation": explanation}
        return CorridorRun(
            self.name, variant_title(self.name), head | summarise(series, self) | ended, series, explanation
        )


@dataclass(frozen=True, slots=True)
class SsaProbe:
    """Asked every tick whether SSA's conditions can be met, and what the least violation is.

    Attributes:
        filter: SSA with least slack.
        parameters: of its rows.
    """

    filter: SafetyFilter
    parameters: RowParameters


class CorridorRecorder(Observer):
    """Keeps every tick in the corridor, and the conflicts that are worth telling."""

    def __init__(self, loop: CorridorLoop, probe: SsaProbe) -> None:
        self._of, self._probe = loop, probe
        self._conflicts: dict[str, Conflict] = {}
        self._ticks: list[dict[str, Any]] = []

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: KinematicOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        of, t, rows, result = self._of, state.stamp, output.rows, output.result
        least = self._probe.filter.apply(rows, output.v_des)
        of_ssa = of.kind.condition is ssa or not of.kind.joint
        infeasible = (least if of_ssa else result).status == FilterStatus.RELAXED
        violations = self._violations(rows, result)
        if infeasible:
            # filters that look at one row at a time know of no conflict
            self._note(t, least if result.candidates is None else result)
        self._ticks.append(
            {
                "time": t,
                "q": state.q,
                "v_des": output.v_des,
                "v_safe": result.v,
                "hands": np.array([task.place(of.kin) for task in of.policy.points]),
                "goals": of.scene.hand_goals(t),
                "h_obstacle": rows.h[of.barriers.slices["obstacle"]].reshape(-1, of.obstacle_barrier.count).copy(),
                "h_self_collision": rows.h[of.barriers.slices["self_collision"]].copy(),
                "violation": float(violations.sum()),
                "violation_norm": float(np.linalg.norm(violations)),
                "least_norm": float(np.linalg.norm(least.violation)) if of_ssa else np.nan,
                "infeasible": infeasible,
                "status": int(result.status),
                "filter_ms": 1e3 * output.filter_seconds,
            }
        )

    def series(self) -> dict[str, NDArray[Any]]:
        """Everything recorded."""
        return {name: np.array([tick[name] for tick in self._ticks]) for name in self._ticks[0]}

    def _note(self, t: float, result: FilterResult) -> None:
        """Keep the first conflict, the first one of closed boards, and the one with the largest violation."""
        self._conflicts.setdefault("first", (t, result))
        if t >= CLOSING[1]:
            self._conflicts.setdefault("boards closed", (t, result))
        worst = self._conflicts.get("worst")
        if worst is None or result.violation.sum() > worst[1].violation.sum():
            self._conflicts["worst"] = (t, result)

    def explanation(self) -> str:
        """The conflicts that were kept, in words."""
        if not self._conflicts:
            return "every tick had a velocity that met all conditions"
        kept = sorted(self._conflicts.items(), key=lambda item: item[1][0])
        return "\n".join(f"{words}, at {t:.2f} s: {self._explain(result)}" for words, (t, result) in kept)

    def _violations(self, rows: BarrierRows, result: FilterResult) -> Array:
        """Amounts by which conditions are violated [m/s]: SSA's, where a filter has none of its own for all rows."""
        if self._of.kind.joint:
            return result.violation
        spaces = ssa(rows, self._probe.parameters)
        gap = (spaces.b - spaces.A @ result.v)[spaces.active]
        return gap[gap > RELAXED]

    def _explain(self, result: FilterResult) -> str:
        kind = {
            0: "the relaxed conditions could hold",
            1: "one condition alone: the joints are not fast enough (kinematics infeasibility)",
        }.get(len(result.conflict()), "each alone could be met, together they cannot (method infeasibility)")
        return f"{explain(result, self._of.labels)}\n  {kind}"


def corridor_loop(case: CorridorCase) -> CorridorLoop:
    """The loop of a case.

    Raises:
        ConfigError: one of its fields is not allowed.
    """
    require_between("duration", case.duration, 0.1, 120.0)
    if case.seed is not None:
        require_between("seed", case.seed, 0, 2**63 - 1)
    return CorridorLoop(corridor_robot(), Corridor(case.gap, case.seed), case.filter, case.weight, case.margins)


def run_case(case: CorridorCase, observers: Sequence[Observer] = (), laps: Laps | None = None) -> Recording:
    """Run one filter through the corridor; arguments and result as of :func:`experiments.running.run.run`."""
    loop, guarded = corridor_loop(case), [Guarded(observer) for observer in observers]
    recording = recording_of(case, loop, loop.run(case.duration, guarded, laps))
    raise_errors_of(guarded, recording)
    return recording


def recording_of(case: CorridorCase, loop: CorridorLoop, run: CorridorRun) -> Recording:
    """A finished run as it is saved."""
    robot = corridor_robot()
    config = {
        "scenario": case.to_json(),
        "robot": "g1",
        "collision_model": COLLISION_MODEL,
        "robot_digest": description_digest(robot),
        "dt": DT,
        "d_min": D_MIN,
        "rows": loop.labels,
    }
    return Recording(robot, config, {"scenario": case.name, **run.summary, "versions": versions()}, run.series)


def _readable(label: str) -> str:
    """A row's label with the obstacle's name, and without underscores."""
    for i, name in enumerate(OBSTACLES):
        label = label.replace(f"obstacle {i}", name)
    return label.replace("_", " ")


def summarise(series: dict[str, NDArray[Any]], loop: CorridorLoop) -> dict[str, Any]:
    """Figures of merit of one run; ``loop`` is the one that made the series."""
    h, own = series["h_obstacle"], series["h_self_collision"]
    names = loop.obstacle_barrier.bodies.names if loop.obstacle_barrier.bodies is not None else ()
    hands = [names.index(n) for n in HAND_BODIES]
    depth, own_depth = D_MIN["obstacle"] - h, D_MIN["self_collision"] - own
    flat = np.concatenate([depth.reshape(len(h), -1), own_depth], axis=1)
    lower, upper = loop.kin.position_limits
    jumps = np.abs(np.diff(series["v_safe"], axis=0)).max(axis=1) if len(h) > 1 else np.zeros(1)
    violation, duration = series["violation"], DT * len(h)
    touched = np.concatenate([own, h.reshape(len(h), -1)], axis=1) < -TOUCH
    return {
        "duration_s": duration,
        "J": tracking_score(np.linalg.norm(series["hands"] - series["goals"], axis=2)),
        "C": control_score(violation),
        "S": safety_score(flat),
        "S_environment": safety_score(depth),
        "S_self": safety_score(own_depth),
        "feasible_rate": feasible_rate(violation),
        "infeasible_ticks": int(series["infeasible"].sum()),
        "phi_hand_max_m": float(depth[:, hands[0]].max()),
        "min_h_hand_m": float(h[:, hands].min()),
        "min_h_obstacle_m": float(h.min()),
        "min_h_self_collision_m": float(own.min()),
        "min_joint_limit_rad": float(min((series["q"] - lower).min(), (upper - series["q"]).min())),
        "collision_ticks": int(touched.any(axis=1).sum()),
        "collisions": [loop.labels[i] for i in np.flatnonzero(touched.any(axis=0))],
        "violation_mean": float(violation.mean()),
        "excess_mean": _finite(float((series["violation_norm"] - series["least_norm"]).mean())),
        "switches_per_s": float(np.count_nonzero(np.diff(flat > 0, axis=0)) / duration),
        "jump_rms": float(np.sqrt(np.mean(jumps**2))),
        "filter_ms_median": float(np.median(series["filter_ms"])),
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
