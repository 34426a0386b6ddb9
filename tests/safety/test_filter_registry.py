"""A filter from outside: registered by name, with parameters of its own, found by every way there is."""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.reference import reference_here
from controllers.whole_body.config import ControllerConfig, FilterTuning
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.errors import ConfigError, DescriptionError
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import BarrierParameters, cbf
from safety.filters.filter_kind import FilterKind
from safety.filters.registry import FILTERS, KINDS, filter_kind, register, unregister
from safety.filters.resolutions import NEAREST
from safety.filters.safety_filter import FilterSettings, FilterStatus, SafetyFilter
from safety.filters.second_order import ecbf_rows

PAGE = (Path(__file__).parents[2] / "docs" / "safety.md").read_text(encoding="utf-8")
SOURCE = next(b for b in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) if "class Approach" in b)


@pytest.fixture
def forget() -> Iterator[None]:
    """What a test registers is forgotten after it."""
    yield
    for name in set(KINDS) - set(FILTERS):
        unregister(name)


@pytest.fixture
def slow(forget: None) -> dict[str, Any]:
    """The worked example of docs/safety.md."""
    scope: dict[str, Any] = {"__name__": "an_example"}
    exec(compile(SOURCE, "docs/safety.md", "exec"), scope)
    return scope


def one_row(h: float = 1.0) -> BarrierRows:
    """h falls as the first input grows negative."""
    return BarrierRows(np.array([h]), np.eye(1, 2), np.zeros(1), np.array([FAMILIES.index("obstacle")]))


def lowest_h(filter_name: str, own: Any = None) -> tuple[Array, Array]:
    """Smallest h of self-collision in each tick, hands sent into the torso, and its fastest fall [m/s]."""
    robot = load_robot("g1")
    config = controller_config(robot, filter=filter_name)
    config = replace(config, safety=replace(config.safety, own=own))
    controller = WholeBodyController(robot, config, with_hands=True)
    kin, q, dt = controller.kin, standing_configuration(robot, "hands_front"), 0.005
    kin.update(q, np.zeros(kin.nv))
    reference = reference_here(kin, with_hands=True)
    for point in reference.hands or ():
        point.position[:2] = 0.0
    rows, heights = controller.barriers.slices["self_collision"], []
    for i in range(300):
        v = controller.tick(RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), dt * i), reference).safety.v
        q = kin.integrate(q, v, dt)
        kin.update_geometry(q)
        heights.append(controller.barriers.evaluate(kin).h[rows].copy())
    h = np.array(heights)
    return h.min(axis=1), -np.diff(h, axis=0).min(axis=1) / dt


def test_the_worked_example_keeps_barriers_and_its_own_bound_in_a_closed_loop(slow: dict[str, Any]) -> None:
    """The robot follows it exactly; a CBF alone comes closer faster."""
    plain, fast = lowest_h("cbf")
    h, rate = lowest_h("slow", slow["Approach"](0.05))
    assert h.min() > -1e-4 and plain.min() > -1e-4
    assert fast.max() > 0.1
    assert rate.max() < 0.05 + 0.01


def test_own_parameters_are_the_kinds_those_given_or_those_of_each_family(slow: dict[str, Any]) -> None:
    approach, v_des = slow["Approach"], np.array([-1.0, 0.0])

    def answer(own: Any) -> float:
        safety = SafetyFilter("slow", 1, BarrierParameters(own=own), np.full(2, 5.0))
        return float(safety.apply(one_row(), v_des).v[0])

    assert answer(None) == pytest.approx(-0.1, abs=1e-9)
    assert answer(approach(0.3)) == pytest.approx(-0.3, abs=1e-9)
    assert answer({"obstacle": approach(0.2)}) == pytest.approx(-0.2, abs=1e-9)
    assert answer({"workspace": approach(0.2)}) == pytest.approx(-0.1, abs=1e-9)


def test_a_description_gives_own_parameters_by_filter_and_by_family(slow: dict[str, Any]) -> None:
    approach, robot = slow["Approach"], load_robot("g1")

    def own(table: object, name: str = "slow") -> Any:
        described = replace(robot, tuning={**robot.tuning, "filters": {"slow": table}})
        return controller_config(described, filter=name).safety.own

    assert own({"approach": 0.2}) == approach(0.2)
    assert own({"obstacle": {"approach": 0.2}}) == {"obstacle": approach(0.2)}
    assert own({"approach": 0.2}, "issf") is None
    assert controller_config(robot, filter="slow").safety.own is None
    for bad in ({"speed": 0.2}, {"obstacle": {"speed": 0.2}}, 0.2):
        with pytest.raises(DescriptionError, match=r"tuning\.filters\.slow"):
            own(bad)


@dataclass
class Loose:
    gain: float = 1.0


@dataclass(frozen=True)
class Tight:
    gain: float = 1.0


