"""The command line as a user meets it: refusals before anything is written, files after a run, honest help."""

import ast
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import pytest

from controllers.whole_body.controller import STAGES
from experiments.cli import console
from experiments.cli import main as cli
from experiments.recording.recording import load_recording
from experiments.running import terminal, warmup
from experiments.running.loop import Observer
from experiments.running.run import run_prepared
from experiments.scenarios.options import OutputOptions, PlantOptions
from experiments.scenarios.registry import SCENARIOS
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.studies import results_tables as table
from robots.kernel_types import CACHE_PREFIX
from robots.loader import load_robot

ROOT = Path(__file__).resolve().parents[2]

REQUIRED = (
    "scenario",
    "robot",
    "filter",
    "mass_scale",
    "seed",
    "duration_s",
    "fell",
    "min_h_self_collision_m",
    "min_h_joint_limit_rad",
    "collision_ratio",
    "hand_rmse_m",
    "com_rmse_m",
    "zmp_inside_fraction",
    "max_torque_fraction",
    "qp_failures",
    "tick_ms_median",
    "tick_ms_p99",
    "versions",
)
QUICK = ("--no-video", "--no-report")


@dataclass(frozen=True)
class Outcome:
    code: object
    out: str
    err: str


class CommandLine:
    """Calls the entry point in this process, in a folder of its own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._monkeypatch = monkeypatch
        self._capsys = capsys
        monkeypatch.chdir(folder)

    def __call__(self, *arguments: str) -> Outcome:
        self._monkeypatch.setattr(sys, "argv", ["safewbc", *arguments])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        text = self._capsys.readouterr()
        return Outcome(caught.value.code, text.out, text.err)

    def files(self) -> list[str]:
        return sorted(str(p.relative_to(self.folder)) for p in self.folder.rglob("*"))


@pytest.fixture
def safewbc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine(tmp_path, monkeypatch, capsys)


# --- refusals

BAD: list[tuple[Sequence[str], Sequence[str]]] = [
    (["--robot", "atlas"], ["robot", "'atlas'", "g1, tocabi"]),
    (["--robot", ""], ["robot", "''", "g1, tocabi"]),
    (["--robot", "missing.toml"], ["missing.toml", "readable"]),
    (["--alpha", "-1"], ["alpha", "-1.0", "above 0"]),
    (["--alpha", "inf"], ["alpha", "inf", "above 0"]),
    (["--epsilon", "0"], ["epsilon", "0.0", "above 0"]),
    (["--mass-scale", "nan"], ["mass_scale", "nan", "above 0"]),
    (["--mass-scale", "0"], ["mass_scale", "0.0", "above 0"]),
    (["--mass-scale", "50"], ["mass_scale", "50.0", "0.1 to 10"]),
    (["--filter", "foo"], ["filter", "'foo'", "none, cbf, issf"]),
    (["--duration", "-1"], ["duration", "-1.0", "0.1 to"]),
    (["--duration", "0.001"], ["duration", "0.001", "0.1 to"]),
    (["--duration", "1e9"], ["duration", "1000000000.0", "3600"]),
    (["--duration", "3600"], ["duration", "3600.0", "at most 600 s"]),
    (["--duration", "nan"], ["duration", "nan", "0.1 to"]),
    (["--control-rate", "333"], ["control_rate", "333.0", "whole number of physics steps"]),
    (["--control-rate", "5000"], ["control_rate", "5000.0", "whole number of physics steps"]),
    (["--control-rate", "0"], ["control_rate", "0.0", "50 to 10000"]),
    (["--physics-dt", "0"], ["physics_dt", "0.0", "0.0001 to 0.005"]),
    (["--physics-dt", "-0.001"], ["physics_dt", "-0.001", "0.0001 to 0.005"]),
    (["--seed", "-1"], ["seed", "-1", "from 0"]),
    (["--nan-at", "-1"], ["nan_at", "-1.0", "0 or above"]),
    (["--nan-at", "10"], ["nan_at", "10.0", "within the run's 10 s"]),
    (["--noise-scale", "-1"], ["noise_scale", "-1.0", "0 to 100"]),
    (["--actuator-delay", "-0.1"], ["actuator_delay", "-0.1", "0 or above"]),
    (["--friction", "0"], ["friction", "0.0", "above 0"]),
    (["--armature-scale", "nan"], ["armature_scale", "nan", "0 or above"]),
    (["--joint-friction-scale", "-2"], ["joint_friction_scale", "-2.0", "0 or above"]),
    (["--com-shift", "0", "nan", "0"], ["com_shift", "nan", "finite"]),
    (["--link-mass", "tail", "2"], ["'tail'", "pelvis", "torso_link"]),
    (["--link-mass", "torso_link", "-1"], ["torso_link", "-1.0", "above 0"]),
]


@pytest.mark.parametrize(("arguments", "told"), BAD, ids=[" ".join(a) for a, _ in BAD])
def test_a_bad_option_is_refused_in_one_line_and_nothing_is_written(
    safewbc: CommandLine, arguments: Sequence[str], told: Sequence[str]
) -> None:
    outcome = safewbc("run", "stand", *arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("safewbc: ")
    assert outcome.err.count("\n") == 1
    for word in told:
        assert word in outcome.err
    assert safewbc.files() == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "hand-tracking", "--motion", "dance"], ["motion", "'dance'", "circles, beyond-reach"]),
        (["run", "hand-tracking", "--robot", "atlas"], ["'atlas'"]),
        (["demo", "--robot", "atlas"], ["'atlas'"]),
        (["demo", "--mass-scale", "-1"], ["mass_scale", "-1.0"]),
        (["demo", "--duration", "0"], ["duration", "0.0"]),
        (["bench", "tick", "--ticks", "5"], ["ticks", "5", "100 to"]),
        (["bench", "tick", "--filter", "foo"], ["filter", "'foo'"]),
        (["bench", "tick", "--robots", "atlas"], ["'atlas'"]),
        (["bench", "tick", "--robots"], ["robots", "at least one"]),
        (["bench", "tick", "--out", "missing/x.json"], ["out", "missing/x.json"]),
        (["bench", "tick", "--out", "."], ["out", "'.'"]),
    ],
    ids=" ".join,
)
def test_every_command_refuses_before_it_writes(
    safewbc: CommandLine, arguments: Sequence[str], told: Sequence[str]
) -> None:
    outcome = safewbc(*arguments)
    assert outcome.code == 2
    assert outcome.err.startswith("safewbc: ")
    assert outcome.err.count("\n") == 1
    for word in told:
        assert word in outcome.err
    assert safewbc.files() == []


@pytest.mark.parametrize("out", ["plain", "plain/below"])
@pytest.mark.parametrize("command", [("run", "stand"), ("run", "hand-tracking"), ("demo",)], ids=" ".join)
def test_a_place_that_cannot_be_written_is_refused_before_the_run(
    safewbc: CommandLine, command: Sequence[str], out: str
) -> None:
    """A path at or below a regular file: that stops the superuser too."""
    (safewbc.folder / "plain").write_text("keep me")
    outcome = safewbc(*command, "--out", out)
    assert outcome.code == 2
    assert outcome.err.startswith(f"safewbc: out = '{out}': must be a folder that can be written")
    assert outcome.err.count("\n") == 1
    assert safewbc.files() == ["plain"]
    assert (safewbc.folder / "plain").read_text() == "keep me"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "stand", "--colour", "red"], "--colour"),
        (["run", "stand", "--mass-scale", "heavy"], "heavy"),
        (["run", "stand", "--seed", "1.5"], "1.5"),
        (["run", "fly"], "fly"),
        (["run"], "stand"),
        ([], "demo"),
        (["bench", "tock"], "tock"),
    ],
    ids=str,
)
def test_what_cannot_be_parsed_is_refused_with_the_culprit(
    safewbc: CommandLine, arguments: Sequence[str], told: str
) -> None:
    outcome = safewbc(*arguments)
    assert outcome.code == 2
    assert told in outcome.err
    assert "Traceback" not in outcome.err
    assert safewbc.files() == []


def test_a_description_that_is_broken_is_refused_by_entry(safewbc: CommandLine) -> None:
    source = (ROOT / "robots" / "data" / "g1.toml").read_text(encoding="utf-8")
    for name, text, told in (
        ("empty.toml", "", "robot"),
        ("no_toml.toml", "[[[", "valid TOML"),
        ("table.toml", source + "\n[tuning.task]\ncom = 1.0\n", "tuning"),
        ("field.toml", source + "\n[tuning.tasks]\ncome = 1.0\n", "come"),
        ("value.toml", source + "\n[tuning.tasks]\ncom = -1.0\n", "task com = -1.0"),
        ("circle.toml", source.replace("radius = 0.1\n", 'radius = "wide"\n'), "radius"),
        ("posture.toml", source.replace('posture = "hands_front"', 'posture = "yoga"'), "'yoga'"),
    ):
        (safewbc.folder / name).write_text(text, encoding="utf-8")
        outcome = safewbc("run", "hand-tracking", "--robot", name)
        assert outcome.code == 2, name
        assert told in outcome.err, name
        assert outcome.err.count("\n") == 1, name
    assert all(f.endswith(".toml") for f in safewbc.files())


def test_a_missing_posture_is_told_with_file_and_table(safewbc: CommandLine) -> None:
    source = (ROOT / "robots" / "data" / "g1.toml").read_text(encoding="utf-8")
    (safewbc.folder / "mine.toml").write_text(source.replace("posture.hands_front", "posture.other"), encoding="utf-8")
    outcome = safewbc("run", "hand-tracking", "--robot", "mine.toml")
    assert outcome.code == 2
    for part in ("mine.toml", "'hands_front'", "one of other, standing", "[posture.hands_front]"):
        assert part in outcome.err
    assert outcome.err.count("\n") == 1


def in_a_process(folder: Path, *arguments: str, **variables: str) -> Outcome:
    """The command in a process of its own, in ``folder``, with further environment variables."""
    command = [sys.executable, "-c", "from experiments.cli.main import main; main()", *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)


@pytest.mark.parametrize(
    "arguments",
    [("run", "stand"), ("run", "hand-tracking"), ("demo",), ("bench", "tick"), ("table",)],
    ids=" ".join,
)
def test_an_opengl_that_mujoco_does_not_know_is_refused_in_one_line(tmp_path: Path, arguments: Sequence[str]) -> None:
    """In a process of its own: MuJoCo reads the variable once, when it is imported."""
    outcome = in_a_process(tmp_path, *arguments, MUJOCO_GL="paint")
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("safewbc: environment variable MUJOCO_GL = 'paint': must be unset, disable")
    assert outcome.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_doctor_reports_an_opengl_that_mujoco_does_not_know(tmp_path: Path) -> None:
    outcome = in_a_process(tmp_path, "doctor", MUJOCO_GL="paint")
    assert outcome.code == 1
    (line,) = [line for line in outcome.out.splitlines() if line.startswith("FAIL")]
    assert "MUJOCO_GL = 'paint'" in line
    assert "Traceback" not in outcome.err


def test_the_version_is_that_of_the_distribution(safewbc: CommandLine) -> None:
    outcome = safewbc("--version")
    assert (outcome.code, outcome.out, outcome.err) == (0, f"safewbc {metadata.version('safewbc')}\n", "")


# --- runs


def test_a_run_leaves_configuration_summary_series_and_report(tmp_path: Path) -> None:
    """As a user starts it, in a process of its own."""
    command = [sys.executable, "-c", "from experiments.cli.main import main; main()"]
    arguments = ["run", "stand", "--duration", "0.3", "--no-video", "--out", "here", "--mass-scale", "1.1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command + arguments, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    folder = tmp_path / "here"
    assert sorted(p.name for p in folder.iterdir()) == ["config.json", "report.html", "series.npz", "summary.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["here"]
    summary = json.loads((folder / "summary.json").read_text())
    assert set(REQUIRED) <= set(summary)
    assert (summary["scenario"], summary["robot"], summary["mass_scale"]) == ("stand", "g1", 1.1)
    assert (summary["hand_rmse_m"], summary["collision_ratio"]) == (None, None)
    assert summary["duration_s"] == pytest.approx(0.3)
    assert summary["fell"] is False
    result = load_recording(folder)
    assert result.config["scenario"]["plant"]["mass_scale"] == 1.1
    assert len(result.series["time"]) == 150
    assert "results: here" in done.stdout


def test_a_run_without_a_display_says_so_and_writes_the_report(tmp_path: Path) -> None:
    """MuJoCo's window opens without a display, and fails only where something is drawn."""
    arguments = ("run", "stand", "--duration", "0.1", "--out", "g")
    outcome = in_a_process(tmp_path, *arguments, MUJOCO_GL="glfw", DISPLAY="", WAYLAND_DISPLAY="")
    assert outcome.code == 0, outcome.err
    assert "Traceback" not in outcome.err
    assert "no pictures or no video: " in outcome.out
    assert sorted(p.name for p in (tmp_path / "g").iterdir()) == [
        "config.json",
        "report.html",
        "series.npz",
        "summary.json",
    ]


