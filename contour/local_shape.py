"""What the surface is like where a beam touches it: normal, kind of contact, curvature along and across.

Between creases the mesh stands for the smooth surface it samples, on creases for the smooth curve. Directions at a
side contact: d along the beam, n the normal square to it, t = d x n across. Seen along d the body has a
silhouette in the plane of n and t; with the shape operator [[a, b], [b, c]] in (d, t) its curvature is c -
b^2 / a, not c.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from contour.creases import Creases
from contour.curvature import SmoothSurface
from contour.first_contact import Touches
from contour.motions import Motions
from contour.rays import RayCaster
from contour.sweep import Where
from contour.tangency import Beams, tangencies
from contour.topology import Topology
from contour.vectors import cross, dot, unit

__all__ = ["FirstContact", "TouchKind", "describe"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LINE = 5e-3
"""A beam that touches along more than this touches along a line [m]."""
LINE_FROM_CREASE = 2e-4
"""Where the touched part begins at a crease, more than this is enough [m]."""
LINE_SAG = 1e-6
"""But where the smooth surface bends away by more than this over the length, it is a facet's width [m]."""
PARALLEL = 0.02
"""A crease within this angle of the beam is a corner of the silhouette [rad]."""
NEARLY_PARALLEL = 1e-6
"""Within this one the crease no longer tells which way it faces [rad]."""
FLAT = 0.1
"""Curvatures along the beam below this do not tell the silhouette from the section [1/m]."""


class TouchKind(IntEnum):
    """What touches what."""

    NONE = -1
    """Nothing was met."""
    SIDE = 0
    """The beam's side and a smooth part of the surface."""
    EDGE = 1
    """The beam's side and a crease, or the near end of a line contact."""
    TIP = 2
    """The beam's end and a face."""
    BASE = 4
    """The root of the beam: the carrier runs into the body."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirstContact:
    """First contacts of n beams. Rows without one have ``hit`` False, kind NONE, indices -1 and zeros."""

    hit: BoolArray
    """Whether anything was met (n,)."""
    travel: FloatArray
    """Way to the touch, or the whole motion where nothing was met (n,) [m] or [rad]."""
    point: FloatArray
    """On the surface (n, 3) [m]."""
    distance: FloatArray
    """s along the beam's axis from its base (n,) [m]."""
    kind: NDArray[np.int8]
    """:class:`TouchKind` (n,)."""
    face: IntArray
    """(n,)."""
    body: IntArray
    """(n,)."""
    normal: FloatArray
    """Unit, facing the beam (n, 3); square to the beam but for TIP and BASE."""
    normal_smooth: FloatArray
    """Unit, of the smooth surface itself, facing the beam (n, 3); on a crease equal to ``normal``."""
    direction: FloatArray
    """The beam's direction at the touch (n, 3)."""
    curvature_along: FloatArray
    """Of the surface along the beam, positive where it bends away from it (n,) [1/m]; inf across a crease."""
    curvature_across: FloatArray
    """Of the silhouette seen along the beam (n,) [1/m]; inf where a crease runs along the beam."""
    lift: FloatArray
    """How far the smooth surface, or crease, stands above the mesh along the normal (n,) [m]; 0 for ends."""
    edge_direction: FloatArray
    """Unit tangent of the touched crease (n, 3); zero where there is none."""
    edge_interval: FloatArray
    """Offsets along t = direction x normal at which the crease's segment ends, the lesser first (n, 2) [m].
    """
    dihedral: FloatArray
    """Angle between the two sides of the crease (n,) [rad], pi at the rim of a sheet; 0 where there is none.
    """
    touching: BoolArray
    """Whether the beam touched where it stood, before any motion (n,)."""
    line: BoolArray
    """Whether it touches along a line (n,); the contact is then its end nearest the base."""


@dataclass(slots=True)
class _Rows:
    """The touched rows while they are described; k of them."""

    index: IntArray
    face: IntArray
    where: IntArray
    line: BoolArray
    axis: FloatArray  # contact on the beam's axis (k, 3), recentred
    distance: FloatArray
    along: FloatArray  # d
    motion: FloatArray  # the way the beam moves at the contact
    radius: float


