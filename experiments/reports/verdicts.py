"""What happened in a run, in sentences made from its data."""

import numpy as np

from experiments.recording.gait_phases import walks
from experiments.recording.recording import FILTER_STATUSES, GUARANTEED, Recording, smallest_self_collision

Verdict = tuple[bool, str]
"""Whether it is good, and the sentence."""


def verdict(result: Recording) -> list[Verdict]:
    """What happened in a run, in plain words.

    Args:
        result: the run.

    Returns:
        (whether it is good, sentence) for standing or falling, self-collision, the other barriers, the bounds that
        the filter guarantees, and the filter.
    """
    if not len(result.series["time"]):
        return [(False, "ended before the first tick")]
    out = [_upright(result)]
    if cause := result.summary.get("stop_cause"):
        out.append((False, f"was stopped: {cause}"))
    out += [(True, f"was pushed with {push}") for push in result.summary.get("pushes", ())]
    if result.series["h_self_collision"].size:
        out.append(_clearance(result))
    out += _other_barriers(result) + _guarantee(result) + _feet(result)
    counts = np.bincount(result.series["filter_status"].astype(int), minlength=len(FILTER_STATUSES))
    if counts[2]:
        first = result.summary.get("first_relaxed")
        why = f"; the first {' '.join(first.split())}" if first else ""
        out.append((False, f"the filter had to relax its conditions in {_ticks(int(counts[2]))}{why}"))
    if counts[3]:
        out.append((False, f"the filter failed in {_ticks(int(counts[3]))}"))
    return out


def _upright(result: Recording) -> Verdict:
    fell = result.summary["fell"]
    end = f"{float(result.series['time'][-1]):.1f} s"
    return (False, f"fell over; the run ended after {end}") if fell else (True, f"stayed upright for {end}")


def _clearance(result: Recording) -> Verdict:
    h = result.series["h_self_collision"]
    smallest = smallest_self_collision(result)
    if np.isnan(smallest).any():
        return False, "distances between its bodies are not numbers in part of the run"
    step, pair = np.unravel_index(int(np.argmin(h)), h.shape)
    a, b = (name.replace("_", " ") for name in result.robot.self_collision_pairs[int(pair)])
    at = float(result.series["step_time"][step])
    if (worst := float(smallest.min())) < 0:
        fraction = f"{100.0 * float(np.mean(smallest < 0)):.2g} % of the time"
        return False, f"{a} entered {b} by {_mm(-worst)} (at {at:.1f} s; bodies overlapped for {fraction})"
    return True, f"bodies stayed clear of each other by {_mm(worst)} (closest: {a} and {b}, at {at:.1f} s)"


def _other_barriers(result: Recording) -> list[Verdict]:
    """Only what was violated: joint limits, obstacles, workspace bounds and barriers of one's own."""
    out = []
    obstacle = result.series.get("h_obstacle", np.empty(0))
    if obstacle.size and obstacle.min() < 0:
        out.append((False, f"an obstacle entered the robot by {_mm(-float(obstacle.min()))}"))
    joint = result.series["h_joint_limit"]
    if joint.size and joint.min() < 0:
        out.append((False, f"a joint went past its limit by {np.degrees(-joint.min()):.2g}°"))
    workspace = result.series["h_workspace"]
    for bound, h in zip(result.robot.workspace, workspace.T, strict=False):
        if h.size and h.min() < 0:
            out.append((False, f"{bound.name.replace('_', ' ')} went beyond its bound by {_mm(-float(h.min()))}"))
    least = result.summary.get("min_h_own")
    if least is not None and least < 0:
        out.append((False, f"a barrier of one's own fell to {least:.3g}"))
    return out


def _guarantee(result: Recording) -> list[Verdict]:
    """Only where h fell below what the filter's condition guarantees."""
    if result.summary.get("bound_held") is not False:
        return []
    out = []
    for family in GUARANTEED:
        unit = "rad" if family == "joint_limit" else "m"
        margin = result.summary.get(f"margin_{family}_{unit}")
        if family != "obstacle" and margin is not None and margin < 0:
            by = f"{np.degrees(-margin):.2g}°" if unit == "rad" else _mm(-margin)
            out.append((False, f"the {family.replace('_', ' ')} barrier fell below its guaranteed bound by {by}"))
    return out


def _feet(result: Recording) -> list[Verdict]:
    """How far the robot walked; or where the plan lifted one foot only, whether the ZMP stayed under the other."""
    way, steps = result.summary.get("distance_m"), result.summary.get("steps")
    if way is not None and steps:
        return [(True, f"walked {way:.2f} m in {steps} step{'s' if steps != 1 else ''}")]
    fraction = result.summary.get("zmp_inside_single_fraction")
    if fraction is None or walks(result.series):
        return []
    if fraction < 1.0:
        return [(False, f"the ZMP left the standing sole for {100.0 * (1.0 - fraction):.2g} % of the time on one foot")]
    return [(True, "the ZMP stayed within the standing sole all the time on one foot")]


def _mm(length: float) -> str:
    mm = 1e3 * length
    return f"{mm:.0f} mm" if mm >= 10 else f"{mm:.1f} mm" if mm >= 0.1 else f"{mm:.2g} mm"


def _ticks(count: int) -> str:
    return f"{count} tick" + ("s" if count != 1 else "")
