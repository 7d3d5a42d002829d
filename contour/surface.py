"""From points with outward normals, lying on contours, to one triangle surface with trust at every vertex.

:func:`reconstruct` does it; METHODS names the ways. All of them make an implicit field, zero on the surface and
positive outside (:mod:`contour.hermite`), and draw its zero level (:mod:`contour.isosurface`). Where no point
is near the surface is a guess, however smooth it looks: ``trust`` and ``sigma`` say where. docs/surface.md has
the measurements behind the choice.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

from contour.contacts import Kind
from contour.errors import UsageError
from contour.hermite import Layers, Observations, Wide, fit_layers, fit_wide, nearest_sigma
from contour.isosurface import Triangles, closed, sample, triangles

__all__ = ["METHODS", "MINIMUM", "Samples", "Surface", "observations", "reconstruct", "samples_of"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

METHODS = ("auto", "hermite", "layers")
"""auto: whichever of the others suits the number of points. hermite: one process through all points, cubic in
their number. layers: one through a spread of them, corrected by sparse ones through the rest."""
MINIMUM = 20
"""Points that a surface needs at least."""
GLOBAL = 1000
"""Points up to which ``auto`` takes ``hermite``."""
MOST_GLOBAL = 2000
"""Points up to which ``hermite`` works: 0.5 GB and the better part of a minute."""

SIGMA_POINT = 0.1e-3
SIGMA_NORMAL = float(np.deg2rad(1.0))
"""Where the caller does not say."""
LEAST_POINT = 10e-6
LEAST_NORMAL = float(np.deg2rad(0.3))
"""No point and no normal is trusted more than this: equal places may disagree."""
SLACK = 0.1
"""The gradient's length is one only for a signed distance, which a smooth field is not everywhere."""
UNSEEN_SLACK = 0.25
UNSEEN_MEAN = 0.85
"""Length of the part of a unit normal that was seen, where a part of it was not: between 0.5 and 1."""
UNSEEN = 0.5
"""Length of the part that was not seen, of either sign."""

PAD = 0.08
"""Room around the points, in their longest edge."""
CELLS, MOST_CELLS = 80, 200
"""Grid cells along the longest edge; more, up to the second, where the body is thin."""
CELLS_THROUGH = 3.0
"""Grid cells through the thinnest parts."""
OPPOSITE = -0.5
"""Cosine of the angle between normals on both sides of a thin part, at most."""
ROUND = 48
"""Neighbours among which the other side is looked for."""
SUPPORT = 3
"""Points that a piece of surface needs; others are the field's inventions."""
FAR = 0.1
"""Distance from any point beyond which the surface counts as untouched, in the longest edge."""
FLAT = 1e-3
"""Thickness of points that lie on one plane, over their extent."""
TOUCH = 20e-6
"""Standard deviation of a contact's place square to the beam [m]."""
SEEN_TURN = 0.05
"""Normals of a contour that vary less than this do not tell its plane [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A triangle surface, and what it rests on."""

    vertices: FloatArray
    """(v, 3) m."""
    faces: IntArray
    """(f, 3) indices into vertices, counter-clockwise seen from outside."""
    normals: FloatArray
    """(v, 3) outward unit normals."""
    trust: FloatArray
    """(v,) m, distance to the nearest point on the same side: whose normal is less than 90 deg off."""
    sigma: FloatArray
    """(v,) m, standard deviation of the surface's place along its normal, given the nearest points."""
    method: str
    """One of METHODS, never ``auto``."""
    watertight: bool
    """Whether every edge has two faces. False where too little was touched for the surface to close."""
    touched: float
    """Share of the area with a point within a tenth of the longest edge."""
    notes: tuple[str, ...]
    """What could not be done, a line each."""
    seconds: float
    """Processor time [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """n points with normals, as :func:`reconstruct` wants them."""

    points: FloatArray
    """(n, 3) m."""
    normals: FloatArray
    """(n, 3) outward unit normals."""
    unseen: FloatArray
    """(n, 3) unit vector along which the normal's part is not known; zero where the whole normal is known."""
    sigma_normal: FloatArray
    """(n,) rad."""
    sigma_point: FloatArray
    """(n,) m, along the normal."""


