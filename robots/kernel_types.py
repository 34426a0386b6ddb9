"""Types and settings of compiled kernels.

With its types given in advance a kernel is compiled when its module is imported, not in the tick that needs it first.
"""

from typing import Any

from numba import types

TYPES: Any = types
"""Numba's types, which it has not annotated."""

VECTOR = TYPES.Array(types.float64, 1, "C", readonly=True)
MATRIX = TYPES.Array(types.float64, 2, "C", readonly=True)
COLUMNS = TYPES.Array(types.float64, 2, "F", readonly=True)
PLACES = TYPES.Array(types.int64, 1, "C", readonly=True)
TABLE = TYPES.Array(types.int64, 2, "C", readonly=True)
FLAGS = TYPES.Array(types.boolean, 1, "C", readonly=True)
"""What kernels read: numbers, row by row or (as pinocchio has them) column by column, places in other arrays, masks."""

OUT = types.float64[::1]
OUT_ROWS = types.float64[:, ::1]
"""What kernels write."""

ORDER_FREE = {"reassoc", "contract"}
"""Sums may be taken in any order, so that they run over several columns at a time; NaN and infinity are not lost."""
