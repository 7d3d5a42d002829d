"""Surface methods that were tried beside those of contour.surface, each as a function of points and normals.

They get whole normals (a tip's from the Hermite field), which flatters them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, sparse
from scipy.sparse import linalg
from scipy.spatial import KDTree

from contour.hermite import farthest_first
from contour.isosurface import Grid, Triangles, sample, triangles

FloatArray = NDArray[np.float64]

PAD = 0.08
"""Room around the points, in their longest edge."""
CELLS = 80
"""Grid cells along the longest edge."""
SCREENING = 4.0
"""Weight of the points' values in the Poisson equation (Kazhdan2013)."""
WINDING_PAIRS = 1.5e8
"""Pairs of grid node and point that the winding number may take: 10 s or so."""
AROUND = 30
"""Points of a sphere in apss."""


def vtk(points: FloatArray) -> Triangles:
    """VTK's reconstruct_surface, which ignores the normals (Hoppe1992)."""
    import pyvista

    made = pyvista.PolyData(points).reconstruct_surface(nbr_sz=20)
    faces = np.array(made.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
    vertices = np.array(made.points, dtype=np.float64)
    inside_out = np.linalg.det(vertices[faces]).sum() < 0.0
    return Triangles(vertices=vertices, faces=faces[:, ::-1] if inside_out else faces)


def poisson(points: FloatArray, normals: FloatArray) -> Triangles:
    """Screened Poisson on a regular grid, cosine transforms as preconditioner (Kazhdan2013)."""
    low, h, shape = _box(points)
    x = (points - low) / h
    share, width = _areas(points)
    push = np.zeros((3, *shape))
    classes = np.quantile(width, [0.0, 0.25, 0.5, 0.75, 1.0])
    for k in range(4):  # normals are spread as wide as the points stand apart
        rows = (width >= classes[k]) & ((width < classes[k + 1]) | (k == 3))
        if rows.any():
            weights = _trilinear(x[rows], shape)
            for axis in range(3):
                spread = (weights.T @ (share[rows] * normals[rows, axis])).reshape(shape) / h**3
                push[axis] += ndimage.gaussian_filter(spread, max(0.7, 0.5 * np.median(width[rows]) / h))
    right = -sum(np.gradient(push[axis], axis=axis) for axis in range(3)).ravel() * h
    at = _trilinear(x, shape)
    weight = SCREENING * share / share.mean() * np.sqrt(share.mean()) / h
    wave = sum(
        (2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n)).reshape([-1 if a == b else 1 for b in range(3)])
        for a, n in enumerate(shape)
    )
    floor = float(weight.sum() / np.prod(shape))

    def apply(v: FloatArray) -> FloatArray:
        grid = v.reshape(shape)
        out = np.zeros(shape)
        for axis in range(3):
            step = np.diff(grid, axis=axis)
            first = [slice(None)] * 3
            last = [slice(None)] * 3
            first[axis], last[axis] = slice(None, -1), slice(1, None)
            out[tuple(first)] -= step
            out[tuple(last)] += step
        return out.ravel() + at.T @ (weight * (at @ v))

    def solve(v: FloatArray) -> FloatArray:
        return fft.idctn(fft.dctn(v.reshape(shape), type=2) / (wave + floor), type=2).ravel()

    size = int(np.prod(shape))
    operator = linalg.LinearOperator((size, size), matvec=apply, dtype=np.float64)
    before = linalg.LinearOperator((size, size), matvec=solve, dtype=np.float64)
    found, _ = linalg.cg(operator, right, rtol=1e-4, maxiter=60, M=before)
    level = float(np.average(at @ found, weights=share))
    return triangles(Grid(origin=low, spacing=h, values=found.reshape(shape) - level))


