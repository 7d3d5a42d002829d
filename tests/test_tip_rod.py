"""The tip's geometry: its place on the surface, its derivatives, and the series of the bent rod."""

import numpy as np
import pytest

from contour import tip_rod
from contour.planar_elastica import base_curvature, shape
from contour.silhouette import ArcProfile

EPS, TILT = np.array([0.3, -0.5]), np.array([0.7, -0.6])


def _rows(ridge):
    return tip_rod.Rows(
        np.sin(EPS),
        np.cos(EPS),
        np.sin(TILT),
        np.cos(TILT),
        np.array([0.3, 0.2]),
        np.full(2, ridge),
        ArcProfile(np.array([8.0, -3.0])),
    )


def _at(rows, b, theta=0.06):
    turn = tip_rod.base_turn(rows, np.full(2, np.sin(theta)), np.full(2, np.cos(theta)), np.zeros(2))
    v = np.zeros(2)
    for _ in range(12):
        place = tip_rod.place(rows, turn, b, v)
        v = place.v
    return place, turn


def _rod(r, pull):
    """Length, chord squared and base curvature of exact rods of slope r whose force has the axial part pull/r."""
    off_base = np.arctan2(1.0, pull / r)
    low, high = np.full(r.shape, 1e-9), np.minimum(6.0 * r, off_base - 1e-6)
    for _ in range(80):
        bend = 0.5 * (low + high)
        s = shape(bend, off_base - bend)
        low, high = np.where(s.aside > r * s.ahead, (low, bend), (bend, high))
    return s, base_curvature(bend, off_base - bend, np.sqrt(2.0 * bend) * s.length)


@pytest.mark.parametrize("slope", [0.01, 0.05, 0.1])
def test_moment_is_that_of_the_exact_rod(slope):
    """D(p, r^2) within 2e-5 for pulls to 0.2, within 2e-4 to 0.3."""
    pull = np.linspace(-0.3, 0.3, 25)
    r = np.full(pull.shape, slope)
    _, curvature = _rod(r, pull)
    off = np.abs(tip_rod.divisor(pull, r * r) * curvature / (3.0 * r) - 1.0)
    assert off[np.abs(pull) <= 0.2].max() < 2e-5
    assert off.max() < 2e-4


def test_chord_is_that_of_the_exact_rod():
    """1 - |P|^2 = r^2 Q: 5e-4 of it for pulls to 0.3 and slopes to 0.1."""
    pull = np.linspace(-0.3, 0.3, 13)
    rows = _rows(0.0)._replace(cos_eps=np.ones(13), sin_eps=np.zeros(13), cos_tilt=1.0, sin_tilt=0.0)
    shrink = tip_rod.base_turn(rows, 0.0, 1.0, pull).shrink
    for slope in (0.02, 0.1):
        r = np.full(pull.shape, slope)
        s, _ = _rod(r, pull)
        chord2 = (s.ahead**2 + s.aside**2) / s.length**2
        assert np.allclose((1.0 - chord2) / r**2, shrink - 0.186 * r * r, rtol=5e-4)


@pytest.mark.parametrize("ridge", [0.0, 10.0])
def test_tip_lies_on_its_surface_at_the_rod_s_length(ridge):
    """P from b and v: its distance is that of the rod's end, m is t0 x P, all by plain vectors."""
    rows = _rows(ridge)
    p, turn = _at(rows, np.array([-0.03, 0.02]))
    for i in range(2):
        c, s = np.cos(TILT[i]), np.sin(TILT[i])
        n_lift, y_back = np.array([0.0, c, -s]), np.array([0.0, s, c])
        profile = rows.profile.rows(np.array([i]))
        along, out, cos, sin, _, _ = (v[0] for v in profile.at(np.array([[-0.03, 0.02][i]])))
        normal = sin * np.array([1.0, 0.0, 0.0]) + cos * n_lift
        turned = np.arcsin(ridge * p.v[i]) if ridge else 0.0
        drop = (np.cos(turned) - 1.0) / ridge if ridge else 0.0
        e_y = np.array([0.0, 0.0, 1.0])
        tip = e_y + along * np.array([1.0, 0.0, 0.0]) + out * n_lift + drop * normal + p.v[i] * y_back
        base = turn.t[i] * np.array([1.0, 0.0, 0.0]) + turn.n[i] * n_lift + turn.y[i] * y_back
        assert np.linalg.norm(base) == pytest.approx(1.0, abs=1e-14)
        slope2 = (np.linalg.norm(np.cross(base, tip)) / (base @ tip)) ** 2
        assert slope2 == pytest.approx(p.slope2[i], rel=1e-10)
        assert 1.0 - tip @ tip == pytest.approx(0.2 * slope2 - 0.186 * slope2**2, abs=1e-13)
        m = np.cross(base, tip)
        e_a = cos * np.array([1.0, 0.0, 0.0]) - sin * n_lift
        n = np.cos(turned) * normal + np.sin(turned) * y_back
        for mine, axis in ((p.m_a, e_a), (p.m_n, n), (p.m_v, np.cross(e_a, n))):
            assert mine[i] == pytest.approx(m @ axis, abs=1e-13)


@pytest.mark.parametrize("ridge", [0.0, 10.0])
def test_rate_of_v_is_its_derivative(ridge):
    """dv/da against differences: to 1 % of the slide's share, as Newton's steps need."""
    rows = _rows(ridge)
    b, h = np.array([-0.03, 0.02]), 1e-6
    v = [_at(rows, b + sign * h)[0].v for sign in (1.0, -1.0)]
    p, _ = _at(rows, b)
    assert np.allclose((v[0] - v[1]) / (2.0 * h) * p.speed, p.v_rate, atol=5e-4)


def test_force_without_friction_is_normal():
    """mu = 0 and m in the plane of e_a and e_v: pull is the normal's axial part, eta its angle off the end."""
    rows = _rows(0.0)._replace(sin_eps=np.zeros(2), cos_eps=np.ones(2), friction=np.zeros(2))
    p, _ = _at(rows, np.zeros(2))
    pull, eta = tip_rod.force(rows, p, np.zeros(2), np.full(2, 1e-6))
    # In the plane of beam and normal the base tangent is -theta off the beam, the normal chi off across it.
    assert np.allclose(pull, np.sqrt(p.slope2) * np.tan(-0.06 - TILT), rtol=1e-9)
    assert np.allclose(eta, 0.5 * np.pi + 0.06 + TILT - 1.5 * np.sqrt(p.slope2), atol=1e-9)
