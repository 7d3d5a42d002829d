"""Where a beam touches the smooth surface that a mesh stands for, from where it touches the mesh.

On a mesh a beam's side lies on an edge or a vertex, whose smooth normal leans against the beam by up to half a
facet's turn. The smooth surface is touched beside it, where its normal is square to the beam. Around any place
of the mesh the surface is the paraboloid of the interpolated normal n and shape operator S there; seen from
the axis of a beam of radius r it is the one offset by r, whose shape operator is S / (1 + r S). A beam that is
moved by x along itself and back by h along its motion touches that paraboloid where two equations hold: height
zero, and normal square to the beam (docs/derivations-geometry.md). They are solved about the touched place,
then once more about the place thus found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.curvature import SmoothSurface
from contour.rays import RayCaster
from contour.topology import Topology
from contour.vectors import dot, unit

__all__ = ["GRAZING", "Beams", "Tangency", "tangencies"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FLAT = 0.1
"""Curvatures along the beam below this do not tell where along it the surface is touched [1/m]."""
STEPS = 3
"""Newton steps for each paraboloid; the equations are nearly linear."""
FAR = 20e-3
"""Farther along the beam than this no smooth surface is followed [m]."""
GRAZING = 0.05
"""A motion is taken to go against the surface at least this steeply, as a sine."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beams:
    """k beams at their contacts."""

    axis: FloatArray
    """The contact on the beam's axis (k, 3) [m]."""
    along: FloatArray
    """Unit, the beam's direction (k, 3)."""
    motion: FloatArray
    """Unit, the way it moves at the contact (k, 3)."""
    radius: float
    """[m]."""

    def rows(self, index: IntArray) -> Beams:
        """Some of the beams."""
        return Beams(
            axis=self.axis[index], along=self.along[index], motion=self.motion[index], radius=self.radius
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tangency:
    """Where k beams touch the smooth surface."""

    step: FloatArray
    """From the mesh contact along the beam (k,) [m]."""
    back: FloatArray
    """How much sooner along the motion the smooth surface is met (k,) [m]."""
    normal: FloatArray
    """Unit, of the smooth surface there, facing the beam (k, 3)."""
    face: IntArray
    """The face over which the place lies (k,)."""
    barycentric: FloatArray
    """And where on it (k, 3)."""


def tangencies(
    topology: Topology,
    surface: SmoothSurface,
    rays: RayCaster,
    face: IntArray,
    barycentric: FloatArray,
    facing: FloatArray,
    beams: Beams,
    *,
    fixed: BoolArray,
) -> Tangency:
    """The tangent points by k mesh contacts on faces (k,) at barycentric coordinates (k, 3).

    Where the surface is flat along the beam, or ends at a crease before it is square to the beam, the step
    stays zero; so it does for ``fixed`` (k,), beams that lie along the surface. ``facing`` are normals of the
    surface on the beams' side (k, 3).
    """
    first = _Paraboloid(topology, surface, face, barycentric, facing, beams.radius)
    back, normal = first.resting(beams)
    step, at, where = np.zeros(len(face)), face.copy(), barycentric.copy()
    rise = np.linalg.norm(np.ptp(topology.vertices[topology.corners[face]], axis=1), axis=1)
    x, h, square, told = first.touching(beams)
    rows = np.nonzero(told & ~fixed & (np.abs(h) < rise))[0]
    x, h, square = x[rows], h[rows], square[rows]
    some = beams.rows(rows)
    place = some.axis + x[:, None] * some.along - h[:, None] * some.motion - beams.radius * square
    below = _below(rays, place, square, rise[rows])
    met = np.nonzero((below >= 0) & (topology.face_patch[below] == topology.face_patch[face[rows]]))[0]
    rows, below, place = rows[met], below[met], place[met]
    share = _foot(topology.vertices[topology.corners[below]], place)
    second = _Paraboloid(topology, surface, below, share, square[met], beams.radius)
    x, h, square, told = second.touching(beams.rows(rows))
    good = np.nonzero(told & (np.abs(h) < rise[rows]))[0]
    rows = rows[good]
    step[rows], back[rows], normal[rows] = x[good], h[good], square[good]
    at[rows], where[rows] = below[good], share[good]
    return Tangency(step=step, back=back, normal=normal, face=at, barycentric=where)


class _Paraboloid:
    """The smooth surface, offset by the beam's radius, about its points over k places of the mesh."""

    def __init__(
        self,
        topology: Topology,
        surface: SmoothSurface,
        face: IntArray,
        barycentric: FloatArray,
        facing: FloatArray,
        radius: float,
    ) -> None:
        corners = topology.vertices[topology.corners[face]]
        normals, shape = surface.corner_normals(face), surface.shape_operator(face, barycentric)
        normal = unit(np.einsum("kc,kcj->kj", barycentric, normals))
        sign = np.where(dot(normal, facing) < 0.0, -1.0, 1.0)
        self._normal = sign[:, None] * normal
        shape = sign[:, None, None] * shape
        # The mesh sags by the parts b_i b_j / 2 of E . (n_j - n_i) along its sides E, which is E S E.
        following = [1, 2, 0]
        bends = np.einsum("kij,kij->ki", corners[:, following] - corners, normals[:, following] - normals)
        sag = 0.5 * sign * np.einsum("ki,ki,ki->k", barycentric, barycentric[:, following], bends)
        summit = np.einsum("kc,kcj->kj", barycentric, corners) + (sag + radius)[:, None] * self._normal
        self._summit = summit
        # S / (1 + r S) in two dimensions, from trace and determinant.
        trace = np.einsum("kii->k", shape)
        determinant = 0.5 * (trace * trace - np.einsum("kij,kji->k", shape, shape))
        plane = np.eye(3) - self._normal[:, :, None] * self._normal[:, None]
        shrink = 1.0 + radius * trace + radius * radius * determinant
        shape = shape + (radius * determinant)[:, None, None] * plane
        self._shape = shape / np.where(shrink > 0.1, shrink, 1.0)[:, None, None]

    def resting(self, beams: Beams) -> tuple[FloatArray, FloatArray]:
        """How far back (k,) the beam comes to height zero without moving along itself, and the normal."""
        terms = _Terms(self._normal, self._shape, beams.axis - self._summit, beams)
        back = np.zeros(len(beams.axis))
        for _ in range(STEPS):
            back -= terms.height(0.0, back) / terms.climb(0.0, back)
        return back, terms.normal(np.zeros_like(back), back)

    def touching(self, beams: Beams) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Step (k,), way back (k,) and normal (k, 3) where the beam is tangent; whether that can be told."""
        terms = _Terms(self._normal, self._shape, beams.axis - self._summit, beams)
        told = terms.dd > FLAT
        bend = np.where(told, terms.dd, 1.0)
        step, back = np.zeros(len(beams.axis)), np.zeros(len(beams.axis))
        for _ in range(STEPS):
            height, lean, climb = terms.height(step, back), terms.lean(step, back), terms.climb(step, back)
            # Newton: (lean, climb; bend, -dw) (dx, dh) = -(height, lean).
            minus = np.maximum(lean * terms.dw + climb * bend, 0.5 * climb * bend)
            step -= (height * terms.dw + climb * lean) / minus
            back -= (height * bend - lean * lean) / minus
        return step, back, terms.normal(step, back), told & (np.abs(step) < FAR)


class _Terms:
    """Height of beams over a paraboloid, from the parts of axis e, direction d and motion w along its normal
    (n) and in its tangent plane through the shape operator: ee = e S e, ed = e S d, and so on.
    """

    def __init__(self, normal: FloatArray, shape: FloatArray, gap: FloatArray, beams: Beams) -> None:
        self._unit = normal
        self._en, e = _parts(gap, normal)
        self._dn, d = _parts(beams.along, normal)
        self._wn, w = _parts(beams.motion, normal)
        self._turns = tuple(np.einsum("kij,kj->ki", shape, part) for part in (e, d, w))
        turned_e, turned_d, turned_w = self._turns
        self._ee, self._ed, self._ew = (dot(turned_e, part) for part in (e, d, w))
        self.dd = dot(turned_d, d)
        self.dw = dot(turned_d, w)
        self._ww = dot(turned_w, w)

    def height(self, x: FloatArray | float, h: FloatArray) -> FloatArray:
        """Of the axis moved by x along the beam and by h back, over the surface (k,) [m]."""
        square = self._ee + x * x * self.dd + h * h * self._ww
        square = square + 2.0 * (x * self._ed - h * self._ew - x * h * self.dw)
        return np.asarray(self._en + x * self._dn - h * self._wn + 0.5 * square)

    def lean(self, x: FloatArray | float, h: FloatArray) -> FloatArray:
        """Its rate with x: how much the normal leans along the beam (k,)."""
        return np.asarray(self._dn + self._ed + x * self.dd - h * self.dw)

    def climb(self, x: FloatArray | float, h: FloatArray) -> FloatArray:
        """Its rate with h (k,)."""
        return np.asarray(np.maximum(h * self._ww - self._wn - self._ew - x * self.dw, GRAZING))

    def normal(self, x: FloatArray, h: FloatArray) -> FloatArray:
        """Of the surface there, unit (k, 3)."""
        e, d, w = self._turns
        normal = self._unit + e + x[:, None] * d - h[:, None] * w
        return unit(normal)


def _parts(vectors: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Along the normal (k,), and the rest (k, 3)."""
    height = dot(vectors, normal)
    return height, vectors - height[:, None] * normal


def _below(rays: RayCaster, place: FloatArray, normal: FloatArray, rise: FloatArray) -> IntArray:
    """The face (k,) that a place (k, 3) by the surface lies over, -1 where there is none within the rise."""
    face, _ = rays.first_hits(place + rise[:, None] * normal, -normal, 2.0 * rise)
    return face


def _foot(corners: FloatArray, place: FloatArray) -> FloatArray:
    """Barycentric coordinates (k, 3) of the place on each triangle (k, 3, 3) under its point (k, 3)."""
    one, two, to = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], place - corners[:, 0]
    products = ((one, one), (one, two), (two, two), (to, one), (to, two))
    a, b, c, p, q = (dot(left, right) for left, right in products)
    share = np.stack([a * c - b * b - (c - b) * p - (a - b) * q, c * p - b * q, a * q - b * p], axis=1)
    # The ray that found the face may have met it beside its rim by a rounding.
    share = np.maximum(share, 0.0)
    total = share.sum(axis=1)[:, None]
    # On slivers too thin for these products the middle will do: the surface is solved about it, not there.
    return np.asarray(np.where(total > 0.0, share / np.where(total > 0.0, total, 1.0), 1.0 / 3.0))
