"""Implicit surfaces through points with normals: Gaussian processes that observe values and gradients.

A field f(x) [m], near the surface its signed distance, positive outside, is a Gaussian process of zero mean.
A point p with outward normal n observes f(p) = 0 and grad f(p) = n, each with its noise. The mean of the
process given all of them is the Hermite interpolant with the covariance as radial basis (Macedo2011;
Williams2007), and its zero level is the surface. Two covariances, both functions of r = |x - y|:

- *wide*, k = 2 r^3 - 3 R r^2 + R^3 (Williams2007), up to constants the r^3 spline. It bridges gaps best, and every
  point acts everywhere: n points cost (4 n)^3.
- *compact*, Wendland's C2 function (Wendland1995), zero beyond a radius: equations are sparse, and n points cost
  about n.

:class:`Layers` is one wide process through a few hundred points spread evenly, and a compact one through what
it leaves at all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse import linalg as iterative
from scipy.spatial import KDTree

from contour.errors import NotConverged

__all__ = [
    "Compact",
    "Layers",
    "Observations",
    "Wide",
    "farthest_first",
    "fit_compact",
    "fit_layers",
    "fit_wide",
    "nearest_sigma",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CHUNK = 2_000_000
"""Numbers that are worked on at once: 16 MB an array."""
CACHED = 100_000
"""The same where little is done with each: arrays that stay in the processor's cache are five times as fast."""
CONSTANT = 4.0
"""Variance of the field's unknown mean, in R^3: it may be anything."""
REACH = 2.0
"""R in units of the points' diagonal: the covariance is positive for distances up to R."""
NUGGET = 1e-8
"""Least variance of noise over that of the prior: rounding must not make the equations indefinite."""
PILOT = 150
"""Points that tell how rough the surface is."""
NEAREST = 10
"""Observations that the standard deviation at a point is conditioned on."""
LEFT_OUT = 600
"""Observations that are left out in turn to see how well they are predicted."""
AROUND = 12
"""Those of them that tell how rough the surface is at a point."""
ASKED = 5000
"""Points at which it is worked out; the others take that of the nearest."""
SPREAD = 800
"""Points that the wide process of :func:`fit_layers` goes through."""
STEP = 4
"""Points of a layer of corrections over those of the one before."""
NEARLY_ALL = 0.7
"""Share of all points beyond which a layer takes all of them."""
CROWDED = 0.7
"""Share of the points that have :data:`NEIGHBOURS` within the compact covariance's radius."""
RESIDUAL = 1e-3
"""Relative residual of the sparse equations, far below what a point's noise leaves."""
ITERATIONS = 500
NEIGHBOURS = 28
"""Points within the compact covariance's radius, for most of the points."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """Values 0 and gradients observed at n points."""

    points: FloatArray
    """(n, 3) m."""
    values: FloatArray
    """(n,) m, of the field."""
    gradients: FloatArray
    """(n, 3) of the field."""
    value_noise: FloatArray
    """(n,) m^2, variance of the value."""
    gradient_noise: FloatArray
    """(n, 3, 3), covariance of the gradient; large along what was not seen."""

    def take(self, rows: IntArray) -> Observations:
        """Those in ``rows``."""
        return Observations(
            points=self.points[rows],
            values=self.values[rows],
            gradients=self.gradients[rows],
            value_noise=self.value_noise[rows],
            gradient_noise=self.gradient_noise[rows],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wide:
    """Mean of the wide process."""

    centres: FloatArray
    """(n, 3) in units of ``length``."""
    values: FloatArray
    """(n,) coefficients of the covariance with values."""
    slopes: FloatArray
    """(n, 3) coefficients of the covariance with gradients."""
    middle: FloatArray
    """(3,) m, origin of the centres."""
    length: float
    """[m], unit of the centres and of the field."""

    def __call__(self, points: FloatArray) -> FloatArray:
        """The field (m,) [m] at ``points`` (m, 3) [m]."""
        x = (points - self.middle) / self.length
        field = np.zeros(len(x))
        offset = np.einsum("nj,nj->n", self.centres, self.slopes)
        constant = CONSTANT * REACH**3 * float(self.values.sum())
        for rows in _chunks(len(x), len(self.centres), CACHED):
            r = _distances(x[rows], self.centres)
            k = (2.0 * r - 3.0 * REACH) * r * r + REACH**3
            r -= REACH
            r *= 6.0  # now k' / r
            r *= x[rows] @ self.slopes.T - offset
            field[rows] = k @ self.values - r.sum(axis=1) + constant
        return field * self.length

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient (m, 3) of the field at ``points`` (m, 3) [m]."""
        x = (points - self.middle) / self.length
        out = np.zeros_like(x)
        offset = np.einsum("nj,nj->n", self.centres, self.slopes)
        for rows in _chunks(len(x), len(self.centres), CACHED):
            r = _distances(x[rows], self.centres)
            g = 6.0 * (r - REACH)
            along = x[rows] @ self.slopes.T - offset
            # d/dx of sum_i a_i k + b_i . (-g d): a_i g d - g b_i - (6 / r) (d . b_i) d, with d = x - c_i.
            push = g * self.values - 6.0 * along / np.maximum(r, 1e-12)
            out[rows] = push.sum(axis=1)[:, None] * x[rows] - push @ self.centres - g @ self.slopes
        return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compact:
    """Mean of the compact process."""

    tree: KDTree
    """Of the n centres, in units of ``radius``."""
    coefficients: FloatArray
    """(n, 4): of the covariance with values and with gradients."""
    radius: float
    """[m], beyond which a centre does not act."""

    def __call__(self, points: FloatArray) -> FloatArray:
        """The field (m,) [m] at ``points`` (m, 3) [m]."""
        return self._sums(points, gradients=False)[:, 0] * self.radius

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient (m, 3) of the field at ``points`` (m, 3) [m]."""
        return self._sums(points, gradients=True)

    def _sums(self, points: FloatArray, *, gradients: bool) -> FloatArray:
        x = points / self.radius
        out = np.zeros((len(x), 3 if gradients else 1))
        centres = np.asarray(self.tree.data)
        for rows in _chunks(len(x), 8 * NEIGHBOURS):
            pairs = self.tree.sparse_distance_matrix(KDTree(x[rows]), 1.0, output_type="ndarray")
            i, j, r = pairs["j"], pairs["i"], pairs["v"]
            d = x[rows][i] - centres[j]
            a, b = self.coefficients[j, 0], self.coefficients[j, 1:]
            k, g, h = _wendland(r)
            along = np.einsum("pj,pj->p", d, b)
            count = len(out[rows])
            if gradients:
                push = a * g - h * along
                for axis in range(3):
                    out[rows, axis] = np.bincount(i, push * d[:, axis] - g * b[:, axis], count)
            else:
                out[rows, 0] = np.bincount(i, a * k - g * along, count)
        return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """A wide field and compact corrections to it."""

    wide: Wide
    corrections: tuple[Compact, ...]

    def __call__(self, points: FloatArray) -> FloatArray:
        """The field (m,) [m] at ``points`` (m, 3) [m]."""
        field = self.wide(points)
        for correction in self.corrections:
            field += correction(points)
        return field

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient (m, 3) of the field at ``points`` (m, 3) [m]."""
        out = self.wide.gradient(points)
        for correction in self.corrections:
            out += correction.gradient(points)
        return out


