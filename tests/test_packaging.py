"""The distribution: what it declares, what the lock holds, what the wheel carries, and whose packages get imported."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from experiments.benchmarks.peer_stacks import PEERS

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = ("robots", "wbc", "safety", "controllers", "sims", "experiments", "safewbc")
DISTRIBUTION_OF = {"PIL": "pillow", "pinocchio": "pin"}
"""Import name to distribution name where the two differ by more than the dash."""

LOCK_TEXT = (ROOT / "requirements.lock").read_text(encoding="utf-8")
LOCK_LINES = LOCK_TEXT.replace("\\\n", " ").splitlines()
PIN = re.compile(r"([A-Za-z0-9._-]+)==([^ ;]+)( ; [^-]+)?(\s+--hash=sha256:[0-9a-f]{64})+")
"""One line of the lock: name, version, marker, hashes; nothing else may stand there."""

LOCK = {canonicalize_name(m[1]): m[2] for line in LOCK_LINES if (m := PIN.fullmatch(line))}


OF_AN_EXTRA = {"g1": ("robots/unitree/idl.py", "robots/unitree/dds.py")}
"""Modules that cannot be imported without an extra; nothing imports them but under TYPE_CHECKING."""

LAZY_EXTRAS = ("study", "cluster", "mcap")
"""Extras whose projects our packages import, inside the functions that need them."""


def third_party_imports(at_once: bool, left_out: Sequence[str] = ()) -> set[str]:
    """Projects of others that our packages import: ``at_once``, or later inside functions."""
    names = set()
    for path in (p for package in PACKAGES for p in (ROOT / package).rglob("*.py")):
        if path.relative_to(ROOT).as_posix() in left_out:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
        later = {node for function in functions for node in ast.walk(function)}
        for node in ast.walk(tree):
            if (node in later) == at_once:
                continue
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.split(".")[0])
    others = names - set(PACKAGES) - sys.stdlib_module_names
    return {canonicalize_name(DISTRIBUTION_OF.get(name, name)) for name in others}


def declared(*extras: str) -> set[str]:
    """Names of the core dependencies and of those of ``extras``."""
    lines = [*PROJECT["project"]["dependencies"]]
    for extra in extras:
        lines += PROJECT["project"]["optional-dependencies"][extra]
    return {canonicalize_name(Requirement(line).name) for line in lines}


def test_all_packages_are_imported_from_this_tree() -> None:
    # the PyPI project `safety` has our import name: the wrong one must not be picked up unseen
    places = {name: importlib.import_module(name).__file__ for name in PACKAGES}
    assert places == {name: str(ROOT / name / "__init__.py") for name in PACKAGES}


def test_lock_holds_no_project_with_one_of_our_import_names() -> None:
    assert LOCK
    assert not set(PACKAGES) & set(LOCK)


def test_every_declared_requirement_is_locked_within_its_bounds() -> None:
    lines = [*PROJECT["project"]["dependencies"], *PROJECT["project"]["optional-dependencies"]["dev"]]
    requirements = [Requirement(line) for line in [*lines, *PROJECT["build-system"]["requires"]]]
    assert all(r.specifier for r in requirements)
    locked = {r.name: LOCK.get(canonicalize_name(r.name)) for r in requirements}
    assert not {name for name, version in locked.items() if version is None}
    assert not [str(r) for r in requirements if not r.specifier.contains(str(locked[r.name]))]


def test_every_line_of_the_lock_is_a_pin_with_hashes_and_names_no_place() -> None:
    assert not [line for line in LOCK_LINES if not PIN.fullmatch(line)]
    assert len(LOCK) == len(LOCK_LINES)


def test_what_is_imported_at_once_is_a_core_dependency() -> None:
    for_extras = [path for paths in OF_AN_EXTRA.values() for path in paths]
    assert third_party_imports(True, for_extras) <= declared()
    for extra, paths in OF_AN_EXTRA.items():
        others = [path for name, kept in OF_AN_EXTRA.items() if name != extra for path in kept]
        assert third_party_imports(True, others) <= declared(extra), paths


def test_what_is_imported_is_what_is_declared() -> None:
    assert third_party_imports(at_once=True) | third_party_imports(at_once=False) == declared(
        *LAZY_EXTRAS, *OF_AN_EXTRA
    )


def test_the_extra_of_the_benchmark_is_what_peers_are_and_stays_out_of_the_lock() -> None:
    requirements = [Requirement(line) for line in PROJECT["project"]["optional-dependencies"]["bench"]]
    assert {r.name for r in requirements} == {p.distribution for p in PEERS}
    assert all(str(r.specifier).startswith(">=") for r in requirements)
    assert not {canonicalize_name(r.name) for r in requirements} & set(LOCK)


def test_console_script_points_at_a_function() -> None:
    value = PROJECT["project"]["scripts"]["safewbc"]
    assert callable(EntryPoint("safewbc", value, "console_scripts").load())


def test_licence_is_declared_and_present() -> None:
    assert PROJECT["project"]["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel_files(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names in a wheel built from this tree with the locked backend; nothing is downloaded."""
    place = tmp_path_factory.mktemp("wheel")
    program = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"
    run = subprocess.run(
        [sys.executable, "-c", program, str(place)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    (wheel,) = place.glob("*.whl")
    return set(zipfile.ZipFile(wheel).namelist())


def test_wheel_carries_our_packages_and_nothing_else(wheel_files: set[str]) -> None:
    tops = {name.split("/")[0] for name in wheel_files}
    assert {top for top in tops if not top.endswith(".dist-info")} == set(PACKAGES)


def test_wheel_carries_every_source_and_every_robot(wheel_files: set[str]) -> None:
    sources = {p.relative_to(ROOT).as_posix() for package in PACKAGES for p in (ROOT / package).rglob("*.py")}
    robots = {p.relative_to(ROOT).as_posix() for p in (ROOT / "robots" / "data").glob("*.toml")}
    assert robots >= {"robots/data/g1.toml", "robots/data/tocabi.toml"}
    assert wheel_files >= sources | robots


def test_wheel_tells_type_checkers_that_every_package_has_types(wheel_files: set[str]) -> None:
    assert wheel_files >= {f"{package}/py.typed" for package in PACKAGES} | {"safewbc/__init__.pyi"}


def test_wheel_carries_the_templates_and_the_style_of_plots(wheel_files: set[str]) -> None:
    reports = ROOT / "experiments" / "reports"
    needed = [*(reports / "templates").iterdir(), *reports.rglob("*.mplstyle")]
    assert len(needed) > 1
    assert wheel_files >= {p.relative_to(ROOT).as_posix() for p in needed}


def test_commands_that_need_no_network_work_without_the_extras() -> None:
    """Replays, rehearsals in one process and the command line itself are there without cyclonedds and mcap."""
    modules = (
        *(
            "experiments.cli.main",
            "experiments.cli.deploy",
            "experiments.cli.twin",
            "experiments.cli.replay_deployment",
        ),
        *("experiments.rehearsal.rehearse", "experiments.running.deployment_tasks", "controllers.deployment.guardian"),
    )
    code = (
        "import sys\n"
        "sys.modules['cyclonedds'] = sys.modules['mcap'] = None\n"
        f"from importlib import import_module\nfor name in {modules!r}:\n    import_module(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