def winding(points: FloatArray, normals: FloatArray) -> Triangles | None:
    """Zero of 1/2 - w, w the winding number of a cloud of area elements (Barill2018); None where too slow."""
    low, h, shape = _box(points)
    share, _ = _areas(points)
    dipoles = normals * share[:, None] / (4.0 * np.pi)
    if len(points) * float(np.prod(shape)) * 0.25 > WINDING_PAIRS:
        return None

    def field(nodes: FloatArray) -> FloatArray:
        out = np.zeros(len(nodes))
        for first in range(0, len(nodes), 500):
            d = points - nodes[first : first + 500, None, :]
            r = np.sqrt(np.einsum("mnj,mnj->mn", d, d))
            flux = np.einsum("mnj,nj->mn", d, dipoles) / np.maximum(r, 0.5 * h) ** 3
            out[first : first + 500] = flux.sum(axis=1)
        return 0.5 - out

    nodes = low + h * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    return triangles(Grid(origin=low, spacing=h, values=field(nodes).reshape(shape)))


def apss(points: FloatArray, normals: FloatArray) -> Triangles:
    """Algebraic spheres fitted to the nearest points and normals, in closed form (Guennebaud2007)."""
    low, h, shape = _box(points)
    tree = KDTree(points)
    count = min(AROUND, len(points))

    def field(nodes: FloatArray) -> FloatArray:
        out = np.zeros(len(nodes))
        for first in range(0, len(nodes), 20_000):
            x = nodes[first : first + 20_000]
            apart, who = tree.query(x, k=count)
            w = np.maximum(1.0 - (apart / (1.01 * apart[:, -1:])) ** 2, 0.0) ** 4
            w /= w.sum(axis=1, keepdims=True)
            p, n = points[who] - x[:, None, :], normals[who]
            mean_p, mean_n = np.einsum("mk,mkj->mj", w, p), np.einsum("mk,mkj->mj", w, n)
            pn = np.einsum("mk,mkj,mkj->m", w, p, n) - np.sum(mean_p * mean_n, axis=1)
            pp = np.einsum("mk,mkj,mkj->m", w, p, p) - np.sum(mean_p**2, axis=1)
            u4 = 0.5 * pn / np.maximum(pp, 1e-18)
            u = mean_n - 2.0 * u4[:, None] * mean_p
            u0 = -np.sum(u * mean_p, axis=1) - u4 * np.einsum("mk,mkj,mkj->m", w, p, p)
            norm = np.sqrt(np.maximum(np.sum(u * u, axis=1) - 4.0 * u0 * u4, 1e-12))
            out[first : first + 20_000] = 2.0 * u0 / (np.maximum(norm, 0.3) + 1.0)
        return out

    return triangles(sample(field, low, low + h * (np.array(shape) - 1), h))


def thinned(points: FloatArray, normals: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """``count`` of the points, evenly spread."""
    rows = farthest_first(points, count)
    return points[rows], normals[rows]


def _box(points: FloatArray) -> tuple[FloatArray, float, tuple[int, ...]]:
    """Origin, spacing and nodes of a grid around the points."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.max(high - low))
    h = size / CELLS
    shape = tuple(int(n) for n in np.ceil((high - low + 2.0 * PAD * size) / h).astype(int) + 1)
    return low - PAD * size, h, shape


def _areas(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Area (n,) that each point stands for, and how far apart points stand there (n,)."""
    k = min(12, len(points) - 1)
    apart, _ = KDTree(points).query(points, k=k + 1)
    return np.pi * apart[:, -1] ** 2 / k, apart[:, -1] * np.sqrt(np.pi / k)


def _trilinear(x: FloatArray, shape: tuple[int, ...]) -> sparse.csr_array:
    """Interpolation (n, nodes) at ``x`` (n, 3) in cells."""
    base = np.clip(np.floor(x).astype(np.int64), 0, np.array(shape) - 2)
    part = x - base
    rows, columns, values = [], [], []
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, part, 1.0 - part), axis=1)
        node = base + np.array(corner)
        rows.append(np.arange(len(x)))
        columns.append(np.ravel_multi_index(tuple(node.T), shape))
        values.append(weight)
    made = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(made, shape=(len(x), int(np.prod(shape))))