def farthest_first(points: FloatArray, count: int) -> IntArray:
    """Rows of ``count`` of the ``points`` (n, 3), each the farthest from those before it."""
    if count >= len(points):
        return np.arange(len(points))
    chosen = np.zeros(count, dtype=np.int64)
    chosen[0] = int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    near = np.full(len(points), np.inf)
    for k in range(1, count):  # each depends on those before it
        step = points - points[chosen[k - 1]]
        np.minimum(near, np.einsum("nj,nj->n", step, step), out=near)
        chosen[k] = int(np.argmax(near))
    return chosen


def fit_wide(observed: Observations) -> Wide:
    """The wide process given all of ``observed``."""
    low, high = observed.points.min(axis=0), observed.points.max(axis=0)
    length, middle = float(np.linalg.norm(high - low)), (low + high) / 2.0
    pilot = observed.take(farthest_first(observed.points, PILOT))
    scale = 1.0
    for _ in range(2):
        scale = _solve_wide(pilot, middle, length, scale)[1]
    solved, _ = _solve_wide(observed, middle, length, scale)
    count = len(observed.points)
    return Wide(
        centres=(observed.points - middle) / length,
        values=solved[:count].copy(),
        slopes=solved[count:].reshape(3, -1).T.copy(),
        middle=middle,
        length=length,
    )


