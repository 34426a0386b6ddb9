"""The closed loop: plant, supervisor, references; everything recorded."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.supervisor import Supervisor
from controllers.whole_body import STAGES, TickResult
from experiments.encounter import Encounter
from experiments.results import GUARANTEED, STOPPED, family_minima
from experiments.scenario import Cast, Push
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.rotation import rotation_from_quaternion
from safety.barriers import ObstacleBarrier, standard_barriers
from safety.filters import FilterStatus, explain
from safety.guarantee import RowBound, promises
from safety.obstacles import Obstacle
from safety.rows import BarrierRows
from sims.plant import MujocoPlant

FALL_TILT = np.cos(np.deg2rad(60.0))
"""Cosine of the base's tilt from which the robot counts as fallen."""

FALL_HEIGHT = 0.6
"""Share of its first height below which the base counts as fallen."""

AFTERMATH = 0.5
"""Time that is still simulated after a fall or a stop [s]."""

GAIT_AFTERMATH = 4.0
"""The same after a stop that leaves it to a gait to come to rest on both feet [s]."""


@dataclass(slots=True)
class LoopOutcome:
    """How a run ended: time of a fall [s] or ``None``, time simulated [s]."""

    fell_at: float | None
    duration: float


class TrueBarriers:
    """Barriers at the plant's true state, by a model of its own: nothing the controller believes enters.

    Of the rows of a pair only the distance is kept.
    """

    def __init__(self, robot: RobotDescription, obstacle_kinds: Sequence[str]) -> None:
        self._kin = Kinematics(robot)
        self._set = standard_barriers(self._kin, obstacle_kinds, keep_fixed=True)
        self._obstacles = next((b for b in self._set.barriers if isinstance(b, ObstacleBarrier)), None)
        self._kept = np.concatenate(list(self._set.primary.values()))
        ends = np.cumsum([rows.size for rows in self._set.primary.values()])
        self.slices = {f: slice(e - r.size, e) for (f, r), e in zip(self._set.primary.items(), ends, strict=True)}

    def evaluate(self, q: Array, obstacles: Sequence[Obstacle] = ()) -> BarrierRows:
        """Rows at a true configuration (nq,) among the true obstacles."""
        self._kin.update_geometry(q)
        if self._obstacles is not None:
            self._obstacles.set_obstacles(obstacles)
        rows, kept = self._set.evaluate(self._kin), self._kept
        return BarrierRows(rows.h[kept], rows.jac[kept], rows.drift[kept], rows.family[kept])

    def gradients(self, rows: BarrierRows) -> Array:
        """Largest size of a row of the Jacobian in each family of ``GUARANTEED``, NaN where it has no rows."""
        squared = np.vecdot(rows.jac, rows.jac)
        parts = (squared[self.slices.get(family, slice(0, 0))] for family in GUARANTEED)
        return np.sqrt([part.max() if part.size else np.nan for part in parts])


