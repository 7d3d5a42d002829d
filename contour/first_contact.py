"""When a moving straight beam first touches a mesh, and where: exact in float64, thousands of beams at once.

A beam that translates, or that turns about its base, sweeps a plane. In plane coordinates (x along the beam, y along
the motion) every triangle that crosses the plane is a straight segment, and on a segment clipped to the beam's reach
the travel is monotone: the first touch is at one of its two ends (docs/derivations-geometry.md). An end on a mesh
edge is a touch of the beam's side; an end made by the clip is a touch of its tip or of its base.

A fan of embree rays proposes one face per beam; its exact travel is an upper bound of the answer. Then all faces that
meet the swept region up to this bound are fetched from the tree and solved exactly, so the rays cost or save time
but never decide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from contour.bvh import Bvh, Regions
from contour.rays import RayCaster

__all__ = ["FirstContactSolver", "Motions", "Touches", "Where", "slides", "turns"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CHUNK = 512
"""Beams solved at once: their candidates then stay in the cache."""
SLIDE_FAN, SLIDE_FAN_FINE = 16, 6
"""Rays along the motion from points of the beam, and between the best one's neighbours."""
TURN_FAN, TURN_ROUNDS = 8, 3
"""Rays along the beam at angles of the sweep, and how often the step before the first hit is divided again."""
TIE = 1e-7
"""Parts of the surface within this distance of the beam at the touch count as touched as well [m]."""
SLACK = 1e-9
"""Regions are searched this much beyond the bound, far above any rounding of coordinates [m]."""
AXIAL = 1e-8
"""A translation within this angle of the beam's axis sweeps a line, not a plane [rad]."""


