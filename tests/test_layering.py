"""Who may import whom, and what may be named where: read from the source, so that a lazy import counts too."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

MAY_IMPORT = {
    "robots": (),
    "wbc": ("robots",),
    "safety": ("robots", "wbc.qp", "wbc.active_set", "wbc.least_slack", "wbc.triangular"),
    "controllers": ("robots", "wbc", "safety"),
    "sims": ("robots",),
    "experiments": ("robots", "wbc", "safety", "controllers", "sims"),
    "safewbc": ("robots", "wbc", "safety", "controllers", "sims", "experiments"),
}
"""Package to what it may import of ours beside itself; the one table of the layering."""

FLOORS = {
    "safety": ("geometry", "tracking", "barriers", "filters"),
    "controllers": (
        "balance",
        "perception",
        "motion_limits",
        "estimation",
        "obstacle_tracker",
        "policies",
        "reference",
        "motions",
        "whole_body",
        "gaits",
        "supervisor",
        "agent",
        "deployment",
    ),
    "experiments": (
        "recording",
        "metrics",
        "reports",
        "scenarios",
        "running",
        "rehearsal",
        "benchmarks",
        "studies",
        "cli",
    ),
}
"""Sub-packages and modules of a package, from the ground up: each imports only what stands before it."""

SOLVERS = {"daqp": "wbc/qp/daqp_solver.py", "proxsuite": "wbc/qp/proxqp_solver.py"}
PLOTTING = ("matplotlib",)
TESTS_ONLY = ("tests", "conftest", "pytest", "_pytest", "hypothesis", "coal")
SILENT = ("robots", "wbc", "safety", "controllers", "sims")
HEAVY = ("matplotlib", "mujoco")


def imported(tree: ast.AST) -> Iterator[str]:
    """Every dotted name that the source imports, anywhere; ``from a import b`` gives ``a.b``, which covers ``a``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names)


def is_under(name: str, parents: tuple[str, ...]) -> bool:
    return any(name == p or name.startswith(p + ".") for p in parents)


def layering_faults(package: str, tree: ast.AST) -> list[str]:
    """Imports against the table, and relative ones, which would hide from it."""
    allowed = (package, *MAY_IMPORT[package])
    return [
        n for n in imported(tree) if n.startswith(".") or (is_under(n, tuple(MAY_IMPORT)) and not is_under(n, allowed))
    ]


def prints(tree: ast.AST) -> list[int]:
    """Lines that call ``print``, whoever's it is."""
    calls = (n for n in ast.walk(tree) if isinstance(n, ast.Call))
    return [c.lineno for c in calls if isinstance(c.func, ast.Name) and c.func.id == "print"]


def sources(*packages: str) -> list[Path]:
    return sorted(p for package in packages for p in (ROOT / package).rglob("*.py"))


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def importers(packages: tuple[str, ...], modules: tuple[str, ...]) -> set[str]:
    """Files of ``packages``, relative to the root, that import one of ``modules``."""
    return {
        path.relative_to(ROOT).as_posix()
        for path in sources(*packages)
        if any(is_under(name, modules) for name in imported(parse(path)))
    }


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_only_what_the_table_allows(package: str) -> None:
    files = sources(package)
    assert files, f"{package} has no modules"
    faults = {str(f.relative_to(ROOT)): found for f in files if (found := layering_faults(package, parse(f)))}
    assert not faults


def test_table_lists_a_package_after_all_it_may_import() -> None:
    order = list(MAY_IMPORT)
    for package, targets in MAY_IMPORT.items():
        assert {t.split(".")[0] for t in targets} <= set(order[: order.index(package)])


