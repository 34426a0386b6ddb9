"""A start with an arm deep inside the torso: how every filter leaves it, with and without bounds on the way out."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from controllers.agent import Agent, AgentOutput
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.robot_config import controller_config
from experiments.metrics.metric import Metric
from experiments.running.loop import ClosedLoop, Observer
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.filters.safety_filter import FilterStatus
from sims.plant import MujocoPlant, PlantConfig

STARTS: Mapping[str, Mapping[str, float]] = {
    "g1": {
        "left_shoulder_yaw_joint": -0.72,
        "right_shoulder_yaw_joint": 0.72,
        "left_shoulder_pitch_joint": -0.3,
        "right_shoulder_pitch_joint": -0.3,
        "left_elbow_joint": 0.0,
        "right_elbow_joint": 0.0,
    },
    "tocabi": {"L_Armlink_Joint": -0.2},
}
"""Joints that differ from the posture ``hands_front`` [rad]: more than 10 cm inside the torso."""

FILTERS = ("cbf", "issf", "ssa", "rssa")
"""Filters that are shown."""

DURATION = 1.5
"""Of each run [s]."""

TITLE = f"a start inside the torso, {DURATION:g} s"
"""Of the table."""

COLUMNS = (
    Metric("robot", "robot"),
    Metric("filter", "filter"),
    Metric("way_out", "way out"),
    Metric("h_start_m", "h, start", "mm", 1e3),
    Metric("step_max", "step of the command, max", "rad/s"),
    Metric("speed_max", "command, max", "rad/s"),
    Metric("torque_step_max", "torque step / limit", "%", 1e2),
    Metric("torque_max", "torque / limit", "%", 1e2),
    Metric("out_s", "h > -5 mm from", "s"),
    Metric("h_end_m", "h, end", "mm", 1e3),
)


def recovery_study(
    robots: Sequence[str] = tuple(STARTS), filters: Sequence[str] = FILTERS, duration: float = DURATION
) -> list[tuple[Any, Any]]:
    """Figures and series of every robot and filter, strict and eased."""
    runs: list[tuple[Any, Any]] = []
    for name in robots:
        robot = load_robot(name)
        for filter_name in filters:
            eased = controller_config(robot, filter=filter_name)
            strict = dataclasses.replace(eased, safety=dataclasses.replace(eased.safety, recovery_weight=0.0))
            for way_out, config in (("strict", strict), ("eased", eased)):
                series = leave_collision(robot, config, duration)
                case = {"robot": name, "filter": filter_name, "way_out": way_out}
                runs.append((case | recovery_figures(series, config), series))
    return runs


def leave_collision(robot: RobotDescription, config: ControllerConfig, duration: float = DURATION) -> dict[str, Array]:
    """Run one start; the reference is to stay where it is.

    Returns:
        By name, a row per tick: ``time`` [s]; ``h``, the smallest of all barriers [m, rad]; ``v`` (n, nv), the command;
        ``failed``, whether filter or DynWBC had no answer. A row per physics step: ``torque`` (m, nj), fractions of the
        limits.
    """
    plant = MujocoPlant(robot, PlantConfig(), np.random.default_rng(0))
    q = standing_configuration(robot, "hands_front")
    for joint, value in STARTS[robot.name].items():
        q[7 + robot.joint_names.index(joint)] = value
    plant.reset(q)
    agent, trace = Agent(robot, config, settle_time=0.0), Trace(plant)
    agent.reset(plant.state())
    ClosedLoop(plant, agent, observers=[trace], steps=round(config.dt / plant.config.dt)).run(duration)
    return trace.series()


class Trace(Observer):
    """Keeps commands, torques, and the smallest of all barriers."""

    def __init__(self, plant: MujocoPlant) -> None:
        self._plant, self._kin = plant, Kinematics(plant.robot)
        self._barriers = standard_barriers(self._kin, ())
        self._ticks: list[dict[str, Any]] = []
        self._torque: list[Array] = []

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: AgentOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        result = output.result
        self._kin.update(state.q, state.v)
        failed = result is None or result.safety.status == FilterStatus.FAILED or result.dynwbc.status != "optimal"
        v = np.zeros(self._kin.nv) if result is None else result.safety.v
        h = self._barriers.evaluate(self._kin).h.min()
        self._ticks.append({"time": loop.time, "h": h, "v": v, "failed": failed})

    def stepped(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.stepped`."""
        self._torque.append(self._plant.torque / self._plant.effort)

    def series(self) -> dict[str, Array]:
        """What was kept, as :func:`leave_collision` returns it."""
        ticks = self._ticks
        return {key: np.array([tick[key] for tick in ticks]) for key in ticks[0]} | {"torque": np.array(self._torque)}


def recovery_figures(series: Mapping[str, Array], config: ControllerConfig) -> dict[str, Any]:
    """Figures of one run of :func:`leave_collision`; ``out_s`` is ``None`` where it is not out at the end."""
    deep = np.flatnonzero(series["h"] < -config.safety.self_collision.recovery_depth)
    last = int(deep[-1]) + 1 if deep.size else 0
    return {
        "h_start_m": float(series["h"][0]),
        "step_max": float(np.abs(np.diff(series["v"], axis=0)).max()),
        "speed_max": float(np.abs(series["v"]).max()),
        "torque_step_max": float(np.abs(np.diff(series["torque"], axis=0)).max()),
        "torque_max": float(np.abs(series["torque"]).max()),
        "out_s": last * config.dt if last < len(series["h"]) else None,
        "h_end_m": float(series["h"][-1]),
    }
