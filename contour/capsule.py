"""A beam with a radius against triangles: when a moving capsule first comes to within its radius of each.

At the first touch the nearest pair of points is one of a few features: the beam's axis and an edge or a
vertex of the triangle, or one of its end points and the face, an edge or a vertex. For each the travel at
which the gap shrinks to the radius has a closed form (docs/derivations-geometry.md); it counts where the
nearest points at that travel lie on the feature. Coordinates are square: X along the beam, Y ahead of it in
the swept plane, Z normal to that plane, from the base.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.sweep import Where, plane_segments
from contour.vectors import cross, dot

__all__ = ["Features", "slide_features", "turn_features"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_EDGE_CODES = (Where.EDGE_0, Where.EDGE_1, Where.EDGE_2)
ON_FEATURE = 1e-9
"""Shares and lengths, relative, by which a nearest point may miss its feature: neighbours share their ends.
"""
ROOT_STEPS = 100
"""Steps of the one root without a closed form; simple roots take about six each."""
ROOT_PUSH = 1e-7
"""Step that leaves a root behind [rad]."""


@dataclass(slots=True)
class Features:
    """Travel to each of m features of k triangles, inf where it is not met."""

    travel: FloatArray
    """(m, k) [m] or [rad]."""
    distance: FloatArray
    """Along the beam (m, k) [m]."""
    where: IntArray
    """:class:`Where` of the features (m,)."""


class _Found:
    """Features gathered one by one."""

    def __init__(self, k: int) -> None:
        self._k = k
        self._travel: list[FloatArray] = []
        self._distance: list[FloatArray] = []
        self._where: list[int] = []

    def add(
        self,
        where: Where,
        travel: FloatArray,
        distance: FloatArray | float,
        met: BoolArray,
        rows: IntArray | None = None,
    ) -> None:
        """A feature of all triangles, or of some rows of them."""
        travel = np.where(met, travel, np.inf)
        if rows is not None:
            everywhere = np.full(self._k, np.inf)
            everywhere[rows] = travel
            place = np.zeros(self._k)
            place[rows] = distance
            travel, distance = everywhere, place
        self._travel.append(travel)
        self._distance.append(np.broadcast_to(np.asarray(distance, dtype=np.float64), (self._k,)))
        self._where.append(int(where))

    def gathered(self) -> Features:
        return Features(
            travel=np.stack(self._travel),
            distance=np.stack(self._distance),
            where=np.array(self._where, dtype=np.int64),
        )


def slide_features(
    local: FloatArray, length: FloatArray, radius: float, along: FloatArray, ahead: FloatArray
) -> Features:
    """Features of triangles for beams that translate.

    Args:
        local: coordinates of the corners (3 coordinates, 3 corners, k).
        length: of the beams (k,).
        radius: of the beams.
        along: way of the beams in X per metre of travel (k,).
        ahead: in Y (k,).
    """
    found = _Found(local.shape[2])
    X, Y, Z = local
    moving = ahead > 0.0
    speed = np.where(moving, ahead, 1.0)
    for i in range(3):
        _slide_edge(found, _EDGE_CODES[i], local[:, i], local[:, (i + 1) % 3], length, radius, along, ahead)
        over = radius * radius - Z[i] ** 2
        inside = Y[i] ** 2 <= over
        travel = np.where(inside, 0.0, (Y[i] - np.sqrt(np.maximum(over, 0.0))) / speed)
        place = X[i] - travel * along
        met = (over >= 0.0) & (inside | (moving & (travel >= 0.0))) & _between(place, length)
        found.add(_EDGE_CODES[i], travel, place, met)
    # Only triangles that the ends can reach while the beam passes them are held against the ends.
    early = np.maximum((_least(Y) - radius) / speed, 0.0)
    late = np.maximum((_most(Y) + radius) / speed, early)
    low = _least(X) - np.maximum(early * along, late * along)
    high = _most(X) - np.minimum(early * along, late * along)
    tip = np.nonzero(~moving | (high >= length - radius))[0]
    base = np.nonzero(~moving | (low <= radius))[0]
    for rows, where, place in ((tip, Where.TIP, length), (base, Where.BASE, np.zeros(len(length)))):
        if len(rows):
            centre = np.zeros((len(rows), 3))
            centre[:, 0] = place[rows]
            way = np.stack([along[rows], ahead[rows], np.zeros(len(rows))], axis=1)
            _slide_end(found, where, _rows_first(local, rows), centre, way, radius, place[rows], rows)
    _pierced(found, local, length)
    return found.gathered()


def _slide_edge(
    found: _Found,
    where: Where,
    start: FloatArray,
    stop: FloatArray,
    length: FloatArray,
    radius: float,
    along: FloatArray,
    ahead: FloatArray,
) -> None:
    """Axis and edge, ends (3, k): seen along the beam, a point that moves towards a straight line."""
    ux, uy, uz = stop - start
    square = uy * uy + uz * uz
    flat = np.sqrt(np.where(square > 0.0, square, 1.0))
    gap = (start[1] * uz - start[2] * uy) / flat
    rate = -ahead * uz / flat
    inside = np.abs(gap) <= radius
    closing = gap * rate < 0.0
    travel = np.where(inside, 0.0, (np.abs(gap) - radius) / np.where(closing, np.abs(rate), 1.0))
    share = ((travel * ahead - start[1]) * uy - start[2] * uz) / (flat * flat)
    place = start[0] + share * ux - travel * along
    met = (inside | closing) & (square > 0.0) & _between(place, length) & _between(share, 1.0)
    found.add(where, travel, place, met)


def _slide_end(
    found: _Found,
    where: Where,
    corners: FloatArray,
    centre: FloatArray,
    way: FloatArray,
    radius: float,
    place: FloatArray,
    rows: IntArray,
) -> None:
    """A ball that moves straight against face, edges and vertices."""
    normal = _unit_normal(corners)
    gap = dot(centre - corners[:, 0], normal)
    rate = dot(way, normal)
    inside, closing = np.abs(gap) <= radius, gap * rate < 0.0
    travel = np.where(inside, 0.0, (np.abs(gap) - radius) / np.where(closing, np.abs(rate), 1.0))
    met = (inside | closing) & _over_face(corners, centre + travel[:, None] * way)
    found.add(where, travel, place, met, rows)
    for i in range(3):
        start, side = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
        square = dot(side, side)
        from_start = centre - start
        travel, met = _ball_root(_square_to(from_start, side, square), _square_to(way, side, square), radius)
        share = dot(from_start + travel[:, None] * way, side) / square
        found.add(where, travel, place, met & _between(share, 1.0), rows)
        travel, met = _ball_root(from_start, way, radius)
        found.add(where, travel, place, met, rows)


def _ball_root(start: FloatArray, way: FloatArray, radius: float) -> tuple[FloatArray, BoolArray]:
    """The travel at which |start + travel way| shrinks to the radius."""
    a = dot(way, way)
    b = dot(start, way)
    c = dot(start, start) - radius * radius
    root = b * b - a * c
    inside = c <= 0.0
    met = inside | ((root >= 0.0) & (b < 0.0))
    # c / (-b + root) instead of (-b - root) / a: no digits cancel.
    below = -b + np.sqrt(np.maximum(root, 0.0))
    return np.where(inside, 0.0, c / np.where(met & ~inside, below, 1.0)), met


def turn_features(local: FloatArray, length: FloatArray, radius: float, limit: FloatArray) -> Features:
    """Features of triangles for beams that turn from X towards Y.

    Args:
        local: coordinates of the corners (3 coordinates, 3 corners, k).
        length: of the beams (k,).
        radius: of the beams.
        limit: angle beyond which nothing is wanted (k,).
    """
    found = _Found(local.shape[2])
    X, Y, Z = local
    square = X * X + Y * Y
    for i in range(3):
        _turn_edge(found, _EDGE_CODES[i], local[:, i], local[:, (i + 1) % 3], length, radius)
        inside = (Y[i] ** 2 + Z[i] ** 2 <= radius * radius) & _between(X[i], length)
        # The foot of the vertex on the axis: x^2 = X^2 + Y^2 + Z^2 - r^2.
        foot = square[i] + Z[i] ** 2 - radius * radius
        place = np.sqrt(np.maximum(foot, 0.0))
        across = np.sqrt(np.maximum(radius * radius - Z[i] ** 2, 0.0))
        travel = np.mod(np.arctan2(Y[i], X[i]) - np.arctan2(across, place), 2.0 * np.pi)
        met = (foot >= 0.0) & (np.abs(Z[i]) <= radius) & (place <= length)
        found.add(_EDGE_CODES[i], np.where(inside, 0.0, travel), np.where(inside, X[i], place), met | inside)
    far = np.nonzero(np.sqrt(_most(square)) >= length - radius)[0]
    if len(far):
        _turn_tip(found, _rows_first(local, far), length[far], radius, limit[far], far)
    about_base = (local.min(axis=1) <= radius) & (local.max(axis=1) >= -radius)
    near = np.nonzero(about_base.all(axis=0))[0]
    if len(near):
        still = np.zeros((len(near), 3))
        corners = _rows_first(local, near)
        _slide_end(found, Where.BASE, corners, still, still, radius, np.zeros(len(near)), near)
    _pierced(found, local, length)
    return found.gathered()


def _turn_edge(
    found: _Found, where: Where, start: FloatArray, stop: FloatArray, length: FloatArray, radius: float
) -> None:
    """Axis and edge, ends (3, k): (P . (d x U))^2 = r^2 |d x U|^2.

    That is a sinusoid of twice the angle, with one entry in each half turn.
    """
    ux, uy, uz = stop - start
    px, py, pz = start
    sine, cosine = px * uz - pz * ux, pz * uy - py * uz
    total = ux * ux + uy * uy + uz * uz
    r2 = radius * radius
    a = cosine**2 + r2 * ux**2
    b = sine**2 + r2 * uy**2
    c = sine * cosine + r2 * ux * uy
    size = np.hypot(0.5 * (a - b), c)
    level = r2 * total - 0.5 * (a + b)
    half = np.arccos(np.clip(level / np.where(size > 0.0, size, 1.0), -1.0, 1.0))
    entry = np.mod(0.5 * (np.arctan2(c, 0.5 * (a - b)) + half), np.pi)
    inside, crosses = a - r2 * total <= 0.0, np.abs(level) < size
    dot = px * ux + py * uy + pz * uz
    for travel, met in ((np.zeros(len(a)), inside), (entry, crosses)):
        if not met.any():
            continue
        co, si = np.cos(travel), np.sin(travel)
        on_beam, lean = co * px + si * py, co * ux + si * uy
        square = total - lean * lean
        skew = square > 1e-18 * total
        share = (on_beam * lean - dot) / np.where(skew, square, 1.0)
        place = on_beam + share * lean
        found.add(where, travel, place, met & skew & _between(place, length) & _between(share, 1.0))


def _turn_tip(
    found: _Found,
    corners: FloatArray,
    length: FloatArray,
    radius: float,
    limit: FloatArray,
    rows: IntArray,
) -> None:
    """Tip against face, edges and vertices."""
    normal = _unit_normal(corners)
    plane = dot(corners[:, 0], normal)
    size = length * np.hypot(normal[:, 0], normal[:, 1])
    phase = np.arctan2(normal[:, 1], normal[:, 0])
    safe = np.where(size > 0.0, size, 1.0)
    for sign in (1.0, -1.0):  # entering the slab about the face from above, and from below
        level = (plane + sign * radius) / safe
        travel = np.mod(phase + sign * np.arccos(np.clip(level, -1.0, 1.0)), 2.0 * np.pi)
        met = (np.abs(level) <= 1.0) & (size > 0.0) & _over_face(corners, _tip(travel, length))
        found.add(Where.TIP, travel, length, met, rows)
    at_start = _tip(np.zeros(len(length)), length)
    still = np.zeros_like(at_start)
    _slide_end(found, Where.TIP, corners, at_start, still, radius, length, rows)
    for i in range(3):
        start = corners[:, i]
        # |tip - P|^2 = r^2: L^2 + P^2 - r^2 = 2 L (cos X + sin Y), entered from below the phase.
        reach = 2.0 * length * np.hypot(start[:, 0], start[:, 1])
        level = length**2 + dot(start, start) - radius * radius
        met = level <= reach
        angle = np.arccos(np.clip(level / np.where(reach > 0.0, reach, 1.0), -1.0, 1.0))
        travel = np.mod(np.arctan2(start[:, 1], start[:, 0]) - angle, 2.0 * np.pi)
        found.add(Where.TIP, travel, length, met, rows)
    starts = corners.reshape(-1, 3)
    sides = corners[:, [1, 2, 0]].reshape(-1, 3) - starts
    angle, met = _tip_edge_root(starts, sides, np.repeat(length, 3), radius, np.repeat(limit, 3))
    for i in range(3):
        found.add(Where.TIP, angle[i::3], length, met[i::3], rows)


def _tip_edge_root(
    start: FloatArray, side: FloatArray, length: FloatArray, radius: float, limit: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The first angle at which h = |tip - P|^2 - ((tip - P) . u)^2 - r^2 falls to zero on an edge, if any.

    h is a trigonometric polynomial of second degree, so |h''| <= M. No root lies before the root of
    |h| + |h|' x - M x^2 / 2: steps to it never pass a root and converge quadratically. Entries beside the
    edge's ends, and what is inside the tube about its line, are walked through.
    """
    square = dot(side, side)
    u = side / np.sqrt(square)[:, None]
    p = dot(start, u)
    level = length**2 + dot(start, start) - radius * radius
    lean = length * np.hypot(u[:, 0], u[:, 1])
    bend = 2.0 * length * np.hypot(start[:, 0], start[:, 1]) + 4.0 * lean**2 + 2.0 * np.abs(p) * lean
    tiny = 1e-14 * length**2
    angle = np.zeros(len(p))
    met = np.zeros(len(p), dtype=np.bool_)
    for _ in range(ROOT_STEPS):
        co, si = np.cos(angle), np.sin(angle)
        q = length * (co * u[:, 0] + si * u[:, 1]) - p
        h = level - 2.0 * length * (co * start[:, 0] + si * start[:, 1]) - q * q
        dq = length * (co * u[:, 1] - si * u[:, 0])
        slope = 2.0 * length * (si * start[:, 0] - co * start[:, 1]) - 2.0 * q * dq
        entry = (np.abs(h) <= tiny) & (slope <= 0.0)
        met |= entry & _between(q * np.sqrt(1.0 / square), 1.0) & (angle > 0.0)
        running = ~met & (angle <= limit)
        if not running.any():
            break
        size, rise = np.abs(h), np.where(h < 0.0, -slope, slope)
        step = 2.0 * size / np.maximum(np.sqrt(rise**2 + 2.0 * bend * size) - rise, 1e-300)
        step = np.where((h <= tiny) | entry, np.maximum(step, ROOT_PUSH), step)
        angle = np.where(running, angle + np.minimum(step, np.pi), angle)
    return angle, met


