"""A bounding-volume tree over triangles, built and descended with whole arrays.

The tree is perfectly balanced: faces are put in order by splitting at the median along the longest side,
level by level, so that the children of node i are 4 i .. 4 i + 3 and every leaf holds the same number of
faces. A region to search is an intersection of slabs lo <= g . p <= hi and, if wanted, a ball; one descent
serves all regions at once. The answer is a superset: every face that meets a region is among its candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bvh", "Regions"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAF_FACES = 8
"""Largest number of faces in a leaf: smaller leaves cost descents, larger ones cost exact tests."""
ROOT_NODES = 64
"""Levels with at most this many nodes are skipped: testing all of them at once is cheaper than descending."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regions:
    """n convex regions in which to look for faces: lo <= g . p <= hi for each slab, within reach of the
    centre.
    """

    slabs: FloatArray
    """g, shape (n, k, 3), k >= 2; the slab that excludes most boxes comes first."""
    low: FloatArray
    """(n, k)."""
    high: FloatArray
    """(n, k)."""
    centre: FloatArray | None = None
    """Centre of the ball (n, 3) [m], or None where there is no ball."""
    reach: FloatArray | None = None
    """Radius of the ball (n,) [m]."""

    def rows(self, start: int, stop: int) -> Regions:
        """The regions start..stop."""
        return Regions(
            slabs=self.slabs[start:stop],
            low=self.low[start:stop],
            high=self.high[start:stop],
            centre=None if self.centre is None else self.centre[start:stop],
            reach=None if self.reach is None else self.reach[start:stop],
        )


def _order(triangles: FloatArray, leaves: int, per_leaf: int) -> IntArray:
    """Faces in leaf order; some stand twice so that every leaf is full."""
    slots = leaves * per_leaf
    # Repeats are spread evenly, so that no leaf consists of repeats alone.
    order = (np.arange(slots, dtype=np.int64) * len(triangles)) // slots
    middles = 0.5 * (triangles.min(axis=1) + triangles.max(axis=1))
    nodes = 1
    while nodes < leaves:
        grouped = middles[order].reshape(nodes, -1, 3)
        axis = np.argmax(np.ptp(grouped, axis=1), axis=1)
        keys = np.take_along_axis(grouped, axis[:, None, None], axis=2)[..., 0]
        half = keys.shape[1] // 2
        rank = np.argpartition(keys, half, axis=1)
        order = np.take_along_axis(order.reshape(nodes, -1), rank, axis=1).reshape(-1)
        nodes *= 2
    return order


def _fours(boxes: FloatArray) -> FloatArray:
    return np.ascontiguousarray(boxes.reshape(-1, 4, 3).transpose(0, 2, 1))


class Bvh:
    """The tree over triangles (f, 3, 3) [m]."""

    def __init__(self, triangles: FloatArray) -> None:
        leaves = 1
        while -(-len(triangles) // leaves) > LEAF_FACES:
            leaves *= 2
        per_leaf = -(-len(triangles) // leaves)
        order = _order(triangles, leaves, per_leaf)
        self.leaf_faces: IntArray = order.reshape(leaves, per_leaf)
        """Faces of each leaf (leaves, m)."""
        vertices = triangles[order].reshape(leaves, 3 * per_leaf, 3)
        self.leaf_vertices: FloatArray = np.ascontiguousarray(vertices.transpose(0, 2, 1))
        """Their vertices (leaves, 3 coordinates, 3 m) [m], three in a row to a face."""
        low, high = vertices.min(axis=1), vertices.max(axis=1)
        self._centres = [0.5 * (low + high)]  # root first, (nodes, 3)
        self._halves = [0.5 * (high - low)]
        while len(low) > ROOT_NODES:
            low = low.reshape(-1, 4, 3).min(axis=1)
            high = high.reshape(-1, 4, 3).max(axis=1)
            self._centres.insert(0, 0.5 * (low + high))
            self._halves.insert(0, 0.5 * (high - low))
        # Coordinates before children: sums then run over contiguous quadruples.
        self._centre_fours = [_fours(level) for level in self._centres[1:]]
        self._half_fours = [_fours(level) for level in self._halves[1:]]

    def leaves_in(self, regions: Regions) -> tuple[IntArray, IntArray]:
        """Pairs (region, leaf), sorted by region, that may hold a face inside the region."""
        region, node = self._meet_roots(regions)
        for level in range(1, len(self._centres)):
            region, node = self._meet_children(regions, region, node, level)
        return region, node

    def _meet_roots(self, regions: Regions) -> tuple[IntArray, IntArray]:
        centre, half = self._centres[0], self._halves[0]
        g = regions.slabs
        n, k = regions.low.shape
        middle = (g.reshape(-1, 3) @ centre.T).reshape(n, k, -1)
        spread = (np.abs(g).reshape(-1, 3) @ half.T).reshape(n, k, -1)
        meets = (middle - spread <= regions.high[..., None]) & (middle + spread >= regions.low[..., None])
        region, node = np.nonzero(meets.all(axis=1))
        if regions.centre is None or regions.reach is None:
            return region, node
        return _in_ball(regions, region, node, centre, half)

    def _meet_children(
        self, regions: Regions, region: IntArray, parent: IntArray, level: int
    ) -> tuple[IntArray, IntArray]:
        centre, half = self._centres[level], self._halves[level]
        g = regions.slabs[:, 0].take(region, axis=0)
        middle = np.einsum("kjc,kj->kc", self._centre_fours[level - 1].take(parent, axis=0), g)
        spread = np.einsum("kjc,kj->kc", self._half_fours[level - 1].take(parent, axis=0), np.abs(g))
        low = regions.low[:, 0].take(region)[:, None]
        high = regions.high[:, 0].take(region)[:, None]
        row, child = np.nonzero((middle - spread <= high) & (middle + spread >= low))
        region, node = region.take(row), 4 * parent.take(row) + child
        g = regions.slabs[:, 1:].take(region, axis=0)
        middle = np.einsum("ksj,kj->sk", g, centre.take(node, axis=0))
        spread = np.einsum("ksj,kj->sk", np.abs(g), half.take(node, axis=0))
        meets = middle - spread <= regions.high.T[1:].take(region, axis=1)
        meets &= middle + spread >= regions.low.T[1:].take(region, axis=1)
        keep = np.nonzero(np.logical_and.reduce(meets, axis=0))[0]
        region, node = region.take(keep), node.take(keep)
        if regions.centre is None or regions.reach is None:
            return region, node
        return _in_ball(regions, region, node, centre, half)


def _in_ball(
    regions: Regions, region: IntArray, node: IntArray, centre: FloatArray, half: FloatArray
) -> tuple[IntArray, IntArray]:
    assert regions.centre is not None
    assert regions.reach is not None
    gap = np.abs(centre.take(node, axis=0) - regions.centre.take(region, axis=0)) - half.take(node, axis=0)
    np.maximum(gap, 0.0, out=gap)
    keep = np.einsum("kj,kj->k", gap, gap) <= regions.reach.take(region) ** 2
    return region[keep], node[keep]
