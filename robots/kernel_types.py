"""Types, settings and cache of compiled kernels.

With its types given in advance a kernel is compiled when its module is imported, not in the tick that needs it first.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import config, types

TYPES: Any = types
"""Numba's types, which it has not annotated."""

_CONFIG: Any = config

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

PACKAGES = ("robots", "wbc", "safety", "controllers", "sims")
"""Where kernels are."""

CACHE_PREFIX = "kernels-"
"""The folder of a cache has this name, and after it what tells the state of the kernels' sources."""


def sources_digest(root: Path) -> str:
    """What tells one state of all kernels below ``root`` from another: their files, and constants of the others."""
    digest = hashlib.sha256()
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        text = path.read_bytes()
        if b"njit" not in text:
            text = b"\n".join(line for line in text.splitlines() if line[:1].isupper() and b"=" in line)
        digest.update(b"\0".join([path.relative_to(root).as_posix().encode(), text, b""]))
    return digest.hexdigest()[:16]


OWN_FOLDER = Path(__file__).resolve().parent / "__pycache__"
"""Where caches are that no other installation uses."""


def cache_folder() -> Path:
    """The first that can be written: what NUMBA_CACHE_DIR names, ``OWN_FOLDER``, a folder of the user."""
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "safewbc"
    chosen = [Path(_CONFIG.CACHE_DIR)] if _CONFIG.CACHE_DIR else [OWN_FOLDER, user]
    parent = next((folder for folder in chosen if can_be_written(folder)), chosen[0])
    return parent / f"{CACHE_PREFIX}{sources_digest(OWN_FOLDER.parents[1])}"


def can_be_written(folder: Path) -> bool:
    """Whether a file can be made in a folder that may not be there yet."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


CACHE_FOLDER = cache_folder()
"""Where compiled kernels are kept."""


def njit(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit``, with a cache of its own for each state of all kernels' sources.

    Numba compiles a kernel anew where its own file has changed. Where what it calls has changed, in another file, it
    goes on with the old code.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        usual, _CONFIG.CACHE_DIR = _CONFIG.CACHE_DIR, str(CACHE_FOLDER)
        try:
            return numba.njit(*signature, **options)(function)
        finally:
            _CONFIG.CACHE_DIR = usual

    return compiled
