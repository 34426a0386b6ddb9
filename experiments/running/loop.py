"""The closed loop: plant, supervisor, references; everything recorded."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.supervisor import Supervisor
from controllers.whole_body.controller import STAGES, TickResult
from experiments.recording.columns import Columns
from experiments.recording.recording import GUARANTEED, STOPPED, family_minima
from experiments.running.ground_truth import TrueBarriers
from experiments.running.laps import Laps
from experiments.scenarios.obstacles import Encounter
from experiments.scenarios.scenario import Cast, Push
from robots.checks import all_finite
from robots.messages import Array, RobotState
from safety.filters.guarantee import RowBound, promises
from safety.filters.safety_filter import FilterStatus, explain
from safety.geometry.shapes import Obstacle
from sims.plant import MujocoPlant

FALL_TILT = np.cos(np.deg2rad(60.0))
"""Cosine of the base's tilt from which the robot counts as fallen."""

FALL_HEIGHT = 0.6
"""Share of its first height below which the base counts as fallen."""

AFTERMATH = 0.5
"""Time that is still simulated after a fall or a stop [s]."""

NO_STAGES = np.full(len(STAGES), np.nan)
"""Times of the stages of a tick that was none."""

GAIT_AFTERMATH = 4.0
"""The same after a stop that leaves it to a gait to come to rest on both feet [s]."""


