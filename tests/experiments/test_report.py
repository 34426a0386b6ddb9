import io
import json
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from experiments.recording.recording import (
    GUARANTEED,
    RunResult,
    family_minima,
    filter_title,
    load_result,
    run_title,
    save_result,
    setting,
    smallest_self_collision,
)
from experiments.recording.store import prepare_folder
from experiments.reports import distance_plots, plot_style, report
from experiments.reports.media import FAR, INSIDE, NEUTRAL, RAMP, barrier_colours, key_frames, make_video
from experiments.reports.plots import joint_groups
from experiments.reports.report import verdict, write_report
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.pinocchio_model import standing_configuration
from sims.rendering import rendering_problem, video_problem

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = {name: load_robot(name) for name in ("g1", "tocabi")}


def make_result(robot: str = "g1", ticks: int = 40, hands: bool = True, **config: Any) -> RunResult:
    """A made-up run at 100 ticks/s, two plant steps a tick; every pair is 0.1 m apart, pair 0 swings about 0.1 m."""
    made = ROBOTS[robot]
    nj, steps = len(made.joints), 2 * ticks
    time, step_time = 0.01 * np.arange(ticks), 0.005 * np.arange(steps)
    q = np.tile(standing_configuration(made), (ticks, 1))
    q[:, 7 + nj // 2] += 0.2 * np.sin(6.0 * time)
    h = np.full((steps, len(made.self_collision_pairs)), 0.1, dtype=np.float32)
    h[:, 0] += 0.05 * np.sin(6.0 * step_time)
    wave = np.sin(6.0 * time)[:, None]
    series = {
        "time": time,
        "q": q,
        "v": np.zeros((ticks, 6 + nj)),
        "torque": 0.5 * wave * made.joint_array("effort"),
        "com": np.tile([0.0, 0.0, 0.67], (ticks, 1)),
        "com_ref": np.tile([0.0, 0.0, 0.673], (ticks, 1)),
        "zmp": 0.01 * np.hstack([wave, -wave]),
        "support_polygon": np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]),
        "foot_wrench": np.zeros((ticks, 2, 6)),
        "v_des": np.zeros((ticks, 6 + nj)),
        "v_safe": np.zeros((ticks, 6 + nj)),
        "filter_status": np.zeros(ticks, dtype=np.int8),
        "filter_slack": np.zeros(ticks),
        "tick_ms": np.full(ticks, 0.3),
        "step_time": step_time,
        "h_self_collision": h,
        "h_joint_limit": np.full(steps, 0.2),
        "h_workspace": np.full((steps, len(made.workspace)), 0.05),
        "h_obstacle": np.full(steps, np.inf),
        "disturbance": np.full(steps, 0.4),
        "gradient": np.full((steps, 5), 0.3),
        "h_bound": np.full((steps, 5), np.nan if config.get("filter") == "none" else -0.016),
        "h_row_bound": np.full(steps, np.nan if config.get("filter") == "none" else 0.002),
        "h_self_reference": np.full(steps, -0.02),
    }
    if hands:
        names = ("left_hand", "left_hand_ref", "right_hand", "right_hand_ref")
        series |= {name: np.tile([0.3, 0.2, 0.8], (ticks, 1)) + 0.01 * wave for name in names}
    settings = {"robot": robot, "filter": "issf", "plant": {"mass_scale": 1.0}, **config}
    return RunResult(made, settings, {"fell": False, "min_h_self_collision_mm": 50.0}, series)


def with_series(result: RunResult, **changes: np.ndarray) -> RunResult:
    return RunResult(result.robot, result.config, result.summary, {**result.series, **changes})


def sentences(result: RunResult, good: bool) -> str:
    return "; ".join(text for is_good, text in verdict(result) if is_good is good)


class Page(HTMLParser):
    """What a page refers to, its headings and words; fails on a tag that is not closed."""

    VOID = frozenset({"meta", "img", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.headings: list[str] = []
        self.words = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "poster"}]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


@pytest.fixture(scope="module")
def pair() -> list[RunResult]:
    """The same motion twice, once without a filter, which ends early."""
    return [make_result(filter="none", ticks=25), make_result(plant={"mass_scale": 1.2})]


