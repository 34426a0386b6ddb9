"""The figures of a summary as people read them: words, unit, factor. Imports nothing heavy."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from experiments.recording.recording import RunResult


@dataclass(frozen=True, slots=True)
class Figure:
    """One entry of a summary: its ``key``, in ``words``, shown in ``unit`` after multiplying by ``factor``.

    ``bad`` says which values stand out: ``negative``, ``true``, ``false``, ``given`` or ``positive``; empty for none.
    """

    key: str
    words: str
    unit: str = ""
    factor: float = 1.0
    bad: str = ""

    def text(self, value: Any) -> str:
        """The value as text."""
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value * self.factor:.3g}" if isinstance(value, float) else str(value)

    def is_bad(self, value: Any) -> bool:
        """Whether the value is one that should not be."""
        if value is None:
            return False
        return {
            "": False,
            "given": True,
            "true": value is True,
            "false": value is False,
            "negative": isinstance(value, float) and value < 0,
            "positive": isinstance(value, int | float) and value > 0,
        }[self.bad]


FIGURES = (
    Figure("fell", "fell", bad="true"),
    Figure("stop_cause", "stopped because", bad="given"),
    Figure("min_h_self_collision_m", "smallest self-collision barrier", "mm", 1e3, "negative"),
    Figure("collision_ratio", "collisions left, of the reference motion's", "%", 1e2, "positive"),
    Figure("min_h_joint_limit_rad", "smallest joint-limit barrier", "rad", bad="negative"),
    Figure("min_h_obstacle_m", "smallest obstacle barrier", "mm", 1e3, "negative"),
    Figure("min_h_workspace_m", "smallest workspace barrier", "mm", 1e3, "negative"),
    Figure("min_h_reference_m", "smallest barrier of the reference motion", "mm", 1e3),
    Figure("disturbance_max", "velocity error |d|, largest", "m/s, rad/s"),
    Figure("bound_m", "bound on h for that |d|, self-collision", "mm", 1e3),
    Figure("bound_running_min_m", "smallest running bound on h, self-collision", "mm", 1e3),
    Figure("row_bound_min_m", "bound on h of the closest pair, smallest", "mm", 1e3),
    Figure("margin_self_collision_m", "least room of h above its running bound", "mm", 1e3, "negative"),
    Figure("bound_held", "h stayed above its running bounds, obstacles apart", bad="false"),
    Figure("hand_rmse_m", "hand error, RMS", "mm", 1e3),
    Figure("hand_rmse_outside_conflict_m", "hand error outside the conflict, RMS", "mm", 1e3),
    Figure("com_error_settled_max_m", "CoM error once settled, largest", "mm", 1e3),
    Figure("foot_slide_max_m", "foot slide, largest", "mm", 1e3),
    Figure("zmp_inside_fraction", "ZMP inside the support polygon", "%", 1e2),
    Figure("zmp_inside_single_fraction", "ZMP inside the sole, on one foot", "%", 1e2),
    Figure("foot_up_s", "foot up", "s"),
    Figure("right_load_end", "weight on the right foot at the end", "%", 1e2),
    Figure("min_h_feet_m", "smallest barrier between the feet", "mm", 1e3, "negative"),
    Figure("min_h_legs_m", "smallest barrier between legs", "mm", 1e3, "negative"),
    Figure("feet_penetrate_fraction", "feet overlap", "%", 1e2, "positive"),
    Figure("legs_penetrate_fraction", "legs overlap", "%", 1e2, "positive"),
    Figure("steps", "steps"),
    Figure("distance_m", "way walked", "m"),
    Figure("step_height_min_m", "lowest step", "mm", 1e3),
    Figure("velocity_error_x_mps", "velocity error forward, mean", "m/s"),
    Figure("velocity_error_x_max_mps", "velocity error forward, largest", "m/s"),
    Figure("velocity_error_y_mps", "velocity error sideways, mean", "m/s"),
    Figure("velocity_error_y_max_mps", "velocity error sideways, largest", "m/s"),
    Figure("velocity_error_wz_radps", "error of turning, mean", "rad/s"),
    Figure("velocity_error_wz_max_radps", "error of turning, largest", "rad/s"),
    Figure("max_torque_fraction", "torque, largest share of a limit", "%", 1e2),
    Figure("torque_step_max", "change of a torque per tick, largest share of a limit", "%", 1e2),
    Figure("qp_failures", "ticks without a QP solution", bad="positive"),
    Figure("filtered_fraction", "ticks in which the filter changed the velocity", "%", 1e2),
    Figure("relaxed_fraction", "ticks with relaxed conditions", "%", 1e2, "positive"),
    Figure("command_step_rms", "change of the velocity command per tick, RMS", "rad/s"),
    Figure("command_step_max", "change of the velocity command per tick, largest", "rad/s"),
    Figure("tick_ms_median", "tick, median", "ms"),
    Figure("tick_ms_p99", "tick, 99th percentile", "ms"),
)
"""In the order to show them."""


def column(key: str, heading: str) -> Figure:
    """The figure of this key under a shorter heading; one that is shown as it is where the key is no figure."""
    known = next((f for f in FIGURES if f.key == key), Figure(key, heading))
    return replace(known, words=heading)


def known_figures(results: Sequence[RunResult]) -> Iterator[tuple[Figure, list[Any]]]:
    """The figures that at least one of the runs has, with the value of each run (``None`` where it has none)."""
    for figure in FIGURES:
        values = [r.summary.get(figure.key) for r in results]
        if any(v is not None for v in values):
            yield figure, values