class ClosedLoop:
    """Runs a supervised controller against a plant and records both.

    Args:
        plant: the plant, reset to its first posture.
        supervisor: of the controller.
        cast: references at the start, and what changes them before every tick.
        encounter: an obstacle; the controller must have been made for one.
        nan_at: from this time on one measured joint position is NaN [s]; ``None`` for never.
        progress: called with the simulated time [s] now and then.
        pushes: on the torso.
    """

    def __init__(
        self,
        plant: MujocoPlant,
        supervisor: Supervisor,
        cast: Cast,
        encounter: Encounter | None = None,
        nan_at: float | None = None,
        progress: Callable[[float], None] | None = None,
        pushes: Sequence[Push] = (),
    ) -> None:
        self.plant = plant
        self.supervisor = supervisor
        self.reference, self.gait, self.motions = cast.reference, cast.gait, cast.motions
        self.encounter = encounter
        self.nan_at = nan_at
        self.progress = progress
        self.pushes = pushes
        self.truth = TrueBarriers(plant.robot, () if encounter is None else ("sphere",))
        self.ticks: list[dict[str, Array | float | int]] = []
        self.steps: list[dict[str, Array | float]] = []
        config = supervisor.controller.config
        self._promises = promises(config.filter, config.safety.parameters())
        promise = self._promises.get("self_collision")
        self._row_bound = None if promise is None else RowBound(promise, plant.config.dt)
        self.first_relaxed: str | None = None
        self._state = plant.true_state()
        self._start_height = float(self._state.q[2])

    def run(self, duration: float) -> LoopOutcome:
        """Run for ``duration`` [s], or until shortly after a fall or a stop."""
        dt = self.supervisor.controller.config.dt
        substeps = round(dt / self.plant.config.dt)
        end, fell_at = duration, None
        self.supervisor.controller.reset(self.plant.measured_state())
        for i in range(round(duration / dt)):
            t = i * dt
            if t >= end - 0.5 * dt:
                break
            self._tick(t)
            for _ in range(substeps):
                if self.pushes:
                    self.plant.push(sum((p.at(self.plant.time) for p in self.pushes), np.zeros(3)))
                self.plant.step()
                self._record_step()
            if self.plant.unstable:
                self.supervisor.hold("the simulation became unstable: try a smaller physics step", self.plant.time)
                break
            if fell_at is None and self._fallen():
                fell_at = self.plant.time
                end = min(end, t + AFTERMATH)
            if self.supervisor.cause is not None:
                rest = AFTERMATH if self.gait is None or self.supervisor.blind else GAIT_AFTERMATH
                end = min(end, self.supervisor.stopped_at + rest)
            if self.progress is not None and i % 50 == 0:
                self.progress(t)
        if self.progress is not None:
            self.progress(self.plant.time)
        return LoopOutcome(fell_at, self.plant.time)

    def _tick(self, t: float) -> None:
        state = self._measure(t)
        start = time.perf_counter()
        self._move_references(t, state)
        command, result = self.supervisor.tick(state, self.reference, self._believed_obstacles(t))
        elapsed = time.perf_counter() - start
        if self.first_relaxed is None and result is not None and result.safety.status == FilterStatus.RELAXED:
            self.first_relaxed = f"at {t:.3f} s: " + explain(result.safety, self.supervisor.controller.barriers.labels)
        self.plant.send(command)
        self._record_tick(t, result, elapsed)

    def _move_references(self, t: float, state: RobotState) -> None:
        """References of this tick. After a stop a gait comes to rest, and hands stay where they are beside it."""
        stopped = self.supervisor.cause is not None
        if self.gait is not None:
            if stopped:
                self.gait.stop()
            if all_finite(state.q, state.v):
                self.gait.apply(self.reference, t, state)
        for motion in self.motions:
            motion.apply(self.reference, min(t, self.supervisor.stopped_at) if stopped else t)
        if stopped:
            for hand in self.reference.hands or ():
                hand.velocity, hand.acceleration = np.zeros(3), np.zeros(3)

    def _believed_obstacles(self, t: float) -> list[Obstacle]:
        """What the controller is told of obstacles; a track that is too old stops the robot."""
        if self.encounter is None:
            return []
        if fault := self.encounter.sense(t):
            self.supervisor.hold(fault, t)
            return []
        return self.encounter.believed(t)

    def _measure(self, t: float) -> RobotState:
        state = self.plant.measured_state()
        if self.nan_at is not None and t >= self.nan_at:
            state.q[7] = np.nan
        return state

    def _record_tick(self, t: float, result: TickResult | None, elapsed: float) -> None:
        # the instant of the last plant step, so what was measured then need not be worked out again
        state, zmp = self._state, self.steps[-1]["step_zmp"] if self.steps else self.plant.zero_moment_point()
        nan = np.full(state.v.size, np.nan)
        controller, corners = self.supervisor.controller, self.plant.sole_corners()
        row: dict[str, Array | float | int] = {
            "time": t,
            "q": state.q,
            "v": state.v,
            "torque": state.tau,
            "com": self.plant.center_of_mass(),
            "com_ref": self.reference.com.position.copy(),
            "in_contact": self.reference.in_contact.astype(float),
            "soles_ref": np.array([point.position for point in self.reference.soles]),
            "load_scale": 1.0 if controller.load is None else controller.load.scale,
            "zmp": zmp,
            "foot_wrench": self.plant.contact_wrenches(),
            "v_des": nan if result is None else result.v_des,
            "v_safe": nan if result is None else result.safety.v,
            "filter_status": STOPPED if result is None else int(result.safety.status),
            "filter_slack": np.nan if result is None else result.safety.slack,
            "qp_failed": 0 if result is None else int(result.dynwbc.status != "optimal"),
            "stages": np.full(len(STAGES), np.nan) if result is None else result.stage_seconds,
            "tick_ms": 1e3 * elapsed,
            "soles": corners.mean(axis=1),
            "sole_corners": corners[:, :, :2],
        }
        if self.reference.dcm is not None:
            row["dcm_ref"], row["zmp_ref"] = self.reference.dcm.position, self.reference.dcm.zmp
        if self.reference.hands is not None:
            for name, point in zip(("left_hand", "right_hand"), self.reference.hands, strict=True):
                row[name] = self.plant.frame_position(self.plant.robot.roles[name])
                row[f"{name}_ref"] = point.position
        if self.encounter is not None:
            sphere = self.encounter.sphere
            row["obstacle"] = np.append(sphere.position(t), sphere.radius)
        self.ticks.append(row)

    def _record_step(self) -> None:
        plant, cut = self.plant, self.truth.slices
        obstacles = [] if self.encounter is None else self.encounter.true(plant.time)
        state = self._state = plant.true_state()
        rows = self.truth.evaluate(state.q, obstacles)
        h, pairs = rows.h, cut["self_collision"]
        disturbance = state.v - self.ticks[-1]["v_safe"]
        row_bound = np.nan
        if self._row_bound is not None:
            row_bound = self._row_bound.advance(h[pairs], rows.jac[pairs], disturbance)
        self.steps.append(
            {
                "h_obstacle": float(h[cut["obstacle"]].min()) if obstacles else np.inf,
                "step_time": plant.time,
                "h_self_collision": h[pairs.start : cut["leg_collision"].stop].astype(np.float32),
                "h_joint_limit": float(h[cut["joint_limit"]].min()),
                "h_workspace": h[cut["workspace"]].copy(),
                "step_zmp": plant.zero_moment_point(),
                "torque_fraction": np.abs(plant.torque) / plant.effort,
                "disturbance": float(np.linalg.norm(disturbance)),
                "gradient": self.truth.gradients(rows),
                "h_row_bound": row_bound,
            }
        )

    def _fallen(self) -> bool:
        q = self._state.q
        upright = rotation_from_quaternion(q[3:7])[2, 2]
        return bool(upright < FALL_TILT or q[2] < FALL_HEIGHT * self._start_height)

    def series(self) -> dict[str, Array]:
        """Everything recorded, stacked."""
        out = {key: np.array([row[key] for row in self.ticks]) for key in self.ticks[0]}
        out |= {key: np.array([row[key] for row in self.steps]) for key in self.steps[0]}
        return out | {"h_bound": self._bounds(out)}

    def _bounds(self, series: dict[str, Array]) -> Array:
        """Running bound of each family of ``GUARANTEED``, shape (P, 5); NaN where nothing is promised."""
        h = family_minima(series, len(self.plant.robot.leg_pairs))
        bounds = np.full(h.shape, np.nan)
        for i, family in enumerate(GUARANTEED):
            if family in self._promises and np.isfinite(h[0, i]):
                # h is known from the end of the first step on
                promise = self._promises[family]
                bounds[0, i] = min(h[0, i], promise.margin)
                disturbance, gradient = series["disturbance"][1:], series["gradient"][1:, i]
                bounds[1:, i] = promise.running_bound(h[0, i], disturbance, gradient, self.plant.config.dt)
        return bounds
