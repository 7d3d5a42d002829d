"""The planar elastica with a clamped base and an end that carries a force and no moment, by its energy
integral.

A rod that is isotropic, without twist and loaded at its end by a force alone bends in the plane of its base
tangent and that force, so this plane curve is the exact shape in space too. With theta(s) the angle of the
tangent from the base's, b = theta(l) the whole bend, eta the angle from the end tangent to the force F and f
= F/EI,

    theta'^2 = 2 f (cos eta - cos(eta + b - theta)),

and theta = b (1 - tau^2) takes the square-root singularity of ds = dtheta/theta' away: with a = b tau^2/2,

    sqrt(f) ds = sqrt(2 b) g dtau,   g = 1/sqrt(sin(a)/a sin(eta + a)),   tau from 1 (base) to 0 (end),

an analytic integrand for Gauss-Legendre quadrature.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Shape", "base_curvature", "shape"]

FloatArray = NDArray[np.float64]

NODES = 8
"""Quadrature nodes: length and position to 1e-13 up to a bend of 0.5 rad, 1e-8 at 1.5 rad."""
_TAU, _WEIGHTS = np.polynomial.legendre.leggauss(NODES)
_HALF_TAU2 = 0.5 * (0.5 * (_TAU + 1.0)) ** 2
_WEIGHTS = 0.5 * _WEIGHTS
SMALLEST = 1e-12
"""Bends [rad] below this are taken as this: their shapes agree to a double's precision."""


class Shape(NamedTuple):
    """A bent rod in units of sqrt(2 b/f); scale it by what is known of it."""

    length: FloatArray
    """Arc length."""
    ahead: FloatArray
    """Position of the end along the base tangent."""
    aside: FloatArray
    """Position of the end across it, towards the force."""


def shape(bend: FloatArray, eta: FloatArray) -> Shape:
    """The shape for a whole bend (rad, above zero) and the angle from end tangent to force (rad, in (0,
    pi)).
    """
    bend = np.maximum(bend, SMALLEST)
    nodes = (slice(None), *([None] * bend.ndim))
    a = _HALF_TAU2[nodes] * bend
    sin, cos = np.sin(a), np.cos(a)
    g = np.sin(eta) * cos
    g += np.cos(eta) * sin
    g *= sin
    g /= a
    np.sqrt(g, out=g)
    np.divide(_WEIGHTS[nodes], g, out=g)
    cos *= sin
    cos *= g
    sin *= sin
    sin *= g
    # Node by node: the order in which numpy adds along an axis depends on how many pushes there are.
    length, lag, rise = g[0].copy(), sin[0].copy(), cos[0].copy()
    for k in range(1, NODES):
        length += g[k]
        lag += sin[k]
        rise += cos[k]
    lag *= -2.0
    lag += length  # the integral of g cos(2a)
    rise *= 2.0  # the integral of g sin(2a)
    sin, cos = np.sin(bend), np.cos(bend)
    return Shape(length, cos * lag + sin * rise, sin * lag - cos * rise)


def base_curvature(bend: FloatArray, eta: FloatArray, root_force: FloatArray) -> FloatArray:
    """theta'(0) = |M|/EI from sqrt(f): 2 sqrt(f sin(eta + b/2) sin(b/2))."""
    return np.asarray(2.0 * root_force * np.sqrt(np.sin(eta + 0.5 * bend) * np.sin(0.5 * bend)))