def test_parameters_of_another_filter_are_refused_by_name(slow: dict[str, Any]) -> None:
    kind = SafetyFilter("slow", 1, BarrierParameters(), np.ones(2))
    for bad in (Tight(), {"obstacle": Tight()}, {"walls": slow["Approach"]()}, slow["Approach"](float("nan"))):
        with pytest.raises(ConfigError):
            kind.set_parameters(BarrierParameters(own=bad))
        with pytest.raises(ConfigError):
            ControllerConfig(filter="slow", safety=FilterTuning(own=bad))
    with pytest.raises(ConfigError, match="this filter has none"):
        ControllerConfig(filter="cbf", safety=FilterTuning(own=slow["Approach"]()))
    for default in (Loose(), Tight, Tight("much")):
        with pytest.raises(ConfigError):
            FilterKind("odd", "odd", cbf, NEAREST, "here", parameters=default)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"name": ""}, "name"),
        ({"name": "a:b"}, "name"),
        ({"orders": ()}, "orders"),
        ({"orders": (3,)}, "orders"),
        ({"margins": {"walls": 1.0}}, "margins"),
    ],
)
def test_a_kind_is_checked_when_it_is_made(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        replace(KINDS["cbf"], **changes)


def test_names_are_given_once_and_those_of_the_project_stay(forget: None) -> None:
    kind = register(replace(KINDS["cbf"], name="ours"))
    assert register(kind) is kind is filter_kind("ours")
    with pytest.raises(ConfigError, match="not taken"):
        register(replace(KINDS["issf"], name="ours"))
    with pytest.raises(ConfigError, match="not taken"):
        register(replace(KINDS["issf"], title="ours"))
    with pytest.raises(ConfigError, match="FilterKind"):
        register(cbf)
    unregister("ours")
    with pytest.raises(ConfigError, match=r"one of none, cbf, issf.*module:name"):
        filter_kind("ours")
    with pytest.raises(ConfigError, match="registered"):
        unregister("cbf")
    with pytest.raises(TypeError):
        KINDS["ours"] = kind


def test_a_module_is_imported_for_the_filter_it_registers(
    forget: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "filters_of_a_module.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert filter_kind("filters_of_a_module:slow").name == "slow"
    with pytest.raises(ConfigError, match="filters_of_a_module registers"):
        filter_kind("filters_of_a_module:fast")
    with pytest.raises(ConfigError, match="can be imported"):
        filter_kind("no_such_module:slow")


def test_a_module_of_the_working_directory_is_found(
    forget: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "filters_from_here.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.chdir(tmp_path)
    assert filter_kind("filters_from_here:slow").name == "slow"


@pytest.mark.parametrize("source", ["from os import no_such_name", "import no_such_module_at_all", "def ("])
def test_a_module_that_cannot_be_imported_is_told(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_filters.py").write_text(source, encoding="utf-8")
    package(tmp_path, "broken = broken_filters:BROKEN")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("broken_filters:slow", "broken"):
        with pytest.raises(ConfigError, match=f"filter = '{name}': must be .*can be imported"):
            filter_kind(name)


def package(folder: Path, entry: str) -> None:
    """An installed package with an entry point."""
    info = folder / "filters_of_a_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: filters-of-a-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[safewbc.filters]\n{entry}\n")


def test_an_entry_point_has_the_name_of_its_filter_which_its_module_must_have(
    forget: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "filters_of_another.py").write_text(SOURCE, encoding="utf-8")
    package(tmp_path, "fast = filters_of_another:SLOW\nlost = filters_of_another:LOST")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"'fast'.*: slow"):
        filter_kind("fast")
    with pytest.raises(ConfigError, match=r"'lost'.*LOST"):
        filter_kind("lost")


def test_an_installed_package_names_its_filters_as_entry_points(
    forget: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "filters_of_a_package.py").write_text(SOURCE, encoding="utf-8")
    package(tmp_path, "slow = filters_of_a_package:SLOW")
    monkeypatch.syspath_prepend(tmp_path)
    assert filter_kind("slow").title == "slow CBF"
    assert ControllerConfig(filter="slow").filter == "slow"


def test_a_filter_for_accelerations_only_is_run_within_dynwbc(forget: None) -> None:
    """The same conditions as those of eCBF under another name: the same torques, bit for bit."""
    register(FilterKind("exponential", "ours", cbf, NEAREST, "here", orders=(2,), index=ecbf_rows))
    robot, torques = load_robot("tocabi"), []
    for name in ("ecbf", "exponential"):
        controller = WholeBodyController(robot, controller_config(robot, filter=name), with_hands=True)
        q = standing_configuration(robot, "hands_front")
        v = np.append(np.zeros(6), np.random.default_rng(0).normal(scale=0.8, size=q.size - 7))
        state = RobotState(q, v, np.zeros(q.size - 7), 0.0)
        controller.reset(state)
        reference = reference_here(controller.kin, with_hands=True)
        result = controller.tick(state, reference)
        assert controller.filter is None
        assert result.safety.status == FilterStatus.FILTERED
        torques.append(result.command.tau)
    np.testing.assert_array_equal(*torques)
    with pytest.raises(ConfigError, match="acts on accelerations"):
        SafetyFilter("exponential", 1, BarrierParameters(), np.ones(2))
    SafetyFilter("exponential", 1, BarrierParameters(), np.ones(2), settings=FilterSettings(order=2))
