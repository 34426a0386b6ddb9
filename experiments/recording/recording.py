"""What one run leaves behind, and the folder it is kept in. Imports neither simulator nor plots."""

import json
import math
import os
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array
from safety.barriers.rows import FAMILIES
from safety.filters.safety_filter import KINDS

FILTER_STATUSES = ("unchanged", "filtered", "relaxed", "failed", "unsafe", "stopped")
"""Names of the numbers in the series ``filter_status``; stopped: the filter was not asked any more."""

STOPPED = FILTER_STATUSES.index("stopped")

GUARANTEED = FAMILIES[:-1]
"""Constraint families whose barriers are recorded, in the order of the columns of ``gradient`` and ``h_bound``."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """One finished run. Arrays are not written to after it is made.

    A run that stopped early has shorter series; nothing else tells them apart.

    ``series`` holds, per control tick (T of them): ``time`` (T,) [s]; ``q`` (T, nq) and ``v`` (T, nv), the true state
    in pinocchio's order; ``torque`` (T, nj), applied [N m]; ``com`` and ``com_ref`` (T, 3) [m]; ``left_hand``,
    ``left_hand_ref``, ``right_hand``, ``right_hand_ref`` (T, 3) [m], absent without a hand task; ``zmp`` (T, 2)
    [m], NaN without contact; ``foot_wrench`` (T, 2, 6), measured force and moment about the sole's centre in its axes
    [N, N m]; ``v_des`` and ``v_safe`` (T, nv); ``filter_status`` (T,), index into ``FILTER_STATUSES``;
    ``filter_slack`` (T,) [m/s]; ``tick_ms`` (T,) [ms]; ``soles`` and ``soles_ref`` (T, 2, 3), centres of the soles
    and where they are asked to be [m]; ``sole_corners`` (T, 2, 4, 2) in the ground plane [m]; ``in_contact`` (T, 2), 1
    where the plan has the foot on the ground, else 0; ``load_scale`` (T,), factor on the masses of the controller's
    model; ``dcm_ref`` and ``zmp_ref`` (T, 2) [m], only where a gait gives them; ``command`` (T, 3), velocity that a
    walk is asked for [m/s, m/s, rad/s]. Once: ``support_polygon`` (K, 2), convex, in the world, of the soles at the
    start [m].

    ``obstacle`` (T, 4), true centre and radius of a sphere [m], only where there is one.

    Per plant step (P of them): ``step_time`` (P,) [s]; ``h_self_collision`` (P, n_pairs), in the order of
    ``robot.self_collision_pairs`` [m]; ``h_joint_limit`` (P,), smallest [rad]; ``h_workspace`` (P, n_bounds) [m];
    ``h_self_reference`` (P,), smallest of the reference motion [m], optional; ``h_obstacle`` (P,) [m],
    infinite without an obstacle; ``disturbance`` (P,), size of v - v_safe [m/s, rad/s]; ``gradient`` and ``h_bound``
    (P, 5), by family of ``GUARANTEED``: longest Jacobian row, and the bound on h that the condition promises, NaN
    without one; ``h_row_bound`` (P,) [m], bound of the closest pair by its own Jacobian row.

    Attributes:
        robot: the robot that ran.
        config: the resolved configuration; JSON-able, ``config["robot"]`` is what :func:`load_robot` takes.
        summary: figures of merit, JSON-able, flat but for ``versions``; ``docs/output.md`` explains each.
        series: arrays by name, as above.
    """

    robot: RobotDescription
    config: Mapping[str, Any]
    summary: Mapping[str, Any]
    series: Mapping[str, NDArray[Any]]


def prepare_folder(path: Path) -> Path:
    """Make the folder, and make sure that files can be written there: to be called before a long run.

    Args:
        path: the folder; parents are made too.

    Returns:
        The same path.

    Raises:
        ConfigError: it cannot be made, is not a folder, or does not take files.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        # a file is really made: permission bits say nothing about read-only or full file systems
        with tempfile.NamedTemporaryFile(dir=path, prefix=".write-test-") as probe:
            probe.write(b"x")
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        raise ConfigError("out", str(path), f"a folder that can be written ({error.strerror or error})") from error
    return path


