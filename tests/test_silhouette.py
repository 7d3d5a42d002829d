"""Profiles: arcs and sampled curves."""

import numpy as np
import pytest

from contour.errors import UsageError
from contour.silhouette import ArcProfile, SampledProfile, sampled


def _profiles(radius):
    x = np.linspace(-0.6, 0.6, 121) * radius
    heights = np.sqrt(radius**2 - x**2) - radius
    return ArcProfile(np.array([1.0 / radius])), SampledProfile(x[None], heights[None])


@pytest.mark.parametrize("curvature", [0.0, 2.5, -2.5])
def test_arc_frame_is_the_circle_s(curvature):
    """Point, normal and arc length of b = (2/kappa) tan(kappa a/2), against the circle by its arc length."""
    profile = ArcProfile(np.array([curvature]))
    for a in (-0.3, 1e-9, 0.2):
        b = np.array([a if curvature == 0.0 else 2.0 / curvature * np.tan(0.5 * curvature * a)])
        frame = profile.at(b)
        along = a if curvature == 0.0 else np.sin(curvature * a) / curvature
        out = 0.0 if curvature == 0.0 else (np.cos(curvature * a) - 1.0) / curvature
        # Near b = 0 the cosine above has lost half of its digits, the profile none.
        assert np.allclose((frame.along[0], frame.out[0]), (along, out), rtol=1e-12, atol=1e-16)
        assert np.allclose(
            (frame.sin[0], frame.cos[0]), (np.sin(curvature * a), np.cos(curvature * a)), atol=1e-14
        )
        assert profile.arc(b)[0] == pytest.approx(a, rel=1e-12)


def test_sampled_circle_is_the_circle():
    """C1 cubics of 121 samples: heights to h^4, normals to h^2 and curvature to h of the cell 0.01 R, at
    worst.
    """
    arc, curve = _profiles(0.4)
    for a in (-0.15, 0.003, 0.11):
        exact = arc.at(np.array([0.8 * np.tan(0.5 * a / 0.4)]))
        near = curve.at(exact.along)
        assert near.out[0] == pytest.approx(exact.out[0], abs=1e-7)
        assert near.sin[0] == pytest.approx(exact.sin[0], abs=1e-4)
        assert near.curvature[0] == pytest.approx(2.5, rel=0.02)
        assert curve.arc(exact.along)[0] == pytest.approx(a, abs=1e-7)


@pytest.mark.parametrize("make", [0, 1])
def test_frame_is_consistent_with_differences(make):
    """The tangent is the derivative of the point, and the curvature that of the normal's turn, by arc
    length.
    """
    profile = _profiles(0.4)[make]
    b, h = np.array([0.0412]), 1e-5
    before, here, after = profile.at(b - h), profile.at(b), profile.at(b + h)
    length = profile.chord(b + h, b - h)
    assert (after.along - before.along) / length == pytest.approx(here.cos, abs=1e-8)
    assert (after.out - before.out) / length == pytest.approx(-here.sin, abs=1e-8)
    assert (after.sin - before.sin) / length == pytest.approx(here.cos * here.curvature, rel=1e-4)
    assert length / (2 * h) == pytest.approx(1.0 / here.speed, rel=1e-6)


def test_sampled_profile_ends_where_nothing_was_seen():
    """A height that is not a number is the end of the body."""
    x = np.linspace(-1.0, 1.0, 21)
    heights = np.where(x > 0.5, np.nan, 0.0)
    profile = SampledProfile(x[None], heights[None])
    assert profile.within(np.array([0.49]))[0]
    assert not profile.within(np.array([0.61]))[0]
    assert profile.within(np.array([-0.99]))[0]


def test_frames_are_the_caller_s_own():
    """The solver works in place on what it is given."""
    b = np.array([0.01])
    for profile in _profiles(0.4):
        assert not np.shares_memory(profile.at(b).along, b)


@pytest.mark.parametrize(
    "offsets, heights, word",
    [
        ([0.0, 1.0, 2.0, 3.0], [0.0] * 4, "both sides"),
        ([-1.0, 1.0, 0.5, 2.0], [0.0] * 4, "rise"),
        ([-1.0, 0.0, 1.0], [0.0] * 3, "samples"),
        ([-2.0, -1.0, 1.0, 2.0], [0.0, np.nan, 0.0, 0.0], "touch point"),
        ([-2.0, -1.0, 1.0, 2.0], [[0.0] * 4] * 3, "pushes"),
    ],
)
def test_sampled_refuses_profiles_that_are_none(offsets, heights, word):
    """One line that names what is wrong."""
    with pytest.raises(UsageError, match=word):
        sampled(offsets, heights, np.ones(2))
