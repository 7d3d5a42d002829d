"""What every shape with a known truth can tell about itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CORNER_RADIUS",
    "Projection",
    "Region",
    "Shape",
    "Surface",
    "TriangleMesh",
    "regions",
    "tangential",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CORNER_RADIUS = 6e-3
"""Rounded features of at most this radius count as corners [m]."""
_FLAT_RADIUS = 10.0
"""Radii above this count as flat [m]."""


class Region(IntEnum):
    """Kind of place on a surface; figures of accuracy are given by region."""

    FACE = 0
    """Flat in every direction."""
    ARC = 1
    """Smoothly curved, smallest radius above :data:`CORNER_RADIUS`."""
    CORNER = 2
    """Smoothly curved with a radius of at most :data:`CORNER_RADIUS`."""
    EDGE = 3
    """A sharp edge or vertex."""


class Projection(NamedTuple):
    """Closest points of a surface."""

    point: FloatArray
    """(n, 3) m, on the surface."""
    normal: FloatArray
    """(n, 3) outward unit normal; on a sharp edge, the direction from the edge to the point asked about."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Differential geometry at the closest points of n points."""

    point: FloatArray
    """(n, 3) m."""
    normal: FloatArray
    """(n, 3) outward unit normal."""
    axes: FloatArray
    """(n, 2, 3) unit principal directions."""
    curvatures: FloatArray
    """(n, 2) 1/m, normal curvatures along them, positive where the solid is convex."""
    edge_distance: FloatArray
    """(n,) m, from the closest point to the nearest sharp edge, inf where there is none."""
    edge_tangent: FloatArray | None = None
    """(n, 3) unit tangent of the edge beside the closest point, either way; None if the shape has no edges."""


class TriangleMesh(NamedTuple):
    """A triangle mesh, faces counter-clockwise seen from outside."""

    vertices: FloatArray
    """(v, 3) m."""
    faces: IntArray
    """(f, 3) indices into vertices."""


class Shape(Protocol):
    """A solid whose surface is known in closed form; metres, in the solid's own frame."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures, for points (n, 3) nearer than the smallest radius."""
        ...

    def mesh(self) -> TriangleMesh:
        """The mesh that stands for it; all vertices lie on the surface."""
        ...


def tangential(surface: Surface, directions: FloatArray) -> FloatArray:
    """Normal curvature (n,) 1/m along ``directions`` (n, 3), of which only the tangential part counts."""
    along = np.einsum("nij,nj->ni", surface.axes, directions)
    squared = np.sum(along**2, axis=1)
    return np.asarray(np.sum(along**2 * surface.curvatures, axis=1) / np.maximum(squared, 1e-300))


def regions(surface: Surface, within: float) -> NDArray[np.int8]:
    """:class:`Region` codes (n,); nearer than ``within`` [m] to a sharp edge counts as that edge."""
    sharpest = np.max(np.abs(surface.curvatures), axis=1)
    code = np.where(sharpest * _FLAT_RADIUS < 1.0, Region.FACE, Region.ARC)
    code = np.where(sharpest * CORNER_RADIUS >= 1.0 - 1e-9, Region.CORNER, code)
    return np.where(surface.edge_distance < within, Region.EDGE, code).astype(np.int8)
