"""The planar elastica against its differential equation and its limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from contour.planar_elastica import base_curvature, shape


@pytest.mark.parametrize(
    "bend, eta, tolerance", [(0.01, 1.4, 1e-13), (0.3, 1.7, 1e-12), (0.5, 1.2, 1e-12), (1.5, 1.3, 1e-9)]
)
def test_shape_solves_the_rod_s_equation(bend, eta, tolerance):
    """theta'' = -f sin(gamma - theta) from the base, f = 1, gamma = bend + eta: end reached, straight
    there.
    """
    b, e = np.array([bend]), np.array([eta])
    rod = shape(b, e)
    unit = np.sqrt(2.0 * bend)

    def rate(_, y):
        return [y[1], -np.sin(bend + eta - y[0]), np.cos(y[0]), np.sin(y[0])]

    start = [0.0, base_curvature(b, e, np.ones(1))[0], 0.0, 0.0]
    end = solve_ivp(rate, (0.0, unit * rod.length[0]), start, rtol=1e-12, atol=1e-14).y[:, -1]
    wanted = (bend, 0.0, unit * rod.ahead[0], unit * rod.aside[0])
    assert np.allclose(end, wanted, atol=tolerance * 10)


def test_small_bend_is_the_cantilever():
    """A transverse end force: slope f l^2/2, deflection f l^3/3, so that aside/ahead is 2/3 of the bend."""
    bend = np.array([1e-4])
    rod = shape(bend, np.array([np.pi / 2 - 1e-4]))
    assert rod.aside / rod.ahead == pytest.approx(bend * 2.0 / 3.0, rel=1e-7)
    curvature = base_curvature(bend, np.array([np.pi / 2]), np.ones(1))
    # l = sqrt(2 b/f) length, curvature l = 2 b.
    assert curvature * np.sqrt(2.0 * bend) * rod.length == pytest.approx(2.0 * bend, rel=1e-7)


def test_length_exceeds_the_chord_by_a_tenth_of_its_slope_squared():
    """l = |p| (1 + r^2/10), the reduced rod's rule, with the next order r^3 and r^4 below it."""
    bend = np.array([0.06])
    rod = shape(bend, np.array([np.pi / 2 - 0.03]))
    r = rod.aside / rod.ahead
    assert rod.length / np.hypot(rod.ahead, rod.aside) - 1.0 == pytest.approx(0.1 * r**2, rel=0.03)


def test_no_bend_is_finite():
    """Straight rods are the limit, not a division by zero."""
    rod = shape(np.zeros(1), np.array([1.5]))
    assert all(np.isfinite(v).all() for v in rod)
    assert rod.aside / rod.ahead == pytest.approx(0.0, abs=1e-11)