def _tip(angle: FloatArray, length: FloatArray) -> FloatArray:
    return np.stack([length * np.cos(angle), length * np.sin(angle), np.zeros(len(angle))], axis=1)


def _pierced(found: _Found, local: FloatArray, length: FloatArray) -> None:
    """Axes that pass through a triangle where they stand, far from its edges."""
    _, Y, Z = local
    crosses = (_least(Z) < 0.0) & (_most(Z) >= 0.0) & (_least(Y) <= 0.0) & (_most(Y) >= 0.0)
    rows = np.nonzero(crosses)[0]
    if not len(rows):
        return
    xa, ya, xb, yb, _, _ = plane_segments(_rows_first(local, rows))
    drop = ya - yb
    place = xa + ya / np.where(drop != 0.0, drop, 1.0) * (xb - xa)
    met = (np.minimum(ya, yb) <= 0.0) & (np.maximum(ya, yb) >= 0.0) & (place >= 0.0) & (place <= length[rows])
    found.add(Where.THROUGH, np.zeros(len(rows)), place, met, rows)


def _rows_first(local: FloatArray, rows: IntArray) -> FloatArray:
    """Some of the triangles (3 coordinates, 3 corners, k) as corners (r, 3, 3)."""
    return np.ascontiguousarray(local.take(rows, axis=2).transpose(2, 1, 0))


def _least(corners: FloatArray) -> FloatArray:
    return np.asarray(np.minimum(np.minimum(corners[0], corners[1]), corners[2]))


def _most(corners: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(np.maximum(corners[0], corners[1]), corners[2]))


def _between(values: FloatArray, top: FloatArray | float) -> BoolArray:
    return (values >= -ON_FEATURE) & (values <= top + ON_FEATURE)


def _square_to(vectors: FloatArray, side: FloatArray, square: FloatArray) -> FloatArray:
    return np.asarray(vectors - (dot(vectors, side) / square)[:, None] * side)


def _unit_normal(corners: FloatArray) -> FloatArray:
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])


def _over_face(corners: FloatArray, point: FloatArray) -> BoolArray:
    """Whether points (k, 3) lie over the inside of their triangles."""
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset = corners - point[:, None]
    parts = np.einsum("kcj,kj->kc", cross(offset[:, [1, 2, 0]], offset[:, [2, 0, 1]]), normal)
    return np.asarray((parts >= -ON_FEATURE * dot(normal, normal)[:, None]).all(axis=1))