@pytest.fixture
def no_rendering(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    for check in (rendering_problem, video_problem):
        check.cache_clear()
    yield
    for check in (rendering_problem, video_problem):
        check.cache_clear()


# --- results


def test_a_saved_result_is_loaded_as_it_was(tmp_path: Path) -> None:
    result = make_result()
    save_result(result, tmp_path / "run")
    loaded = load_result(tmp_path / "run")
    assert loaded.config == result.config
    assert loaded.summary == result.summary
    assert loaded.robot.joint_names == result.robot.joint_names
    assert loaded.series.keys() == result.series.keys()
    for name, values in result.series.items():
        np.testing.assert_array_equal(loaded.series[name], values)
        assert loaded.series[name].dtype == values.dtype


def test_the_summary_is_plain_json_in_its_own_order(tmp_path: Path) -> None:
    summary = {"z": np.float32(0.5), "a": float("nan"), "n": np.int64(3), "ok": np.bool_(True), "inf": float("inf")}
    result = make_result()
    save_result(RunResult(result.robot, result.config, summary, result.series), tmp_path)
    text = (tmp_path / "summary.json").read_text(encoding="utf-8")
    assert list(json.loads(text).items()) == [("z", 0.5), ("a", None), ("n", 3), ("ok", True), ("inf", None)]
    assert text.startswith('{\n  "z": 0.5,\n')


def test_what_json_cannot_hold_is_named(tmp_path: Path) -> None:
    result = make_result(callback=object())
    with pytest.raises(ConfigError, match="config"):
        save_result(result, tmp_path)


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
        load_result(tmp_path)
    save_result(make_result(ticks=2), tmp_path)
    (tmp_path / "series.npz").write_bytes(b"PK broken")
    with pytest.raises(ConfigError, match=r"series\.npz"):
        load_result(tmp_path)


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
    assert filter_title(make_result(ticks=1, filter=chosen)) == title


def test_a_run_is_called_by_filter_and_mass() -> None:
    assert run_title(make_result(ticks=1)) == "ISSf-CBF"
    assert run_title(make_result(ticks=1, plant={"mass_scale": 1.2})) == "ISSf-CBF, mass +20 %"
    assert run_title(make_result(ticks=1, filter="none", mass_scale=0.8)) == "no filter, mass -20 %"


# --- media


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_bodies_have_the_colour_of_their_smallest_barrier(robot: RobotDescription) -> None:
    names = [shape.name for shape in robot.collisions]
    h = np.full(len(robot.self_collision_pairs), 1.0)
    far = barrier_colours(robot, h)
    paired = {name for pair in robot.self_collision_pairs for name in pair}
    for name, colour in zip(names, far, strict=True):
        np.testing.assert_array_equal(colour, RAMP[-1] if name in paired else NEUTRAL)
    h[0] = -1e-6
    near = barrier_colours(robot, h)
    red = {name for name, colour in zip(names, near, strict=True) if tuple(colour) == INSIDE}
    assert red == set(robot.self_collision_pairs[0])


def test_colours_run_from_blue_to_orange_and_jump_to_red() -> None:
    robot = ROBOTS["g1"]
    index = [shape.name for shape in robot.collisions].index(robot.self_collision_pairs[0][0])

    def colour(value: float) -> np.ndarray:
        h = np.ones(len(robot.self_collision_pairs))
        h[0] = value
        return barrier_colours(robot, h)[index]

    np.testing.assert_allclose(colour(FAR), RAMP[3], atol=1e-15)
    np.testing.assert_allclose(colour(FAR / 3), RAMP[1], atol=1e-15)
    np.testing.assert_allclose(colour(FAR / 6), 0.5 * (RAMP[0] + RAMP[1]), atol=1e-15)
    np.testing.assert_allclose(colour(0.0), RAMP[0], atol=1e-15)
    assert tuple(colour(-1e-9)) == INSIDE
    assert tuple(colour(np.nan)) == INSIDE


@pytest.mark.rendering
def test_key_frames_hold_the_smallest_barrier() -> None:
    result = make_result(ticks=100)
    frames = key_frames(result)
    times = [t for t, _ in frames]
    worst = result.series["step_time"][np.argmin(smallest_self_collision(result))]
    assert len(frames) == 4
    assert times == sorted(times)
    # the tick that was running when it happened
    assert any(t <= worst < t + 0.01 for t in times)
    sizes = {Image.open(io.BytesIO(png)).size for _, png in frames}
    assert sizes == {(420, 480)}


@pytest.mark.rendering
@pytest.mark.parametrize(("ticks", "count"), [(0, 0), (1, 1), (3, 3)])
def test_short_runs_have_fewer_key_frames(ticks: int, count: int) -> None:
    assert len(key_frames(make_result(ticks=ticks))) == count


@pytest.mark.rendering
def test_a_film_lasts_as_long_as_the_longest_run(pair: list[RunResult], tmp_path: Path) -> None:
    path = make_video(pair, tmp_path / "film.mp4", fps=10)
    assert path is not None
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 4  # at 0.0, 0.1, 0.2 and 0.3 s of 0.39 s
    assert next(imageio_ffmpeg.read_frames(str(path)))["source_size"] == (960, 544)


@pytest.mark.usefixtures("no_rendering")
def test_without_rendering_there_are_no_pictures(tmp_path: Path) -> None:
    result = make_result(ticks=5)
    assert key_frames(result) == []
    assert make_video([result], tmp_path / "film.mp4") is None
    assert not (tmp_path / "film.mp4").exists()


# --- plots


@pytest.mark.parametrize(("robot", "sizes"), [("g1", (12, 3, 14, 0)), ("tocabi", (12, 3, 16, 2))])
def test_joints_are_grouped_by_limb(robot: str, sizes: tuple[int, ...]) -> None:
    groups = joint_groups(ROBOTS[robot])
    assert tuple(len(groups.get(name, [])) for name in ("legs", "waist", "arms", "other")) == sizes
    assert sorted(k for joints in groups.values() for k in joints) == list(range(len(ROBOTS[robot].joints)))


def test_the_pairs_shown_are_of_hand_and_torso_where_hands_move() -> None:
    result = make_result()
    pairs = result.robot.self_collision_pairs
    feet = pairs.index(("left_foot", "right_foot"))
    hand = pairs.index(("right_hand", "torso_high"))
    h = result.series["h_self_collision"].copy()
    h[:, feet], h[:, hand] = 0.01, 0.02
    shown = distance_plots._closest_pairs([with_series(result, h_self_collision=h)])
    assert shown[0] == hand
    assert all("hand" in a and b in {"torso_low", "torso_high", "head"} for a, b in (pairs[k] for k in shown))
    without = with_series(make_result(hands=False), h_self_collision=h)
    assert distance_plots._closest_pairs([without])[:2] == [feet, hand]


def test_every_run_has_its_own_colour() -> None:
    results = [make_result(ticks=1, filter=name) for name in ("cbf", "none", "ssa", "none", "sss")]
    colours = [colour for _, colour in plot_style.coloured(results)]
    assert colours[1] == plot_style.UNFILTERED
    assert len(set(colours)) == len(results)


def test_bounds_are_drawn_only_where_something_is_promised() -> None:
    free, filtered = make_result(filter="none"), make_result()
    assert distance_plots.guarantee_plot([free]) is None
    assert distance_plots.guarantee_plot([make_result(ticks=0)]) is None
    alone = distance_plots.guarantee_plot([filtered])
    assert alone is not None
    assert distance_plots.guarantee_plot([free, filtered]) == alone
    stopped = {k: filtered.series[k].copy() for k in ("h_bound", "h_row_bound", "disturbance")}
    for values in stopped.values():
        values[30:] = np.nan
    assert distance_plots.guarantee_plot([with_series(filtered, **stopped)]) not in {None, alone}
    before = {k: v for k, v in filtered.series.items() if k not in stopped}
    assert distance_plots.guarantee_plot([RunResult(filtered.robot, filtered.config, filtered.summary, before)]) is None


# --- report


def test_the_report_needs_nothing_else(pair: list[RunResult], tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    film.write_bytes(b"not really a film")
    frames = [[(0.0, b"png"), (0.1, b"png")], []]
    text = write_report(tmp_path / "report.html", pair, "Hands", frames, film).read_text(encoding="utf-8")
    page = Page(text)
    assert page.references
    assert all(reference.startswith("data:") for reference in page.references)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "http" not in text
    assert "url(" not in text
    assert "@import" not in text
    assert len(text) < 3_000_000
    assert page.headings == [
        "Outcome", "Figures", "Film", "Pictures", "Distances", "Guarantee", "Limits", "Hands", "Balance",
        "Centre of mass", "Filter", "Torques", "Computing time",
    ]  # fmt: skip
    assert "no filter" in page.words
    assert "ISSf-CBF, mass +20 %" in page.words
    assert '"mass_scale": 1.2' in page.words


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_short_run_without_hands_is_reported(robot: str, tmp_path: Path) -> None:
    result = make_result(robot, ticks=5, hands=False)
    result = with_series(result, zmp=np.full((5, 2), np.nan))
    page = Page(write_report(tmp_path / "r.html", [result], "Short").read_text(encoding="utf-8"))
    assert "Hands" not in page.headings
    assert "Pictures" not in page.headings
    assert "Film" not in page.headings
    assert {"Distances", "Guarantee", "Balance", "Torques"} <= set(page.headings)
    assert page.tags.count("img") == 8


@pytest.mark.parametrize("ticks", [0, 1])
def test_a_run_that_ended_at_once_is_reported(ticks: int, tmp_path: Path) -> None:
    results = [make_result(ticks=ticks), make_result(ticks=3)]
    page = Page(write_report(tmp_path / "r.html", results, "Early").read_text(encoding="utf-8"))
    assert ("ended before the first tick" in page.words) == (ticks == 0)


def test_text_from_outside_is_shown_as_text(tmp_path: Path) -> None:
    result = make_result(ticks=2, filter="<script>a</script>", note="</pre><b>")
    page = Page(write_report(tmp_path / "r.html", [result], "<i>x & y</i>", note="<u>n</u>").read_text("utf-8"))
    assert not {"script", "i", "b", "u"} & set(page.tags)
    assert "<i>x & y</i>" in page.words
    assert "<u>n</u>" in page.words


def test_a_large_film_is_linked_by_its_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "LARGEST_EMBEDDED_VIDEO", 3)
    (tmp_path / "films").mkdir()
    film = tmp_path / "films" / "a film #1.mp4"
    film.write_bytes(b"long")
    text = write_report(tmp_path / "r.html", [make_result(ticks=2)], "Film", video=film).read_text(encoding="utf-8")
    assert "films/a%20film%20%231.mp4" in Page(text).references


def test_a_report_needs_runs_matching_frames_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="results"):
        write_report(tmp_path / "r.html", [], "None")
    with pytest.raises(ConfigError, match="frames"):
        write_report(tmp_path / "r.html", [make_result(ticks=2)], "None", frames=[[], []])
    with pytest.raises(ConfigError, match="report"):
        write_report(tmp_path / "missing" / "r.html", [make_result(ticks=2)], "None")


