"""The file of tuned parameters: what is written is read again, and what is wrong in it is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.whole_body.config import FilterTuning
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.tuning_file import Tuning, read_tuning, write_tuning
from experiments.running.run import prepare, run
from experiments.scenarios.options import FilterOptions
from experiments.scenarios.resolve import control_config, filter_changes
from experiments.scenarios.stand import Stand
from robots.errors import ConfigError, WithoutEffectError
from robots.loader import load_robot
from safety.barriers.rows import FAMILIES

NUMBERS = st.floats(1e-3, 1e3)
TEXTS = st.text(st.characters(exclude_categories=("Cs",)), max_size=20)


def written(folder: Path, text: str) -> Path:
    path = folder / "tuning.toml"
    path.write_text(text, encoding="utf-8")
    return path


@given(
    families=st.dictionaries(st.sampled_from(FAMILIES), st.fixed_dictionaries({"alpha": NUMBERS, "epsilon": NUMBERS})),
    words=st.lists(TEXTS, max_size=3),
    numbers=st.lists(NUMBERS, max_size=3),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory,
    families: dict[str, dict[str, float]],
    words: list[str],
    numbers: list[float],
) -> None:
    path = tmp_path_factory.mktemp("tuning") / "new" / "g1.toml"
    tuning = Tuning(families, {"robot": "g1", "scenarios": words, "masses": numbers, "seed": 3, "quick": True})
    write_tuning(path, tuning)
    assert read_tuning(path, "g1") == tuning
    assert [p.name for p in path.parent.iterdir()] == ["g1.toml"]


def test_numbers_of_numpy_and_control_characters_are_written_as_toml(tmp_path: Path) -> None:
    path, text = tmp_path / "g1.toml", "".join(chr(i) for i in range(160))
    tuning = Tuning({"obstacle": {"epsilon": np.float64(0.1)}}, {"found": text, "masses": [np.float64(2.0)]})
    write_tuning(path, tuning)
    assert read_tuning(path, "g1") == tuning


@pytest.mark.parametrize("tuned", [{"a b": 1}, {"a.b": 1}, {"found": "\ud800"}, {"note = 1\nfound": 1}, {"": 1}])
def test_what_would_not_be_read_again_leaves_the_file_that_was_there(tmp_path: Path, tuned: dict[str, object]) -> None:
    path, old = tmp_path / "g1.toml", Tuning({"obstacle": {"epsilon": 3.0}})
    write_tuning(path, old)
    with pytest.raises(ConfigError, match=r"g1\.toml"):
        write_tuning(path, Tuning({}, tuned))
    assert read_tuning(path, "g1") == old
    assert [p.name for p in tmp_path.iterdir()] == ["g1.toml"]


def test_only_what_the_file_names_changes() -> None:
    before = controller_config(load_robot("tocabi")).safety
    after = Tuning({"obstacle": {"epsilon": 3.0}, "leg_collision": {"alpha": 4.0, "epsilon": 6.0}}).applied(before)
    assert after.obstacle == replace(before.obstacle, epsilon=3.0)
    assert after.leg_collision == replace(before.leg_collision, alpha=4.0, epsilon=6.0)
    assert replace(after, obstacle=before.obstacle, leg_collision=before.leg_collision) == before


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[safety.elbows]\nalpha = 1.0", r"safety = \['elbows'\].*joint_limit"),
        ("[safety.self_collision]\nbeta = 1.0", r"safety.self_collision = \['beta'\].*alpha, epsilon"),
        ("[safety.self_collision]\nalpha = nan", r"safety.self_collision.alpha = nan"),
        ("[safety.self_collision]\nepsilon = inf", r"safety.self_collision.epsilon = inf"),
        ("[safety.obstacle]\nepsilon = -1.0", r"safety.obstacle.epsilon = -1.0"),
        ("[safety.obstacle]\nalpha = 0", r"safety.obstacle.alpha = 0"),
        ("[safety.obstacle]\nalpha = true", r"safety.obstacle.alpha = True.*a number"),
        ('[safety.obstacle]\nalpha = "5"', r"safety.obstacle.alpha = '5'.*a number"),
        ("[safety]\nobstacle = 5.0", r"safety.obstacle = 5.0.*a table"),
        ("safety = 5.0", r"safety = 5.0.*a table"),
        ("[filter.obstacle]\nalpha = 1.0", r"tables = \['filter'\].*tuned, safety"),
        ('[tuned]\nrobot = "tocabi"', r"tuned.robot = 'tocabi'.*'g1'"),
        ("[safety.obstacle\nalpha = 1.0", r"a TOML file"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        read_tuning(written(tmp_path, text), "g1")
    # and refused by a run before it begins
    with pytest.raises(ConfigError, match=named):
        prepare(Stand(safety=FilterOptions(tuning=tmp_path / "tuning.toml")))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.toml"):
        read_tuning(tmp_path / "missing.toml", "g1")


def test_a_file_that_cannot_be_written_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "g1.toml").mkdir()
    with pytest.raises(ConfigError, match=r"g1\.toml"):
        write_tuning(tmp_path / "g1.toml", Tuning({}))
    assert [p.name for p in tmp_path.iterdir()] == ["g1.toml"]


def test_what_toml_cannot_hold_is_refused(tmp_path: Path) -> None:
    for value in (float("nan"), {"a": 1}, None):
        with pytest.raises(ConfigError, match=r"tuned\.found"):
            write_tuning(tmp_path / "g1.toml", Tuning({}, {"found": value}))
    assert not list(tmp_path.iterdir())


def test_a_run_takes_the_file_and_its_own_options_come_before(tmp_path: Path) -> None:
    path = written(tmp_path, "[safety.self_collision]\nalpha = 7.0\nepsilon = 0.7\n[safety.obstacle]\nepsilon = 3.0")
    robot, usual = load_robot("g1"), controller_config(load_robot("g1")).safety
    safety: FilterTuning = filter_changes(robot, FilterOptions(tuning=path))["safety"]
    assert (safety.self_collision.alpha, safety.self_collision.epsilon) == (7.0, 0.7)
    assert (safety.obstacle.alpha, safety.obstacle.epsilon) == (usual.obstacle.alpha, 3.0)
    own = filter_changes(robot, FilterOptions(tuning=path, epsilon=0.2))["safety"]
    assert (own.self_collision.alpha, own.self_collision.epsilon) == (7.0, 0.2)
    options = Stand(duration=0.1, safety=FilterOptions(tuning=path))
    assert control_config(robot, options).safety == safety
    assert run(options).config["controller"]["safety"]["self_collision"]["epsilon"] == 0.7


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("none", "alpha = 7.0"),
        ("none", "margin = 0.01"),
        ("cbf", "epsilon = 2.0"),
        ("ssa", "alpha = 7.0\nepsilon = 2.0"),
    ],
)
def test_a_file_of_which_the_filter_reads_nothing_is_refused(tmp_path: Path, name: str, text: str) -> None:
    path = written(tmp_path, f"[safety.obstacle]\n{text}")
    with pytest.raises(WithoutEffectError, match=f"tuning.*--filter {name}"):
        prepare(Stand(safety=FilterOptions(name, tuning=path)))


@pytest.mark.parametrize(
    ("name", "text"), [("cbf", "alpha = 7.0\nepsilon = 2.0"), ("ssa", "epsilon = 2.0\nmargin = 0.01")]
)
def test_a_file_may_hold_more_than_the_filter_reads(tmp_path: Path, name: str, text: str) -> None:
    prepare(Stand(safety=FilterOptions(name, tuning=written(tmp_path, f"[safety.obstacle]\n{text}"))))
