"""DCM feedback and the region of the ZMP."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from controllers.balance.dcm_feedback import clip_to_support, zmp_command
from controllers.balance.dcm_plan import DcmReference

OMEGA, GAIN = 3.8, 4.0
CENTRES = np.array([[0.05, 0.12], [-0.05, -0.12]])
HALF = np.array([[0.08, 0.03], [0.08, 0.03]])


def test_the_error_decays_at_the_gain() -> None:
    reference = DcmReference(np.array([0.1, -0.2]), np.array([0.3, 0.1]), OMEGA)
    dcm = reference.position + np.array([0.02, -0.01])
    rate = OMEGA * (dcm - zmp_command(dcm, reference, GAIN))
    assert rate - reference.velocity == pytest.approx(-GAIN * (dcm - reference.position), abs=1e-12)


def test_without_error_the_zmp_is_the_plans() -> None:
    reference = DcmReference(np.array([0.1, -0.2]), np.array([0.3, 0.1]), OMEGA)
    assert zmp_command(reference.position, reference, GAIN) == pytest.approx(reference.zmp, abs=1e-12)


def hull_of(feet: list[int], yaw: float) -> ConvexHull:
    c, s = np.cos(yaw), np.sin(yaw)
    axes = np.array([[c, -s], [s, c]])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return ConvexHull(np.concatenate([CENTRES[f] + (signs * HALF[f]) @ axes.T for f in feet]))


@settings(max_examples=100, deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3, 3), st.sampled_from([[0, 1], [0], [1]]))
def test_a_clipped_point_lies_in_the_support(x: float, y: float, yaw: float, feet: list[int]) -> None:
    contact = np.array([i in feet for i in (0, 1)])
    clipped = clip_to_support(np.array([x, y]), CENTRES, np.full(2, yaw), HALF, contact)
    hull = hull_of(feet, yaw).equations
    assert (hull[:, :2] @ clipped + hull[:, 2] <= 1e-9).all()


def test_points_of_one_sole_and_between_the_soles_stay() -> None:
    both = np.array([True, True])
    for fraction in np.linspace(0, 1, 11):
        for offset in ([0.07, 0.0], [-0.07, 0.02], [0.0, -0.03]):
            line = CENTRES[0] + fraction * (CENTRES[1] - CENTRES[0])
            across = np.array([0.0, 1.0])
            point = line + offset - across * 0.0
            clipped = clip_to_support(point, CENTRES, np.zeros(2), HALF, both)
            nearest = clip_to_support(clipped, CENTRES, np.zeros(2), HALF, both)
            assert nearest == pytest.approx(clipped, abs=1e-9)
    inside = CENTRES[0] + [0.05, -0.02]
    left = np.array([True, False])
    assert clip_to_support(inside, CENTRES, np.zeros(2), HALF, left) == pytest.approx(inside, abs=1e-12)


def test_headings_on_both_sides_of_half_a_turn_have_their_mean_between_them() -> None:
    """Soles at +179 and -179 degrees look backwards, not forwards: the region is long along x all the same."""
    yaws = np.deg2rad([179.0, -179.0])
    middle = CENTRES.mean(axis=0)
    clipped = clip_to_support(middle + np.array([0.3, 0.0]), CENTRES, yaws, HALF, np.array([True, True]))
    assert np.linalg.norm(clipped - middle) > 0.07


def test_without_contact_there_is_nothing_to_clip_to() -> None:
    point = np.array([3.0, 4.0])
    assert clip_to_support(point, CENTRES, np.zeros(2), HALF, np.array([False, False])) == pytest.approx(point, abs=0)
