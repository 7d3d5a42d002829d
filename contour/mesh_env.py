"""A mesh scene that can be touched: first contacts of moving beams, local shape, silhouettes, free segments.

All lengths are metres and all angles radians; points and directions are in the scene's world frame. A
contact's normal faces the side the beam came from, whichever way the mesh is wound; no question is ever asked
about inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from contour.creases import Creases
from contour.curvature import SmoothSurface
from contour.errors import UsageError
from contour.first_contact import FirstContactSolver
from contour.local_shape import FirstContact, TouchKind, describe
from contour.mesh_io import as_triangles, load_scene
from contour.motions import Motions, slides, turns
from contour.tangency import GRAZING
from contour.topology import build_topology

__all__ = ["FirstContact", "MeshEnvironment", "TouchKind"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SQUARE = 1e-6
"""Turning axes may lean by this much from the normal to their beam; the lean is taken out [rad]."""


class MeshEnvironment:
    """Bodies to touch.

    Args:
        mesh_or_scene: in metres; each placed geometry of a scene is a body.
        friction: Coulomb coefficient between beam and bodies, one for all or one for each.
        smoothing: rounds of averaging the curvature over neighbouring vertices, 0 to 3, for scanned meshes.

    >>> ball = MeshEnvironment(trimesh.creation.icosphere(subdivisions=4, radius=0.05))
    >>> contact = ball.first_contact([[0.1, 0, 0.1]], [[0, 0, -1]], 0.21, translation=[[-0.1, 0, 0]])
    >>> round(float(contact.travel[0]), 4), round(float(contact.distance[0]), 3)
    (0.05, 0.1)
    >>> TouchKind(contact.kind[0]).name, round(1 / float(contact.curvature_across[0]), 4)
    ('SIDE', 0.05)
    """

    def __init__(
        self,
        mesh_or_scene: trimesh.Trimesh | trimesh.Scene,
        *,
        friction: float | Sequence[float] = 0.0,
        smoothing: int = 0,
    ) -> None:
        triangles = as_triangles(mesh_or_scene)
        self.body_names: tuple[str, ...] = triangles.names
        """Names of the bodies."""
        self.friction: FloatArray = _frictions(friction, triangles.names)
        """Coulomb coefficient of each body (b,)."""
        self.body: IntArray = triangles.body
        """Body of each face (f,)."""
        corners = triangles.vertices[triangles.faces]
        self.bounds: FloatArray = np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
        """Least and largest coordinates (2, 3) [m]."""
        # Near the origin float32 and float64 both keep the most digits.
        self._centre = self.bounds.mean(axis=0)
        self.topology = build_topology(triangles.vertices - self._centre, triangles.faces, triangles.body)
        """Edges, creases and patches; its coordinates are relative to the middle of the bounds."""
        self.surface = SmoothSurface(self.topology, smoothing=smoothing)
        """The smooth surface that the mesh samples."""
        self.creases = Creases(self.topology, self.surface)
        """The smooth curves that its creases sample."""
        self._solver = FirstContactSolver(corners - self._centre)

    @classmethod
    def load(
        cls,
        path: str | Path,
        unit: str | None = None,
        transform: ArrayLike | None = None,
        *,
        friction: float | Sequence[float] = 0.0,
        smoothing: int = 0,
    ) -> Self:
        """The environment of a mesh or scene file; see :func:`contour.mesh_io.load_scene`."""
        scene = load_scene(path, unit=unit, transform=transform)
        try:
            return cls(scene, friction=friction, smoothing=smoothing)
        except UsageError as error:
            raise UsageError(f"{error} (from {path})") from error

    @property
    def triangles(self) -> FloatArray:
        """Vertices of the faces (f, 3, 3) [m], in the world."""
        return np.asarray(self._solver.triangles + self._centre)

    @property
    def rays_cast(self) -> int:
        """Embree rays cast so far."""
        return self._solver.rays.rays_cast

    def first_contact(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        length: ArrayLike,
        *,
        translation: ArrayLike | None = None,
        rotation: tuple[ArrayLike, ArrayLike] | None = None,
        radius: float = 0.0,
    ) -> FirstContact:
        """Where n moving beams first touch.

        Args:
            origins: bases of the beams (n, 3) [m].
            directions: from base to tip (n, 3), of any length.
            length: of the beams, one number or (n,) [m].
            translation: how far and where to the bases move (n, 3) [m], or
            rotation: axes (n, 3) square to the beams, and angles (n,) [rad] of at most half a turn.
            radius: of the beams, which then are capsules about the line from base to tip [m].
        """
        if not (np.isfinite(radius) and radius >= 0.0):
            raise UsageError(f"beam radius is {radius!r} m: it must be a finite number, zero or above")
        motions = self._motions(origins, directions, length, translation, rotation)
        touches = self._solver.solve(motions, radius)
        return describe(
            self.topology,
            self.surface,
            self.creases,
            self._solver.rays,
            self.body,
            motions,
            touches,
            self._centre,
            radius,
        )

    def segments_hit(self, starts: ArrayLike, ends: ArrayLike) -> BoolArray:
        """Whether each straight segment from start (n, 3) to end (n, 3) [m] meets any body (n,)."""
        start, end = _vectors("starts", starts), _vectors("ends", ends)
        if start.shape != end.shape:
            raise UsageError(f"segments have starts {start.shape} but ends {end.shape}: give pairs")
        return self._solver.rays.blocked(start - self._centre, end - self._centre)

    def profile(
        self,
        points: ArrayLike,
        directions: ArrayLike,
        distances: ArrayLike,
        normals: ArrayLike,
        length: ArrayLike,
        offsets: ArrayLike,
        *,
        rise: float | None = None,
        depth: float | None = None,
        radius: float = 0.0,
    ) -> FloatArray:
        """The silhouette seen along the beam around n contacts: heights (n, m) [m] along the normal.

        The beam, its direction kept, is laid on the bodies at lateral offsets along t = direction x normal.
        The height is that of its axis above the contact, positive along the normal, on the smooth surface and
        the smooth creases that the mesh samples. It is -inf where nothing is met within the depth, and the
        rise where something already stands there.

        Args:
            points: on the beam's axis at the contacts (n, 3) [m].
            directions: unit, from base to tip (n, 3).
            distances: of the contacts from the base (n,) [m].
            normals: unit, square to the beams (n, 3).
            length: of the beams, one number or (n,) [m].
            offsets: along t (n, m) or (m,) [m].
            rise: height to start from; without it the largest offset [m].
            depth: how far below the contact to look; without it twice the largest offset [m].
            radius: of the beams [m].
        """
        point, direction, normal = _vectors("points", points), _unit(directions), _unit(normals)
        n = len(point)
        offset = np.asarray(offsets, dtype=np.float64)
        offset = np.broadcast_to(offset, (n, offset.shape[-1]))
        widest = float(np.abs(offset).max(initial=0.0))
        rise = widest if rise is None else rise
        depth = 2.0 * widest if depth is None else depth
        if not rise + depth > 0.0:
            raise UsageError(f"profile has rise {rise} m and depth {depth} m: their sum must be above zero")
        base = point - np.asarray(distances, dtype=np.float64)[:, None] * direction + rise * normal
        lateral = np.cross(direction, normal)
        m = offset.shape[1]
        contact = self.first_contact(
            (base[:, None] + offset[..., None] * lateral[:, None]).reshape(-1, 3),
            np.repeat(direction, m, axis=0),
            np.repeat(np.broadcast_to(np.asarray(length, dtype=np.float64), (n,)), m),
            translation=np.repeat(-(rise + depth) * normal, m, axis=0),
            radius=radius,
        )
        facing = np.maximum(np.einsum("ij,ij->i", contact.normal, np.repeat(normal, m, axis=0)), GRAZING)
        heights = np.where(contact.hit, rise - contact.travel + contact.lift / facing, -np.inf)
        return np.where(contact.touching, rise, heights).reshape(n, m)

    def _motions(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        length: ArrayLike,
        translation: ArrayLike | None,
        rotation: tuple[ArrayLike, ArrayLike] | None,
    ) -> Motions:
        base, direction = _vectors("origins", origins), _unit(directions)
        n = len(base)
        if len(direction) != n:
            raise UsageError(f"{n} origins but {len(direction)} directions: give one direction for each beam")
        reach = _scalars("length", length, n)
        if not (reach > 0.0).all():
            raise UsageError(f"a beam has length {reach.min()} m: lengths must be above zero")
        if translation is not None and rotation is None:
            move = _vectors("translation", translation)
            if len(move) != n:
                raise UsageError(f"{n} origins but {len(move)} translations: give one for each beam")
            return slides(base - self._centre, direction, reach, move)
        if rotation is not None and translation is None:
            axis, angle = _unit(rotation[0]), _scalars("rotation angles", rotation[1], n)
            if len(axis) != n:
                raise UsageError(f"{n} origins but {len(axis)} rotation axes: give one for each beam")
            lean = np.einsum("ij,ij->i", axis, direction)
            if (np.abs(lean) > SQUARE).any() or (np.abs(angle) > np.pi).any():
                raise UsageError("rotation needs axes square to the beams and angles of at most half a turn")
            axis = _unit((axis - lean[:, None] * direction) * np.where(angle < 0.0, -1.0, 1.0)[:, None])
            return turns(base - self._centre, direction, reach, axis, np.abs(angle))
        raise UsageError("first_contact needs a translation or a rotation: give exactly one of them")


def _frictions(friction: float | Sequence[float], names: tuple[str, ...]) -> FloatArray:
    values = np.atleast_1d(np.asarray(friction, dtype=np.float64))
    if values.shape not in {(1,), (len(names),)} or not (np.isfinite(values) & (values >= 0.0)).all():
        raise UsageError(
            f"friction {friction!r} does not suit {len(names)} bodies: give one coefficient, or one each"
        )
    return np.broadcast_to(values, (len(names),)).copy()


def _vectors(name: str, values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise UsageError(f"{name} has shape {array.shape}: it must be (n, 3) finite numbers")
    return array


def _scalars(name: str, values: ArrayLike, n: int) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in {(), (n,)} or not np.isfinite(array).all():
        raise UsageError(f"{name} has shape {array.shape}: it must be one finite number, or {n} of them")
    return np.broadcast_to(array, (n,))


def _unit(values: ArrayLike) -> FloatArray:
    array = _vectors("directions", values)
    norm = np.linalg.norm(array, axis=1)
    if not (norm > 0.0).all():
        raise UsageError("a direction is the zero vector: directions must point somewhere")
    return np.asarray(array / norm[:, None])
