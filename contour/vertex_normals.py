"""Normals of the smooth surface at a mesh's vertices, split along creases.

Faces are weighed as Max1999 does, which is exact on spheres. Where a wide flat meets the narrow facets of a
fillet the narrow ones would tilt the flat; there faces count by their area instead. Weights cannot tell that
the curvature jumps there, but chords can: the chord e of a circular arc, or of a parabola, leans alike against
the normals at its ends, e . (n_i + n_j) = 0. Normals that break this are turned until it holds, if that leaves
nothing broken around them; on noisy meshes it does not, and nothing is turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contour.topology import Topology
from contour.vectors import dot, unit

__all__ = ["vertex_normals"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EVEN = 6.0
"""Up to this ratio the areas of the faces about a vertex are alike; beyond its square they are not at all."""
PASSES, FINISH = 6, 12
"""Times that the worst normals are turned (each leaves the second worst beside them to the next), and that all
turned ones are settled among each other."""
WORST = 0.8
"""Normals are turned together if none beside them gains more than this share of the gain less."""
SMALL_TURN = np.deg2rad(0.05)
"""Turns below this are left alone: Max1999 is better than chords of a third-degree surface [rad]."""
MENDED = 0.1
"""A normal stays turned if what is broken around it falls to this share; noise leaves about half."""


def vertex_normals(topology: Topology) -> FloatArray:
    """Unit normals of the split vertices (p, 3)."""
    normals = _blended(topology)
    chords = _Chords(topology)
    turned = chords.turned(normals)
    mended = chords.around(chords.broken(turned)) <= MENDED * chords.around(chords.broken(normals))
    return np.where(mended[:, None], turned, normals)


class _Chords:
    """The smooth edges and the rims of all patches, from both ends: from split vertex i to j (k,)."""

    def __init__(self, topology: Topology) -> None:
        corners, count = topology.patch_corners, topology.patch_count
        first = topology.edge_faces[topology.face_edges, 0] == np.arange(len(corners))[:, None]
        # A smooth edge is listed by two faces alike, one on a crease by each with its own vertices.
        rows = np.nonzero((first | topology.sharp[topology.face_edges]).reshape(-1))[0]
        start = topology.vertices[topology.corners].reshape(-1, 3)[rows]
        stop = topology.vertices[np.roll(topology.corners, -1, axis=1)].reshape(-1, 3)[rows]
        ends = corners.reshape(-1)[rows], np.roll(corners, -1, axis=1).reshape(-1)[rows]
        self._i, self._j = np.concatenate(ends), np.concatenate(ends[::-1])
        length = np.linalg.norm(stop - start, axis=1)
        self._along = np.tile((stop - start) / length[:, None], (2, 1))
        # Short chords count more: they tell most about their ends.
        self._weight = np.tile(1.0 / length, 2)
        self._count = count

    def turned(self, normals: FloatArray) -> FloatArray:
        """The normals (p, 3) after turning those that break their chords most."""
        normals = normals.copy()
        inverse, size = self._inverse(normals)
        moved = np.zeros(self._count, dtype=np.bool_)
        for _ in range(PASSES):
            gap = self._weight * dot(self._along, normals[self._i] + normals[self._j])
            pull = np.stack([-self._sum(gap * self._along[:, axis]) for axis in range(3)], axis=1)
            pull -= dot(pull, normals)[:, None] * normals
            turn = np.einsum("pij,pj->pi", inverse, pull)
            gain = dot(pull, turn) / size
            beside = np.zeros(self._count)
            np.maximum.at(beside, self._i, gain[self._j])
            rows = (gain >= WORST * beside) & (dot(turn, turn) > SMALL_TURN**2)
            if not rows.any():
                break
            moved |= rows
            normals[rows] = unit(normals[rows] + turn[rows])
        return self._settled(normals, inverse, np.nonzero(moved)[0]) if moved.any() else normals

    def _settled(self, normals: FloatArray, inverse: FloatArray, rows: IntArray) -> FloatArray:
        """The normals after the given ones have come to terms: they were turned with stale ones beside them."""
        place = np.full(self._count, -1, dtype=np.int64)
        place[rows] = np.arange(len(rows))
        mine = np.nonzero(place[self._i] >= 0)[0]
        owner, i, j = place[self._i[mine]], self._i[mine], self._j[mine]
        along = self._along[mine]
        pull = self._weight[mine, None] * along
        for _ in range(FINISH):
            lean = pull * dot(along, normals[i] + normals[j])[:, None]
            total = np.zeros((len(rows), 3))
            for axis in range(3):
                total[:, axis] = np.bincount(owner, lean[:, axis], len(rows))
            total -= dot(total, normals[rows])[:, None] * normals[rows]
            normals[rows] = unit(normals[rows] - np.einsum("pij,pj->pi", inverse[rows], total))
        return normals

    def broken(self, normals: FloatArray) -> FloatArray:
        """Sum of squares by which the chords of each vertex lean (p,)."""
        gap = dot(self._along, normals[self._i] + normals[self._j])
        return self._sum(self._weight * gap * gap)

    def around(self, values: FloatArray) -> FloatArray:
        """Values (p,) of each vertex and its neighbours together."""
        return values + self._sum(values[self._j])

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self._i, values, self._count), dtype=np.float64)

    def _inverse(self, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse of the sums of e e^T in the plane square to each normal (p, 3, 3), and their traces (p,)."""
        total = np.zeros((self._count, 3, 3))
        for i in range(3):
            for j in range(i, 3):
                part = self._sum(self._weight * self._along[:, i] * self._along[:, j])
                total[:, i, j] = total[:, j, i] = part
        size = np.trace(total, axis1=1, axis2=2)
        across = normals[:, :, None] * normals[:, None]
        plane = np.eye(3) - across
        # Along the normal nothing turns; a little of the identity keeps vertices with one chord solvable.
        total = plane @ total @ plane + size[:, None, None] * (across + 1e-3 * np.eye(3))
        return np.linalg.inv(total), size