def test_the_verdict_names_what_entered_what() -> None:
    result = make_result()
    k = result.robot.self_collision_pairs.index(("left_hand", "torso_low"))
    h = result.series["h_self_collision"].copy()
    h[20:28, k] = -0.041
    inside = with_series(result, h_self_collision=h)
    assert sentences(inside, good=False) == (
        "left hand entered torso low by 41 mm (at 0.1 s; bodies overlapped for 10 % of the time)"
    )
    h[20:28, k] = 0.0032
    assert "stayed clear of each other by 3.2 mm" in sentences(with_series(result, h_self_collision=h), good=True)
    h[3, k] = np.nan
    assert "not numbers" in sentences(with_series(result, h_self_collision=h), good=False)


def test_the_verdict_tells_falls() -> None:
    result = make_result()
    assert sentences(result, good=True).startswith("stayed upright for 0.4 s")
    fallen = RunResult(result.robot, result.config, {"fell": True}, result.series)
    assert "fell over; the run ended after 0.4 s" in sentences(fallen, good=False)


def test_the_verdict_tells_other_violations_and_filter_trouble() -> None:
    result = make_result()
    limit, reach = result.series["h_joint_limit"].copy(), result.series["h_workspace"].copy()
    limit[4], reach[5, 0] = np.radians(-2.0), -0.012
    status = result.series["filter_status"].copy()
    status[:2], status[2] = 2, 3
    text = sentences(with_series(result, h_joint_limit=limit, h_workspace=reach, filter_status=status), good=False)
    assert "a joint went past its limit by 2°" in text
    assert f"{result.robot.workspace[0].name.replace('_', ' ')} went beyond its bound by 12 mm" in text
    assert "relax its conditions in 2 ticks" in text
    assert "failed in 1 tick" in text


def test_the_verdict_tells_broken_bounds() -> None:
    result = make_result()
    margins = {"margin_joint_limit_rad": np.radians(-1.5), "margin_leg_collision_m": -0.012, "margin_workspace_m": 0.1}
    missing = {"margin_self_collision_m": None, "margin_obstacle_m": -0.3}

    def told(held: bool | None) -> str:
        summary = {**result.summary, **margins, **missing, "bound_held": held}
        return sentences(RunResult(result.robot, result.config, summary, result.series), good=False)

    assert told(False) == (
        "the joint limit barrier fell below its guaranteed bound by 1.5°; "
        "the leg collision barrier fell below its guaranteed bound by 12 mm"
    )
    assert told(True) == told(None) == ""


def test_smallest_barriers_are_taken_family_by_family() -> None:
    result = make_result(ticks=3)
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