class Where(IntEnum):
    """The part of a triangle or of the beam at which they first meet."""

    EDGE_0 = 0
    """The triangle's edge from vertex 0 to 1."""
    EDGE_1 = 1
    """From vertex 1 to 2."""
    EDGE_2 = 2
    """From vertex 2 to 0."""
    TIP = 3
    """The beam's end, inside the triangle."""
    BASE = 4
    """The beam's root, inside the triangle: the carrier runs into the object."""
    THROUGH = 5
    """The beam pierces the triangle where it stands."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motions:
    """n beams and how they move, in coordinates (x, y, z) = frame (p - base) of the plane they sweep."""

    turning: bool
    """Whether the beams turn about their bases (y then is a length in the plane, the travel an angle)."""
    base: FloatArray
    """(n, 3) [m]."""
    direction: FloatArray
    """Unit, from the base to the tip (n, 3)."""
    advance: FloatArray
    """Unit: along the translation, or of the tip's first movement in a turn (n, 3)."""
    frame: FloatArray
    """The functionals x, y, z as rows (n, 3, 3): oblique for a translation, z normal to the plane."""
    length: FloatArray
    """(n,) [m]."""
    limit: FloatArray
    """Farthest travel (n,) [m] or [rad]."""

    def rows(self, index: IntArray | slice) -> Motions:
        """Some of the motions."""
        return Motions(
            turning=self.turning,
            base=self.base[index],
            direction=self.direction[index],
            advance=self.advance[index],
            frame=self.frame[index],
            length=self.length[index],
            limit=self.limit[index],
        )

    def moved(self, travel: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Base (n, 3) [m], direction (n, 3) and the way the beam's points move (n, 3) after the travel (n,)."""
        if not self.turning:
            return self.base + travel[:, None] * self.advance, self.direction, self.advance
        c, s = np.cos(travel)[:, None], np.sin(travel)[:, None]
        return self.base, c * self.direction + s * self.advance, c * self.advance - s * self.direction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touches:
    """First touches of n beams; rows without a touch have an infinite travel and face -1."""

    travel: FloatArray
    """(n,) [m] or [rad]; 0 for beams that touch where they stand."""
    distance: FloatArray
    """Along the beam's axis from its base (n,) [m]."""
    face: IntArray
    """(n,)."""
    where: IntArray
    """:class:`Where` (n,)."""
    near: FloatArray
    """Where the touched part of the beam begins, as seen from the base (n,) [m]."""
    far: FloatArray
    """Where it ends (n,) [m]."""
    near_face: IntArray
    """The face at the near end (n,)."""


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def slides(base: FloatArray, direction: FloatArray, length: FloatArray, translation: FloatArray) -> Motions:
    """Beams that keep their direction while the base moves along the translation (n, 3) [m]."""
    limit = np.linalg.norm(translation, axis=1)
    advance = translation / limit[:, None]
    along = np.einsum("ij,ij->i", advance, direction)
    # Twice, because the first difference loses digits where the motion is nearly along the beam.
    across = advance - along[:, None] * direction
    across -= np.einsum("ij,ij->i", across, direction)[:, None] * direction
    sine = np.linalg.norm(across, axis=1)
    axial = sine < AXIAL
    # Beams that move along themselves sweep a line; any plane through it does.
    across[axial] = _unit(np.cross(direction[axial], np.eye(3)[np.argmin(np.abs(direction[axial]), axis=1)]))
    across[~axial] /= sine[~axial, None]
    sine[axial] = np.inf
    frame = np.zeros((len(base), 3, 3))
    frame[:, 0] = direction - (along / sine)[:, None] * across
    frame[:, 1] = across / np.where(axial, 1.0, sine)[:, None]
    frame[:, 2] = np.cross(direction, across)
    return Motions(
        turning=False, base=base, direction=direction, advance=advance, frame=frame, length=length, limit=limit
    )


def turns(
    base: FloatArray, direction: FloatArray, length: FloatArray, axis: FloatArray, angle: FloatArray
) -> Motions:
    """Beams that turn about their bases, by angle (n,) [rad] >= 0 about unit axes (n, 3) normal to them."""
    advance = np.cross(axis, direction)
    frame = np.stack([direction, advance, axis], axis=1)
    return Motions(
        turning=True, base=base, direction=direction, advance=advance, frame=frame, length=length, limit=angle
    )


@dataclass(slots=True)
class _Pieces:
    """What is left of k triangles inside the swept plane: segments, and the travel at which they are met."""

    travel: FloatArray
    distance: FloatArray
    where: IntArray
    x: FloatArray  # (k, 2) ends of the clipped segment
    y: FloatArray  # (k, 2)


def _plane_segments(
    local: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray, IntArray]:
    """Where triangles (k, 3 vertices, 3 coordinates) that cross z = 0 cut it: xa, ya, xb, yb and their edges."""
    z = local[..., 2]
    above = z >= 0.0
    one_above = above.sum(axis=1) == 1
    lone = np.where(one_above, above.argmax(axis=1), above.argmin(axis=1))
    at = 3 * np.arange(len(local))
    flat = local.reshape(-1, 3)
    i, j, k = flat.take(at + lone, 0), flat.take(at + (lone + 1) % 3, 0), flat.take(at + (lone + 2) % 3, 0)
    # Symmetric in the two vertices: both triangles of an edge find the very same point.
    a = (i[:, 2:] * j[:, :2] - j[:, 2:] * i[:, :2]) / (i[:, 2] - j[:, 2])[:, None]
    b = (i[:, 2:] * k[:, :2] - k[:, 2:] * i[:, :2]) / (i[:, 2] - k[:, 2])[:, None]
    return a[:, 0], a[:, 1], b[:, 0], b[:, 1], lone, (lone + 2) % 3


def _slide_pieces(local: FloatArray, length: FloatArray) -> _Pieces:
    xa, ya, xb, yb, edge_a, edge_b = _plane_segments(local)
    swap = xa > xb
    xa, xb = np.where(swap, xb, xa), np.where(swap, xa, xb)
    ya, yb = np.where(swap, yb, ya), np.where(swap, ya, yb)
    edge_a, edge_b = np.where(swap, edge_b, edge_a), np.where(swap, edge_a, edge_b)
    span = xb - xa
    slope = (yb - ya) / np.where(span > 0.0, span, 1.0)
    x0, x1 = np.maximum(xa, 0.0), np.minimum(xb, length)
    y0 = np.where(xa < 0.0, ya - xa * slope, ya)
    y1 = np.where(xb > length, yb - (xb - length) * slope, yb)
    where0 = np.where(xa < 0.0, Where.BASE, edge_a)
    where1 = np.where(xb > length, Where.TIP, edge_b)
    first = y0 <= y1
    low, high = np.where(first, y0, y1), np.where(first, y1, y0)
    through = (low <= 0.0) & (high >= 0.0)
    share = -low / np.where(high > low, high - low, 1.0)
    x_low, x_high = np.where(first, x0, x1), np.where(first, x1, x0)
    met = (x0 <= x1) & (high >= 0.0)
    return _Pieces(
        travel=np.where(met, np.maximum(low, 0.0), np.inf),
        distance=np.where(through, x_low + share * (x_high - x_low), x_low),
        where=np.where(through, Where.THROUGH, np.where(first, where0, where1)),
        x=np.stack([x0, x1], axis=1),
        y=np.stack([y0, y1], axis=1),
    )


def _turn_pieces(local: FloatArray, length: FloatArray) -> _Pieces:
    xa, ya, xb, yb, edge_a, edge_b = _plane_segments(local)
    dx, dy = xb - xa, yb - ya
    # |a + u (b - a)|^2 = length^2: the disc cuts the segment to u0 <= u <= u1.
    square = dx * dx + dy * dy
    half = xa * dx + ya * dy
    outside_a, outside_b = np.hypot(xa, ya) > length, np.hypot(xb, yb) > length
    root = half * half - square * (xa * xa + ya * ya - length * length)
    met = (root >= 0.0) | ~outside_a
    root = np.sqrt(np.maximum(root, 0.0))
    safe = np.where(square > 0.0, square, 1.0)
    u0 = np.where(outside_a, (-half - root) / safe, 0.0)
    u1 = np.where(outside_b, (-half + root) / safe, 1.0)
    met &= (u0 <= u1) & (u0 >= 0.0) & (u1 <= 1.0)
    x = np.stack([np.where(outside_a, xa + u0 * dx, xa), np.where(outside_b, xa + u1 * dx, xb)], axis=1)
    y = np.stack([np.where(outside_a, ya + u0 * dy, ya), np.where(outside_b, ya + u1 * dy, yb)], axis=1)
    angle = np.arctan2(y, x)
    angle = np.where(angle < 0.0, angle + 2.0 * np.pi, angle)
    drop = y[:, 0] - y[:, 1]
    straddles = (y.min(axis=1) <= 0.0) & (y.max(axis=1) >= 0.0)
    share = y[:, 0] / np.where(drop != 0.0, drop, 1.0)
    crossing = x[:, 0] + share * (x[:, 1] - x[:, 0])
    through = straddles & (crossing >= 0.0)
    first = angle[:, 0] <= angle[:, 1]
    end = np.where(first, 0, 1)[:, None]
    where = np.where(first, np.where(outside_a, Where.TIP, edge_a), np.where(outside_b, Where.TIP, edge_b))
    radius = np.take_along_axis(np.hypot(x, y), end, axis=1)[:, 0]
    travel = np.where(through, 0.0, np.take_along_axis(angle, end, axis=1)[:, 0])
    return _Pieces(
        travel=np.where(met, travel, np.inf),
        distance=np.where(through, crossing, np.minimum(radius, length)),
        where=np.where(through, Where.THROUGH, where),
        x=x,
        y=y,
    )


def _axial_pieces(local: FloatArray, length: FloatArray, forward: NDArray[np.bool_]) -> _Pieces:
    """Beams that move along themselves: the line y = z = 0 is all they sweep."""
    xa, ya, xb, yb, _, _ = _plane_segments(local)
    drop = ya - yb
    met = (np.minimum(ya, yb) <= 0.0) & (np.maximum(ya, yb) >= 0.0)
    x = xa + ya / np.where(drop != 0.0, drop, 1.0) * (xb - xa)
    travel = np.where(forward, x - length, -x)
    through = (x >= 0.0) & (x <= length)
    met &= through | (travel > 0.0)
    return _Pieces(
        travel=np.where(met, np.maximum(travel, 0.0), np.inf),
        distance=np.where(through, x, np.where(forward, length, 0.0)),
        where=np.where(through, Where.THROUGH, np.where(forward, Where.TIP, Where.BASE)),
        x=np.stack([x, x], axis=1),
        y=np.zeros((len(x), 2)),
    )


def _first_of(values: FloatArray, owner: IntArray, n: int) -> FloatArray:
    """The least value of each owner (n,), inf where there is none; the owners are sorted."""
    best = np.full(n, np.inf)
    if len(owner):
        starts = np.nonzero(np.diff(owner, prepend=-1))[0]
        best[owner[starts]] = np.minimum.reduceat(values, starts)
    return best


def _pick(mask: NDArray[np.bool_], owner: IntArray, n: int) -> IntArray:
    """The first marked item of each owner (n,), -1 where there is none."""
    marked = np.nonzero(mask)[0][::-1]
    chosen = np.full(n, -1, dtype=np.int64)
    chosen[owner[marked]] = marked  # of repeated owners the last assignment stays, which is the first item
    return chosen


class FirstContactSolver:
    """First touches of beams with the triangles (f, 3, 3) [m]; their coordinates should be near the origin."""

    def __init__(self, triangles: FloatArray) -> None:
        self.triangles = np.ascontiguousarray(triangles)
        """(f, 3, 3) [m]."""
        self.bvh = Bvh(self.triangles)
        """The tree over them."""
        self.rays = RayCaster(self.triangles)
        """The same triangles for embree."""

    def solve(self, motions: Motions) -> Touches:
        """The first touch of each beam."""
        parts = [
            self._solve(motions.rows(slice(start, start + CHUNK)))
            for start in range(0, len(motions.base), CHUNK)
        ]
        return join(parts)

    def _solve(self, motions: Motions) -> Touches:
        sine = np.linalg.norm(np.cross(motions.direction, motions.advance), axis=1)
        axial = np.zeros(len(sine), dtype=np.bool_) if motions.turning else sine < AXIAL
        if not axial.any():
            return self._narrow(motions, _turn_pieces if motions.turning else _slide_pieces)
        touches = _nothing(len(axial))
        rows = np.nonzero(~axial)[0]
        if len(rows):
            _put(touches, rows, self._narrow(motions.rows(rows), _slide_pieces))
        rows = np.nonzero(axial)[0]
        _put(touches, rows, self._axial(motions.rows(rows)))
        return touches

    def _narrow(self, motions: Motions, pieces: Callable[[FloatArray, FloatArray], _Pieces]) -> Touches:
        proposed = self._bound(motions, pieces)
        touches = self._within(motions, np.minimum(proposed, motions.limit), pieces)
        # A face that only just crosses the plane may be judged otherwise in the search than in the bound, by
        # the last digit of a coordinate. Nothing then bears the bound out, and the whole sweep is searched.
        doubtful = np.nonzero((proposed <= motions.limit) & (touches.travel > proposed + SLACK))[0]
        if len(doubtful):
            some = motions.rows(doubtful)
            _put(touches, doubtful, self._within(some, some.limit, pieces))
        return touches

    def _within(
        self, motions: Motions, bound: FloatArray, pieces: Callable[[FloatArray, FloatArray], _Pieces]
    ) -> Touches:
        regions = _swept(motions, bound)
        owner, leaf = self.bvh.leaves_in(regions)
        owner, face, local = self._crossing(motions, regions, owner, leaf)
        return _reduce(motions, owner, face, pieces(local, motions.length.take(owner)))

    def _axial(self, motions: Motions) -> Touches:
        n = len(motions.base)
        forward = np.einsum("ij,ij->i", motions.direction, motions.advance) > 0.0
        zero = np.zeros(n)
        low = np.stack([zero, zero, np.where(forward, 0.0, -motions.limit)], axis=1) - SLACK
        high = np.stack([zero, zero, motions.length + np.where(forward, motions.limit, 0.0)], axis=1) + SLACK
        order = motions.frame[:, [2, 1, 0]]
        shift = np.einsum("nsj,nj->ns", order, motions.base)
        regions = Regions(slabs=order, low=low + shift, high=high + shift)
        owner, leaf = self.bvh.leaves_in(regions)
        owner, face, local = self._crossing(motions, regions, owner, leaf)
        found = _axial_pieces(local, motions.length.take(owner), forward.take(owner))
        return _reduce(motions, owner, face, found)

    def _crossing(
        self, motions: Motions, regions: Regions, owner: IntArray, leaf: IntArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Candidates that cross the swept plane: owner (k,), face (k,), local vertices (k, 3, 3)."""
        vertices = self.bvh.leaf_vertices.take(leaf, axis=0)
        shift = np.einsum("nsj,nj->ns", motions.frame, motions.base)
        z = np.einsum("kjv,kj->kv", vertices, motions.frame[:, 2].take(owner, axis=0))
        z -= shift[:, 2].take(owner)[:, None]
        front = np.einsum("kjv,kj->kv", vertices, regions.slabs[:, 1].take(owner, axis=0))
        reached = (front <= regions.high[:, 1].take(owner)[:, None]).view(np.int8).reshape(len(leaf), -1, 3)
        above = (z >= 0.0).view(np.int8).reshape(reached.shape)
        count = above[..., 0] + above[..., 1] + above[..., 2]
        near = reached[..., 0] | reached[..., 1] | reached[..., 2]
        row, slot = np.nonzero(((count == 1) | (count == 2)) & (near > 0))
        item = row * above.shape[1] + slot
        owner = owner.take(row)
        face = self.bvh.leaf_faces.take(leaf.take(row) * above.shape[1] + slot)
        local = np.einsum(
            "kvj,ksj->kvs", self.triangles.take(face, axis=0), motions.frame.take(owner, axis=0)
        )
        local -= shift.take(owner, axis=0)[:, None]
        # The very values that the crossing was judged by: a recomputed sign could differ in the last digit.
        local[..., 2] = z.reshape(-1, 3).take(item, axis=0)
        return owner, face, local

    def _bound(self, motions: Motions, pieces: Callable[[FloatArray, FloatArray], _Pieces]) -> FloatArray:
        """Exact travel to one face that the rays propose (n,): an upper bound, inf where they found none."""
        face = self._turn_hint(motions) if motions.turning else self._slide_hint(motions)
        row = np.nonzero(face >= 0)[0]
        corners = self.triangles.take(face[row], axis=0) - motions.base[row, None]
        local = np.einsum("kvj,ksj->kvs", corners, motions.frame[row])
        above = local[..., 2] >= 0.0
        crosses = above.any(axis=1) & ~above.all(axis=1)
        bound = np.full(len(face), np.inf)
        bound[row[crosses]] = pieces(local[crosses], motions.length[row[crosses]]).travel
        return bound

    def _slide_hint(self, motions: Motions) -> IntArray:
        """Face (n,) that rays along the motion, from points of the beam, meet first; -1 for none."""
        n = len(motions.base)
        pitch = 1.0 / (SLIDE_FAN - 1)
        share = np.broadcast_to(np.linspace(0.0, 1.0, SLIDE_FAN), (n, SLIDE_FAN))
        face, travel = self._rays_ahead(motions, share)
        best = np.argmin(travel, axis=1)
        rows = np.arange(n)
        around = pitch * (2.0 * (np.arange(SLIDE_FAN_FINE) + 0.5) / SLIDE_FAN_FINE - 1.0)
        fine_face, fine_travel = self._rays_ahead(
            motions, np.clip(share[rows, best][:, None] + around, 0.0, 1.0)
        )
        finer = np.argmin(fine_travel, axis=1)
        return np.where(
            fine_travel[rows, finer] < travel[rows, best], fine_face[rows, finer], face[rows, best]
        )

    def _rays_ahead(self, motions: Motions, share: FloatArray) -> tuple[IntArray, FloatArray]:
        k = share.shape[1]
        starts = motions.base[:, None] + (share * motions.length[:, None])[..., None] * motions.direction[:, None]
        ahead = np.repeat(motions.advance, k, axis=0)
        face, travel = self.rays.first_hits(starts.reshape(-1, 3), ahead, np.repeat(motions.limit, k))
        return face.reshape(-1, k), np.where(face >= 0, travel, np.inf).reshape(-1, k)

    def _turn_hint(self, motions: Motions) -> IntArray:
        """Face (n,) that rays along the turning beam meet first; -1 for none."""
        n = len(motions.base)
        rows = np.arange(n)
        start, step = np.zeros(n), motions.limit / TURN_FAN
        found = np.full(n, -1, dtype=np.int64)
        for _ in range(TURN_ROUNDS):
            angle = start[:, None] + step[:, None] * np.arange(TURN_FAN + 1)
            c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
            along = c * motions.direction[:, None] + s * motions.advance[:, None]
            face, _ = self.rays.first_hits(
                np.repeat(motions.base, TURN_FAN + 1, axis=0),
                along.reshape(-1, 3),
                np.repeat(motions.length, TURN_FAN + 1),
            )
            face = face.reshape(n, -1)
            blocked = np.argmax(face >= 0, axis=1)
            # Rays at the far end of a step are cast again, and may slip through an edge: keep what was found.
            found = np.where(face[rows, blocked] >= 0, face[rows, blocked], found)
            start += step * np.maximum(blocked - 1, 0)
            step /= TURN_FAN
        return found


def _swept(motions: Motions, bound: FloatArray) -> Regions:
    """What the beams sweep until the bound, as regions for the tree."""
    n = len(bound)
    wide = TIE + SLACK
    normal, ahead, along = motions.frame[:, 2], motions.frame[:, 1], motions.frame[:, 0]
    zero = np.zeros(n)
    if not motions.turning:
        slabs = np.stack([normal, ahead, along], axis=1)
        low = np.stack([zero, zero, zero], axis=1) - SLACK
        high = np.stack([zero + SLACK, bound + wide, motions.length + SLACK], axis=1)
        centre = reach = None
    else:
        # Up to a half turn the sector is convex: before the beam's last position, ahead of its first.
        c, s = np.cos(bound)[:, None], np.sin(bound)[:, None]
        slabs = np.stack([normal, c * ahead - s * along, ahead], axis=1)
        low = np.stack([zero - SLACK, np.full(n, -np.inf), zero - SLACK], axis=1)
        high = np.stack([zero + SLACK, zero + wide, np.full(n, np.inf)], axis=1)
        centre, reach = motions.base, motions.length + SLACK
    shift = np.einsum("nsj,nj->ns", slabs, motions.base)
    return Regions(slabs=slabs, low=low + shift, high=high + shift, centre=centre, reach=reach)


def _reduce(motions: Motions, owner: IntArray, face: IntArray, pieces: _Pieces) -> Touches:
    """From all pieces to the first touch of each beam."""
    n = len(motions.base)
    touches = _nothing(n)
    if not len(owner):
        return touches
    travel = np.where(pieces.travel <= motions.limit.take(owner), pieces.travel, np.inf)
    best = _first_of(travel, owner, n)
    ties = (travel == best.take(owner)) & np.isfinite(travel)
    nearest = _first_of(np.where(ties, pieces.distance, np.inf), owner, n)
    pick = _pick(ties & (pieces.distance == nearest.take(owner)), owner, n)
    rows = np.nonzero(pick >= 0)[0]
    pick = pick[rows]
    touches.travel[rows] = travel[pick]
    for name in ("distance", "near", "far"):
        getattr(touches, name)[rows] = pieces.distance[pick]
    for name in ("face", "near_face"):
        getattr(touches, name)[rows] = face[pick]
    touches.where[rows] = pieces.where[pick]
    _spread(motions, touches, owner, face, pieces)
    return touches


def _spread(motions: Motions, touches: Touches, owner: IntArray, face: IntArray, pieces: _Pieces) -> None:
    """The interval of the beam that lies within TIE of the surface at the touch."""
    n = len(motions.base)
    reach = touches.travel + (TIE / motions.length if motions.turning else TIE)
    free = np.isfinite(touches.travel) & (touches.where != Where.THROUGH)
    near = np.nonzero((pieces.travel <= reach.take(owner)) & free.take(owner))[0]
    owner, face = owner.take(near), face.take(near)
    x, y = pieces.x.take(near, axis=0), pieces.y.take(near, axis=0)
    travel = touches.travel.take(owner)[:, None]
    if motions.turning:
        c, s = np.cos(travel), np.sin(travel)
        x, y = c * x + s * y, c * y - s * x
    else:
        y = y - travel
    gap = y[:, 1] - y[:, 0]
    cut = x[:, 0] + (TIE - y[:, 0]) / np.where(gap != 0.0, gap, 1.0) * (x[:, 1] - x[:, 0])
    ends = np.where(y <= TIE, x, cut[:, None])
    low = _first_of(ends.min(axis=1), owner, n)
    high = -_first_of(-ends.max(axis=1), owner, n)
    pick = _pick(ends.min(axis=1) == low.take(owner), owner, n)
    rows = np.nonzero(pick >= 0)[0]
    touches.near[rows] = low[rows]
    touches.far[rows] = high[rows]
    touches.near_face[rows] = face[pick[rows]]


def _nothing(n: int) -> Touches:
    return Touches(
        travel=np.full(n, np.inf),
        distance=np.zeros(n),
        face=np.full(n, -1, dtype=np.int64),
        where=np.full(n, -1, dtype=np.int64),
        near=np.zeros(n),
        far=np.zeros(n),
        near_face=np.full(n, -1, dtype=np.int64),
    )


_FIELDS = ("travel", "distance", "face", "where", "near", "far", "near_face")


def _put(into: Touches, rows: IntArray, touches: Touches) -> None:
    for name in _FIELDS:
        getattr(into, name)[rows] = getattr(touches, name)


def join(parts: list[Touches]) -> Touches:
    """Touches of several batches as one."""
    if not parts:
        return _nothing(0)
    if len(parts) == 1:
        return parts[0]
    return Touches(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS})