@dataclass(slots=True)
class _Curve:
    """The creases that are felt; zeros in other rows."""

    felt: BoolArray  # (k,), not those at which a line on a surface ends
    tangent: FloatArray  # unit (k, 3)
    bend: FloatArray  # curvature vector (k, 3)

    @classmethod
    def on(cls, creases: Creases, edge: IntArray, point: FloatArray, felt: BoolArray) -> _Curve:
        """By the points (k, 3) at which the mesh is touched."""
        tangent, bend = np.zeros_like(point), np.zeros_like(point)
        tangent[felt], bend[felt] = creases.at(edge[felt], point[felt])
        return cls(felt=felt.copy(), tangent=tangent, bend=bend)


def describe(
    topology: Topology,
    surface: SmoothSurface,
    creases: Creases,
    rays: RayCaster,
    body: IntArray,
    motions: Motions,
    touches: Touches,
    centre: FloatArray,
    radius: float,
) -> FirstContact:
    """The contacts at which first touches happen.

    Args:
        topology: of the mesh, recentred.
        surface: the smooth surface it stands for.
        creases: the curves that its sharp edges stand for.
        rays: over its faces.
        body: body of each face (f,).
        motions: of the beams, recentred.
        touches: their first touches.
        centre: what was subtracted from world coordinates (3,) [m].
        radius: of the beam [m].
    """
    n = len(touches.travel)
    contact = _blank(n, np.where(np.isfinite(touches.travel), touches.travel, motions.limit))
    contact.hit[:] = np.isfinite(touches.travel)
    contact.touching[:] = touches.travel == 0.0
    rows = _rows(topology, surface, motions, touches, radius)
    if not len(rows.index):
        return contact
    at = rows.index
    barycentric = _barycentric(topology.vertices[topology.corners[rows.face]], rows.axis, radius)
    point = np.einsum("kc,kcj->kj", barycentric, topology.vertices[topology.corners[rows.face]])
    edge = _edges(topology, rows, barycentric)
    crease = (edge >= 0) & topology.sharp[edge]
    # Where a line ends at a crease, its normal and the silhouette are still those of the surface it lies on.
    ends_line = crease & rows.line & ~_runs_along(topology, rows, edge)
    normal, smooth = _normals(topology, surface, rows, barycentric, edge, crease & ~ends_line, point)
    spot = point.copy() if radius > 0.0 else rows.axis.copy()
    ends = (rows.where == Where.TIP) | (rows.where == Where.BASE)
    moved = (rows.where < Where.TIP) & ~contact.touching[at]
    bent = np.nonzero(moved & ~(crease & ~ends_line))[0]
    found = tangencies(
        topology,
        surface,
        rays,
        rows.face[bent],
        barycentric[bent],
        smooth[bent],
        _beams(rows, bent),
        fixed=rows.line[bent],
    )
    smooth[bent] = found.normal
    normal[bent] = unit(found.normal - dot(found.normal, rows.along[bent])[:, None] * rows.along[bent])
    contact.lift[at[bent]] = -found.back * dot(rows.motion[bent], normal[bent])
    spot[bent] = rows.axis[bent] + found.step[:, None] * rows.along[bent] - radius * normal[bent]
    rows.distance[bent] += found.step
    rows.face[bent], barycentric[bent] = found.face, found.barycentric
    curve = _Curve.on(creases, edge, point, crease & ~ends)
    curve.felt &= ~ends_line
    on = np.nonzero(curve.felt & moved & ~rows.line & ~_runs_along(topology, rows, edge))[0]
    touch = creases.touched(edge[on], point[on], normal[on], _beams(rows, on))
    normal[on] = smooth[on] = touch.normal
    contact.lift[at[on]] = -touch.back * dot(rows.motion[on], normal[on])
    curve.tangent[on], curve.bend[on] = touch.tangent, touch.curve
    contact.point[at] = spot + centre
    contact.distance[at] = rows.distance
    contact.face[at], contact.body[at] = rows.face, body[rows.face]
    contact.direction[at], contact.normal[at], contact.normal_smooth[at] = rows.along, normal, smooth
    contact.line[at] = rows.line
    kind = np.where(crease | rows.line, TouchKind.EDGE, TouchKind.SIDE)
    kind = np.where(rows.where == Where.TIP, TouchKind.TIP, kind)
    contact.kind[at] = np.where(rows.where == Where.BASE, TouchKind.BASE, kind)
    _curvatures(contact, topology, surface, rows, barycentric, edge, curve)
    _creases(contact, topology, at, point, edge, curve, crease & ~ends)
    return contact


