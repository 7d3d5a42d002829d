"""The curves that creases stand for: on a mesh a round rim is a polygon, whose normals jump from side to side.

A crease's tangent at a vertex is square to the normals of both surfaces that meet there; at the rim of an open
sheet, which has one surface only, it is that of the circle through the vertex and its neighbours. Between two
vertices the curve is the cubic with these tangents: on a circle its direction is linear along the side, and it
stands off the side by the circle's own sag. Where the tangents differ from the sides too much, or three creases
meet, there is a corner, and each side ends there on its own.

Over such a curve a beam is moved as over the smooth surface between creases (:mod:`contour.tangency`): the place
and the way at which its axis lies at the beam's radius from the curve are two equations in the plane square to
the beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.curvature import SmoothSurface
from contour.tangency import GRAZING, Beams
from contour.topology import Topology
from contour.vectors import cross, dot, unit

__all__ = ["CreaseTouch", "Creases"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

CURVE_TURN = np.deg2rad(50.0)
"""A chain of sharp edges that turns more than this at a vertex has a corner there [rad]."""
FOLDED = 0.25
"""Below this sine of the angle between the two surfaces' normals their cross product does not tell the tangent."""
ALIKE = 1e-3
"""Tangents that two sides have at their common vertex are one if they differ by less [rad]."""
STEPS = 3
"""Newton steps to the touched place of a curve."""
BEYOND = 0.5
"""A round beam at a vertex may touch the curve this share of a side beyond it."""
NEAR_END = 1e-6
"""Share of a side that is its end."""
ASKEW = 0.02
"""Sine of the angle between beam and crease below which the crease does not tell the normal."""

_ALONG = np.array([[1.0], [-1.0]])  # directions away from a side's two ends, and along the side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CreaseTouch:
    """Where k beams touch the curves."""

    back: FloatArray
    """How much sooner along the motion the curve is met than the mesh (k,) [m]."""
    normal: FloatArray
    """Unit, square to beam and curve, facing the beam (k, 3)."""
    tangent: FloatArray
    """Unit, of the curve there, along the mesh edge (k, 3)."""
    curve: FloatArray
    """Curvature vector of the curve (k, 3) [1/m]."""


