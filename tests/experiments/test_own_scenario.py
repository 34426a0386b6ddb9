"""A scenario from outside the project: run, saved, reported, replayed; with a barrier and a world of its own."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.recording.recording import load_recording
from experiments.running.run import prepare
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.pushes import Push
from experiments.scenarios.registry import RUNNABLE, read_scenario, scenario_called
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.scenarios.world import (
    Box,
    Capsule,
    Circle,
    HalfSpace,
    Sensor,
    Sphere,
    Straight,
    Waypoints,
    WorldObject,
)
from robots.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
OWN = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from experiments.metrics.metric import Metric
from experiments.scenarios.scenario import Scenario, Setup
from safety.barriers.barrier import Barrier


class Ceiling(Barrier):
    """The base stays below a height."""

    family = "workspace"
    size = 1

    def __init__(self, height):
        self.height = height

    def labels(self):
        return ("ceiling",)

    def write(self, kin, h, jac, dh_dt):
        h[0] = self.height - kin.q[2]
        jac[0] = 0.0
        jac[0, :3] = -kin.frame_placement(kin.frame_id(kin.robot.roles["base"]))[0][2]
        dh_dt[0] = 0.0


@dataclass(frozen=True)
class UnderACeiling(Scenario):
    """Stand below a ceiling."""

    name: ClassVar[str] = "under-a-ceiling"
    metrics: ClassVar[tuple[Metric, ...]] = (Metric("headroom_m", "room below the ceiling", "mm", 1e3),)
    ceiling: float = 0.9
    """Height of the ceiling above the ground [m]."""

    def setup(self, robot):
        return Setup()

    def extra_barriers(self, kin):
        return (Ceiling(self.ceiling),)

    def measure(self, robot, series):
        return {"headroom_m": float(self.ceiling - np.max(series["q"][:, 2]))}
'''


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from experiments.cli.main import main; main()"
    # -P: as the installed script, which does not look into the working directory first
    command = [sys.executable, "-P", "-c", program, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_a_scenario_of_ones_own_is_a_command_with_a_report_and_can_be_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    done = call(
        tmp_path, "run", "mine:UnderACeiling", "--ceiling", "0.95", "--duration", "0.2", "--no-video", "--out", "o"
    )
    assert done.returncode == 0, done.stderr
    assert "room below the ceiling" in done.stdout
    assert "room below the ceiling" in (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    result = load_recording(tmp_path / "o")
    assert result.config["scenario"]["scenario"] == "mine:UnderACeiling"
    assert result.summary["headroom_m"] == pytest.approx(0.95 - result.series["q"][:, 2].max())
    # the barrier that it adds: the controller sees the state of the instant that is recorded
    assert result.series["h_own"][:, 0] == pytest.approx(0.95 - result.series["q"][:, 2], abs=1e-12)
    assert result.summary["min_h_own"] == pytest.approx(result.summary["headroom_m"], abs=1e-12)
    assert "smallest barrier of one's own" in done.stdout
    assert call(tmp_path, "replay", "o").returncode == 0
    helped = call(tmp_path, "run", "mine:UnderACeiling", "--help")
    assert "Height of the ceiling" in helped.stdout
    monkeypatch.syspath_prepend(tmp_path)
    scenario = read_scenario(result.config["scenario"])
    assert isinstance(scenario, Scenario)
    assert dataclasses.asdict(scenario)["ceiling"] == 0.95
    assert scenario.key() != dataclasses.replace(scenario, duration=0.3).key()


@pytest.mark.parametrize("module", ["mine", "kit.mine"])
def test_a_run_of_ones_own_scenario_is_replayed_from_any_folder(tmp_path: Path, module: str) -> None:
    home, away = tmp_path / "home", tmp_path / "away"
    for folder in (home / "kit", away):
        folder.mkdir(parents=True)
    (home / (module.replace(".", "/") + ".py")).write_text(OWN)
    # one of the same name where the replay is started is not what ran
    (away / "mine.py").write_text("raise SystemExit('another one')")
    made = call(home, "run", f"{module}:UnderACeiling", "--duration", "0.1", "--no-video", "--no-report", "--out", "o")
    assert made.returncode == 0, made.stderr
    again = call(away, "replay", str(home / "o"))
    assert again.returncode == 0, again.stderr
    assert "identical" in again.stdout


WITH_A_TASK = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.whole_body.task_stack import PlacedTask
from experiments.metrics.metric import Metric
from experiments.scenarios.scenario import Scenario, Setup
from robots.kinematics import Kinematics
from robots.pinocchio_model import standing_configuration
from wbc.tasks import FramePositionTask, TaskGains

ELBOW = "left_elbow_link"


def elbow(robot, q):
    kin = Kinematics(robot)
    kin.update_geometry(q)
    return kin.frame_placement(kin.frame_id(ELBOW))[1].copy()


@dataclass(frozen=True)
class LiftedElbow(Scenario):
    """Stand, and lift an elbow."""

    name: ClassVar[str] = "lifted-elbow"
    metrics: ClassVar[tuple[Metric, ...]] = (Metric("short_m", "elbow short of its target by", "mm", 1e3),)
    angle: float = 0.3

    def setup(self, robot):
        return Setup(motions=(self.lift,))

    def lift(self, robot, reference):
        target = self.target(robot)

        class Lift:
            def apply(self, reference, t):
                reference.extra["elbow"] = (target,)

        return Lift()

    def target(self, robot):
        q = standing_configuration(robot)
        q[7 + list(robot.joint_names).index("left_shoulder_roll_joint")] += self.angle
        return elbow(robot, q)

    def extra_tasks(self, kin):
        task = FramePositionTask(kin.frame_id(ELBOW), TaskGains(5.0, 1.0), name="elbow")
        return [PlacedTask(task, "other", 45)]

    def measure(self, robot, series):
        return {"short_m": float(np.linalg.norm(self.target(robot) - elbow(robot, series["q"][-1])))}
'''


def test_a_scenario_with_a_task_and_a_motion_of_its_own_has_a_report_and_can_be_replayed(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(WITH_A_TASK)
    done = call(tmp_path, "run", "mine:LiftedElbow", "--duration", "1", "--no-video", "--out", "o")
    assert done.returncode == 0, done.stderr
    assert "elbow short of its target by" in (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    assert load_recording(tmp_path / "o").summary["short_m"] < 0.01
    again = call(tmp_path, "replay", "o")
    assert again.returncode == 0, again.stdout + again.stderr


@pytest.mark.parametrize("name", ["nowhere:Nothing", "json:JSONDecoder", "experiments.scenarios.stand:Walk", ":x"])
def test_what_is_no_scenario_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"^scenario = "):
        scenario_called(name)


NEAR, AWAY = (1.0, 1.0, 1.0), (2.0, 1.0, 1.0)
WORLD = (
    WorldObject("ball", Sphere(0.1), Straight((1.0, 0.0, 1.0), (-0.1, 0.0, 0.0)), Sensor(kappa=1.0)),
    WorldObject("bar", Capsule(0.05, (0.0, 0.0, 1.0)), Circle((2.0, 0.0, 0.5), 0.2, 0.3), physical=True),
    WorldObject(
        "shelf", Box((0.1, 0.2, 0.3), (0.0, 0.0, 0.4)), Waypoints((0.0, 1.0), ((1.0, 1.0, 1.0), (2.0, 1.0, 1.0)))
    ),
    WorldObject("wall", HalfSpace((-1.0, 0.0, 0.0)), Straight((2.0, 0.0, 0.0))),
)


def test_pushes_and_a_world_come_back_from_json() -> None:
    scenario = Stand(pushes=(Push(40.0, 90.0, 2.0),), world=WORLD)
    again = read_scenario(json.loads(json.dumps(scenario.to_json())))
    assert again == scenario
    assert again.key() == scenario.key()


def test_a_push_after_the_end_is_refused_however_it_was_given() -> None:
    with pytest.raises(ConfigError, match=r"push time = 2\.0.*within the run's 2 s"):
        prepare(Stand(duration=2.0, pushes=(Push(40.0, 90.0, 2.0),)))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t["world"][0]["shape"].update(kind="cone"), "stand.world[0].shape.kind = 'cone'"),
        (lambda t: t["world"][0]["shape"].update(radius="wide"), "stand.world[0].shape.radius = 'wide'"),
        (lambda t: t["world"][1]["motion"].pop("center"), "stand.world[1].motion.center"),
        (lambda t: t["world"][0].update(colour="red"), "stand.world[0].colour"),
        (lambda t: t["pushes"][0].update(force=True), "stand.pushes[0].force = True"),
    ],
)
def test_a_world_that_does_not_fit_is_refused_by_name(change, told: str) -> None:  # type: ignore[no-untyped-def]
    table = Stand(pushes=(Push(40.0, 90.0, 2.0),), world=WORLD).to_json()
    change(table)
    with pytest.raises(ConfigError) as caught:
        read_scenario(table)
    assert str(caught.value).startswith(told)


def test_the_key_is_that_of_the_content() -> None:
    scenarios = (
        *(kind() for kind in RUNNABLE),
        Stand(seed=1),
        Stand(plant=PlantOptions(mass_scale=1.1)),
        Stand(safety=FilterOptions(epsilon=3.0)),
        Walk(vx=0.1),
        Taichi(push=("60,left,17.5",)),
        HandTracking(motion="hold", obstacle=True),
    )
    keys = [scenario.key() for scenario in scenarios]
    assert len(set(keys)) == len(keys)
    assert keys == [type(s).from_json(s.to_json()).key() for s in scenarios]
    assert Stand(duration=10).key() == Stand(duration=10.0).key()
    # in another process, whatever its hash seed
    program = "from experiments.scenarios.stand import Stand; print(Stand().key())"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == keys[0]


def test_the_key_follows_what_files_hold_and_not_where_they_are(tmp_path: Path) -> None:
    for place, text in (("a.txt", "1 0.2 0 0"), ("b.txt", "1 0.2 0 0"), ("c.txt", "1 0.1 0 0")):
        (tmp_path / place).write_text(text)
    a, b, c = (Walk(script=tmp_path / name).key() for name in ("a.txt", "b.txt", "c.txt"))
    assert a == b != c
    with pytest.raises(ConfigError, match=r"gone\.txt"):
        Walk(script=tmp_path / "gone.txt").key()
