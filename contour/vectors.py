"""Products of three-vectors in rows: numpy's own cost more than the arithmetic at a few hundred rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["cross", "dot", "unit"]

FloatArray = NDArray[np.float64]


def cross(one: FloatArray, two: FloatArray) -> FloatArray:
    """Cross products (..., 3); shapes broadcast.

    >>> cross(np.array([1.0, 0.0, 0.0]), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]))
    array([[ 0.,  0.,  1.],
           [ 0., -2.,  0.]])
    """
    x, y, z = one[..., 0], one[..., 1], one[..., 2]
    u, v, w = two[..., 0], two[..., 1], two[..., 2]
    out = np.zeros(np.broadcast_shapes(one.shape, two.shape))
    np.subtract(y * w, z * v, out=out[..., 0])
    np.subtract(z * u, x * w, out=out[..., 1])
    np.subtract(x * v, y * u, out=out[..., 2])
    return out


def dot(one: FloatArray, two: FloatArray) -> FloatArray:
    """Scalar products of rows (k, 3): (k,)."""
    return np.asarray(np.einsum("kj,kj->k", one, two))


def unit(vectors: FloatArray) -> FloatArray:
    """Rows (k, 3) of length one; none may be zero."""
    return np.asarray(vectors / np.sqrt(np.einsum("kj,kj->k", vectors, vectors))[:, None])
