"""Plane curves of straight lines and circular arcs: closest point, normal and curvature in closed form.

A path runs with its body on the left, so its outward normal is on the right of the direction of travel; loops
run counter-clockwise and holes clockwise. Curvature is positive where the body is convex. Profiles of
solids of revolution live in the half plane (r, z), outlines of extruded solids in (x, y); lengths in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Nearest", "Path"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_CHUNK = 2048
"""Points handled at once, so that the (points, segments) tables stay in the cache."""
_SHARP = np.deg2rad(1.0)
"""A joint whose normal turns by more than this is a sharp corner; fillets meet their lines smoothly."""
_AT_POINT = 1e-12
"""Nearer than this to a corner [m] the direction towards the corner is meaningless."""


class Nearest(NamedTuple):
    """What a path has nearest to each of n points."""

    point: FloatArray
    """(n, 2) m, on the path."""
    normal: FloatArray
    """(n, 2) outward unit normal; at a corner, the direction from it to the point if that is outside."""
    signed: FloatArray
    """(n,) m, distance, negative inside the body."""
    curvature: FloatArray
    """(n,) 1/m, positive convex."""
    corner: FloatArray
    """(n,) m, straight distance from the nearest point of the path to the nearest sharp corner, or inf."""


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Segments of one or more chains; a line is an arc of curvature 0.

    ``points_of`` samples it, ``nearest`` asks it.
    """

    start: FloatArray
    """(k, 2) m, first point of each segment."""
    end: FloatArray
    """(k, 2) m, last point of each segment."""
    bend: FloatArray
    """(k,) 1/m, signed curvature: 0 a line, positive counter-clockwise (convex), negative clockwise."""
    centre: FloatArray
    """(k, 2) m, centre of each arc; unused for lines."""
    sweep: FloatArray
    """(k,) rad, angle that each arc turns through, at least 0; unused for lines."""
    corners: FloatArray
    """(c, 2) m, joints at which the normal jumps."""
    corner_normals: FloatArray
    """(c, 2) unit mean of the normals on both sides of each of them."""

    @classmethod
    def circle(cls, centre: tuple[float, float], radius: float, *, hole: bool = False) -> Path:
        """A full circle about ``centre``, the boundary of a disc or of a hole."""
        c = np.array([centre], dtype=np.float64)
        at = c + np.array([[radius, 0.0]])
        bend = np.array([-1.0 if hole else 1.0]) / radius
        none = np.zeros((0, 2))
        return cls(at, at.copy(), bend, c, np.array([2.0 * np.pi]), none, none)

    @classmethod
    def rounded(
        cls, vertices: Sequence[tuple[float, float]], fillets: Sequence[float], *, closed: bool
    ) -> Path:
        """A polygon (or an open chain) whose vertices are rounded with the given radii, 0 for a sharp one."""
        v = np.array(vertices, dtype=np.float64)
        n = len(v)
        radius = np.array(fillets, dtype=np.float64)
        before, after = np.roll(v, 1, axis=0), np.roll(v, -1, axis=0)
        incoming, outgoing = _unit(v - before), _unit(after - v)
        turn = np.arctan2(_cross(incoming, outgoing), np.sum(incoming * outgoing, axis=1))
        if not closed:
            turn[[0, -1]], radius[[0, -1]] = 0.0, 0.0
        cut = radius * np.abs(np.tan(0.5 * turn))
        first, last = v - cut[:, None] * incoming, v + cut[:, None] * outgoing
        segments: list[tuple[FloatArray, FloatArray, float, FloatArray, float]] = []
        corners: list[FloatArray] = []
        corner_normals: list[FloatArray] = []
        for i in range(n):
            if radius[i] > 0.0:
                side = np.sign(turn[i])
                towards = side * np.array([-incoming[i, 1], incoming[i, 0]])
                centre = first[i] + radius[i] * towards
                segments.append((first[i], last[i], side / radius[i], centre, abs(float(turn[i]))))
            elif (closed or 0 < i < n - 1) and abs(turn[i]) > _SHARP:
                corners.append(v[i])
                corner_normals.append(_unit((_right(incoming[i]) + _right(outgoing[i]))[None])[0])
            if closed or i < n - 1:
                a, b = last[i], first[(i + 1) % n]
                if float(np.dot(b - a, outgoing[i])) < -1e-12:
                    raise ValueError(f"fillets of vertices {i} and {i + 1} overlap: make them smaller")
                if np.linalg.norm(b - a) > 1e-12:
                    segments.append((a, b, 0.0, np.zeros(2), 0.0))
        start, end, bend, centres, sweep = zip(*segments, strict=True)
        return cls(
            np.array(start),
            np.array(end),
            np.array(bend),
            np.array(centres),
            np.array(sweep),
            np.array(corners).reshape(-1, 2),
            np.array(corner_normals).reshape(-1, 2),
        )

    def nearest(self, points: FloatArray) -> Nearest:
        """What the path has nearest to ``points`` (n, 2)."""
        parts = [self._nearest(points[i : i + _CHUNK]) for i in range(0, max(len(points), 1), _CHUNK)]
        return Nearest(*(np.concatenate(field) for field in zip(*parts, strict=True)))

    def _nearest(self, p: FloatArray) -> Nearest:
        rows = np.arange(len(p))
        on_lines, on_arcs = self._on_lines(p), self._on_arcs(p)
        arc = self.bend != 0.0
        candidates = np.where(arc[:, None], on_arcs, on_lines)  # (n, k, 2)
        distance = np.linalg.norm(p[:, None] - candidates, axis=2)
        best = np.argmin(distance, axis=1)
        point = candidates[rows, best]
        normal = np.where(
            arc[best, None],
            (point - self.centre[best]) * self.bend[best, None],
            _right(_unit(self.end - self.start))[best],
        )
        away = p - point
        gap = np.linalg.norm(away, axis=1)
        to_corner = np.full(len(p), np.inf)
        if len(self.corners):
            separation = np.linalg.norm(point[:, None] - self.corners, axis=2)
            which = np.argmin(separation, axis=1)
            to_corner = separation[rows, which]
            at = to_corner < _AT_POINT
            outside = at & (np.sum(away * self.corner_normals[which], axis=1) > 0.0) & (gap > _AT_POINT)
            normal[at] = self.corner_normals[which[at]]
            normal[outside] = away[outside] / gap[outside, None]
        inside = np.sum(away * normal, axis=1) < 0.0
        return Nearest(point, normal, np.where(inside, -gap, gap), self.bend[best], to_corner)

    def _on_lines(self, p: FloatArray) -> FloatArray:
        along = self.end - self.start
        squared = np.maximum(np.sum(along**2, axis=1), 1e-300)  # full circles have no chord
        share = np.sum((p[:, None] - self.start) * along, axis=2) / squared
        return np.asarray(self.start + np.clip(share, 0.0, 1.0)[..., None] * along)

    def _on_arcs(self, p: FloatArray) -> FloatArray:
        side = np.sign(self.bend)
        radius = 1.0 / np.where(self.bend == 0.0, 1.0, np.abs(self.bend))
        from_centre = p[:, None] - self.centre
        zero = np.arctan2(self.start[:, 1] - self.centre[:, 1], self.start[:, 0] - self.centre[:, 0])
        turned = np.mod(side * (np.arctan2(from_centre[..., 1], from_centre[..., 0]) - zero), 2.0 * np.pi)
        # Past the arc's end a neighbour is as near or nearer, so either end will do.
        turned = np.minimum(turned, self.sweep)
        angle = zero + side * turned
        return np.asarray(self.centre + radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1))

    def points_of(
        self, tolerance: float, longest: float, turn: float, *, closed: bool, shortest: float = 0.0
    ) -> FloatArray:
        """Points (m, 2) along the path, close enough for a smooth mesh.

        Args:
            tolerance: m, largest distance of a chord from its arc.
            longest: m, longest chord.
            turn: rad, largest angle between neighbouring chords.
            closed: whether the path is; then its first point is not repeated.
            shortest: m, chords of arcs are not made shorter than this for the sake of the rest.
        """
        parts = []
        for a, b, bend, centre, sweep in zip(
            self.start, self.end, self.bend, self.centre, self.sweep, strict=True
        ):
            if bend == 0.0:
                count = max(1, int(np.ceil(np.linalg.norm(b - a) / longest)))
                parts.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
                continue
            radius = 1.0 / abs(bend)
            step = min(turn, longest / radius, 2.0 * np.arccos(1.0 - tolerance / radius))
            step = max(step, shortest / radius)
            count = max(2, int(np.ceil(sweep / step)))
            zero = np.arctan2(a[1] - centre[1], a[0] - centre[0])
            angle = zero + np.sign(bend) * np.linspace(0.0, sweep, count, endpoint=False)
            parts.append(centre + radius * np.stack((np.cos(angle), np.sin(angle)), axis=1))
        if not closed:
            parts.append(self.end[-1:])
        return np.concatenate(parts)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300))


def _right(v: FloatArray) -> FloatArray:
    return np.stack((v[..., 1], -v[..., 0]), axis=-1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
