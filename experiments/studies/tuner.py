"""Rounds of runs that lead from one set of filter parameters to the next."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.recording.recording import GUARANTEED
from experiments.studies.study_options import TuneOptions
from experiments.studies.tuning_rounds import Seen, margins_of
from experiments.studies.tuning_scenarios import TuningRun

LEAST, MOST = 0.05, 20.0
"""Range of epsilon: below, the room kept at rest is more than arms have; above, the ISSf term is as good as none."""

GROWTH = 2.0
"""Largest factor by which epsilon grows from one round to the next: what was measured was measured near the old one."""

SPARE = 1.1
"""The room kept at rest is smaller by this factor than what each posture of the robot leaves."""

WORTH = 1.25
"""Epsilon is tried larger while the last round would have allowed this many times as much."""

CAUTION = 0.9
"""Where a margin was missed, epsilon sinks at least by this factor."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Parameters of one family.

    Attributes:
        alpha: [1/s].
        epsilon: ISSf parameter.
        settled: whether a round of runs with it has kept the margin, or nothing more is to be tried.
        note: what the last round said of it, in words.
        least: smallest barrier of that round [m or rad]; NaN before one.
        push: largest push of that round [m/s or rad/s].
        squared: median squared gradient of the rows that bound.
        where: run of the smallest barrier.
        allowed: largest epsilon that the disturbance of that round would have allowed.
        good: the choice of an earlier round that kept its margin with a smaller epsilon.
        tried: epsilon of the last round, of which ``least`` to ``allowed`` are; NaN before one.
    """

    alpha: float
    epsilon: float
    settled: bool = False
    note: str = "not met"
    least: float = math.nan
    push: float = math.nan
    squared: float = math.nan
    where: str = ""
    allowed: float = math.nan
    good: "Choice | None" = None
    tried: float = math.nan

    @property
    def room(self) -> float:
        """Barrier kept at rest, of the median row that bound [m or rad]; NaN where none did."""
        return self.squared / (self.alpha * self.epsilon)


Round = Callable[[Sequence[TuningRun], Mapping[str, Mapping[str, float]], Sequence[str]], Sequence[Seen]]
"""What some runs come to with parameters by family and name, of which the last argument tells those to be tuned."""


def rounded_down(value: float) -> float:
    """The largest number of two digits that is not above ``value`` > 0: what stands in a file is to be read."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    # 0.29 / 0.01 is a little less than 29
    return float(f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.2g}")


