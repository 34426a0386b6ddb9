"""The recorder: an observer that keeps every tick and every physics step of a run in MuJoCo."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from controllers.agent import Agent, AgentOutput
from controllers.estimation.estimated_body import EstimatedBody
from controllers.whole_body.config import ControllerConfig, FilterTuning
from controllers.whole_body.controller import STAGES, TickResult
from experiments.recording.columns import Columns
from experiments.recording.recording import GUARANTEED, STOPPED, family_minima
from experiments.running.ground_truth import TrueBarriers
from experiments.running.laps import Laps
from experiments.running.loop import ClosedLoop, Observer
from robots.messages import Array, RobotState
from safety.filters.guarantee import RowBound, safety_bounds
from safety.filters.results import FilterStatus, explain
from safety.geometry.shapes import Obstacle
from sims.plant import MujocoPlant

NO_STAGES = np.full(len(STAGES), np.nan)
"""Times of the stages of a tick that was none."""

TrueObstacles = Callable[[float], list[Obstacle]]
"""What really is around the robot at a time [s]."""


def nothing(t: float) -> list[Obstacle]:
    """No obstacles."""
    return []


class Recorder(Observer):
    """Keeps what happens, and the barriers at the plant's true state.

    Args:
        plant: at its first posture.
        agent: that drives it.
        duration: longest time that is recorded [s].
        obstacles: what really is around the robot.
        laps: books where the time goes.
        estimated: the body, where the agent is told of an estimate.

    Attributes:
        first_relaxed: which conditions were given up first, and when, in words; ``None`` where all held.
        filter_changed_at: time of the first tick with another filter than at the start, or with other parameters of it
            [s]; the bounds are those of the first one, and end there. ``None`` where there was none.
    """

    def __init__(
        self,
        plant: MujocoPlant,
        agent: Agent,
        duration: float,
        obstacles: TrueObstacles = nothing,
        laps: Laps | None = None,
        estimated: EstimatedBody | None = None,
    ) -> None:
        self._estimated = estimated
        self.plant, self._agent, self._obstacles = plant, agent, obstacles
        self._laps = Laps() if laps is None else laps
        present = obstacles(0.0)
        self.truth = TrueBarriers(plant.robot, [o.kind for o in present])
        ticks = round(duration / agent.dt)
        self._ticks, self._steps = Columns(ticks), Columns(ticks * round(agent.dt / plant.config.dt))
        config = agent.controller.config
        self._first_filter = _filter_of(config)
        self._guarantees = safety_bounds(config.filter, config.safety.parameters())
        guarantee = self._guarantees.get("self_collision")
        self._row_bound = None if guarantee is None else RowBound(guarantee, plant.config.dt)
        self.first_relaxed: str | None = None
        self.filter_changed_at: float | None = None
        self._state = plant.true_state()
        self._zmp = plant.zero_moment_point()
        self._nowhere = np.full(self._state.v.size, np.nan)
        self._own_rows = agent.controller.barriers.own
        self._v_safe = self._nowhere

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: AgentOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        result = output.result
        if self.filter_changed_at is None and _filter_of(self._agent.controller.config) != self._first_filter:
            self.filter_changed_at = loop.time
        if self.first_relaxed is None and result is not None and result.safety.status == FilterStatus.RELAXED:
            labels = self._agent.controller.barriers.labels
            self.first_relaxed = f"at {loop.time:.3f} s: " + explain(result.safety, labels)
        row = self._body_row(loop.time) | self._reference_row() | {"tick_ms": 1e3 * seconds}
        if (own := self._own_rows).size:
            h = self._agent.controller.barriers.h[own]
            row["h_own"] = np.full(h.shape, np.nan) if result is None else h
        if self._estimated is not None:
            row |= self._estimate_row(self._estimated)
        answer = self._answer(result)
        self._v_safe = answer["v_safe"]
        self._ticks.append(row | answer)
        self._laps.book("recording")

    def _estimate_row(self, body: EstimatedBody) -> dict[str, Any]:
        estimate = body.estimate
        assert estimate is not None
        forces = np.full(2, np.nan) if estimate.foot_forces is None else estimate.foot_forces
        return {
            "q_estimated": estimate.q,
            "v_estimated": estimate.v,
            "foot_force_estimated": forces,
            "contact_estimated": np.ones(2) if estimate.contact is None else estimate.contact,
            "estimate_ms": 1e3 * body.seconds,
        }

    def _body_row(self, t: float) -> dict[str, Any]:
        # the instant of the last plant step, so what was measured then need not be worked out again
        state, plant = self._state, self.plant
        load = self._agent.controller.load
        row = {
            "time": t,
            "q": state.q,
            "v": state.v,
            "torque": state.tau,
            "com": plant.center_of_mass(),
            "load_scale": 1.0 if load is None else load.scale,
            "zmp": self._zmp,
            "foot_wrench": plant.contact_wrenches(),
            "corners": plant.sole_corners(),
        }
        if bodies := self._obstacles(t):
            row["obstacles"] = np.array([body.position for body in bodies])
            if spheres := [body for body in bodies if body.kind == "sphere"]:
                row["obstacle"] = np.append(spheres[0].position, spheres[0].radius)
        return row

    def _reference_row(self) -> dict[str, Any]:
        reference, plant = self._agent.reference, self.plant
        row: dict[str, Any] = {
            "com_ref": reference.com.position,
            "in_contact": reference.in_contact.astype(float),
            "soles_ref": np.array([point.position for point in reference.soles]),
        }
        if reference.dcm is not None:
            row["dcm_ref"], row["zmp_ref"] = reference.dcm.position, reference.dcm.zmp
        if reference.hands is not None:
            for name, point in zip(("left_hand", "right_hand"), reference.hands, strict=True):
                row[name] = plant.frame_position(plant.robot.roles[name])
                row[f"{name}_ref"] = point.position
        return row

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

    def stepped(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.stepped`."""
        plant, pairs, book = self.plant, self.truth.slices["self_collision"], self._laps.book
        state = self._state = plant.true_state()
        self._zmp = plant.zero_moment_point()
        book("state")
        rows = self.truth.evaluate(state.q, self._obstacles(plant.time))
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
        out["h_bound"] = self._bounds(out)
        if self.filter_changed_at is not None:
            ended = out["step_time"] > self.filter_changed_at + 0.5 * self.plant.config.dt
            out["h_bound"][ended], out["h_row_bound"][ended] = np.nan, np.nan
        return out

    def _bounds(self, series: dict[str, Array]) -> Array:
        """Running bound of each family of ``GUARANTEED``, shape (P, 5); NaN where nothing is guaranteed."""
        h = family_minima(series, len(self.plant.robot.leg_pairs))
        bounds = np.full(h.shape, np.nan)
        for i, family in enumerate(GUARANTEED):
            if family in self._guarantees and np.isfinite(h[0, i]):
                # h is known from the end of the first step on
                guarantee = self._guarantees[family]
                bounds[0, i] = min(h[0, i], guarantee.margin)
                disturbance, gradient = series["disturbance"][1:], series["gradient"][1:, i]
                bounds[1:, i] = guarantee.running_bound(h[0, i], disturbance, gradient, self.plant.config.dt)
        return bounds


def _filter_of(config: ControllerConfig) -> tuple[str, bool, FilterTuning]:
    """What bounds are guaranteed by: the filter and its parameters."""
    return config.filter, config.adaptive, config.safety


class Progress(Observer):
    """Tells how far the run is, now and then."""

    EVERY = 50

    def __init__(self, tell: Callable[[float], None]) -> None:
        """``tell`` is called with the time that has passed [s]."""
        self._tell = tell

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        if loop.ticks % self.EVERY == 1:
            self._tell(loop.time - loop.agent.dt)
        return False

    def ended(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.ended`."""
        self._tell(loop.time)