def samples_of(columns: Mapping[str, NDArray[Any]]) -> Samples:
    """Points of the unflagged contacts in ``columns``, a table as ``contour.cloud.read_csv`` gives it.

    The side of the beam lies along the surface, so its normals are whole. Of a tip's normal the part within the
    sensing plane is known; along the beam, which all normals of a contour are square to, it is not. Tips of
    contours whose normals do not tell the beam's direction are left out. Smoothed normals are used if the table
    has them.
    """
    smooth = "smooth_nx" in columns
    names = [f"smooth_n{axis}" if smooth else f"n{axis}" for axis in "xyz"]
    normals = np.stack([columns[name] for name in names], axis=1).astype(np.float64)
    points = np.stack([columns[f"{axis}_m"] for axis in "xyz"], axis=1).astype(np.float64)
    sigma = columns["sigma_smooth_normal_rad" if smooth else "sigma_normal_rad"].astype(np.float64)
    good = (columns["flags"] == 0) & np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    tip = columns["kind"] == Kind.TIP
    beam = np.zeros_like(points)
    for contour in np.unique(columns["contour"][good]):
        rows = np.flatnonzero((columns["contour"] == contour) & good)
        _, spread, axes = np.linalg.svd(normals[rows])
        if rows.size > 1 and spread[1] > SEEN_TURN * np.sqrt(rows.size):
            beam[rows] = axes[2]
    good &= ~tip | (np.linalg.norm(beam, axis=1) > 0.5)
    along = UNSEEN * columns["sigma_s_m"].astype(np.float64)
    return Samples(
        points=points[good],
        normals=normals[good],
        unseen=np.where(tip[:, None], beam, 0.0)[good],
        sigma_normal=sigma[good],
        sigma_point=np.where(tip, np.hypot(TOUCH, along), TOUCH)[good],
    )


def reconstruct(
    points: FloatArray,
    normals: FloatArray,
    *,
    unseen: FloatArray | None = None,
    sigma_normal: FloatArray | None = None,
    sigma_point: FloatArray | None = None,
    method: str = "auto",
    spacing: float | None = None,
) -> Surface:
    """The surface through ``points`` (n, 3) [m] with outward ``normals`` (n, 3).

    Args:
        points: on the surface; leave out those that are flagged.
        normals: need not be of length one.
        unseen: (n, 3), along which a normal's part is not known, as at the beam's tip; zero where it is.
        sigma_normal: (n,) rad, standard deviation of the normals where they were seen.
        sigma_point: (n,) m, standard deviation of the points along their normals.
        method: one of METHODS.
        spacing: grid on which the surface is drawn [m]; by default from the size and the thinnest parts.

    Raises:
        UsageError: too few points, all on one plane, numbers that are not finite, an unknown method.
    """
    begun = time.process_time()
    observed = observations(points, normals, unseen, sigma_normal, sigma_point)
    chosen = _chosen(method, len(observed.points))
    field: Wide | Layers = fit_wide(observed) if chosen == "hermite" else fit_layers(observed)
    low, high = observed.points.min(axis=0), observed.points.max(axis=0)
    size = float(np.max(high - low))
    if spacing is None:
        spacing = float(np.clip(_thinnest(observed) / CELLS_THROUGH, size / MOST_CELLS, size / CELLS))
    elif not 0.0 < spacing < size:
        raise UsageError(
            f"spacing is {spacing:.3g} m: it must be above 0 and below the points' extent of {size:.3g} m"
        )
    grid = sample(field, low - PAD * size, high + PAD * size, spacing)
    kept = _supported(triangles(grid), observed.points, spacing)
    if not len(kept.faces):
        raise UsageError(
            f"no surface goes through the {len(observed.points)} points: their normals contradict each other; "
            "check that they point outwards"
        )
    slope = field.gradient(kept.vertices)
    steep = np.maximum(np.einsum("vj,vj->v", slope, slope), 0.25)
    back = np.clip(field(kept.vertices) / steep, -0.5 * spacing, 0.5 * spacing)
    vertices = kept.vertices - back[:, None] * slope
    normal = slope / np.linalg.norm(slope, axis=1)[:, None]
    watertight = closed(kept.faces)
    corners = vertices[kept.faces]
    if watertight and np.linalg.det(corners - corners.mean(axis=(0, 1))).sum() < 0.0:
        raise UsageError("the normals point into the body: turn them round, they must point outwards")
    trust = _to_support(vertices, normal, observed)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    near = trust[kept.faces].max(axis=1) <= FAR * size
    touched = float(area[near].sum() / area.sum())
    return Surface(
        vertices=vertices,
        faces=kept.faces,
        normals=normal,
        trust=trust,
        sigma=nearest_sigma(observed, vertices),
        method=chosen,
        watertight=watertight,
        touched=touched,
        notes=_notes(touched, FAR * size, watertight=watertight),
        seconds=time.process_time() - begun,
    )


