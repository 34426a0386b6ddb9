"""What one run leaves behind, and the folder it is kept in. Imports neither simulator nor plots."""

import dataclasses
import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.recording.plain import plain
from experiments.recording.store import claimed, run_file, write_json, write_run
from robots.collision_models import with_collision_model
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
class Recording:
    """One finished run. Arrays are not written to after it is made.

    A run that stopped early has shorter series; nothing else tells them apart.

    Attributes:
        robot: the robot that ran.
        config: the resolved configuration; JSON-able, ``config["scenario"]`` is what
            :func:`experiments.scenarios.registry.read_scenario` takes, ``config["robot"]`` what :func:`load_robot`.
        summary: metrics, JSON-able, flat but for ``versions``; :mod:`experiments.metrics.declared` declares each.
        series: arrays by name; :mod:`experiments.recording.channels` declares each.
    """

    robot: RobotDescription
    config: Mapping[str, Any]
    summary: Mapping[str, Any]
    series: Mapping[str, NDArray[Any]]


def save_recording(result: Recording, folder: Path, series: bool = True, overwrite: bool = False) -> None:
    """Write ``config.json``, ``summary.json`` and ``series.npz``, all or none.

    Args:
        result: the run.
        folder: where to; made when missing.
        series: whether the arrays are written too; without them a run can be made again, but not looked at.
        overwrite: whether it may take the place of a run that the folder holds.

    Raises:
        ConfigError: the folder holds a run, cannot be written, or is written to by another process; config or summary
            holds what JSON cannot.
    """
    with claimed(folder, overwrite):
        write_recording(result, folder, series)


def write_recording(result: Recording, folder: Path, series: bool = True) -> None:
    """:func:`save_recording` in place of what the folder holds, for who has claimed it already.

    Raises:
        ConfigError: the folder cannot be written, or config or summary holds what JSON cannot.
    """
    files = {"config.json": write_json("config", result.config), "summary.json": write_json("summary", result.summary)}
    write_run(folder, files | ({"series.npz": partial(_write_arrays, dict(result.series))} if series else {}))


def _write_arrays(arrays: dict[str, Any], path: Path) -> None:
    np.savez_compressed(path, **arrays)


def load_recording(folder: Path) -> Recording:
    """Read what :func:`save_recording` wrote.

    Args:
        folder: the folder of one run.

    Returns:
        The run; metrics that were NaN come back as ``None``, and ``series`` is empty where it was not saved.

    Raises:
        ConfigError: a file is missing or cannot be read.
        SafeWbcError: the robot's description is not where it was.
    """
    config = _read_json(run_file(folder, "config.json"))
    summary = _read_json(run_file(folder, "summary.json"))
    if "robot" not in config:
        raise ConfigError("config.json", sorted(config), "an object with the entry 'robot'")
    robot = load_robot(config["robot"])
    if model := config.get("collision_model"):
        robot = with_collision_model(robot, model)
    return Recording(robot, config, summary, _read_series(run_file(folder, "series.npz")))


def _read_series(path: Path) -> dict[str, NDArray[Any]]:
    if not path.exists():
        return {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError("series", str(path), f"a file written by this project ({error})") from error


def robot_reference(robot: str) -> dict[str, str]:
    """Entries of a configuration by which :func:`load_recording` finds a robot from any working directory."""
    return {"robot": str(Path(robot).resolve()) if robot.endswith(".toml") else robot}


def description_digest(robot: RobotDescription) -> str:
    """Sixteen hexadecimal digits that stand for all that a description says, wherever it was read from."""
    text = json.dumps(_table(robot), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _table(value: Any) -> Any:
    """The value in JSON's own types, dataclasses as tables."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _table(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _table(item) for key, item in value.items()}
    return [_table(item) for item in value] if isinstance(value, list | tuple) else plain(value)


def smallest_self_collision(result: Recording) -> Array:
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


def filter_title(result: Recording) -> str:
    """The filter of a run as a reader knows it, for example ``ISSf-CBF``."""
    chosen = setting(result.config, "filter")
    if chosen is None:
        return result.robot.title
    return KINDS[chosen].title if chosen in KINDS else str(chosen)


def run_title(result: Recording) -> str:
    """A run in a few words: its filter, and the change of mass where the plant is not the nominal robot."""
    scale = setting(result.config, "mass_scale")
    mass = f", mass {100 * (scale - 1):+.3g} %" if isinstance(scale, int | float) and scale != 1 else ""
    return filter_title(result) + mass


def _read_json(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError("result", str(path), f"a JSON file written by this project ({error})") from error
    if not isinstance(table, dict):
        raise ConfigError("result", str(path), "a JSON object")
    return table