class Creases:
    """The sharp edges of a mesh as curves."""

    def __init__(self, topology: Topology, surface: SmoothSurface) -> None:
        edges = np.nonzero(topology.sharp)[0]
        self._row = np.full(len(topology.sharp), -1, dtype=np.int64)
        self._row[edges] = np.arange(len(edges))
        vertex = topology.edge_vertices[edges]
        self._start = topology.vertices[vertex[:, 0]]
        side = topology.vertices[vertex[:, 1]] - self._start
        self._length = np.linalg.norm(side, axis=1)
        self._side = side / self._length[:, None]
        self._paired = topology.edge_faces[edges, 1] >= 0
        self._normals = _both_sides(topology, surface, edges)
        joints = _Joints(vertex, self._side, self._length)
        tangent, told = self._square_to_both()
        tangent = np.where(told[..., None], tangent, joints.circle)
        along = np.einsum("kej,kj->ke", tangent, self._side)
        bent = along < np.cos(0.5 * CURVE_TURN)
        # Directions as slopes against the side, so that they can be mixed.
        self._slope = tangent / np.where(bent, 1.0, along)[..., None] - self._side[:, None]
        self._slope[bent] = 0.0
        self.joined: BoolArray = joints.smooth(_units(self._slope + self._side[:, None]))
        """Whether the curve goes on without a corner beyond the start and the end of each side (k, 2)."""

    def _square_to_both(self) -> tuple[FloatArray, BoolArray]:
        """Tangents from the surfaces on both sides (k, 2, 3), and whether these tell them (k, 2)."""
        tangent = cross(self._normals[:, 0], self._normals[:, 1])
        size = np.linalg.norm(tangent, axis=2)
        told = self._paired[:, None] & (size > FOLDED)
        tangent = tangent / np.where(told, size, 1.0)[..., None]
        back = np.einsum("kej,kj->ke", tangent, self._side) < 0.0
        return np.where(back[..., None], -tangent, tangent), told

    def at(self, edge: IntArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit tangent (k, 3) and curvature vector (k, 3) [1/m] by points (k, 3) on sharp edges (k,)."""
        row = self._row[edge]
        share = np.clip(dot(point - self._start[row], self._side[row]) / self._length[row], 0.0, 1.0)
        tangent = unit(self._direction(row, share))
        return tangent, self._curve(row, tangent)

    def touched(self, edge: IntArray, point: FloatArray, facing: FloatArray, beams: Beams) -> CreaseTouch:
        """The places of the curves that k beams touch, which touch the mesh at points (k, 3) on sharp edges (k,).

        ``facing`` is the normal of beam and mesh there (k, 3). It stays, and nothing is met sooner, where the
        beam lies along the crease or rolls about a corner.
        """
        row, length, along = self._row[edge], self._length[self._row[edge]], beams.along
        first = np.clip(dot(point - self._start[row], self._side[row]) / length, 0.0, 1.0)
        share, back = first.copy(), np.zeros(len(row))
        normal, told = facing, np.ones(len(row), dtype=np.bool_)
        for _ in range(STEPS):
            tangent = self._direction(row, share)
            flat = tangent - dot(tangent, along)[:, None] * along
            sine = np.linalg.norm(flat, axis=1)
            told &= sine > ASKEW
            sine = np.where(told, sine, 1.0)
            flat = flat / sine[:, None]
            normal = cross(along, flat)
            normal = np.where((dot(normal, facing) < 0.0)[:, None], -normal, normal)
            gap = beams.axis - back[:, None] * beams.motion - self._place(row, share)
            closing = np.minimum(dot(beams.motion, normal), -GRAZING)
            later = (dot(gap, normal) - beams.radius) / closing
            # The normal turns along the side; the axis moves on the curve offset by the radius.
            speed = length * sine - beams.radius * dot(normal, self._bend(row, share)) / sine
            aside = dot(gap, flat) - later * dot(beams.motion, flat)
            share = share + np.where(told, aside / np.maximum(speed, 0.5 * length * sine), 0.0)
            share = np.clip(share, -BEYOND, 1.0 + BEYOND)
            back = back + np.where(told, later, 0.0)
        over = np.where(self.joined[row], BEYOND, NEAR_END)
        told &= (share > -over[:, 0]) & (share < 1.0 + over[:, 1])
        told &= (np.abs(back) < 0.5 * length) & (dot(normal, facing) > np.cos(CURVE_TURN))
        normal = self._kept_outside(row, np.clip(share, 0.0, 1.0), normal, along)
        tangent = unit(self._direction(row, np.where(told, share, first)))
        return CreaseTouch(
            back=np.where(told, back, 0.0),
            normal=np.where(told[:, None], normal, facing),
            tangent=tangent,
            curve=self._curve(row, tangent),
        )

    def _kept_outside(
        self, row: IntArray, share: FloatArray, normal: FloatArray, along: FloatArray
    ) -> FloatArray:
        """Normals no further round than either surface faces: a beam there touches that surface itself."""
        mix = np.stack([1.0 - share, share], axis=1)
        sides = np.einsum("kfej,ke->kfj", self._normals[row], mix)
        outward = np.einsum("kfj,kj->k", sides, normal)
        sides = np.where((outward < 0.0)[:, None, None], -sides, sides)
        lean = np.einsum("kfj,kj->kf", sides, along)
        nearer = np.argmin(np.abs(lean), axis=1)
        own = sides[np.arange(len(row)), nearer]
        own = own - dot(own, along)[:, None] * along
        size = np.linalg.norm(own, axis=1)
        past = (lean[:, 0] * lean[:, 1] > 0.0) & self._paired[row] & (size > FOLDED)
        return np.where(past[:, None], own / np.where(past, size, 1.0)[:, None], normal)

    def _place(self, row: IntArray, share: FloatArray) -> FloatArray:
        """Points of the curves (k, 3) at shares (k,) of their sides."""
        u, slope = share[:, None], self._slope[row]
        off = u * (1.0 - u) * ((1.0 - u) * slope[:, 0] - u * slope[:, 1])
        return np.asarray(self._start[row] + self._length[row, None] * (u * self._side[row] + off))

    def _direction(self, row: IntArray, share: FloatArray) -> FloatArray:
        """Their derivative by the length along the side (k, 3)."""
        u, slope = share[:, None], self._slope[row]
        lean = (1.0 - u) * (1.0 - 3.0 * u) * slope[:, 0] - u * (2.0 - 3.0 * u) * slope[:, 1]
        return np.asarray(self._side[row] + lean)

    def _bend(self, row: IntArray, share: FloatArray) -> FloatArray:
        """The derivative of that by the share (k, 3)."""
        u, slope = share[:, None], self._slope[row]
        return np.asarray((6.0 * u - 4.0) * slope[:, 0] + (6.0 * u - 2.0) * slope[:, 1])

    def _curve(self, row: IntArray, tangent: FloatArray) -> FloatArray:
        """Curvature vector (k, 3) [1/m], of the size that is the mean over the side, square to the tangent."""
        slope = self._slope[row]
        # From end to end the direction turns by slope 1 - slope 0, over an arc a little longer than the side.
        longer = 1.0 + 0.25 * np.sum(slope * slope, axis=(1, 2))
        mean = (slope[:, 1] - slope[:, 0]) / (self._length[row] * longer)[:, None]
        square = mean - dot(mean, tangent)[:, None] * tangent
        # The direction turns along the side, by too little to lose its length.
        size, left = np.linalg.norm(mean, axis=1), np.linalg.norm(square, axis=1)
        return np.asarray(square * (size / np.where(left > 0.0, left, 1.0))[:, None])


class _Joints:
    """Vertices at which exactly two sharp edges meet; there the curve may go on."""

    def __init__(self, vertex: IntArray, side: FloatArray, length: FloatArray) -> None:
        k = len(vertex)
        at = vertex.reshape(-1)
        order = np.argsort(at, kind="stable")
        _, count = np.unique(at, return_counts=True)
        head = (np.cumsum(count) - count)[count == 2]
        # Ends of sides are numbered 2 * side + (0 at its start, 1 at its end).
        self._one, self._two = order[head], order[head + 1]
        away = np.stack([side, -side], axis=1).reshape(-1, 3)
        one, two = away[self._one], away[self._two]
        near = 1.0 / np.repeat(length, 2)
        # The circle through three points leaves the middle one along the chords' mean by 1 / length.
        mean = two * near[self._two, None] - one * near[self._one, None]
        size = np.linalg.norm(mean, axis=1)
        gentle = (dot(one, two) < -np.cos(CURVE_TURN)) & (size > 0.0)
        mean = mean / np.where(size > 0.0, size, 1.0)[:, None]
        tangent = away.copy()
        tangent[self._one[gentle]] = -mean[gentle]
        tangent[self._two[gentle]] = mean[gentle]
        self.circle: FloatArray = tangent.reshape(k, 2, 3) * _ALONG
        """Tangents along the sides at both ends (k, 2, 3): of the circles through three vertices, else the side."""

    def smooth(self, tangent: FloatArray) -> BoolArray:
        """Whether the tangents (k, 2, 3) at both ends of the sides are those of the neighbours too (k, 2)."""
        away = (tangent * _ALONG).reshape(-1, 3)
        same = np.linalg.norm(away[self._one] + away[self._two], axis=1) < ALIKE
        joined = np.zeros(len(away), dtype=np.bool_)
        joined[self._one[same]] = joined[self._two[same]] = True
        return joined.reshape(-1, 2)


def _both_sides(topology: Topology, surface: SmoothSurface, edges: IntArray) -> FloatArray:
    """Normals of the surfaces on both sides of sharp edges (k,), at their two ends: (k, 2 faces, 2 ends, 3).

    Where there is no second face, the first one's stand twice.
    """
    vertex, faces = topology.edge_vertices[edges], topology.edge_faces[edges]
    faces = np.where(faces >= 0, faces, faces[:, :1])
    local = np.argmax(topology.corners[faces][:, :, None, :] == vertex[:, None, :, None], axis=3)
    return surface.normals[np.take_along_axis(topology.patch_corners[faces], local, axis=2)]


def _units(vectors: FloatArray) -> FloatArray:
    """Vectors (k, 2, 3) of length one; none is zero."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=2, keepdims=True))