def test_hand_tracking_summarises_the_same_and_more(safewbc: CommandLine) -> None:
    outcome = safewbc("run", "hand-tracking", "--duration", "0.2", "--out", "h", "--robot", "tocabi", *QUICK)
    assert outcome.code == 0
    summary = json.loads((safewbc.folder / "h" / "summary.json").read_text())
    assert set(REQUIRED) <= set(summary)
    assert summary["hand_rmse_m"] < 0.01
    assert summary["scenario"] == "hand-tracking"
    assert safewbc.files() == ["h", "h/config.json", "h/series.npz", "h/summary.json"]


def test_without_out_results_go_below_runs_and_never_over_each_other(safewbc: CommandLine) -> None:
    for _ in range(2):
        assert safewbc("run", "stand", "--duration", "0.1", *QUICK).code == 0
    folders = list((safewbc.folder / "runs").iterdir())
    assert len(folders) == 2
    assert all(f.name.startswith("stand-") for f in folders)
    assert all((f / "summary.json").is_file() for f in folders)


def test_a_folder_used_before_holds_no_pictures_of_the_old_run(safewbc: CommandLine) -> None:
    old = safewbc.folder / "again"
    old.mkdir()
    for name in ("report.html", "video.mp4", "summary.json", "notes.txt"):
        (old / name).write_text("old")
    refused = safewbc("run", "stand", "--duration", "0.1", "--out", "again", *QUICK)
    assert refused.code == 2
    assert "--overwrite" in refused.err
    assert {(old / name).read_text() for name in ("report.html", "video.mp4", "summary.json")} == {"old"}
    assert safewbc("run", "stand", "--duration", "0.1", "--out", "again", "--overwrite", *QUICK).code == 0
    names = sorted(p.name for p in old.iterdir())
    assert names == ["config.json", "notes.txt", "series.npz", "summary.json"]
    assert json.loads((old / "summary.json").read_text())["scenario"] == "stand"
    assert (old / "notes.txt").read_text() == "old"


