"""Plots of runs: which there are, what they show, and the one style of all."""

import io

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from experiments.metrics.estimate import estimate_figures, velocity_errors
from experiments.recording.recording import Recording
from experiments.reports.plots import distances, estimate, style
from experiments.reports.plots.signals import joint_groups
from tests.support.made_runs import ROBOTS, made_run, with_series


@pytest.mark.parametrize(("robot", "sizes"), [("g1", (12, 3, 14, 0)), ("tocabi", (12, 3, 16, 2))])
def test_joints_are_grouped_by_limb(robot: str, sizes: tuple[int, ...]) -> None:
    groups = joint_groups(ROBOTS[robot])
    assert tuple(len(groups.get(name, [])) for name in ("legs", "waist", "arms", "other")) == sizes
    assert sorted(k for joints in groups.values() for k in joints) == list(range(len(ROBOTS[robot].joints)))


def test_the_pairs_shown_are_of_hand_and_torso_where_hands_move() -> None:
    result = made_run()
    pairs = result.robot.self_collision_pairs
    feet = pairs.index(("left_foot", "right_foot"))
    hand = pairs.index(("right_hand", "torso_high"))
    h = result.series["h_self_collision"].copy()
    h[:, feet], h[:, hand] = 0.01, 0.02
    shown = distances.closest_pairs([with_series(result, h_self_collision=h)])
    assert shown[0] == hand
    assert all("hand" in a and b in {"torso_low", "torso_high", "head"} for a, b in (pairs[k] for k in shown))
    without = with_series(made_run(hands=False), h_self_collision=h)
    assert distances.closest_pairs([without])[:2] == [feet, hand]


def test_an_estimate_is_drawn_where_there_is_one() -> None:
    """An estimate that is the truth has no errors; one that is off by a centimetre has these."""
    result = made_run()
    assert estimate.estimate_plot([result]) is None
    assert estimate.contact_plot([result]) is None
    ticks = len(result.series["time"])
    told = {"q_estimated": result.series["q"].copy(), "v_estimated": result.series["v"].copy()}
    told["q_estimated"][:, 2] += 0.01
    told |= {"foot_force_estimated": np.zeros((ticks, 2)), "contact_estimated": np.ones((ticks, 2))}
    known = with_series(result, **told, estimate_ms=np.ones(ticks))
    np.testing.assert_allclose(velocity_errors(known.series), 0.0, rtol=0, atol=1e-12)
    figures = estimate_figures(dict(known.series))
    assert figures["height_error_m"] == pytest.approx(0.01)
    assert figures["base_velocity_error_m_s"] == pytest.approx(0.0, abs=1e-12)
    faster = told["v_estimated"] + np.concatenate([[0.02, 0.0, 0.0], np.zeros(result.series["v"].shape[1] - 3)])
    figures = estimate_figures(dict(known.series) | {"v_estimated": faster})
    assert figures["base_velocity_error_m_s"] == pytest.approx(0.02)
    for draw in (estimate.estimate_plot, estimate.contact_plot):
        png = draw([known, result])
        assert png is not None and Image.open(io.BytesIO(png)).width > 600


def test_every_run_has_its_own_colour() -> None:
    results = [made_run(ticks=1, filter=name) for name in ("cbf", "none", "ssa", "none", "sss")]
    colours = [colour for _, colour in style.coloured(results)]
    assert colours[1] == style.UNFILTERED
    assert len(set(colours)) == len(results)


def test_bounds_are_drawn_only_where_something_is_guaranteed() -> None:
    free, filtered = made_run(filter="none"), made_run()
    assert distances.guarantee_plot([free]) is None
    assert distances.guarantee_plot([made_run(ticks=0)]) is None
    alone = distances.guarantee_plot([filtered])
    assert alone is not None
    assert distances.guarantee_plot([free, filtered]) == alone
    stopped = {k: filtered.series[k].copy() for k in ("h_bound", "h_row_bound", "disturbance")}
    for values in stopped.values():
        values[30:] = np.nan
    assert distances.guarantee_plot([with_series(filtered, **stopped)]) not in {None, alone}
    before = {k: v for k, v in filtered.series.items() if k not in stopped}
    assert distances.guarantee_plot([Recording(filtered.robot, filtered.config, filtered.summary, before)]) is None


@style.as_png
def _line() -> Figure:
    figure, (axis,) = style.new_axes(1, 1, 2.0)
    axis.plot([0.0, 1.0], [0.0, 1.0])
    style.label_time([axis])
    return figure


def test_plots_look_the_same_whatever_the_users_settings() -> None:
    expected = _line()
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "black", "figure.dpi": 30, "savefig.dpi": 20}):
        assert _line() == expected
        assert mpl.rcParams["lines.linewidth"] == 9.0


def test_every_plot_is_as_wide_as_the_others() -> None:
    widths = {Image.open(io.BytesIO(png)).width for png in (_line(), distances.limits_plot([made_run()])) if png}
    assert widths == {round(style.WIDTH * 110)}


def test_where_there_is_nothing_to_draw_there_is_no_plot() -> None:
    assert style.as_png(lambda: None)() is None
