"""Checks of the installation: what is needed, whether it works, what to do if not."""

import importlib
import importlib.util
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console

from experiments.scenarios.options import DoctorOptions, refuse_without
from robots.errors import ConfigError

PACKAGES = ("robots", "wbc", "safety", "controllers", "sims", "experiments")


def check_imports() -> str:
    """All six packages come from one folder; ``safewbc`` has looked before whether they are ours, and told why not."""
    homes = {}
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            raise RuntimeError(f"package {name!r} is not installed: run `make setup`")
        homes[name] = Path(spec.origin).resolve().parent.parent
    if len(set(homes.values())) > 1:
        places = ", ".join(f"{n} from {h}" for n, h in homes.items())
        raise RuntimeError(f"packages come from several places ({places}): `python -m safewbc` tells what to do")
    return f"all from {next(iter(homes.values()))}"


def check_mujoco() -> str:
    """MuJoCo can be imported, which it refuses where the environment asks for an OpenGL that is not there.

    Raises:
        ConfigError: the variable ``MUJOCO_GL`` keeps it from being imported.
    """
    try:
        import mujoco
    except Exception as error:  # what is raised depends on the OpenGL binding that the variable asks for
        if (chosen := os.environ.get("MUJOCO_GL")) is None:
            raise
        here = {"Linux": "egl, osmesa, glfw, glx", "Darwin": "cgl, glfw", "Windows": "wgl, glfw"}
        known = here.get(platform.system(), "glfw")
        allowed = f"unset, disable (no pictures), or one of {known} whose library is installed"
        raise ConfigError("environment variable MUJOCO_GL", chosen, allowed) from error
    return f"version {mujoco.__version__}"


def check_models() -> str:
    """Both robots load and build."""
    from robots.kinematics import Kinematics
    from robots.loader import BUILT_IN, load_robot

    return ", ".join(f"{n}: {Kinematics(load_robot(n)).nv - 6} joints" for n in BUILT_IN)


def check_solvers() -> str:
    """Every QP solver answers a small problem rightly."""
    from wbc.qp import make_solver

    for name in ("daqp", "proxqp"):
        solver = make_solver(name, 2, 1)
        solution = solver.solve(
            np.eye(2), np.zeros(2), np.array([[1.0, 1.0]]), np.array([-5.0, -5.0, 1.0]), np.array([5.0, 5.0, 9.0])
        )
        if solution.status != "optimal" or np.abs(solution.x - 0.5).max() > 1e-7:
            raise RuntimeError(f"{name} gave {solution.x} ({solution.status}) instead of [0.5, 0.5]: reinstall it")
    return "daqp and proxqp answer"


def check_kernels() -> str:
    """The compiled kernels run, and are in the cache from now on: the first time they are compiled.

    Raises:
        ConfigError: there is no folder that numba could keep them in.
    """
    try:
        from experiments.running.warmup import fill_caches

        done = fill_caches()
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        chosen = os.environ.get("NUMBA_CACHE_DIR", "not given")
        raise ConfigError("environment variable NUMBA_CACHE_DIR", chosen, "a folder that can be written") from error
    how = f"{done.compiled} compiled now" if done.compiled else "all from the cache"
    places = ", ".join(map(str, done.folders))
    return f"{done.kernels}, {how}, ready after {done.seconds:.1f} s; kept in {places}"


def check_rendering() -> str:
    """An image can be rendered and a video written."""
    from sims.rendering import rendering_problem, video_problem

    if problem := rendering_problem() or video_problem():
        raise RuntimeError(problem)
    return "images and videos"


def check_runs_folder() -> str:
    """Results can be written below the current folder."""
    if not os.access(Path.cwd(), os.W_OK):
        raise RuntimeError(f"{Path.cwd()} cannot be written: give --out, or work in another folder")
    return f"below {Path.cwd()}"


CHECKS: tuple[tuple[str, Callable[[], str], bool], ...] = (
    ("imports", check_imports, True),
    ("mujoco", check_mujoco, True),
    ("robots", check_models, True),
    ("solvers", check_solvers, True),
    ("kernels", check_kernels, True),
    ("rendering", check_rendering, False),
    ("results", check_runs_folder, False),
)
"""Name, check, whether the stack cannot run without it."""


def doctor(options: DoctorOptions | None = None) -> int:
    """Run all checks and print them; returns 0, or 1 where something that is needed does not work.

    Raises:
        WithoutEffectError: an option has no effect without ``g1``.
    """
    console = Console(soft_wrap=True)
    if options is not None:
        refuse_without(options, options.g1, ("interface", "domain"), "--g1")
        if options.g1:
            from experiments.cli.doctor_g1 import doctor_g1

            return doctor_g1(options.interface, options.domain, console)
    console.print(f"Python {sys.version.split()[0]}, {sys.executable}")
    failed = False
    for name, check, needed in CHECKS:
        try:
            with console.status(f"checking {name}"):
                said = check()
            console.print(f"[green]ok[/]   {name:<10} {said}")
        except Exception as error:
            failed |= needed
            mark = "[red]FAIL[/]" if needed else "[yellow]warn[/]"
            console.print(f"{mark} {name:<10} {error}")
    return 1 if failed else 0
