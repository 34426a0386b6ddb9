"""Folders of runs: what is written is read back, and what cannot be is refused."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.recording.recording import (
    GUARANTEED,
    Recording,
    family_minima,
    filter_title,
    load_recording,
    run_title,
    save_recording,
    setting,
)
from experiments.recording.store import claimed, prepare_folder
from robots.errors import ConfigError
from tests.support.made_runs import made_run

ROOT = Path(__file__).resolve().parents[2]


def test_a_saved_result_is_loaded_as_it_was(tmp_path: Path) -> None:
    result = made_run()
    save_recording(result, tmp_path / "run")
    loaded = load_recording(tmp_path / "run")
    assert loaded.config == result.config
    assert loaded.summary == result.summary
    assert loaded.robot.joint_names == result.robot.joint_names
    assert loaded.series.keys() == result.series.keys()
    for name, values in result.series.items():
        np.testing.assert_array_equal(loaded.series[name], values)
        assert loaded.series[name].dtype == values.dtype


def test_a_run_in_the_folder_is_overwritten_on_purpose_only(tmp_path: Path) -> None:
    save_recording(made_run(ticks=2), tmp_path / "run")
    with pytest.raises(ConfigError, match=r"overwrite=True"):
        save_recording(made_run(ticks=3), tmp_path / "run")
    assert len(load_recording(tmp_path / "run").series["time"]) == 2
    save_recording(made_run(ticks=3), tmp_path / "run", overwrite=True)
    assert len(load_recording(tmp_path / "run").series["time"]) == 3


def test_a_folder_that_another_run_is_writing_to_is_left_alone(tmp_path: Path) -> None:
    with claimed(tmp_path / "run") as folder, pytest.raises(ConfigError, match="no other run is writing to"):
        save_recording(made_run(ticks=2), folder, overwrite=True)


def test_the_summary_is_plain_json_in_its_own_order(tmp_path: Path) -> None:
    summary = {"z": np.float32(0.5), "a": float("nan"), "n": np.int64(3), "ok": np.bool_(True), "inf": float("inf")}
    result = made_run()
    save_recording(Recording(result.robot, result.config, summary, result.series), tmp_path)
    text = (tmp_path / "summary.json").read_text(encoding="utf-8")
    assert list(json.loads(text).items()) == [("z", 0.5), ("a", None), ("n", 3), ("ok", True), ("inf", None)]
    assert text.startswith('{\n  "z": 0.5,\n')


def test_what_json_cannot_hold_is_named(tmp_path: Path) -> None:
    result = made_run(callback=object())
    with pytest.raises(ConfigError, match="config"):
        save_recording(result, tmp_path)


def test_a_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    assert prepare_folder(folder) == folder
    assert list(folder.iterdir()) == []
    assert prepare_folder(folder) == folder


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("x", encoding="utf-8")
    for path in (file, file / "below"):
        with pytest.raises(ConfigError, match=r"out = .*must be a folder that can be written"):
            prepare_folder(path)

    def read_only(**_: Any) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("experiments.recording.store.tempfile.NamedTemporaryFile", read_only)
    with pytest.raises(ConfigError, match="Read-only file system"):
        prepare_folder(tmp_path)


def test_a_folder_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"config\.json"):
        load_recording(tmp_path)
    save_recording(made_run(ticks=2), tmp_path)
    (tmp_path / "series.npz").write_bytes(b"PK broken")
    with pytest.raises(ConfigError, match=r"series\.npz"):
        load_recording(tmp_path)


def test_results_import_nothing_heavy() -> None:
    heavy = "('matplotlib', 'mujoco', 'PIL')"
    code = f"import sys, experiments.recording.recording; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_settings_are_found_in_inner_tables() -> None:
    assert setting({"a": 1, "b": {"c": {"d": 0}}}, "d") == 0
    assert setting({"a": 1}, "d") is None


@pytest.mark.parametrize(
    ("chosen", "title"),
    [("none", "no filter"), ("issf", "ISSf-CBF"), ("cbf", "CBF"), ("mine", "mine")],
)
def test_filters_have_names_for_readers(chosen: str, title: str) -> None:
    assert filter_title(made_run(ticks=1, filter=chosen)) == title


def test_a_run_is_called_by_filter_and_mass() -> None:
    assert run_title(made_run(ticks=1)) == "ISSf-CBF"
    assert run_title(made_run(ticks=1, plant={"mass_scale": 1.2})) == "ISSf-CBF, mass +20 %"
    assert run_title(made_run(ticks=1, filter="none", mass_scale=0.8)) == "no filter, mass -20 %"


def test_smallest_barriers_are_taken_family_by_family() -> None:
    result = made_run(ticks=3)
    legs = len(result.robot.leg_pairs)
    h = np.full_like(result.series["h_self_collision"], 0.5)
    h[1, 0], h[2, -1], h[3, -legs - 1], h[4, -legs] = 0.1, 0.2, 0.3, 0.4
    found = family_minima({**result.series, "h_self_collision": h}, legs)
    columns = dict(zip(GUARANTEED, found.T, strict=True))
    np.testing.assert_array_equal(columns["self_collision"], np.float32([0.5, 0.1, 0.5, 0.3, 0.5, 0.5]))
    np.testing.assert_array_equal(columns["leg_collision"], np.float32([0.5, 0.5, 0.2, 0.5, 0.4, 0.5]))
    np.testing.assert_array_equal(columns["joint_limit"], result.series["h_joint_limit"])
    np.testing.assert_array_equal(columns["workspace"], result.series["h_workspace"].min(axis=1))
    assert np.isinf(columns["obstacle"]).all()
    none = {**result.series, "h_self_collision": h[:, :0], "h_workspace": np.zeros((6, 0))}
    assert np.isinf(family_minima(none, 0)[:, 1:]).all()
