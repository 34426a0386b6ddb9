"""Options back from JSON, and runs made again bit by bit."""

import dataclasses
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from experiments.cli import main as cli
from experiments.cli.replay import TIMES, array_differences
from experiments.recording.plain import plain
from experiments.recording.recording import load_recording, save_recording
from experiments.running.run import run
from experiments.scenarios.content import from_plain
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.registry import RUNNABLE, read_scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError


@dataclass(frozen=True)
class Inner:
    size: float = 1.0
    flag: bool = False


@dataclass(frozen=True)
class Outer:
    name: str = "a"
    count: int = 1
    path: Path | None = None
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    words: tuple[str, ...] = ()
    masses: dict[str, float] = field(default_factory=dict)
    kind: Literal["left", "right"] = "left"
    limit: float | None = None
    inner: Annotated[Inner, "a note"] = field(default_factory=Inner)


def through_json(value: object) -> Any:
    return json.loads(json.dumps(plain(dataclasses.asdict(value))))


@pytest.mark.parametrize(
    "value",
    [
        Outer(),
        Outer("b", 3, Path("some/where"), (1.0, 2.5, -3.0), ("x", "y"), {"arm": 1.2}, "right", 0.5, Inner(2.0, True)),
    ],
)
def test_a_dataclass_comes_back_from_json(value: Outer) -> None:
    again = from_plain(Outer, through_json(value), "options")
    assert again == value
    assert isinstance(again.place, tuple) and isinstance(again.inner, Inner)


def test_every_scenario_comes_back_by_its_name() -> None:
    plant = PlantOptions(mass_scale=1.2, link_mass={"torso_link": 1.1}, com_shift=(0.01, 0.0, 0.0))
    given = (
        Stand(plant=plant, safety=FilterOptions("cbf", alpha=3.0)),
        Taichi(push=("60,left,17.5",), torque="gravity"),
        Walk(script=Path("walk.txt").resolve(), push=("10,left,3", "20,90,4"), hands=True),
        *(kind() for kind in RUNNABLE),
    )
    for scenario in given:
        assert read_scenario(json.loads(json.dumps(scenario.to_json()))) == scenario


def test_what_is_not_given_keeps_its_default() -> None:
    assert from_plain(Outer, {"count": 4, "inner": {"flag": True}}, "o") == Outer(count=4, inner=Inner(flag=True))
    assert from_plain(Inner, {"size": 3}, "o") == Inner(3.0)


@pytest.mark.parametrize(
    ("table", "named", "allowed"),
    [
        ([], "options", "a table"),
        ({"cuont": 1}, "options.cuont", "known are name, count"),
        ({"count": 1.5}, "options.count", "int"),
        ({"count": True}, "options.count", "int"),
        ({"name": 3}, "options.name", "str"),
        ({"name": None}, "options.name", "str"),
        ({"place": [1.0, 2.0]}, "options.place", "list of 3"),
        ({"place": "origin"}, "options.place", "a list"),
        ({"place": [1.0, 2.0, "z"]}, "options.place[2]", "float"),
        ({"masses": {"arm": "heavy"}}, "options.masses.arm", "float"),
        ({"masses": 3}, "options.masses", "a table"),
        ({"kind": "up"}, "options.kind", "left, right"),
        ({"limit": "high"}, "options.limit", "float"),
        ({"inner": {"flag": 1}}, "options.inner.flag", "bool"),
        ({"inner": 1}, "options.inner", "a table"),
    ],
)
def test_what_does_not_fit_is_named(table: object, named: str, allowed: str) -> None:
    with pytest.raises(ConfigError) as caught:
        from_plain(Outer, table, "options")
    assert caught.value.name == named
    assert allowed in caught.value.allowed


def test_equal_arrays_do_not_differ_and_times_do_not_count() -> None:
    a = {"q": np.array([[1.0, np.nan], [0.0, 2.0]]), "tick_ms": np.array([1.0]), "stages": np.array([[2.0]])}
    b = {"q": a["q"].copy(), "tick_ms": np.array([9.0]), "stages": np.array([[3.0]])}
    assert set(TIMES) == {"tick_ms", "stages", "filter_ms", "estimate_ms"}
    assert array_differences(a, b) == []


def test_every_bit_counts() -> None:
    q = np.array([[1.0, np.nan], [0.0, 2.0], [3.0, 3.0]])
    last_bit = q.copy()
    last_bit[1, 1] = np.nextafter(2.0, 3.0)
    for other, words in (
        (last_bit, "row 1 of 3"),
        (np.where(q == 0.0, -0.0, q), "row 1 of 3"),
        (q[:2], "(2, 2)"),
        (q.astype(np.float32), "float32"),
    ):
        (line,) = array_differences({"q": q}, {"q": other})
        assert line.startswith("q: ") and words in line
    assert array_differences({"q": q}, {}) == ["q: only in the saved run"]
    assert array_differences({}, {"q": q}) == ["q: only in the new run"]


# --- the command


def replay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(sys, "argv", ["safewbc", "replay", str(folder)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return caught.value.code


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    plant = PlantOptions(mass_scale=1.1, noise_scale=1.0, actuator_delay=0.002, physics_dt=0.002)
    save_recording(run(Walk(duration=4.3, push=("20,left,2.5",), plant=plant, seed=3)), folder)
    return folder


def test_a_run_is_the_same_again(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert load_recording(saved).summary["steps"] > 0
    assert replay(saved, monkeypatch) == 0
    assert "identical" in capsys.readouterr().out


def test_another_seed_is_another_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "stand"
    save_recording(run(Stand(duration=0.2, plant=PlantOptions(noise_scale=1.0), seed=3)), folder)
    assert replay(folder, monkeypatch) == 0
    config = json.loads((folder / "config.json").read_text())
    config["scenario"]["seed"] = 4
    config["controller"]["dt"] = 0.001
    (folder / "config.json").write_text(json.dumps(config))
    capsys.readouterr()
    assert replay(folder, monkeypatch) == 1
    out = capsys.readouterr().out
    assert "q: first differs in row" in out
    assert "not identical" in out
    assert "changed since: controller.dt: 0.001 -> 0.002" in out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.pop("scenario"), "'scenario'"),
        (lambda c: c["scenario"].pop("scenario"), "'scenario'"),
        (lambda c: c["scenario"].update(scenario="fly"), "fly"),
        (lambda c: c["scenario"].update(scenario="nowhere:Fly"), "nowhere:Fly"),
        (lambda c: c["scenario"].update(wings=2), "walk.wings"),
        (lambda c: c["scenario"].update(duration=-1.0), "duration"),
    ],
)
def test_a_folder_that_cannot_be_replayed_is_refused(
    saved: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: Any,
    words: str,
) -> None:
    for name in ("config.json", "summary.json", "series.npz"):
        (tmp_path / name).write_bytes((saved / name).read_bytes())
    config = json.loads((tmp_path / "config.json").read_text())
    change(config)
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert replay(tmp_path, monkeypatch) == 2
    assert words in capsys.readouterr().err


def test_a_folder_without_a_run_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in (tmp_path, tmp_path / "absent"):
        assert replay(folder, monkeypatch) == 2
        assert str(folder / "config.json") in capsys.readouterr().err