def fit_compact(observed: Observations, *, radius: float) -> Compact:
    """The compact process given ``observed``; its covariance ends at ``radius`` [m].

    Raises:
        NotConverged: the sparse equations were not solved.
    """
    x = observed.points / radius
    count = len(x)
    tree = KDTree(x)
    # The prior's variance follows from that of the gradients, 20 times it an axis, where they were seen.
    spread = np.trace(observed.gradient_noise, axis1=1, axis2=2)
    seen = np.clip(1.0 - spread, 0.05, None)
    slope = float(np.average(np.sum(observed.gradients**2, axis=1), weights=seen)) / 3.0
    scale = max(slope / 20.0, float(np.mean(observed.values**2)) / radius**2, 1e-12)
    pairs = tree.sparse_distance_matrix(tree, 1.0, output_type="ndarray")
    order = np.argsort(pairs["i"], kind="stable")
    i, j, r = pairs["i"][order], pairs["j"][order], pairs["v"][order]
    d = x[i] - x[j]
    k, g, h = _wendland(r)
    blocks = np.zeros((len(r), 4, 4))
    blocks[:, 0, 0] = k
    blocks[:, 0, 1:] = -g[:, None] * d
    blocks[:, 1:, 0] = g[:, None] * d
    blocks[:, 1:, 1:] = -h[:, None, None] * d[:, :, None] * d[:, None, :]
    blocks[:, [1, 2, 3], [1, 2, 3]] -= g[:, None]
    own = np.flatnonzero(i == j)
    blocks[own, 0, 0] += observed.value_noise[i[own]] / (radius**2 * scale) + NUGGET
    blocks[own, 1:, 1:] += observed.gradient_noise[i[own]] / scale + NUGGET * np.eye(3)
    starts = np.concatenate(([0], np.cumsum(np.bincount(i, minlength=count))))
    matrix = sparse.bsr_array((blocks, j, starts), shape=(4 * count, 4 * count))
    inverse = np.zeros((count, 4, 4))
    inverse[i[own]] = np.linalg.inv(blocks[own])
    start = sparse.bsr_array((inverse, np.arange(count), np.arange(count + 1)), shape=matrix.shape)
    y = np.concatenate((observed.values[:, None] / radius, observed.gradients), axis=1).ravel()
    solved, failed = iterative.cg(matrix, y, rtol=RESIDUAL, maxiter=ITERATIONS, M=start)
    if failed:
        left = float(np.linalg.norm(matrix @ solved - y) / np.linalg.norm(y))
        raise NotConverged("sparse Hermite interpolation", residual=left, iterations=ITERATIONS)
    return Compact(tree=tree, coefficients=solved.reshape(-1, 4), radius=radius)


