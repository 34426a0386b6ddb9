"""Barriers at the plant's true state, for the record."""

from collections.abc import Sequence

import numpy as np

from experiments.recording.recording import GUARANTEED
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.barriers.barrier_set import ObstacleBarrier, standard_barriers
from safety.barriers.rows import BarrierRows
from safety.geometry.shapes import Obstacle


class TrueBarriers:
    """Barriers at the plant's true state, by a model of its own: nothing the controller believes enters.

    Of the rows of a pair only the distance is kept, and of two bodies of the robot only that is computed.

    Attributes:
        slices: rows of each family.
    """

    def __init__(self, robot: RobotDescription, obstacle_kinds: Sequence[str]) -> None:
        self._kin = Kinematics(robot)
        self._set = standard_barriers(self._kin, obstacle_kinds, keep_fixed=True, distances_only=True)
        self._obstacles = next((b for b in self._set.barriers if isinstance(b, ObstacleBarrier)), None)
        kept = np.concatenate(list(self._set.representative.values()))
        self._kept = None if kept.size == self._set.size else kept
        ends = np.cumsum([rows.size for rows in self._set.representative.values()])
        self.slices = {
            f: slice(e - r.size, e) for (f, r), e in zip(self._set.representative.items(), ends, strict=True)
        }
        present = [f for f in GUARANTEED if f in self.slices and self._set.representative[f].size]
        self._present = np.array([GUARANTEED.index(f) for f in present], dtype=np.intp)
        self._starts = np.array([self.slices[f].start for f in present], dtype=np.intp)
        self._longest = np.full(len(GUARANTEED), np.nan)

    def evaluate(self, q: Array, obstacles: Sequence[Obstacle] = ()) -> BarrierRows:
        """Rows at a true configuration (nq,) among the true obstacles; the next call may overwrite them."""
        self._kin.update_geometry(q)
        if self._obstacles is not None:
            self._obstacles.set_obstacles(obstacles)
        rows, kept = self._set.evaluate(self._kin), self._kept
        if kept is None:
            return rows
        return BarrierRows(rows.h[kept], rows.jac[kept], rows.dh_dt[kept], rows.family[kept])

    def gradients(self, rows: BarrierRows) -> Array:
        """Largest size of a row of the Jacobian in each family of ``GUARANTEED``, NaN where it has no rows.

        The next call overwrites what it returns.
        """
        if self._starts.size:
            squared = np.vecdot(rows.jac, rows.jac)
            self._longest[self._present] = np.sqrt(np.maximum.reduceat(squared, self._starts))
        return self._longest