def _blank(n: int, travel: FloatArray) -> FirstContact:
    return FirstContact(
        hit=np.zeros(n, dtype=np.bool_),
        travel=travel,
        point=np.zeros((n, 3)),
        distance=np.zeros(n),
        kind=np.full(n, TouchKind.NONE, dtype=np.int8),
        face=np.full(n, -1, dtype=np.int64),
        body=np.full(n, -1, dtype=np.int64),
        normal=np.zeros((n, 3)),
        normal_smooth=np.zeros((n, 3)),
        direction=np.zeros((n, 3)),
        curvature_along=np.zeros(n),
        curvature_across=np.zeros(n),
        lift=np.zeros(n),
        edge_direction=np.zeros((n, 3)),
        edge_interval=np.zeros((n, 2)),
        dihedral=np.zeros(n),
        touching=np.zeros(n, dtype=np.bool_),
        line=np.zeros(n, dtype=np.bool_),
    )


def _rows(
    topology: Topology, surface: SmoothSurface, motions: Motions, touches: Touches, radius: float
) -> _Rows:
    index = np.nonzero(np.isfinite(touches.travel))[0]
    base, along, motion = motions.rows(index).moved(touches.travel[index])
    line = _lines(topology, surface, touches, index, base, along, radius)
    distance = np.where(line, touches.near[index], touches.distance[index])
    return _Rows(
        index=index,
        face=np.where(line, touches.near_face[index], touches.face[index]),
        # Tip or base may lie on the line as well; what is felt is its near end.
        where=np.where(line, Where.EDGE_0, touches.where[index]),
        line=line,
        axis=base + distance[:, None] * along,
        distance=distance,
        along=along,
        motion=motion,
        radius=radius,
    )


def _lines(
    topology: Topology,
    surface: SmoothSurface,
    touches: Touches,
    index: IntArray,
    base: FloatArray,
    along: FloatArray,
    radius: float,
) -> BoolArray:
    """Which of the touches index (k,) by beams at base along (k, 3) are lines (k,)."""
    line = np.zeros(len(index), dtype=np.bool_)
    span = touches.far[index] - touches.near[index]
    long = np.nonzero((span > LINE_FROM_CREASE) & (touches.where[index] < Where.THROUGH))[0]
    if not len(long):
        return line
    span, base, along, index = span[long], base[long], along[long], index[long]
    # On a smooth surface a facet that happens to lie along the beam is no line: its surface is bent.
    ends = []
    for place, at in ((touches.near, touches.near_face), (touches.far, touches.far_face)):
        corners = topology.vertices[topology.corners[at[index]]]
        ends.append(_barycentric(corners, base + place[index, None] * along, radius))
    near_face = touches.near_face[index]
    one, two = surface.normal(near_face, ends[0]), surface.normal(touches.far_face[index], ends[1])
    two = np.where((dot(one, two) < 0.0)[:, None], -two, two)
    sag = np.abs(dot(two - one, along)) * span / 8.0
    creased = (_on_edges(ends[0]) & topology.sharp[topology.face_edges[near_face]]).any(axis=1)
    line[long] = (span > np.where(creased, LINE_FROM_CREASE, LINE)) & (sag < LINE_SAG)
    return line


def _beams(rows: _Rows, index: IntArray) -> Beams:
    return Beams(
        axis=rows.axis[index], along=rows.along[index], motion=rows.motion[index], radius=rows.radius
    )


def _on_edges(barycentric: FloatArray) -> BoolArray:
    """Which of its face's edges a point lies on (k, 3)."""
    return np.asarray(barycentric[:, [2, 0, 1]] < 1e-6)  # edge i is opposite corner i + 2


def _barycentric(corners: FloatArray, point: FloatArray, radius: float) -> FloatArray:
    """Of the place on each triangle (k, 3, 3) that is nearest to the point (k, 3)."""
    if radius > 0.0:
        return _closest(corners, point)
    # The point lies on the triangle but for rounding.
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    from_point = corners - point[:, None]
    parts = cross(from_point[:, [1, 2, 0]], from_point[:, [2, 0, 1]])
    weights = np.maximum(np.einsum("kcj,kj->kc", parts, normal), 0.0)
    return np.asarray(weights / weights.sum(axis=1)[:, None])