def observations(
    points: FloatArray,
    normals: FloatArray,
    unseen: FloatArray | None = None,
    sigma_normal: FloatArray | None = None,
    sigma_point: FloatArray | None = None,
) -> Observations:
    """The arguments of :func:`reconstruct`, checked, as what the field's process observes."""
    p = np.array(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3:
        raise UsageError(f"points have shape {p.shape}: give (n, 3), a row a point, in metres")
    n = len(p)
    if n < MINIMUM:
        raise UsageError(
            f"{n} points are too few for a surface: at least {MINIMUM} are needed; scan more contours"
        )
    no_part = np.zeros((n, 3))
    normal = _checked("normals", normals, (n, 3))
    hidden = no_part if unseen is None else _checked("unseen", unseen, (n, 3))
    turn = np.full(n, SIGMA_NORMAL) if sigma_normal is None else _checked("sigma_normal", sigma_normal, (n,))
    off = np.full(n, SIGMA_POINT) if sigma_point is None else _checked("sigma_point", sigma_point, (n,))
    _checked("points", p, (n, 3))
    for name, sigma in (("sigma_normal", turn), ("sigma_point", off)):
        if np.any(sigma < 0.0):
            raise UsageError(f"{name} of point {int(np.argmin(sigma))} is negative: give standard deviations")
    length = np.linalg.norm(normal, axis=1)
    if np.any(length < 1e-9):
        raise UsageError(f"the normal of point {int(np.argmin(length))} is zero: leave the point out")
    thickness = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if thickness[2] <= FLAT * thickness[0]:
        raise UsageError(
            f"all {n} points lie on one plane or line: a surface needs contours in several planes; scan more"
        )
    normal /= length[:, None]
    long = np.linalg.norm(hidden, axis=1)
    partly = long > 1e-9
    hidden[partly] /= long[partly, None]
    slack = np.where(partly, UNSEEN_SLACK, SLACK)
    noise = np.maximum(turn, LEAST_NORMAL)[:, None, None] ** 2 * np.eye(3)
    noise += slack[:, None, None] ** 2 * normal[:, :, None] * normal[:, None, :]
    noise += UNSEEN**2 * hidden[:, :, None] * hidden[:, None, :]
    return Observations(
        points=p,
        values=np.zeros(n),
        gradients=np.where(partly, UNSEEN_MEAN, 1.0)[:, None] * normal,
        value_noise=np.maximum(off, LEAST_POINT) ** 2,
        gradient_noise=noise,
    )


def _checked(name: str, values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise UsageError(f"{name} have shape {array.shape}: give {shape}, a row for each of the points")
    bad = ~np.isfinite(array.reshape(shape[0], -1)).all(axis=1)
    if bad.any():
        raise UsageError(
            f"{name} of {int(bad.sum())} points are not finite, first of point {int(np.argmax(bad))}: "
            "leave such points out"
        )
    return array


def _chosen(method: str, count: int) -> str:
    """The method that is meant."""
    if method not in METHODS:
        raise UsageError(f"no surface method is called {method!r}: choose one of {', '.join(METHODS)}")
    if method == "hermite" and count > MOST_GLOBAL:
        raise UsageError(
            f"method 'hermite' takes at most {MOST_GLOBAL} points, not {count}: choose 'layers' or 'auto'"
        )
    if method == "auto":
        return "hermite" if count <= GLOBAL else "layers"
    return method


def _thinnest(observed: Observations) -> float:
    """Thickness [m] of the thinnest parts, or width of the narrowest gaps: points that face apart; or inf."""
    tree = KDTree(observed.points)
    count = min(ROUND, len(observed.points))
    apart, who = tree.query(observed.points, k=count)
    facing = np.einsum("nj,nkj->nk", observed.gradients, observed.gradients[who]) < OPPOSITE
    width = np.where(facing, apart, np.inf).min(axis=1)
    return float(np.quantile(width, 0.02, method="lower"))


def _to_support(vertices: FloatArray, normals: FloatArray, observed: Observations) -> FloatArray:
    """Distance (v,) [m] to the nearest observed point on the same side; walls and plates have another one."""
    tree = KDTree(observed.points)
    far = np.full(len(vertices), np.inf)
    left, count = np.arange(len(vertices)), min(ROUND // 4, len(observed.points))
    while left.size:  # most vertices find theirs at once
        apart, who = tree.query(vertices[left], k=count)
        like = np.einsum("vj,vkj->vk", normals[left], observed.gradients[who]) > 0.0
        far[left] = np.where(like, apart, np.inf).min(axis=1)
        left = left[np.isinf(far[left])] if count < len(observed.points) else left[:0]
        count = min(8 * count, len(observed.points))
    return far


def _supported(mesh: Triangles, points: FloatArray, spacing: float) -> Triangles:
    """The pieces of ``mesh`` that at least :data:`SUPPORT` of the ``points`` lie on."""
    if not len(mesh.faces):
        return mesh
    count = len(mesh.vertices)
    ends = mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = sparse.coo_array((np.ones(len(ends), dtype=np.int8), ends.T), shape=(count, count))
    pieces, piece = sparse.csgraph.connected_components(links, directed=False)
    apart, who = KDTree(mesh.vertices).query(points)
    good = np.bincount(piece[who], apart < 2.0 * spacing, pieces) >= SUPPORT
    faces = mesh.faces[good[piece[mesh.faces[:, 0]]]]
    used, faces_of_used = np.unique(faces, return_inverse=True)
    return Triangles(vertices=mesh.vertices[used], faces=faces_of_used.reshape(-1, 3))


def _notes(touched: float, far: float, *, watertight: bool) -> tuple[str, ...]:
    notes = []
    if touched < 0.995:
        notes.append(
            f"{100.0 * (1.0 - touched):.1f} % of the surface lies farther than {far * 1e3:.1f} mm from any point: "
            "a guess"
        )
    if not watertight:
        notes.append("the surface is open: too little was touched for it to close")
    return tuple(notes)