def _blended(topology: Topology) -> FloatArray:
    """Max1999, blended into weights by area where a large face meets small ones."""
    corners, count = topology.patch_corners, topology.patch_count
    points = topology.vertices[topology.corners]
    weights = np.zeros(corners.shape)
    double = 2.0 * topology.areas
    for i in range(3):
        one, two = points[:, (i + 1) % 3] - points[:, i], points[:, (i + 2) % 3] - points[:, i]
        squares = np.einsum("ij,ij->i", one, one) * np.einsum("ij,ij->i", two, two)
        # sin(angle) over the product of the two sides.
        weights[:, i] = double / np.where(squares > 0.0, squares, 1.0)
    curved = _weighted(topology.normals, weights, corners, count)
    flat = _weighted(topology.normals, np.repeat(topology.areas[:, None], 3, axis=1), corners, count)
    least, most = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least, corners, topology.areas[:, None])
    np.maximum.at(most, corners, topology.areas[:, None])
    uneven = np.log(most / least) / np.log(EVEN)
    share = np.clip(uneven - 1.0, 0.0, 1.0)[:, None]
    mixed = (1.0 - share) * curved + share * flat
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1)[:, None])


def _weighted(normals: FloatArray, weights: FloatArray, corners: IntArray, count: int) -> FloatArray:
    """Unit mean of the faces' normals at each split vertex (p, 3)."""
    at = corners.reshape(-1)
    total = np.stack(
        [np.bincount(at, (weights * normals[:, axis, None]).reshape(-1), count) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1)
    # A vertex whose faces cancel each other (a sheet folded flat) keeps the normal of one of them.
    lost = length <= 0.0
    one_face = np.zeros(count, dtype=np.int64)
    one_face[corners] = np.arange(len(corners))[:, None]
    total[lost] = normals[one_face[lost]]
    return total / np.where(lost, 1.0, length)[:, None]
