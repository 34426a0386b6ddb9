"""What came out of the corridor, in sentences made from the data."""

from collections.abc import Iterator, Sequence

import numpy as np

from experiments.running.corridor_loop import NAIVE, TOUCH, CorridorRun

PAPER = ("pssa", "rssa", NAIVE)
"""From least to largest phi of the left hand, as figure 10 of the p-SSA paper has it."""

SAME = 1e-6
"""Joint angles nearer than this [rad] count as the same motion."""

ROUGH = 0.1
"""Jumps of the velocity above this [rad/s], RMS, count as chatter."""


def findings(runs: Sequence[CorridorRun]) -> list[str]:
    """Sentences on feasibility, distances, violation, tracking and chatter.

    Args:
        runs: of one scene, each another filter; those of the paper are compared where they are there.
    """
    by_name = {run.name: run for run in runs}
    return [
        *_feasibility(runs),
        *_hand(by_name),
        *_collisions(runs),
        *_violation(by_name),
        *_tracking(runs),
        *_score_of_depth(runs),
        *_same(by_name),
        *_chatter(runs),
    ]


def _feasibility(runs: Sequence[CorridorRun]) -> Iterator[str]:
    met = [run.title for run in runs if not run.series["infeasible"].any()]
    if met:
        yield f"Conditions that could be met in every tick: {', '.join(met)}."
    words = []
    for run in runs:
        infeasible = run.series["infeasible"]
        if count := int(infeasible.sum()):
            first = float(run.series["time"][int(np.argmax(infeasible))])
            words.append(f"{run.title} {count} of {len(infeasible)} ticks, from {first:.2f} s on ({_answer(run)})")
    if words:
        yield f"No velocity met all conditions: {'; '.join(words)}."


def _answer(run: CorridorRun) -> str:
    """What a filter does where its conditions cannot all be met."""
    if run.name in {"pfm", "sma"}:
        return "one row at a time pushed"
    if run.name == "none":
        return "nothing done"
    passed = run.summary["infeasible_action"] == "unsafe_pass_nominal"
    return "the nominal velocity passed on" if passed else "conditions relaxed"


def _hand(by_name: dict[str, CorridorRun]) -> Iterator[str]:
    phi = {name: 1e3 * by_name[name].summary["phi_hand_max_m"] for name in by_name}
    order = sorted(phi, key=lambda name: phi[name])
    words = ", ".join(f"{by_name[n].title} {phi[n]:.1f} mm" for n in order)
    yield f"Largest phi of the left hand (contact at 50 mm): {words}."
    if not all(name in by_name for name in PAPER):
        return
    found = [name for name in order if name in PAPER]
    names = " < ".join(by_name[n].title for n in found)
    if found == list(PAPER):
        yield (
            "That is the paper's order of p-SSA, r-SSA and naive SSA: p-SSA bounds phi best of the three, r-SSA lets "
            f"it grow further, naive SSA most ({names})."
        )
    else:
        yield f"That is not the paper's order, p-SSA < r-SSA < naive SSA, but {names}."


def _collisions(runs: Sequence[CorridorRun]) -> Iterator[str]:
    clear = []
    for run in runs:
        summary = run.summary
        deepest = min(summary["min_h_obstacle_m"], summary["min_h_self_collision_m"])
        if deepest >= -TOUCH:
            clear.append(f"{run.title} ({1e3 * max(deepest, 0.0):.1f} mm)")
            continue
        pairs = summary["collisions"]
        more = f" and {len(pairs) - 3} more" if len(pairs) > 3 else ""
        yield (
            f"{run.title}: {summary['collision_ticks']} ticks with a collision, {-1e3 * deepest:.1f} mm deep at most; "
            f"{', '.join(pairs[:3])}{more}."
        )
    if clear:
        yield f"Hit nothing (nearest approach): {', '.join(clear)}. So the scene can be passed without a collision."


def _violation(by_name: dict[str, CorridorRun]) -> Iterator[str]:
    words = []
    for run in by_name.values():
        excess, mean = run.summary["excess_mean"], run.summary["violation_mean"]
        if excess is not None and mean > 0:
            above = "the least possible" if abs(excess) < 1e-6 else f"{excess:.2g} m/s above the least possible"
            words.append(f"{run.title} {mean:.3g} m/s ({above})")
    if words:
        yield (
            f"Total violation, mean: {'; '.join(words)}. In brackets the root of the sum of squares, against what is "
            "possible at the states that the run met: another way through the scene meets others."
        )


def _tracking(runs: Sequence[CorridorRun]) -> Iterator[str]:
    order = sorted(runs, key=lambda run: -run.summary["J"])
    if len(order) > 1:
        yield "Tracking of the goals, best first: " + ", ".join(f"{r.title} {r.summary['J']:.2f}" for r in order) + "."


def _score_of_depth(runs: Sequence[CorridorRun]) -> Iterator[str]:
    """S judges only pairs inside a margin, and may prefer a run that collides to one that does not."""
    scored = [r for r in runs if r.summary["S"] is not None]
    hit = [r for r in scored if r.summary["min_h_obstacle_m"] < -TOUCH]
    clear = [r for r in scored if r not in hit]
    odd = [(a, b) for a in hit for b in clear if a.summary["S"] > b.summary["S"]]
    if odd:
        above, below = (", ".join(dict.fromkeys(pair[k].title for pair in odd)) for k in (0, 1))
        yield (
            f"S rates runs that collide ({above}) above some that do not ({below}): it averages over the pairs that "
            "are inside a margin, so a body pressed into one board and clear of the other can score better than one "
            "that keeps to the middle. Read it with the smallest distances."
        )


def _same(by_name: dict[str, CorridorRun]) -> Iterator[str]:
    if "ssa" in by_name and "pssa" in by_name:
        apart = float(np.abs(by_name["ssa"].series["q"] - by_name["pssa"].series["q"]).max())
        if apart < SAME:
            yield "SSA that relaxes by least slack moved as p-SSA did: the two differ in name only."
        else:
            yield f"SSA that relaxes by least slack and p-SSA moved differently, by up to {apart:.2g} rad."


def _chatter(runs: Sequence[CorridorRun]) -> Iterator[str]:
    rough = [r for r in runs if r.summary["jump_rms"] > ROUGH]
    calm = [r for r in runs if r.summary["jump_rms"] <= ROUGH]
    if rough:
        words = ", ".join(
            f"{r.title} (velocities jump by {r.summary['jump_rms']:.2g} rad/s a tick, "
            f"{r.summary['switches_per_s']:.0f} times a second into or out of a margin)"
            for r in rough
        )
        yield (
            f"Chatter: {words}. A condition of the SSA kind is absent below phi = 0 and asks for eta at once above it, "
            "so a body held at its margin is pushed out in one tick and let in again in the next ones; those of CBF "
            "and ISSf-CBF are there all the time and jump only where they are in conflict."
        )
    if calm:
        words = ", ".join(f"{r.title} ({r.summary['jump_rms']:.2g} rad/s)" for r in calm)
        yield f"Velocities changed little from tick to tick with {words}."