def save_result(result: RunResult, folder: Path) -> None:
    """Write ``config.json``, ``summary.json`` and ``series.npz``.

    Args:
        result: the run.
        folder: where to; made when missing.

    Raises:
        ConfigError: the folder cannot be written, or config or summary holds what JSON cannot.
    """
    prepare_folder(folder)
    try:
        _write_json(folder / "config.json", "config", result.config)
        _write_json(folder / "summary.json", "summary", result.summary)
        arrays: dict[str, Any] = dict(result.series)
        np.savez_compressed(folder / "series.npz", **arrays)
    except OSError as error:
        raise ConfigError("out", str(folder), f"a folder that can be written ({error.strerror or error})") from error


def load_result(folder: Path) -> RunResult:
    """Read what :func:`save_result` wrote.

    Args:
        folder: the folder of one run.

    Returns:
        The run; figures that were NaN come back as ``None``.

    Raises:
        ConfigError: a file is missing or cannot be read.
    """
    config = _read_json(folder / "config.json")
    summary = _read_json(folder / "summary.json")
    path = folder / "series.npz"
    try:
        with np.load(path, allow_pickle=False) as archive:
            series = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError("series", str(path), f"a file written by this project ({error})") from error
    if "robot" not in config:
        raise ConfigError("config.json", sorted(config), "an object with the entry 'robot'")
    return RunResult(load_robot(config["robot"]), config, summary, series)


def smallest_self_collision(result: RunResult) -> Array:
    """Smallest self-collision barrier at each plant step, shape (P,) [m]; infinite for a robot without pairs."""
    h = result.series["h_self_collision"]
    return np.min(h, axis=1, initial=np.inf).astype(float)


def family_minima(series: Mapping[str, NDArray[Any]], leg_pairs: int) -> Array:
    """Smallest barrier of each family of ``GUARANTEED`` at each plant step.

    Args:
        series: of a run.
        leg_pairs: number of pairs of legs: the last columns of ``h_self_collision``.

    Returns:
        Shape (P, 5) [rad for joint limits, else m]; infinite for a family without rows.
    """
    pairs = series["h_self_collision"]
    arms = pairs.shape[1] - leg_pairs
    columns = {
        "joint_limit": series["h_joint_limit"],
        "self_collision": pairs[:, :arms].min(axis=1, initial=np.inf),
        "leg_collision": pairs[:, arms:].min(axis=1, initial=np.inf),
        "obstacle": series["h_obstacle"],
        "workspace": series["h_workspace"].min(axis=1, initial=np.inf),
    }
    out: Array = np.column_stack([columns[family] for family in GUARANTEED]).astype(float)
    return out


def setting(config: Mapping[str, Any], name: str) -> Any:
    """The first entry called ``name`` in a configuration, tables within it included; ``None`` when there is none."""
    if name in config:
        return config[name]
    inner = (setting(value, name) for value in config.values() if isinstance(value, Mapping))
    return next((value for value in inner if value is not None), None)


def filter_title(result: RunResult) -> str:
    """The filter of a run as a reader knows it, for example ``ISSf-CBF``."""
    chosen = setting(result.config, "filter")
    if chosen is None:
        return result.robot.title
    return KINDS[chosen].title if chosen in KINDS else str(chosen)


def run_title(result: RunResult) -> str:
    """A run in a few words: its filter, and the change of mass where the plant is not the nominal robot."""
    scale = setting(result.config, "mass_scale")
    mass = f", mass {100 * (scale - 1):+.3g} %" if isinstance(scale, int | float) and scale != 1 else ""
    return filter_title(result) + mass


def plain(value: Any) -> Any:
    """The value in JSON's own types: numpy numbers and arrays as Python's, NaN and infinity as ``None``."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def _write_json(path: Path, name: str, table: Mapping[str, Any]) -> None:
    try:
        text = json.dumps(plain(table), indent=2, allow_nan=False)
    except TypeError as error:
        raise ConfigError(name, dict(table), f"made of numbers, strings, lists and tables ({error})") from error
    path.write_text(text + "\n", encoding="utf-8")


def _read_json(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError("result", str(path), f"a JSON file written by this project ({error})") from error
    if not isinstance(table, dict):
        raise ConfigError("result", str(path), "a JSON object")
    return table
