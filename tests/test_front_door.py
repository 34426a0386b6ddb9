"""The front door: every name is there, is the original, and costs nothing until it is used."""

import ast
import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import safewbc as sw

ROOT = Path(__file__).resolve().parents[1]
STUB = ROOT / "safewbc" / "__init__.pyi"
IMPORTS = [s for s in ast.parse(STUB.read_text(encoding="utf-8")).body if isinstance(s, ast.ImportFrom)]


def loaded_after(program: str) -> set[str]:
    """Top-level modules of a fresh interpreter after ``program``."""
    report = "; import json, sys; print(json.dumps([n.split('.')[0] for n in sys.modules]))"
    run = subprocess.run(
        [sys.executable, "-c", program + report], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return set(json.loads(run.stdout))


def test_every_name_is_the_object_of_the_module_that_defines_it() -> None:
    for statement in IMPORTS:
        for alias in statement.names:
            found = getattr(sw, alias.name)
            assert found is getattr(import_module(str(statement.module)), alias.name)
            assert found.__module__ == statement.module


def test_the_names_are_a_list_that_one_can_read() -> None:
    names = vars(sw)["__all__"]  # the stub, which is what a type checker sees, has none
    assert names == dir(sw) == sorted(set(names))
    assert 40 <= len(names) <= 60


def test_the_stub_exports_each_name_as_itself_and_says_nothing_else() -> None:
    """``import x as x`` is what makes a name of a stub public."""
    assert len(ast.parse(STUB.read_text(encoding="utf-8")).body) == len(IMPORTS)
    assert all(alias.asname == alias.name for statement in IMPORTS for alias in statement.names)


def test_the_package_runs_as_the_command_line() -> None:
    command = [sys.executable, "-m", "safewbc", "--version"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout.split()[0], run.stderr) == (0, "safewbc", "")


def test_an_unknown_name_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'load_robots', only .*load_robot,"):
        sw.load_robots  # type: ignore[attr-defined]  # noqa: B018


def test_the_door_alone_loads_nothing_heavy_and_none_of_the_six_packages() -> None:
    heavy = {"numpy", "scipy", "numba", "mujoco", "pinocchio", "matplotlib"}
    ours = {"robots", "wbc", "safety", "controllers", "sims", "experiments"}
    assert not loaded_after("import safewbc") & (heavy | ours)


def test_a_name_loads_no_more_than_its_module_needs() -> None:
    loaded = loaded_after("import safewbc; safewbc.ConfigError")
    assert "robots" in loaded
    assert not loaded & {"mujoco", "numba", "experiments"}