@pytest.mark.parametrize("out", ["a [b] c", "[red]", "closing [/b]", "ümlaut", "deep/er/still", "..hidden"])
def test_paths_are_taken_and_shown_as_they_are(safewbc: CommandLine, out: str) -> None:
    """Brackets are no markup; a long path is not broken, so that it can be copied."""
    long = f"{out}{'x' * 100}"
    outcome = safewbc("run", "stand", "--duration", "0.1", "--out", long, *QUICK)
    assert outcome.code == 0, outcome.err
    assert f"results: {long}\n" in outcome.out
    assert (safewbc.folder / long / "summary.json").is_file()


def test_the_demo_keeps_both_runs(safewbc: CommandLine) -> None:
    outcome = safewbc("demo", "--duration", "0.1", "--out", "d", *QUICK)
    assert outcome.code == 0, outcome.err
    for name in ("none", "issf"):
        result = load_recording(safewbc.folder / "d" / name)
        assert (result.summary["filter"], result.summary["mass_scale"]) == (name, 1.2)
        assert set(REQUIRED) <= set(result.summary)
    assert len(safewbc.files()) == 9


def test_an_empty_folder_that_was_there_before_stays(safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(console, "run_prepared", broken)
    (safewbc.folder / "mine").mkdir()
    assert safewbc("run", "stand", "--out", "mine", *QUICK).code == 130
    assert safewbc.files() == ["mine"]


def test_a_stopped_run_is_saved_and_told_by_the_exit_code(safewbc: CommandLine) -> None:
    outcome = safewbc("run", "stand", "--duration", "0.2", "--nan-at", "0.05", "--out", "s", *QUICK)
    assert outcome.code == 1
    assert "stopped because" in outcome.out
    summary = json.loads((safewbc.folder / "s" / "summary.json").read_text())
    assert summary["stop_cause"] == f"measured position of {load_robot('g1').joint_names[0]} is nan"
    assert set(REQUIRED) <= set(summary)


def test_a_robot_without_self_collision_pairs_runs(safewbc: CommandLine) -> None:
    source = (ROOT / "robots" / "data" / "g1.toml").read_text(encoding="utf-8")
    start, end = source.index("[self_collision]"), source.index("[posture.standing]")
    (safewbc.folder / "bare.toml").write_text(source[:start] + source[end:], encoding="utf-8")
    outcome = safewbc("run", "hand-tracking", "--robot", "bare.toml", "--duration", "0.1", "--out", "b", *QUICK)
    assert outcome.code == 0, outcome.err
    summary = json.loads((safewbc.folder / "b" / "summary.json").read_text())
    assert summary["min_h_self_collision_m"] is None
    assert summary["collision_ratio"] is None


def test_an_interrupted_run_says_so_and_leaves_no_empty_folder(
    safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(console, "run_prepared", interrupted)
    outcome = safewbc("run", "stand", "--out", "i", *QUICK)
    assert outcome.code == 130
    assert outcome.err == "safewbc: interrupted\n"
    assert safewbc.files() == []


def test_what_was_simulated_is_saved_when_an_observer_raises(
    safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken(Observer):
        def ended(self, loop: object) -> None:
            raise OSError("terminal is gone")

    monkeypatch.setattr(console, "run_prepared", lambda given, observers: run_prepared(given, (*observers, Broken())))
    outcome = safewbc("run", "stand", "--duration", "0.1", "--out", "b", *QUICK)
    assert outcome.code == 2
    assert "Broken raised OSError: terminal is gone" in outcome.err
    assert len(load_recording(safewbc.folder / "b").series["time"]) == 50


def start_run(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """A run in a process of its own, which prints a line when it simulates; Ctrl-C is what a terminal makes it."""
    # jobs in the background of a shell are started with the interrupt ignored, and pass that on
    program = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from experiments.cli import main as cli
from experiments.cli import console
from experiments.running import terminal
from experiments.running.recorder import Progress
run_prepared = console.run_prepared
def told(given, observers):
    return run_prepared(given, (Progress(lambda t: print("at", t, flush=True)), *observers))
console.run_prepared = told
cli.main()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program, "run", "stand", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    # a pipe gets the bars as lines too
    assert any(line == "at 0.0\n" for line in lines)
    return process


def test_control_c_keeps_what_was_simulated(safewbc: CommandLine) -> None:
    """The signal comes when the simulation is known to run; what is saved is made again by replay."""
    process = start_run(safewbc.folder, "--duration", "600", "--out", "c", "--no-video", "--no-report")
    try:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    result = load_recording(safewbc.folder / "c")
    assert result.summary["stop_cause"] == "interrupted"
    assert 0.0 < result.summary["duration_s"] < 600.0
    assert result.summary["stop_time_s"] == pytest.approx(result.summary["duration_s"])
    assert len(result.series["time"]) == round(500 * result.summary["duration_s"])
    assert safewbc("replay", "c").code == 0


def test_two_runs_in_one_folder_are_refused_and_a_killed_one_leaves_nothing_in_the_way(safewbc: CommandLine) -> None:
    process = start_run(safewbc.folder, "--duration", "600", "--out", "c")
    try:
        second = safewbc("run", "stand", "--duration", "0.1", "--out", "c", *QUICK)
        assert second.code == 2
        assert "no other run is writing to" in second.err
    finally:
        process.kill()
        process.communicate()
    assert safewbc("run", "stand", "--duration", "0.1", "--out", "c", *QUICK).code == 0
    assert safewbc.files() == ["c", "c/config.json", "c/series.npz", "c/summary.json"]


def test_unused_folders_are_numbered(tmp_path: Path) -> None:
    first = tmp_path / "run"
    assert terminal.unused(first) == first
    for name in ("run", "run-2", "run-3"):
        (tmp_path / name).mkdir()
    assert terminal.unused(first) == tmp_path / "run-4"


def test_a_folder_that_is_given_is_used_as_it_is(tmp_path: Path) -> None:
    given = tmp_path / "given"
    given.mkdir()
    with terminal.results_folder(OutputOptions(out=given), "stand") as folder:
        assert folder == given


# --- other commands


def test_doctor_finds_nothing_missing(safewbc: CommandLine) -> None:
    outcome = safewbc("doctor")
    assert outcome.code == 0, outcome.out
    assert "FAIL" not in outcome.out
    for name in ("imports", "mujoco", "robots", "solvers", "kernels", "results"):
        assert f"ok   {name}" in outcome.out
    assert safewbc.files() == []


@pytest.mark.parametrize("shared", [False, True])
def test_caches_of_other_states_of_the_sources_go_where_nobody_else_has_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared: bool
) -> None:
    new, old = (CACHE_PREFIX + 16 * digit for digit in "ab")
    others = ["kernels-of-mine", "others"]
    for name in (new, old, *others):
        (tmp_path / name / "wbc").mkdir(parents=True)
    monkeypatch.setattr(warmup, "CACHE_FOLDER", tmp_path / new)
    monkeypatch.setattr(warmup, "OWN_FOLDER", tmp_path / "elsewhere" if shared else tmp_path)
    warmup.forget_old_caches()
    assert {path.name for path in tmp_path.iterdir()} == {new, *others, *([old] if shared else [])}


def test_filled_caches_hold_every_kernel_that_a_controller_needs() -> None:
    """In folders that hold an index for each kernel that was compiled or loaded here."""
    done = warmup.fill_caches()
    ready = [k for k in warmup.kernels() if k.overloads]
    assert done.kernels == len(warmup.kernels()) >= len(ready) > 0
    assert done.compiled + done.loaded >= len(ready)
    kept = {path.name.split("-")[0] for folder in done.folders for path in folder.rglob("*.nbi")}
    assert {f"{Path(k.py_func.__code__.co_filename).stem}.{k.py_func.__qualname__}" for k in ready} <= kept


@pytest.mark.parametrize(
    ("compiled", "told"), [(0, "44, all from the cache, ready after 1.5 s"), (7, "7 compiled now")]
)
def test_doctor_says_what_was_compiled_and_where_it_is_kept(
    safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch, compiled: int, told: str
) -> None:
    places = (Path("/one/place"), Path("/another"))
    monkeypatch.setattr(warmup, "fill_caches", lambda: warmup.Preparation(44, compiled, 44 - compiled, places, 1.5))
    outcome = safewbc("doctor")
    assert outcome.code == 0, outcome.out
    (line,) = [line for line in outcome.out.splitlines() if line.startswith("ok   kernels")]
    assert told in line
    assert line.endswith("; kept in /one/place, /another")


def test_doctor_tells_what_to_set_where_kernels_cannot_be_kept(
    safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere() -> None:
        raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")

    monkeypatch.setattr(warmup, "fill_caches", nowhere)
    outcome = safewbc("doctor")
    assert outcome.code == 1
    assert "NUMBA_CACHE_DIR" in outcome.out
    assert "a folder that can be written" in outcome.out


def test_every_run_of_the_table_has_a_folder_that_tells_what_it_is() -> None:
    folders = [table.run_folder(run) for group, _ in table.runs().values() for run in group]
    assert len(set(folders)) == len(folders)
    assert {"g1-issf-stand-1.2", "tocabi-none-circles", "g1-issf-beyond-reach", "tocabi-cbf-hold"} <= set(folders)


def test_the_table_takes_no_option_that_it_ignores(safewbc: CommandLine) -> None:
    outcome = safewbc("table", "--help")
    assert outcome.code == 0
    assert "--out" in outcome.out
    assert "runs/<study>-<time>" in " ".join(outcome.out.split())
    for name in ("--report", "--video"):
        assert name not in outcome.out


def test_the_table_saves_every_run_in_its_folder(safewbc: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    group: list[Scenario] = [Stand(duration=0.1, plant=PlantOptions(mass_scale=m)) for m in (1.0, 1.2)]
    monkeypatch.setitem(table.PAGES, "results", lambda: {"Short": (group, table.STAND_COLUMNS)})
    outcome = safewbc("table", "--jobs", "1", "--out", "t")
    assert outcome.code == 0, outcome.err
    assert "### Short" in outcome.out
    for scale, name in ((1.0, "g1-issf-stand-1"), (1.2, "g1-issf-stand-1.2")):
        assert load_recording(safewbc.folder / "t" / name).summary["mass_scale"] == scale


def test_bench_prints_and_writes_every_stage(safewbc: CommandLine) -> None:
    outcome = safewbc("bench", "tick", "--ticks", "100", "--robots", "g1", "--out", "b.json")
    assert outcome.code == 0, outcome.err
    figures = json.loads((safewbc.folder / "b.json").read_text())
    assert set(figures) == {"g1"}
    assert list(figures["g1"]) == [*STAGES, "total"]
    for stage in figures["g1"]:
        assert stage in outcome.out
        assert 0 < figures["g1"][stage]["median_us"] <= figures["g1"][stage]["p99_us"]


# --- help


OPTION_FILES = ("options", "scenario", *(kind.__module__.split(".")[-1] for kind in SCENARIOS))
OPTIONS = [p for p in (ROOT / "experiments" / "scenarios").glob("*.py") if p.stem in OPTION_FILES]


def documented_options() -> list[tuple[str, str, str, str]]:
    """Class, name, type and text of every option, as written in the source."""
    out = []
    for path in OPTIONS:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for group in (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name not in {"Setup", "Runnable"}):
            for field, text in zip(group.body, [*group.body[1:], None], strict=True):
                if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                    annotation = ast.unparse(field.annotation)
                    documented = isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
                    said = text.value.value if documented else ""  # type: ignore[union-attr]
                    out.append((group.name, field.target.id, annotation, str(said)))
    return [entry for entry in out if not entry[2].startswith("ClassVar")]


@pytest.mark.parametrize(("group", "name", "kind", "text"), documented_options(), ids=lambda x: str(x)[:20])
def test_every_option_is_documented_and_every_number_has_its_unit(group: str, name: str, kind: str, text: str) -> None:
    if kind.startswith("Annotated"):
        return
    assert text.endswith("."), f"{group}.{name} has no help"
    if "float" in kind or "int" in kind:
        assert text.endswith("]."), f"{group}.{name} does not end with its unit"


def test_help_shows_every_option_of_a_run(safewbc: CommandLine) -> None:
    outcome = safewbc("run", "hand-tracking", "--help")
    assert outcome.code == 0
    groups = {"PlantOptions", "FilterOptions", "OutputOptions", "Scenario", "HandTracking"}
    for group, name, kind, _ in documented_options():
        if group in groups and not kind.startswith("Annotated"):
            assert f"-{name.replace('_', '-')}" in outcome.out, name
