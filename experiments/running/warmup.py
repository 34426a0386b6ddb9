"""Compiles the kernels before anything is timed or a person waits for it unawares, and tells where they are kept."""

import shutil
import sys
import time
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

from numba.core.registry import CPUDispatcher
from rich.console import Console

from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.kernel_types import CACHE_FOLDER, CACHE_PREFIX, OWN_FOLDER
from robots.loader import BUILT_IN, load_robot
from safety.filters.safety_filter import FILTERS
from safety.geometry.shapes import KINDS

EXTRAS = ("cyclonedds",)
"""Packages that only modules of an extra import."""

PACKAGES = ("robots", "wbc", "safety", "controllers", "sims")
"""Where kernels may be; those whose signature is given are compiled when their module is imported."""


@dataclass(frozen=True, slots=True)
class Preparation:
    """What filling the caches came to.

    Attributes:
        kernels: compiled functions of the packages.
        compiled: how often one of them was compiled in this process.
        loaded: how often one was found in the cache instead.
        folders: where the cache is.
        seconds: what it took [s].
    """

    kernels: int
    compiled: int
    loaded: int
    folders: tuple[Path, ...]
    seconds: float


def warm_up(console: Console, robot: RobotDescription) -> None:
    """Go through the ticks of a robot's controller, which compiles every kernel; later runs find them in the cache."""
    with console.status("preparing (the first run compiles its kernels, which takes some 20 seconds)"):
        WholeBodyController(robot, controller_config(robot), with_hands=True, obstacle_kinds=("sphere",)).warm_up()


def fill_caches() -> Preparation:
    """Have every kernel of every filter, obstacle and robot that comes with the project in numba's cache."""
    start = time.perf_counter()
    forget_old_caches()
    _import_all()
    for name in BUILT_IN:
        robot = load_robot(name)
        for safety_filter in FILTERS:
            config = controller_config(robot, filter=safety_filter)
            WholeBodyController(robot, config, with_hands=True, obstacle_kinds=KINDS).warm_up()
    found = kernels()
    stats = [k.stats for k in found]
    return Preparation(
        kernels=len(found),
        compiled=sum(sum(s.cache_misses.values()) for s in stats),
        loaded=sum(sum(s.cache_hits.values()) for s in stats),
        folders=tuple(sorted({_kept_in(Path(s.cache_path)) for s in stats if s.cache_path})),
        seconds=time.perf_counter() - start,
    )


def forget_old_caches() -> None:
    """Remove the caches of other states of the kernels' sources, where no other installation can have one."""
    if CACHE_FOLDER.parent != OWN_FOLDER:
        return
    for folder in OWN_FOLDER.glob(CACHE_PREFIX + 16 * "[0-9a-f]"):
        if folder != CACHE_FOLDER:
            shutil.rmtree(folder, ignore_errors=True)


def _kept_in(folder: Path) -> Path:
    """The cache that a kernel's folder is part of."""
    return CACHE_FOLDER if CACHE_FOLDER in folder.parents else folder


def _import_all() -> None:
    """Import every module of the packages; where MuJoCo does not load (a check of its own), those without it."""
    try:
        import_module("mujoco")
        errors: AbstractContextManager[Any] = nullcontext()
    except Exception:  # what is raised depends on the OpenGL binding that the environment asks for
        errors = suppress(Exception)
    for package in PACKAGES:
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            with errors:
                _import_unless_extra(module.name)


def _import_unless_extra(name: str) -> None:
    """Import a module; one that needs an extra which is not installed has no kernels."""
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in EXTRAS:
            raise


def kernels() -> list[CPUDispatcher]:
    """The compiled functions of all modules of the packages that are imported by now, each once."""
    modules = [m for name, m in sorted(sys.modules.items()) if name.split(".")[0] in PACKAGES]
    found = (value for module in modules for value in vars(module).values() if isinstance(value, CPUDispatcher))
    return list({id(k): k for k in found}.values())
