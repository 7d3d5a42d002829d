"""When a moving straight beam first touches a mesh, and where: exact in float64, thousands of beams at once.

A fan of embree rays proposes one face per beam; its exact travel is an upper bound of the answer. Then all
faces that meet the swept region up to this bound are fetched from the tree and solved exactly, so the rays
cost or save time but never decide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.bvh import Bvh, Regions
from contour.capsule import Features, slide_features, turn_features
from contour.motions import AXIAL, Motions
from contour.rays import RayCaster
from contour.sweep import Pieces, Where, axial_pieces, slide_pieces, turn_pieces
from contour.vectors import cross, dot

__all__ = ["TIE", "FirstContactSolver", "Touches"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CHUNK = 512
"""Beams solved at once: their candidates then stay in the cache."""
SLIDE_FAN, SLIDE_FAN_FINE = 12, 6
"""Rays along the motion from points of the beam, and between the best one's neighbours."""
TURN_FAN, TURN_ROUNDS = 6, 4
"""Rays along the beam at angles of the sweep, and how often the step before the first hit is divided again.
"""
TIE = 1e-7
"""Parts of the surface within this distance of the beam at the touch count as touched as well [m]."""
SLACK = 1e-9
"""Regions are searched this much beyond the bound, far above any rounding of coordinates [m]."""


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
    far_face: IntArray
    """The face at the far end (n,)."""


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
    """First touches of beams with triangles (f, 3, 3) [m] whose coordinates are near the origin."""

    def __init__(self, triangles: FloatArray) -> None:
        self.triangles = np.ascontiguousarray(triangles)
        """(f, 3, 3) [m]."""
        self.bvh = Bvh(self.triangles)
        """The tree over them."""
        self.rays = RayCaster(self.triangles)
        """The same triangles for embree."""

    def solve(self, motions: Motions, radius: float = 0.0) -> Touches:
        """The first touch of each beam, as a line or as a capsule of the radius [m] about it."""
        parts = []
        for start in range(0, len(motions.base), CHUNK):
            part = motions.rows(slice(start, start + CHUNK))
            parts.append(self._thick(part, radius) if radius > 0.0 else self._thin(part))
        return _join(parts)

    def _thin(self, motions: Motions) -> Touches:
        axial = _axial(motions)
        if not axial.any():
            return self._narrow(motions, turn_pieces if motions.turning else slide_pieces)
        touches = _nothing(len(axial))
        rows = np.nonzero(~axial)[0]
        if len(rows):
            _put(touches, rows, self._narrow(motions.rows(rows), slide_pieces))
        rows = np.nonzero(axial)[0]
        _put(touches, rows, self._along(motions.rows(rows)))
        return touches

    def _thick(self, motions: Motions, radius: float) -> Touches:
        n = len(motions.base)
        face = self._turn_hint(motions) if motions.turning else self._slide_hint(motions)
        row = np.nonzero(face >= 0)[0]
        bound = motions.limit.copy()
        # A capsule about an axis that meets a face meets it no later than the axis does.
        first = _features(motions, row, self._square(motions, row, face[row]), radius, bound)
        bound[row] = np.minimum(bound[row], first.travel.min(axis=0))
        regions = _swept(motions, bound, radius)
        owner, leaf = self.bvh.leaves_in(regions)
        owner, face = self._candidates(regions, owner, leaf)
        features = _features(motions, owner, self._square(motions, owner, face), radius, bound)
        return _reduce_features(motions, owner, face, features, n)

    def _candidates(self, regions: Regions, owner: IntArray, leaf: IntArray) -> tuple[IntArray, IntArray]:
        """Faces of the leaves that meet the first two slabs: owner (k,), face (k,)."""
        vertices = self.bvh.leaf_vertices.take(leaf, axis=0)
        near = np.ones((len(leaf), vertices.shape[2] // 3), dtype=np.bool_)
        for slab in (0, 1):
            value = np.einsum("kjv,kj->kv", vertices, regions.slabs[:, slab].take(owner, axis=0))
            value = value.reshape(*near.shape, 3)
            least = np.minimum(np.minimum(value[..., 0], value[..., 1]), value[..., 2])
            most = np.maximum(np.maximum(value[..., 0], value[..., 1]), value[..., 2])
            near &= least <= regions.high[:, slab].take(owner)[:, None]
            near &= most >= regions.low[:, slab].take(owner)[:, None]
        row, slot = np.nonzero(near)
        return owner.take(row), self.bvh.leaf_faces.take(leaf.take(row), axis=0)[np.arange(len(row)), slot]

    def _square(self, motions: Motions, owner: IntArray, face: IntArray) -> FloatArray:
        """Coordinates along the beam, ahead of it and normal to the sweep of the three corners (3, 3, k)."""
        axes = np.stack(
            [motions.direction, cross(motions.frame[:, 2], motions.direction), motions.frame[:, 2]], axis=1
        )
        corners = self.triangles.take(face, axis=0) - motions.base.take(owner, axis=0)[:, None]
        return np.asarray(np.einsum("kvj,ksj->svk", corners, axes.take(owner, axis=0)))

    def _narrow(self, motions: Motions, pieces: Callable[[FloatArray, FloatArray], Pieces]) -> Touches:
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
        self, motions: Motions, bound: FloatArray, pieces: Callable[[FloatArray, FloatArray], Pieces]
    ) -> Touches:
        regions = _swept(motions, bound)
        owner, leaf = self.bvh.leaves_in(regions)
        owner, face, local = self._crossing(motions, regions, owner, leaf)
        return _reduce(motions, owner, face, pieces(local, motions.length.take(owner)))

    def _along(self, motions: Motions) -> Touches:
        """Beams that move along themselves."""
        forward = np.einsum("ij,ij->i", motions.direction, motions.advance) > 0.0
        regions = _swept(motions, motions.limit)
        owner, leaf = self.bvh.leaves_in(regions)
        owner, face, local = self._crossing(motions, regions, owner, leaf)
        found = axial_pieces(local, motions.length.take(owner), forward.take(owner))
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
        reached = front <= regions.high[:, 1].take(owner)[:, None]
        reached = reached.view(np.int8).reshape(len(leaf), self.bvh.leaf_faces.shape[1], 3)
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

    def _bound(self, motions: Motions, pieces: Callable[[FloatArray, FloatArray], Pieces]) -> FloatArray:
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
        nearer = fine_travel[rows, finer] < travel[rows, best]
        return np.asarray(np.where(nearer, fine_face[rows, finer], face[rows, best]))

    def _rays_ahead(self, motions: Motions, share: FloatArray) -> tuple[IntArray, FloatArray]:
        k = share.shape[1]
        starts = (
            motions.base[:, None] + (share * motions.length[:, None])[..., None] * motions.direction[:, None]
        )
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


def _axial(motions: Motions) -> NDArray[np.bool_]:
    """Which beams move along themselves (n,)."""
    if motions.turning:
        return np.zeros(len(motions.base), dtype=np.bool_)
    sine = np.linalg.norm(cross(motions.direction, motions.advance), axis=1)
    return np.asarray(sine < AXIAL)


def _swept(motions: Motions, bound: FloatArray, radius: float = 0.0) -> Regions:
    """What the beams sweep until the bound, as regions for the tree."""
    n = len(bound)
    normal, ahead, along = motions.frame[:, 2], motions.frame[:, 1], motions.frame[:, 0]
    low, high = np.zeros((n, 3)), np.zeros((n, 3))
    centre = reach = None
    if motions.turning:
        # Up to a half turn the sector is convex: before the beam's last position, ahead of its first.
        c, s = np.cos(bound)[:, None], np.sin(bound)[:, None]
        slabs = np.stack([normal, c * ahead - s * along, ahead], axis=1)
        low[:, 1], high[:, 1], high[:, 2] = -np.inf, TIE, np.inf
        centre, reach = motions.base, motions.length + SLACK + radius
    else:
        slabs = np.stack([normal, ahead, along], axis=1)
        axial = _axial(motions)
        forward = np.einsum("ij,ij->i", motions.direction, motions.advance) > 0.0
        high[:, 1] = np.where(axial, 0.0, bound + TIE)
        low[:, 2] = np.where(axial & ~forward, -bound, 0.0)
        high[:, 2] = motions.length + np.where(axial & forward, bound, 0.0)
    pad = SLACK + radius * np.linalg.norm(slabs, axis=2)
    shift = np.einsum("nsj,nj->ns", slabs, motions.base)
    return Regions(slabs=slabs, low=low + shift - pad, high=high + shift + pad, centre=centre, reach=reach)


def _features(
    motions: Motions, owner: IntArray, local: FloatArray, radius: float, bound: FloatArray
) -> Features:
    """Travel, up to the bound (n,), of motions owner (k,) to the features of a triangle each (3, 3, k)."""
    length = motions.length.take(owner)
    if motions.turning:
        return turn_features(local, length, radius, bound.take(owner) + TIE / length)
    along = dot(motions.advance, motions.direction)
    sine = np.linalg.norm(cross(motions.direction, motions.advance), axis=1)
    ahead = np.where(sine < AXIAL, 0.0, sine)
    return slide_features(local, length, radius, along.take(owner), ahead.take(owner))


def _reduce_features(
    motions: Motions, owner: IntArray, face: IntArray, features: Features, n: int
) -> Touches:
    """From all features to the first touch of each beam."""
    touches = _nothing(n)
    feature = features.travel.argmin(axis=0)
    travel = features.travel[feature, np.arange(len(owner))]
    travel = np.where(travel <= motions.limit.take(owner), travel, np.inf)
    best = _first_of(travel, owner, n)
    pick = _pick((travel == best.take(owner)) & np.isfinite(travel), owner, n)
    found = np.nonzero(pick >= 0)[0]
    pick = pick[found]
    touches.travel[found] = travel[pick]
    touches.face[found] = touches.near_face[found] = touches.far_face[found] = face[pick]
    touches.where[found] = features.where[feature[pick]]
    for name in ("distance", "near", "far"):
        getattr(touches, name)[found] = features.distance[feature[pick], pick]
    reach = touches.travel + (TIE / motions.length if motions.turning else TIE)
    free = np.isfinite(touches.travel) & (touches.where != Where.THROUGH) & (touches.travel > 0.0)
    close = np.nonzero((travel <= reach.take(owner)) & free.take(owner))[0]
    owner, face = owner.take(close), face.take(close)
    tied = features.travel.take(close, axis=1) <= reach.take(owner)
    place = features.distance.take(close, axis=1)
    low = np.where(tied, place, np.inf).min(axis=0)
    high = np.where(tied, place, -np.inf).max(axis=0)
    _note_ends(touches, owner, face, low, high)
    return touches


def _reduce(motions: Motions, owner: IntArray, face: IntArray, pieces: Pieces) -> Touches:
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
    for name in ("face", "near_face", "far_face"):
        getattr(touches, name)[rows] = face[pick]
    touches.where[rows] = pieces.where[pick]
    _spread(motions, touches, owner, face, pieces)
    return touches


def _spread(motions: Motions, touches: Touches, owner: IntArray, face: IntArray, pieces: Pieces) -> None:
    """The interval of the beam that lies within TIE of the surface at the touch."""
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
    _note_ends(touches, owner, face, np.minimum(ends[:, 0], ends[:, 1]), np.maximum(ends[:, 0], ends[:, 1]))


def _note_ends(touches: Touches, owner: IntArray, face: IntArray, low: FloatArray, high: FloatArray) -> None:
    """Fill in the touched interval of each beam from those (low, high) of the faces it touches."""
    n = len(touches.travel)
    least = _first_of(low, owner, n)
    most = -_first_of(-high, owner, n)
    # Of the faces that begin there, but for rounding, the one touched farthest along lies along the beam; of
    # those that end at the far end the one touched from farthest back.
    first, last = low <= least.take(owner) + TIE, high >= most.take(owner) - TIE
    ahead = np.where(first, -high, np.inf)
    back = np.where(last, low, np.inf)
    near = _pick(first & (ahead == _first_of(ahead, owner, n).take(owner)), owner, n)
    far = _pick(last & (back == _first_of(back, owner, n).take(owner)), owner, n)
    rows = np.nonzero(near >= 0)[0]
    touches.near[rows], touches.near_face[rows] = least[rows], face[near[rows]]
    touches.far[rows], touches.far_face[rows] = most[rows], face[far[rows]]


def _nothing(n: int) -> Touches:
    return Touches(
        travel=np.full(n, np.inf),
        distance=np.zeros(n),
        face=np.full(n, -1, dtype=np.int64),
        where=np.full(n, -1, dtype=np.int64),
        near=np.zeros(n),
        far=np.zeros(n),
        near_face=np.full(n, -1, dtype=np.int64),
        far_face=np.full(n, -1, dtype=np.int64),
    )


_FIELDS = ("travel", "distance", "face", "where", "near", "far", "near_face", "far_face")


def _put(into: Touches, rows: IntArray, touches: Touches) -> None:
    for name in _FIELDS:
        getattr(into, name)[rows] = getattr(touches, name)


def _join(parts: list[Touches]) -> Touches:
    """Touches of several batches as one."""
    if not parts:
        return _nothing(0)
    if len(parts) == 1:
        return parts[0]
    return Touches(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS})
