"""Made-up runs, for what reads a run: reports, plots, pictures, files."""

from typing import Any

import numpy as np

from experiments.recording.recording import (
    Recording,
)
from robots.loader import load_robot
from robots.pinocchio_model import standing_configuration

ROBOTS = {name: load_robot(name) for name in ("g1", "tocabi")}


def made_run(robot: str = "g1", ticks: int = 40, hands: bool = True, **config: Any) -> Recording:
    """A made-up run at 100 ticks/s, two plant steps a tick; every pair is 0.1 m apart, pair 0 swings about 0.1 m."""
    made = ROBOTS[robot]
    nj, steps = len(made.joints), 2 * ticks
    time, step_time = 0.01 * np.arange(ticks), 0.005 * np.arange(steps)
    q = np.tile(standing_configuration(made), (ticks, 1))
    q[:, 7 + nj // 2] += 0.2 * np.sin(6.0 * time)
    h = np.full((steps, len(made.self_collision_pairs)), 0.1, dtype=np.float32)
    h[:, 0] += 0.05 * np.sin(6.0 * step_time)
    wave = np.sin(6.0 * time)[:, None]
    series = {
        "time": time,
        "q": q,
        "v": np.zeros((ticks, 6 + nj)),
        "torque": 0.5 * wave * made.joint_array("effort"),
        "com": np.tile([0.0, 0.0, 0.67], (ticks, 1)),
        "com_ref": np.tile([0.0, 0.0, 0.673], (ticks, 1)),
        "zmp": 0.01 * np.hstack([wave, -wave]),
        "support_polygon": np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]),
        "foot_wrench": np.zeros((ticks, 2, 6)),
        "v_des": np.zeros((ticks, 6 + nj)),
        "v_safe": np.zeros((ticks, 6 + nj)),
        "filter_status": np.zeros(ticks, dtype=np.int8),
        "filter_slack": np.zeros(ticks),
        "tick_ms": np.full(ticks, 0.3),
        "step_time": step_time,
        "h_self_collision": h,
        "h_joint_limit": np.full(steps, 0.2),
        "h_workspace": np.full((steps, len(made.workspace)), 0.05),
        "h_obstacle": np.full(steps, np.inf),
        "disturbance": np.full(steps, 0.4),
        "gradient": np.full((steps, 5), 0.3),
        "h_bound": np.full((steps, 5), np.nan if config.get("filter") == "none" else -0.016),
        "h_row_bound": np.full(steps, np.nan if config.get("filter") == "none" else 0.002),
        "h_self_reference": np.full(steps, -0.02),
    }
    if hands:
        names = ("left_hand", "left_hand_ref", "right_hand", "right_hand_ref")
        series |= {name: np.tile([0.3, 0.2, 0.8], (ticks, 1)) + 0.01 * wave for name in names}
    settings = {"robot": robot, "filter": "issf", "plant": {"mass_scale": 1.0}, **config}
    return Recording(made, settings, {"fell": False, "min_h_self_collision_m": 0.05}, series)


def with_series(result: Recording, **changes: np.ndarray) -> Recording:
    return Recording(result.robot, result.config, result.summary, {**result.series, **changes})