@pytest.mark.parametrize(
    ("package", "source", "faults"),
    [
        ("robots", "import wbc", ["wbc"]),
        ("robots", "def f():\n    from safety import rows", ["safety.rows"]),
        ("safety", "from wbc.qp import make_solver\nimport wbc.qp\nfrom wbc import qp", []),
        ("safety", "from wbc import tasks", ["wbc.tasks"]),
        ("safety", "import wbc.qpx", ["wbc.qpx"]),
        ("controllers", "from sims.plant import Plant", ["sims.plant.Plant"]),
        ("sims", "from controllers import tick", ["controllers.tick"]),
        ("sims", "import robots.loader\nimport robotsx", []),
        ("wbc", "from . import qp", ["..qp"]),
        ("experiments", "import sims, wbc, robots, safety, controllers", []),
        ("experiments", "def f():\n    import safewbc", ["safewbc"]),
        ("safewbc", "import sims, wbc, robots, safety, controllers, experiments", []),
    ],
)
def test_the_check_itself_tells_allowed_from_forbidden(package: str, source: str, faults: list[str]) -> None:
    assert layering_faults(package, ast.parse(source)) == faults


def without_type_checking(tree: ast.Module) -> ast.Module:
    """The source without what only type checkers read."""

    class Drop(ast.NodeTransformer):
        def visit_If(self, node: ast.If) -> ast.AST | None:
            only_types = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
            return None if only_types else self.generic_visit(node)

    return Drop().visit(tree)


@pytest.mark.parametrize("package", FLOORS)
def test_within_a_package_imports_go_down(package: str) -> None:
    floors = FLOORS[package]
    there = {p.stem for p in (ROOT / package).iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    assert there - {"__init__"} == set(floors)
    upward = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources(package)
        for name in imported(without_type_checking(parse(path)))
        if (own := path.relative_to(ROOT).with_suffix("").parts[1]) != "__init__"
        and name.startswith(f"{package}.")
        and (other := name.split(".")[1]) in floors
        and floors.index(other) > floors.index(own)
    ]
    assert not upward


def test_no_modules_import_each_other_in_a_circle() -> None:
    modules = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in sources(*MAY_IMPORT)
    }
    graph = {
        module: {home for name in imported(without_type_checking(parse(path))) if (home := home_of(name, modules))}
        for module, path in modules.items()
    }
    # raises where there is a circle, and names it
    order = TopologicalSorter({module: homes - {module} for module, homes in graph.items()}).static_order()
    assert len(list(order)) == len(modules)


def home_of(name: str, modules: Mapping[str, Path]) -> str | None:
    """The module that a dotted name is in; ``None`` for one of others."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name or None


def test_each_solver_is_imported_by_its_own_wrapper_only() -> None:
    for solver, wrapper in SOLVERS.items():
        assert importers(tuple(MAY_IMPORT), (solver,)) == {wrapper}


def test_plotting_is_imported_by_experiments_only() -> None:
    assert {file.split("/")[0] for file in importers(tuple(MAY_IMPORT), PLOTTING)} == {"experiments"}


def test_reports_know_recordings_and_metrics_and_nothing_that_asks_for_a_report() -> None:
    above = [p.name for p in (ROOT / "experiments").iterdir() if p.is_dir()]
    above = [f"experiments.{name}" for name in above if name not in {"reports", "recording", "metrics"}]
    assert importers(("experiments/reports",), tuple(above)) == set()
    assert "experiments/cli/console.py" in importers(("experiments",), ("experiments.reports",))


def test_nothing_that_serves_tests_is_imported() -> None:
    assert not importers(tuple(MAY_IMPORT), TESTS_ONLY)


def test_library_does_not_print() -> None:
    assert prints(ast.parse("x = 1\nprint(x)")) == [2]
    assert not {str(f.relative_to(ROOT)): lines for f in sources(*SILENT) if (lines := prints(parse(f)))}


def test_command_line_starts_without_the_heavy_modules() -> None:
    program = "import json, sys, experiments.cli.main; print(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    loaded = json.loads(run.stdout)
    assert "experiments.cli.main" in loaded
    assert not [name for name in loaded if name in HEAVY]


def test_a_run_without_obstacles_does_not_wait_for_the_filter_of_their_tracks() -> None:
    """filterpy imports scipy.stats, which is the slowest of all imports."""
    program = "import json, sys, experiments.running.run; print(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    loaded = json.loads(run.stdout)
    assert "controllers.whole_body.controller" in loaded
    assert not {"filterpy", "scipy.stats"} & set(loaded)