@dataclass(slots=True)
class LoopOutcome:
    """How a run ended: time of a fall [s] or ``None``, time simulated [s]."""

    fell_at: float | None
    duration: float


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
        laps: books where the time goes.
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
        laps: Laps | None = None,
    ) -> None:
        self.plant = plant
        self.supervisor = supervisor
        self.reference, self.gait, self.motions = cast.reference, cast.gait, cast.motions
        self.encounter = encounter
        self.nan_at = nan_at
        self.progress = progress
        self.pushes = pushes
        self.laps = Laps() if laps is None else laps
        self.truth = TrueBarriers(plant.robot, () if encounter is None else ("sphere",))
        self._ticks, self._steps = Columns(0), Columns(0)
        config = supervisor.controller.config
        self._promises = promises(config.filter, config.safety.parameters())
        promise = self._promises.get("self_collision")
        self._row_bound = None if promise is None else RowBound(promise, plant.config.dt)
        self.first_relaxed: str | None = None
        self._state = plant.true_state()
        self._zmp = plant.zero_moment_point()
        self._nowhere = np.full(self._state.v.size, np.nan)
        self._v_safe = self._nowhere
        self._start_height = float(self._state.q[2])

    def run(self, duration: float) -> LoopOutcome:
        """Run for ``duration`` [s], or until shortly after a fall or a stop."""
        dt = self.supervisor.controller.config.dt
        substeps = round(dt / self.plant.config.dt)
        end, fell_at, ticks = duration, None, round(duration / dt)
        self._ticks, self._steps = Columns(ticks), Columns(ticks * substeps)
        self.supervisor.controller.reset(self.plant.measured_state())
        for i in range(ticks):
            t = i * dt
            if t >= end - 0.5 * dt:
                break
            self._tick(t)
            self._advance(substeps)
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

    def _advance(self, substeps: int) -> None:
        """Let the plant move for a control period."""
        for _ in range(substeps):
            if self.pushes:
                self.plant.push(sum((p.at(self.plant.time) for p in self.pushes), np.zeros(3)))
            self.laps.book("rest")
            self.plant.step()
            self.laps.book("plant")
            self._record_step()

    def _tick(self, t: float) -> None:
        book = self.laps.book
        book("rest")
        state = self._measure(t)
        book("state")
        start = time.perf_counter()
        self._move_references(t, state)
        believed = self._believed_obstacles(t)
        book("references")
        command, result = self.supervisor.tick(state, self.reference, believed)
        elapsed = time.perf_counter() - start
        book("tick")
        if self.first_relaxed is None and result is not None and result.safety.status == FilterStatus.RELAXED:
            self.first_relaxed = f"at {t:.3f} s: " + explain(result.safety, self.supervisor.controller.barriers.labels)
        self.plant.send(command)
        book("rest")
        self._record_tick(t, result, elapsed)
        book("recording")

    def _move_references(self, t: float, state: RobotState) -> None:
        """References of this tick. After a stop a gait comes to rest, and hands stay where they are beside it."""
        stopped = self.supervisor.cause is not None
        if self.gait is not None:
            if stopped:
                self.gait.stop()
            if all_finite(state.q, state.v):
                kin = self.supervisor.controller.kin
                kin.update(state.q, state.v)
                self.gait.apply(self.reference, t, state, kin)
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
        state, plant, reference = self._state, self.plant, self.reference
        load = self.supervisor.controller.load
        row: dict[str, Array | float] = {
            "time": t,
            "q": state.q,
            "v": state.v,
            "torque": state.tau,
            "com": plant.center_of_mass(),
            "com_ref": reference.com.position,
            "in_contact": reference.in_contact.astype(float),
            "soles_ref": np.array([point.position for point in reference.soles]),
            "load_scale": 1.0 if load is None else load.scale,
            "zmp": self._zmp,
            "foot_wrench": plant.contact_wrenches(),
            "corners": plant.sole_corners(),
            "tick_ms": 1e3 * elapsed,
        }
        if reference.dcm is not None:
            row["dcm_ref"], row["zmp_ref"] = reference.dcm.position, reference.dcm.zmp
        if reference.hands is not None:
            for name, point in zip(("left_hand", "right_hand"), reference.hands, strict=True):
                row[name] = plant.frame_position(plant.robot.roles[name])
                row[f"{name}_ref"] = point.position
        if self.encounter is not None:
            sphere = self.encounter.sphere
            row["obstacle"] = np.append(sphere.position(t), sphere.radius)
        answer = self._answer(result)
        self._v_safe = answer["v_safe"]
        self._ticks.append(row | answer)

    def _answer(self, result: TickResult | None) -> dict[str, Any]:
        """What is recorded of the controller's answer; ``None`` once it is not asked any more."""
        if result is None:
            return {
                "v_des": self._nowhere,
                "v_safe": self._nowhere,
                "filter_status": STOPPED,
                "filter_slack": np.nan,
                "qp_failed": 0,
                "stages": NO_STAGES,
            }
        return {
            "v_des": result.v_des,
            "v_safe": result.safety.v,
            "filter_status": int(result.safety.status),
            "filter_slack": result.safety.slack,
            "qp_failed": int(result.dynwbc.status != "optimal"),
            "stages": result.stage_seconds,
        }

    def _record_step(self) -> None:
        plant, pairs, book = self.plant, self.truth.slices["self_collision"], self.laps.book
        state = self._state = plant.true_state()
        self._zmp = plant.zero_moment_point()
        book("state")
        obstacles = [] if self.encounter is None else self.encounter.true(plant.time)
        rows = self.truth.evaluate(state.q, obstacles)
        disturbance = state.v - self._v_safe
        row_bound = np.nan
        if self._row_bound is not None:
            row_bound = self._row_bound.advance(rows.h[pairs], rows.jac[pairs], disturbance)
        gradients = self.truth.gradients(rows)
        book("true barriers")
        self._steps.append(
            {
                "step_time": plant.time,
                "h": rows.h,
                "step_zmp": self._zmp,
                "step_torque": plant.torque,
                "disturbance": math.sqrt(disturbance @ disturbance),
                "gradient": gradients,
                "h_row_bound": row_bound,
            }
        )
        book("recording")

    def _fallen(self) -> bool:
        q = self._state.q
        upright = 1 - 2 * (q[3] * q[3] + q[4] * q[4])
        return bool(upright < FALL_TILT or q[2] < FALL_HEIGHT * self._start_height)

    def series(self) -> dict[str, Array]:
        """Everything recorded, and what follows from it."""
        ticks, steps = self._ticks.arrays(), self._steps.arrays()
        corners, h, torque = ticks.pop("corners"), steps.pop("h"), steps.pop("step_torque")
        cut = self.truth.slices
        out = ticks | steps
        out["soles"], out["sole_corners"] = corners.mean(axis=2), np.ascontiguousarray(corners[..., :2])
        out["torque_fraction"] = np.abs(torque) / self.plant.effort
        out["h_self_collision"] = h[:, cut["self_collision"].start : cut["leg_collision"].stop].astype(np.float32)
        out["h_joint_limit"] = h[:, cut["joint_limit"]].min(axis=1)
        out["h_workspace"] = h[:, cut["workspace"]].copy()
        out["h_obstacle"] = h[:, cut.get("obstacle", slice(0))].min(axis=1, initial=np.inf)
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
