"""Normals and curvature of the smooth surface that a mesh samples.

The shape operator is fitted on each face to the change of the vertex normals (:mod:`contour.vertex_normals`)
and averaged to the vertices (Rusinkiewicz2004). Vertices on creases are split, one copy for each smooth patch,
so that a flat side is flat up to its edge. Curvature is positive where the surface bends away from the side
its normal points to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contour.topology import Topology
from contour.vertex_normals import vertex_normals

__all__ = ["SmoothSurface"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the six entries of a symmetric tensor


class SmoothSurface:
    """Normal n and shape operator S of the smooth surface, interpolated over the faces: dn = S dx.

    Args:
        topology: the mesh.
        smoothing: rounds of averaging S over the neighbours of each vertex, for scanned, noisy meshes.
    """

    def __init__(self, topology: Topology, *, smoothing: int = 0) -> None:
        self._corners = topology.patch_corners
        points = topology.vertices[topology.corners]
        self.normals: FloatArray = vertex_normals(topology)
        """Unit normals of the split vertices (p, 3)."""
        weights = _corner_areas(points, topology.areas)
        tensors = _corner_tensors(points, topology.normals, self.normals[self._corners])
        self.tensors: FloatArray = _average(tensors, weights, self._corners, topology.patch_count)
        """S of the split vertices (p, 6) [1/m]: xx, yy, zz, xy, xz, yz."""
        flat = weights.reshape(-1)
        mass = np.asarray(
            np.bincount(self._corners.reshape(-1), flat, topology.patch_count), dtype=np.float64
        )
        for _ in range(smoothing):
            self.tensors = _smoothed(self.tensors, mass, self._corners)

    def normal(self, face: IntArray, barycentric: FloatArray) -> FloatArray:
        """Unit normals (k, 3) at barycentric coordinates (k, 3) of faces (k,)."""
        mixed = np.einsum("kc,kcj->kj", barycentric, self.corner_normals(face))
        return np.asarray(mixed / np.linalg.norm(mixed, axis=1)[:, None])

    def corner_normals(self, face: IntArray) -> FloatArray:
        """Unit normals at the corners of faces (k,), on the face's own patches (k, 3, 3)."""
        return self.normals.take(self._corners.take(face, axis=0), axis=0)

    def shape_operator(self, face: IntArray, barycentric: FloatArray) -> FloatArray:
        """S (k, 3, 3) [1/m] there; it maps tangent steps to changes of the normal."""
        mixed = np.einsum("kc,kcs->ks", barycentric, self.tensors[self._corners[face]])
        return np.asarray(mixed[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3))


def _corner_areas(points: FloatArray, areas: FloatArray) -> FloatArray:
    """The part of each face (f, 3) nearest to its corners, cut as usual where an angle is obtuse [m^2]."""
    sides = points[:, [2, 0, 1]] - points[:, [1, 2, 0]]  # side i is opposite corner i
    squares = np.einsum("fij,fij->fi", sides, sides)
    following, previous = np.roll(squares, -1, axis=1), np.roll(squares, 1, axis=1)
    cosine = following + previous - squares  # 2 |a| |b| cos(angle at the corner)
    double = 2.0 * areas[:, None]
    # Voronoi: (|b|^2 cot B + |c|^2 cot C) / 8, with cot = cosine / (4 area).
    voronoi = (following * np.roll(cosine, -1, axis=1) + previous * np.roll(cosine, 1, axis=1)) / np.where(
        double > 0.0, 16.0 * double, 1.0
    )
    obtuse = cosine < 0.0
    mixed = np.where(obtuse, 0.5, 0.25) * areas[:, None]
    return np.where(obtuse.any(axis=1)[:, None], mixed, voronoi)


def _corner_tensors(points: FloatArray, face_normal: FloatArray, normals: FloatArray) -> FloatArray:
    """S of each face, turned into the tangent planes of its three corners: (f, 3, 6) [1/m]."""
    sides = points[:, [2, 0, 1]] - points[:, [1, 2, 0]]
    change = normals[:, [2, 0, 1]] - normals[:, [1, 2, 0]]
    length = np.linalg.norm(sides[:, 0], axis=1)[:, None]
    u = sides[:, 0] / np.where(length > 0.0, length, 1.0)
    v = np.cross(face_normal, u)
    e = np.stack([np.einsum("fij,fj->fi", sides, u), np.einsum("fij,fj->fi", sides, v)], axis=-1)
    d = np.stack([np.einsum("fij,fj->fi", change, u), np.einsum("fij,fj->fi", change, v)], axis=-1)
    # Least squares of S e = d over the three sides, S = [[a, b], [b, c]].
    m = np.einsum("fip,fiq->fpq", e, e)
    r = np.einsum("fip,fiq->fpq", d, e)
    trace = m[:, 0, 0] + m[:, 1, 1]
    # The symmetric solution of S m + m S = r + r^T, in closed form for two by two.
    determinant = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] ** 2
    q = r + r.transpose(0, 2, 1)
    adjugate = np.stack(
        [np.stack([m[:, 1, 1], -m[:, 0, 1]], axis=-1), np.stack([-m[:, 0, 1], m[:, 0, 0]], axis=-1)], axis=1
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        s = (q + adjugate @ q @ adjugate / determinant[:, None, None]) / (2.0 * trace[:, None, None])
    s = np.where(np.isfinite(s), s, 0.0)
    total = 1.0 + np.einsum("fj,fcj->fc", face_normal, normals)
    total = np.maximum(total, 1e-6)[..., None]  # a corner normal against its face: nothing to turn
    both = face_normal[:, None] + normals
    u = u[:, None] - np.einsum("fcj,fj->fc", normals, u)[..., None] / total * both
    v = v[:, None] - np.einsum("fcj,fj->fc", normals, v)[..., None] / total * both
    a, b, c = s[:, 0, 0, None], s[:, 0, 1, None], s[:, 1, 1, None]
    return np.stack(
        [
            a * u[..., i] * u[..., j]
            + b * (u[..., i] * v[..., j] + v[..., i] * u[..., j])
            + c * v[..., i] * v[..., j]
            for i, j in _PAIRS
        ],
        axis=-1,
    )


def _average(tensors: FloatArray, weights: FloatArray, corners: IntArray, count: int) -> FloatArray:
    at = corners.reshape(-1)
    mass = np.bincount(at, weights.reshape(-1), count)
    mass = np.where(mass > 0.0, mass, 1.0)
    weighted = (tensors * weights[..., None]).reshape(-1, 6)
    return np.stack([np.bincount(at, weighted[:, i], count) / mass for i in range(6)], axis=1)


def _smoothed(tensors: FloatArray, mass: FloatArray, corners: IntArray) -> FloatArray:
    """Each vertex takes the mean of itself and of its faces' corners, weighed by area."""
    weighted = tensors * mass[:, None]
    per_face = weighted[corners].sum(axis=1)
    face_mass = mass[corners].sum(axis=1)
    at = corners.reshape(-1)
    count = len(tensors)
    total = np.bincount(at, np.repeat(face_mass, 3), count)
    total = np.where(total > 0.0, total, 1.0)
    return np.stack([np.bincount(at, np.repeat(per_face[:, i], 3), count) / total for i in range(6)], axis=1)
