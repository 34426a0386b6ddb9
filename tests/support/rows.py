"""Barrier rows made by hand."""

import numpy as np

from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows


def rows_of(h: Array, jac: Array, dh_dt: Array | None = None, family: str = "obstacle") -> BarrierRows:
    """Rows of one family; without ``dh_dt`` nothing moves by itself."""
    h = np.array(h, dtype=float)
    still = np.zeros(h.size)
    return BarrierRows(h, jac, still if dh_dt is None else dh_dt, np.full(h.size, FAMILIES.index(family)))


def rows_demanding(A: Array, b: Array, eta: float) -> BarrierRows:
    """Rows inside every margin on which SSA with this ``eta`` demands A v >= b."""
    return rows_of(np.full(b.size, -0.1), A, eta - b)


def copied(rows: BarrierRows) -> BarrierRows:
    """Rows that later evaluations of their barriers do not overwrite."""
    return BarrierRows(rows.h.copy(), rows.jac.copy(), rows.dh_dt.copy(), rows.family)