def rounded_up(value: float) -> float:
    """The smallest number of two digits that is not below ``value`` > 0."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit * (1.0 - 1e-12)) * unit:.2g}")


class Tuner:
    """Rounds of runs, each with the parameters that the last one proposed.

    Args:
        runs: to choose from in each round.
        slopes: the alphas to try.
        ratios: by family, the least alpha epsilon that leaves the robot's postures alone.
        options: checked.
        make_round: carries out a round.
    """

    def __init__(
        self,
        runs: Sequence[TuningRun],
        slopes: Sequence[float],
        ratios: Mapping[str, float],
        options: TuneOptions,
        make_round: Round,
    ) -> None:
        self._runs, self._slopes, self._ratios = runs, slopes, ratios
        self._options, self._make_round = options, make_round
        self._margins = margins_of(options)

    def run(self, before: dict[str, Choice]) -> dict[str, Choice]:
        """The parameters of every family."""
        tuned = self._options.only or GUARANTEED
        chosen = {f: c if f in tuned else replace(c, settled=True, note="left as it was") for f, c in before.items()}
        chosen = self._first(chosen, before)
        for _ in range(self._options.rounds - 1):
            if all(c.settled for c in chosen.values()):
                break
            seen = self._round(chosen)
            chosen = {f: self._judge(f, c, before[f], seen) for f, c in chosen.items()}
        return {f: self._ended(f, c) for f, c in chosen.items()}

    def _ended(self, family: str, choice: Choice) -> Choice:
        """What is left of a choice where no round is: parameters that a round was run with."""
        if choice.settled or math.isnan(choice.tried):
            return choice
        if choice.good is not None:
            return choice.good
        # an epsilon that was proposed in the last round is one that no run has tried
        note = "keeps its margin" if choice.least >= self._margins[family] else "margin missed"
        if choice.epsilon != choice.tried:
            note += f", rounds ended before epsilon {choice.epsilon:.3g} was tried"
        return replace(choice, epsilon=choice.tried, note=note)

    def _first(self, chosen: dict[str, Choice], before: dict[str, Choice]) -> dict[str, Choice]:
        """A round for every slope: of each family that one which keeps the least room at rest."""
        tried: list[dict[str, Choice]] = []
        for alpha in self._slopes:
            # at rest the room of before
            start = {
                f: c if c.settled else replace(c, alpha=alpha, epsilon=min(MOST, c.epsilon * c.alpha / alpha))
                for f, c in chosen.items()
            }
            seen = self._round(start)
            tried.append({f: self._propose(f, c, before[f], seen) for f, c in start.items()})
        return {f: c if c.settled else self._best(f, before[f], [t[f] for t in tried]) for f, c in chosen.items()}

    def _best(self, family: str, before: Choice, tried: Sequence[Choice]) -> Choice:
        met = [c for c in tried if not math.isnan(c.allowed) and not c.settled]
        if met:
            return min(met, key=lambda choice: self._rank(family, choice))
        # no row came to its limit, or every slope made a robot fall: nothing is known that could be better
        notes = [c.note for c in tried if c.settled]
        return replace(before, settled=True, note=notes[0] if notes else before.note)

    def _rank(self, family: str, choice: Choice) -> tuple[float, float]:
        """How a slope compares, the least is the best: room at rest, then how far barriers sank.

        Of the room with the epsilon that is allowed, not as far as it goes in one round. Where the robot's own postures
        bound epsilon, as they do the product with alpha, all slopes have the same room.
        """
        epsilon = max(float(np.clip(choice.allowed, LEAST, MOST)), self._least(family, choice))
        room = choice.squared / (choice.alpha * epsilon)
        return (math.inf if math.isnan(room) else float(f"{room:.1g}")), -choice.least

    def _propose(self, family: str, choice: Choice, before: Choice, seen: Iterable[Seen]) -> Choice:
        """What the runs with these parameters allow; settled where they must not be taken."""
        judged = self._judge(family, choice, before, seen)
        if math.isnan(judged.allowed) or judged.note.startswith("kept"):
            return judged
        factor = GROWTH if judged.least >= self._margins[family] else CAUTION
        most = max(LEAST, min(judged.allowed, MOST, factor * choice.epsilon))
        return replace(judged, settled=False, good=None, epsilon=max(self._least(family, choice), rounded_down(most)))

    def _judge(self, family: str, choice: Choice, before: Choice, seen: Iterable[Seen]) -> Choice:
        """The choice after a round of runs with it."""
        if choice.settled:
            return choice
        own = [s for s in seen if family in s.run.families]
        if fallen := [s for s in own if s.ended]:
            if choice.good is not None:
                return choice.good
            tried = f"alpha {choice.alpha:.3g}, epsilon {choice.epsilon:.3g}"
            note = f"kept: {fallen[0].run.name} {fallen[0].ended} with {tried}"
            return replace(before, settled=True, note=note)
        # also of runs in which no condition bound: their barriers count, though no disturbance is known of them
        measured = [(m, s.run.name) for s in own for m in s.measured if m.family == family]
        worst, where = min(measured, key=lambda pair: pair[0].least, default=(None, ""))
        bound = [m for m, _ in measured if m.binding]
        if worst is None or not (bound or worst.least < self._margins[family] or math.isfinite(choice.tried)):
            return replace(choice, note="not met", tried=choice.epsilon)
        known = replace(
            choice,
            least=worst.least,
            where=where,
            push=max((m.push for m in bound), default=math.nan),
            squared=float(np.median([m.squared for m in bound])) if bound else math.nan,
            allowed=min((m.epsilon for m in bound), default=math.inf),
            tried=choice.epsilon,
        )
        if worst.least >= self._margins[family]:
            return self._kept(known)
        return self._missed(known, self._least(family, choice))

    def _least(self, family: str, choice: Choice) -> float:
        """Least epsilon that leaves room for the robot's postures, of two digits."""
        return rounded_up(max(LEAST, SPARE * self._ratios.get(family, 0.0) / choice.alpha))

    def _kept(self, known: Choice) -> Choice:
        """After a round that kept the margin: done, unless epsilon may be larger by a good deal."""
        good = replace(known, settled=True, note="keeps its margin", good=None)
        if math.isinf(known.allowed):
            # no condition bound any more: nothing tells how much larger it may be
            return good
        larger = rounded_down(max(LEAST, min(known.allowed, GROWTH * known.epsilon, MOST)))
        if larger < WORTH * known.epsilon:
            return good
        return replace(known, epsilon=larger, good=good, note="tried larger")

    def _missed(self, known: Choice, least: float) -> Choice:
        """After a round that missed it: back to what kept it, or further down."""
        if known.good is not None:
            return known.good
        if known.epsilon <= least:
            limit = "leaves the robot's postures alone" if least > LEAST else "is tried"
            return replace(known, settled=True, note=f"margin missed at the least epsilon that {limit}")
        lower = rounded_down(max(LEAST, min(known.allowed, CAUTION * known.epsilon)))
        return replace(known, epsilon=max(least, lower), note="margin missed")

    def _round(self, chosen: dict[str, Choice]) -> Sequence[Seen]:
        """All runs that measure a family which is not settled."""
        tuned = [f for f, c in chosen.items() if not c.settled]
        runs = [r for r in self._runs if set(tuned) & set(r.families)]
        parameters = {f: {"alpha": c.alpha, "epsilon": c.epsilon} for f, c in chosen.items()}
        return self._make_round(runs, parameters, tuned)