def fit_layers(observed: Observations) -> Layers:
    """A wide process through :data:`SPREAD` points, and compact ones through what is left at more and more."""
    count = len(observed.points)
    sizes = [min(SPREAD, count)]
    while STEP * sizes[-1] < NEARLY_ALL * count:
        sizes.append(STEP * sizes[-1])
    order = farthest_first(observed.points, sizes[-1])
    field = Layers(wide=fit_wide(observed.take(order[: sizes[0]])), corrections=())
    layers = [order[:size] for size in sizes[1:]]
    if sizes[-1] < count:
        layers.append(np.arange(count))
    for rows in layers:  # each corrects what those before it leave
        part = observed.take(rows)
        left = replace(
            part,
            values=part.values - field(part.points),
            gradients=part.gradients - field.gradient(part.points),
        )
        near = KDTree(part.points).query(part.points, k=[min(NEIGHBOURS, len(rows))])[0]
        radius = float(np.quantile(near, CROWDED))
        field = Layers(wide=field.wide, corrections=(*field.corrections, fit_compact(left, radius=radius)))
    return field


def nearest_sigma(observed: Observations, points: FloatArray) -> FloatArray:
    """Standard deviation (m,) [m] of the field at ``points`` (m, 3) [m], of the wide process.

    Only the nearest observations are given, whose errors may be common to them. The prior's variance is such that
    observations left out in turn are predicted from their nearest others as well as it says: overall, and among
    those near each point, since bodies are smooth in one place and cornered in another.
    """
    rows = farthest_first(observed.points, LEFT_OUT)
    tree = KDTree(observed.points)
    count = min(NEAREST, len(observed.points) - 1)
    others = _nearest(tree, observed.points[rows], count + 1)[:, 1:]
    scale, squared = 1.0, np.ones(len(rows))
    for _ in range(3):
        mean, variance = _predict(observed, observed.points[rows], others, scale)
        squared = (mean - observed.values[rows]) ** 2 / (variance + observed.value_noise[rows])
        scale *= float(np.mean(squared))
    asked = np.arange(0, len(points), max(1, len(points) // ASKED))
    near = _nearest(tree, points[asked], count)
    _, variance = _predict(observed, points[asked], near, scale)
    around = min(AROUND, len(rows))
    like = _nearest(KDTree(observed.points[rows]), points[asked], around)
    local = (1.0 + squared[like].sum(axis=1) / np.mean(squared)) / (1.0 + around)
    variance = variance * local + observed.value_noise[near].mean(axis=1)
    return np.asarray(np.sqrt(variance)[_nearest(KDTree(points[asked]), points, 1)[:, 0]])


def _nearest(tree: KDTree, points: FloatArray, count: int) -> IntArray:
    """Rows (m, count) in ``tree`` nearest to ``points`` (m, 3)."""
    return np.asarray(tree.query(points, k=np.arange(1, count + 1))[1], dtype=np.int64)


def _predict(
    observed: Observations, points: FloatArray, near: IntArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """Mean [m] and variance [m^2] (m,) at ``points`` (m, 3) given the observations ``near`` (m, k) of each."""
    length = float(np.linalg.norm(np.ptp(observed.points, axis=0)))
    k = near.shape[1]
    mean, variance = np.zeros(len(points)), np.zeros(len(points))
    for rows in _chunks(len(points), 16 * k * k):
        who = near[rows]
        x = (
            observed.points[who] - points[rows, None, :]
        ) / length  # (c, k, 3), seen from the point asked for
        matrix = _covariance(x, x)
        _add_noise(
            matrix, observed.value_noise[who] / (length**2 * scale), observed.gradient_noise[who] / scale
        )
        y = np.concatenate((observed.values[who][..., None] / length, observed.gradients[who]), axis=-1)
        y = np.moveaxis(y, -1, 1).reshape(len(x), 4 * k)
        cross = _covariance(x, np.zeros((len(x), 1, 3)))[:, :, :, 0, 0].reshape(len(x), 4 * k)
        weights = np.linalg.solve(matrix.reshape(len(x), 4 * k, 4 * k), cross[..., None])[..., 0]
        mean[rows] = np.einsum("cj,cj->c", weights, y) * length
        left = (1.0 + CONSTANT) * REACH**3 - np.einsum("cj,cj->c", weights, cross)
        variance[rows] = np.maximum(left, NUGGET) * scale * length**2
    return mean, variance


def _solve_wide(
    observed: Observations, middle: FloatArray, length: float, scale: float
) -> tuple[FloatArray, float]:
    """Coefficients (4 n,) given the prior's variance ``scale``; and the likeliest one, where noise is small."""
    x = (observed.points - middle) / length
    matrix = _covariance(x, x)
    _add_noise(matrix, observed.value_noise / (length**2 * scale), observed.gradient_noise / scale)
    y = np.concatenate((observed.values / length, observed.gradients.T.ravel()))
    square = matrix.reshape(y.size, y.size).T  # symmetric; LAPACK wants columns together
    factor = linalg.cholesky(square, lower=True, overwrite_a=True, check_finite=False)
    solved = linalg.cho_solve((factor, True), y, check_finite=False)
    return solved, float(y @ solved) / y.size


def _covariance(x: FloatArray, y: FloatArray) -> FloatArray:
    """(..., 4, n, 4, m) of value and gradient at ``x`` (..., n, 3) with those at ``y`` (..., m, 3), wide."""
    d = x[..., :, None, :] - y[..., None, :, :]
    r = np.sqrt(np.einsum("...j,...j->...", d, d))
    out = np.zeros((*r.shape[:-2], 4, r.shape[-2], 4, r.shape[-1]))
    out[..., 0, :, 0, :] = (2.0 * r - 3.0 * REACH) * r * r + (1.0 + CONSTANT) * REACH**3
    g = 6.0 * (r - REACH)  # k' / r
    h = 6.0 / np.maximum(r, 1e-12)  # (k' / r)' / r
    for a in range(3):
        slope = g * d[..., a]
        out[..., 1 + a, :, 0, :] = slope
        out[..., 0, :, 1 + a, :] = -slope
        for b in range(3):
            out[..., 1 + a, :, 1 + b, :] = -h * d[..., a] * d[..., b] - (g if a == b else 0.0)
    return out


def _add_noise(matrix: FloatArray, value: FloatArray, gradient: FloatArray) -> None:
    """Add to ``matrix`` (..., 4, n, 4, n) the variances ``value`` (..., n) and ``gradient`` (..., n, 3, 3)."""
    # A view of the entries with equal n: (..., 4, 4, n).
    own = np.einsum("...anbn->...abn", matrix)
    own[..., 0, 0, :] += value + NUGGET
    own[..., 1:, 1:, :] += np.moveaxis(gradient, -3, -1) + NUGGET * np.eye(3)[:, :, None]


def _wendland(r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Wendland's C2 function (1 - r)^4 (4 r + 1) and, of it, k' / r and (k' / r)' / r; r <= 1."""
    one = 1.0 - r
    square = one * one
    return square * square * (4.0 * r + 1.0), -20.0 * square * one, 60.0 * square / np.maximum(r, 1e-9)


def _distances(x: FloatArray, y: FloatArray) -> FloatArray:
    """(m, n) between the rows of ``x`` and ``y``."""
    squared = x @ y.T
    squared *= -2.0
    squared += np.einsum("mj,mj->m", x, x)[:, None]
    squared += np.einsum("nj,nj->n", y, y)
    return np.sqrt(np.maximum(squared, 0.0, out=squared), out=squared)


def _chunks(rows: int, columns: int, numbers: int = CHUNK) -> list[slice]:
    """Slices of ``rows`` rows with ``columns`` numbers each, to work on at once."""
    size = max(1, numbers // max(columns, 1))
    return [slice(first, min(first + size, rows)) for first in range(0, rows, size)]