def _closest(corners: FloatArray, point: FloatArray) -> FloatArray:
    """Barycentric coordinates (k, 3) of the place on each triangle (k, 3, 3) nearest to its point (k, 3)."""
    k = len(point)
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    from_point = corners - point[:, None]
    weights = np.einsum("kcj,kj->kc", cross(from_point[:, [1, 2, 0]], from_point[:, [2, 0, 1]]), normal)
    best = weights / weights.sum(axis=1)[:, None]
    outside = (weights < 0.0).any(axis=1)
    gap = np.where(outside, np.inf, -1.0)
    for i in range(3):
        start, side = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
        share = dot(point - start, side) / dot(side, side)
        share = np.clip(share, 0.0, 1.0)
        distance = np.linalg.norm(start + share[:, None] * side - point, axis=1)
        nearer = np.nonzero(distance < gap)[0]
        gap[nearer] = distance[nearer]
        best[nearer] = 0.0
        best[nearer, i] = 1.0 - share[nearer]
        best[nearer, (i + 1) % 3] = share[nearer]
    assert best.shape == (k, 3)
    return np.asarray(best)


def _edges(topology: Topology, rows: _Rows, barycentric: FloatArray) -> IntArray:
    """The mesh edge that is touched (k,), -1 inside a face."""
    k = np.arange(len(rows.face))
    on = _on_edges(barycentric)
    edges = topology.face_edges[rows.face]
    # At the near end of a line the edge that ends it is felt, unless the line runs along a crease.
    corner = on & topology.sharp[edges]
    for i in range(3):
        corner[:, i] &= _runs_along(topology, rows, edges[:, i])
    local = np.where(on.any(axis=1), on.argmax(axis=1), -1)
    local = np.where(corner.any(axis=1), corner.argmax(axis=1), local)
    local = np.where(rows.line, local, np.where(rows.where < Where.TIP, rows.where, -1))
    edge = np.where(local >= 0, edges[k, local], -1)
    # At a vertex the crease through it is what is felt, whichever edge was met first.
    at_vertex = (np.sort(barycentric, axis=1)[:, 1] < 1e-9) & (edge >= 0) & ~rows.line
    crease = topology.crease_at[topology.corners[rows.face, np.argmax(barycentric, axis=1)]]
    return np.where(at_vertex & ~topology.sharp[edge] & (crease >= 0), crease, edge)


def _runs_along(topology: Topology, rows: _Rows, edge: IntArray) -> BoolArray:
    """Whether edges (k,) are parallel to the beams."""
    ends = topology.vertices[topology.edge_vertices[edge]]
    cosine = dot(unit(ends[:, 1] - ends[:, 0]), rows.along)
    return np.asarray(np.abs(cosine) > np.cos(PARALLEL))


