"""Triangle meshes from grids of points, geodesic spheres and level sets; numpy alone, the same every time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from contour.shapes.base import TriangleMesh

__all__ = ["geodesic_sphere", "grid_patch", "oriented", "ring_strip", "surface_nets", "weld"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_WELD = 1e-9
"""Vertices that agree to this are one [m]."""


def grid_patch(grid: FloatArray) -> TriangleMesh:
    """Two triangles for each cell of a (rows, columns, 3) grid; normal along (down) x (across)."""
    rows, columns, _ = grid.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    lower = np.stack((a, b, c), axis=-1).reshape(-1, 3)
    upper = np.stack((a, c, d), axis=-1).reshape(-1, 3)
    return TriangleMesh(grid.reshape(-1, 3), np.concatenate((lower, upper)))


def ring_strip(inner: FloatArray, outer: FloatArray) -> TriangleMesh:
    """The flat strip (z = 0) between two loops (m, 2) and (n, 2) about the origin, of any two numbers of points.

    Both run counter-clockwise, their angles rising all the way, and start near each other.
    """
    m, n = len(inner), len(outer)
    step = np.arctan2(inner[0, 1], inner[0, 0])
    turned = []
    for loop in (inner, outer):
        angle = np.arctan2(loop[:, 1], loop[:, 0]) - step
        angle[0] -= 2.0 * np.pi * np.round(angle[0] / (2.0 * np.pi))
        angle = np.unwrap(np.append(angle, angle[0] + 2.0 * np.pi))
        turned.append(0.5 * (angle[:-1] + angle[1:]))
    # Each side is joined to the point of the other loop that is reached by then.
    i, j = np.arange(m), np.arange(n)
    to_outer = np.searchsorted(turned[1], turned[0], side="right") % n
    to_inner = np.searchsorted(turned[0], turned[1], side="left") % m
    faces = np.concatenate(
        (
            np.stack(((i + 1) % m, i, m + to_outer), axis=1),
            np.stack((m + j, m + (j + 1) % n, to_inner), axis=1),
        )
    )
    points = np.concatenate((inner, outer))
    return TriangleMesh(np.column_stack((points, np.zeros(m + n))), faces)


def weld(patches: Sequence[TriangleMesh]) -> TriangleMesh:
    """One mesh of the patches: equal vertices merged, triangles without area dropped."""
    offsets = np.cumsum([0] + [len(patch.vertices) for patch in patches])
    vertices = np.concatenate([patch.vertices for patch in patches])
    faces = np.concatenate(
        [patch.faces + offset for patch, offset in zip(patches, offsets[:-1], strict=True)]
    )
    _, first, label = np.unique(np.round(vertices / _WELD), axis=0, return_index=True, return_inverse=True)
    faces = label.reshape(-1)[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return TriangleMesh(vertices[first], faces[proper].astype(np.int64))


def oriented(mesh: TriangleMesh) -> TriangleMesh:
    """The same closed mesh with its faces turned outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    volume = np.sum(a * np.cross(b, c)) / 6.0
    return mesh if volume > 0.0 else TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])


def geodesic_sphere(frequency: int) -> TriangleMesh:
    """Unit sphere of 20 ``frequency``^2 nearly equal triangles: an icosahedron with its sides cut up."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    icosahedron = np.array([p[-k:] + p[:-k] for k in (0, 1, 2) for p in corners])
    triples = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if all(
            abs(np.linalg.norm(icosahedron[p] - icosahedron[q]) - 2.0) < 1e-6
            for p, q in ((i, j), (j, k), (k, i))
        )
    ]
    first, second = (
        m.reshape(-1) for m in np.meshgrid(range(frequency + 1), range(frequency + 1), indexing="ij")
    )
    kept = first + second <= frequency
    number = np.full((frequency + 2, frequency + 2), -1)
    number[first[kept], second[kept]] = np.arange(kept.sum())
    i, j = first[kept], second[kept]
    up = np.stack((number[i, j], number[i + 1, j], number[i, j + 1]), axis=1)[i + j < frequency]
    down = np.stack((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]), axis=1)[i + j < frequency - 1]
    faces = np.concatenate((up, down))
    patches = []
    for triple in triples:
        p, q, r = icosahedron[list(triple)]
        if np.dot(p, np.cross(q, r)) < 0.0:
            q, r = r, q
        flat = (i[:, None] * q + j[:, None] * r + (frequency - i - j)[:, None] * p) / frequency
        patches.append(TriangleMesh(flat / np.linalg.norm(flat, axis=1, keepdims=True), faces))
    return weld(patches)


def surface_nets(
    value: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray, cell: float
) -> TriangleMesh:
    """Zero level of ``value``, negative inside, in dual quads: a vertex in each crossed cell (surface nets).

    Args:
        value: maps points (n, 3) to (n,).
        low: (3,) m, corner of the grid; the surface must lie inside it.
        high: (3,) m, opposite corner.
        cell: m, side of a grid cell.
    """
    axes = [np.arange(low[k], high[k] + cell, cell) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    field = np.concatenate(
        [
            value(np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 3))
            for x in axes[0]
        ]
    ).reshape(shape)
    inside = field < 0.0
    total = np.zeros((*(n - 1 for n in shape), 3))
    count = np.zeros(tuple(n - 1 for n in shape))
    crossed_edges = []
    for axis in range(3):
        near = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        far = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        at = np.argwhere(inside[near] != inside[far])
        f0, f1 = field[near][tuple(at.T)], field[far][tuple(at.T)]
        crossing = at.astype(np.float64)
        crossing[:, axis] += f0 / (f0 - f1)
        others = [k for k in range(3) if k != axis]
        for da in (0, 1):
            for db in (0, 1):
                owner = at.copy()
                owner[:, others[0]] -= da
                owner[:, others[1]] -= db
                np.add.at(total, tuple(owner.T), crossing)
                np.add.at(count, tuple(owner.T), 1.0)
        crossed_edges.append((at, f0 < 0.0, others))
    used = count > 0
    number = np.full(count.shape, -1)
    number[used] = np.arange(used.sum())
    vertices = low + cell * total[used] / count[used][:, None]
    quads = []
    for at, leaving, (u, v) in crossed_edges:
        shifted = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            owner = at.copy()
            owner[:, u] -= du
            owner[:, v] -= dv
            shifted.append(number[tuple(owner.T)])
        quad = np.stack(shifted, axis=1)
        forward = leaving ^ ((u, v) == (0, 2))  # x and z are a left-handed pair about y
        quads.append(np.where(forward[:, None], quad, quad[:, ::-1]))
    quad = np.concatenate(quads)
    return TriangleMesh(vertices, np.concatenate((quad[:, [0, 1, 2]], quad[:, [0, 2, 3]])).astype(np.int64))
