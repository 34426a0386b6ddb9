"""The worked example of docs/robots.md, read out of the page, does what the page says."""

import dataclasses
import re
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from controllers.motions.hands import CircleSettings, circle_settings
from controllers.whole_body.robot_config import TABLES as TUNING_TABLES
from experiments.running.run import prepare, run
from experiments.scenarios.hand_tracking import HandTracking
from robots.description import ROLES, Joint
from robots.errors import DescriptionError
from robots.kinematics import Kinematics
from robots.loader import JOINT_NUMBERS, TABLES, load_robot
from robots.mujoco_spec import build_mujoco_spec
from robots.pinocchio_model import standing_configuration

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The only code block of the page in this language."""
    found = re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


@pytest.fixture
def example(tmp_path: Path) -> Path:
    (tmp_path / "my_robot.urdf").write_text(block("xml"), encoding="utf-8")
    path = tmp_path / "my_robot.toml"
    path.write_text(block("toml"), encoding="utf-8")
    return path


def test_example_loads_as_written(example: Path) -> None:
    robot = load_robot(example)
    assert robot.joint_names == ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
    assert robot.total_mass == pytest.approx(36.0, abs=1e-12)
    assert robot.joint_array("armature").tolist() == [0.02, 0.02, 0.005, 0.005]
    assert robot.joint_array("velocity").tolist() == [20.0, 20.0, 20.0, 15.0]
    assert robot.joint_array("damping").tolist() == [0.0, 0.0, 0.05, 0.05]
    assert set(robot.roles) == set(ROLES)
    assert [c.is_sphere for c in robot.collisions] == [False, True, True]


def test_example_stands_with_both_soles_on_the_ground_in_both_models(example: Path) -> None:
    robot = load_robot(example)
    q = standing_configuration(robot)
    kin, model = Kinematics(robot), build_mujoco_spec(robot).compile()
    kin.update(q, np.zeros(kin.nv))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
    mujoco.mj_forward(model, data)
    for sole in robot.soles:
        assert abs(kin.frame_placement(kin.frame_id(sole.frame))[1][2]) < 1e-12
        assert abs(data.site(sole.frame).xpos[2]) < 1e-12
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(mass, kin.mass_matrix, rtol=0, atol=1e-12 * abs(mass).max())


def test_example_runs_hand_tracking_with_every_motion(example: Path) -> None:
    for motion in ("circles", "hold", "beyond-reach"):
        prepare(HandTracking(robot=str(example), motion=motion))
    result = run(HandTracking(robot=str(example), duration=0.3))
    assert result.summary["stop_cause"] is None
    assert result.summary["fell"] is False
    assert result.summary["hand_rmse_m"] > 0


def test_without_hand_tracking_settings_the_error_is_the_one_shown(example: Path) -> None:
    text = example.read_text(encoding="utf-8")
    example.write_text(text[: text.index("[posture.hands_front]")], encoding="utf-8")
    assert set(load_robot(example).postures) == {"standing"}
    with pytest.raises(DescriptionError) as caught:
        prepare(HandTracking(robot=str(example)))
    assert str(caught.value) in PAGE


def test_the_posture_and_start_of_hand_tracking_default_as_documented(example: Path) -> None:
    table = tomllib.loads(example.read_text(encoding="utf-8"))["tuning"]["hand_tracking"]
    assert "posture" not in table  # so the runs above started from the default
    assert circle_settings(load_robot(example)).start == 1.0


def test_the_error_shown_is_the_error_raised(example: Path) -> None:
    urdf = example.with_suffix(".urdf")
    swapped = urdf.read_text(encoding="utf-8").replace('lower="-2" upper="1"', 'lower="1" upper="-2"')
    urdf.write_text(swapped, encoding="utf-8")
    with pytest.raises(DescriptionError) as caught:
        load_robot(example)
    assert str(caught.value).removeprefix(str(example.parent) + "/") in PAGE


def test_python_example_runs() -> None:
    scope: dict[str, object] = {}
    exec(compile(block("python"), "docs/robots.md", "exec"), scope)
    assert scope["robot"].name == "g1"  # type: ignore[attr-defined]


def test_every_table_field_and_role_is_documented() -> None:
    for table in TABLES:
        assert re.search(rf"^### `\[+{table}[.\]]", PAGE, flags=re.MULTILINE), table
    for name in (*ROLES, *JOINT_NUMBERS, *(f.name for f in dataclasses.fields(Joint))):
        assert f"`{name}`" in PAGE, name


def test_every_tuning_table_and_field_of_hand_tracking_is_documented() -> None:
    for table in TUNING_TABLES:
        assert f"`[tuning.{table}]`" in PAGE, table
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.split("### `[tuning.hand_tracking]`")[1].split("###")[0], re.MULTILINE)
    # how the speed rises is not for the description to say
    assert set(rows) == {f.name for f in dataclasses.fields(CircleSettings)} - {"start"} | {"posture"}