def _normals(
    topology: Topology,
    surface: SmoothSurface,
    rows: _Rows,
    barycentric: FloatArray,
    edge: IntArray,
    crease: BoolArray,
    point: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The contact normal and the smooth surface's, both facing the beam (k, 3)."""
    smooth = surface.normal(rows.face, barycentric)
    ends = topology.vertices[topology.edge_vertices[edge]]
    side = unit(ends[:, 1] - ends[:, 0])
    across = cross(side, rows.along)
    sine = np.linalg.norm(across, axis=1)
    told = (edge >= 0) & (sine > NEARLY_PARALLEL)
    facing = np.where(told[:, None], across / np.where(told, sine, 1.0)[:, None], topology.normals[rows.face])
    away = dot(facing, rows.motion)
    facing = np.where((away > 0.0)[:, None], -facing, facing)
    if rows.radius > 0.0:
        gap = rows.axis - point
        apart = np.linalg.norm(gap, axis=1)
        clear = apart > 0.5 * rows.radius  # less only for beams that stand inside the surface from the start
        facing = np.where(clear[:, None], gap / np.where(clear, apart, 1.0)[:, None], facing)
    turned = dot(smooth, facing) < 0.0
    smooth = np.where(turned[:, None], -smooth, smooth)
    if rows.radius <= 0.0:
        corner = np.nonzero(crease & ~told & (rows.where < Where.TIP))[0]
        facing[corner] = _corner_normal(topology, rows.along[corner], rows.motion[corner], edge[corner])
    by_end = (rows.where == Where.TIP) | (rows.where == Where.BASE)
    smooth = np.where(crease[:, None] & ~by_end[:, None], facing, smooth)
    normal = smooth - dot(smooth, rows.along)[:, None] * rows.along
    length = np.linalg.norm(normal, axis=1)
    # A beam that pierces a face head on has no normal square to it but the way it came.
    lost = length < NEARLY_PARALLEL
    normal = np.where(lost[:, None], -rows.motion, normal / np.where(lost, 1.0, length)[:, None])
    return np.where(by_end[:, None], smooth, normal), smooth


def _corner_normal(topology: Topology, along: FloatArray, motion: FloatArray, edge: IntArray) -> FloatArray:
    """For creases along the beam: against the motion, but no further round than the two sides face."""
    faces = topology.edge_faces[edge]
    faces = np.where(faces >= 0, faces, faces[:, :1])
    sides = topology.normals[faces]
    flip = np.einsum("kcj,kj->kc", sides, motion) > 0.0
    sides = np.where(flip[..., None], -sides, sides)
    back = unit(dot(motion, along)[:, None] * along - motion)
    turn = cross(along, back)
    angle = np.arctan2(np.einsum("kcj,kj->kc", sides, turn), np.einsum("kcj,kj->kc", sides, back))
    nearest = np.clip(0.0, angle.min(axis=1), angle.max(axis=1))
    return np.asarray(np.cos(nearest)[:, None] * back + np.sin(nearest)[:, None] * turn)


def _curvatures(
    contact: FirstContact,
    topology: Topology,
    surface: SmoothSurface,
    rows: _Rows,
    barycentric: FloatArray,
    edge: IntArray,
    curve: _Curve,
) -> None:
    at = rows.index
    normal = contact.normal[at]
    by_end = np.isin(contact.kind[at], [TouchKind.TIP, TouchKind.BASE])
    # An end's normal is not square to the beam: take the directions along and across within the surface.
    first = rows.along - np.where(by_end, dot(rows.along, normal), 0.0)[:, None] * normal
    head_on = np.linalg.norm(first, axis=1) < NEARLY_PARALLEL
    first[head_on] = cross(normal[head_on], np.eye(3)[np.argmin(np.abs(normal[head_on]), axis=1)])
    first = unit(first)
    second = cross(first, normal)
    shape = surface.shape_operator(rows.face, barycentric)
    raw = surface.normal(rows.face, barycentric)
    sign = np.where(dot(raw, normal) < 0.0, -1.0, 1.0)
    shape = shape * sign[:, None, None]
    a = np.einsum("ki,kij,kj->k", first, shape, first)
    b = np.einsum("ki,kij,kj->k", first, shape, second)
    c = np.einsum("ki,kij,kj->k", second, shape, second)
    across = np.where(by_end, c, c - b * b * a / (a * a + FLAT * FLAT))
    cosine = dot(curve.tangent, rows.along)
    square = np.maximum(1.0 - cosine**2, PARALLEL**2)
    turn = 0.0 - dot(curve.bend, normal)
    along_beam = _runs_along(topology, rows, edge)
    bluff = np.where(curve.felt & along_beam, turn, np.where(curve.felt, np.inf, a))
    contact.curvature_along[at] = np.where(rows.line, np.inf, bluff)
    contact.curvature_across[at] = np.where(curve.felt, np.where(along_beam, np.inf, turn / square), across)


def _creases(
    contact: FirstContact,
    topology: Topology,
    at: IntArray,
    point: FloatArray,
    edge: IntArray,
    curve: _Curve,
    crease: BoolArray,
) -> None:
    at, point, edge = at[crease], point[crease], edge[crease]
    ends = topology.vertices[topology.edge_vertices[edge]]
    contact.edge_direction[at] = curve.tangent[crease]
    contact.dihedral[at] = topology.dihedral[edge]
    across = cross(contact.direction[at], contact.normal[at])
    contact.edge_interval[at] = np.sort(np.einsum("kej,kj->ke", ends - point[:, None], across), axis=1)
