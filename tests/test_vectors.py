"""Products of vectors are numpy's own."""

from __future__ import annotations

import numpy as np

from contour.vectors import cross, dot, unit


def test_products_are_those_of_numpy(rng):
    """Bit for bit for cross products, also where shapes broadcast; to rounding for the others."""
    one, two = rng.normal(size=(7, 3, 3)), rng.normal(size=(7, 1, 3))
    np.testing.assert_array_equal(cross(one, two), np.cross(one, two))
    np.testing.assert_allclose(dot(one[:, 0], one[:, 1]), (one[:, 0] * one[:, 1]).sum(axis=1), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(unit(one[:, 0]), axis=1), 1.0, atol=1e-15)
