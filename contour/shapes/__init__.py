"""Shapes whose surface is known in closed form: what the meshes of data/meshes were made from.

``load("torus").project(points)`` gives closest points and outward normals, ``curvature`` the normal curvature
along a direction (positive where the solid is convex) and ``region`` the kind of place. Metres, in the
shape's own frame, which is that of its mesh.

>>> import numpy as np
>>> torus = load("torus")
>>> point, normal = torus.project(np.array([[0.090, 0.0, 0.0]]))
>>> np.round(point, 6) + 0.0
array([[0.085, 0.   , 0.   ]])
>>> [round(float(k), 3) for d in ([0, 0, 1.0], [0, 1.0, 0]) for k in torus.curvature(point, np.array([d]))]
[40.0, 11.765]
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.errors import UsageError
from contour.shapes.base import (
    CORNER_RADIUS,
    Projection,
    Region,
    Shape,
    Surface,
    TriangleMesh,
    regions,
    tangential,
)
from contour.shapes.catalogue import SHAPES
from contour.shapes.files import write_mesh

__all__ = [
    "CORNER_RADIUS",
    "NAMES",
    "Projection",
    "Region",
    "Surface",
    "TriangleMesh",
    "Truth",
    "load",
    "write_mesh",
]

FloatArray = NDArray[np.float64]

NAMES = tuple(SHAPES)
"""Names that :func:`load` knows."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """One named shape. Points are (n, 3) in m and nearer to the surface than its smallest radius."""

    name: str
    """Name in the catalogue, and of the mesh file."""
    shape: Shape
    """The solid itself."""

    def project(self, points: FloatArray) -> Projection:
        """Closest points of the surface and the outward normals there."""
        surface = self.surface(points)
        return Projection(surface.point, surface.normal)

    def curvature(self, points: FloatArray, directions: FloatArray) -> FloatArray:
        """Normal curvature (n,) 1/m of the smooth surface at the closest points, along ``directions`` (n, 3).

        Positive where the solid is convex. Sharp edges are left out: ask :meth:`region` where they are.
        """
        return tangential(self.surface(points), np.asarray(directions, dtype=np.float64))

    def region(self, points: FloatArray, *, within: float = 0.05e-3) -> NDArray[np.int8]:
        """:class:`Region` code (n,) of the closest points; EDGE ``within`` that distance [m] of one."""
        return regions(self.surface(points), within)

    def surface(self, points: FloatArray) -> Surface:
        """All of it at once: closest points, normals, principal curvatures, distance to an edge."""
        p = np.array(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != 3 or not np.isfinite(p).all():
            raise UsageError(
                f"points must be finite and of shape (n, 3), not {p.shape}: give metres, a row each"
            )
        return self.shape.surface(p)

    def mesh(self) -> TriangleMesh:
        """The mesh of the shape, in metres; all its vertices lie on the surface."""
        return self.shape.mesh()


def load(name: str) -> Truth:
    """The shape called ``name``.

    Raises:
        UsageError: no such shape; the message says which there are.
    """
    if name not in SHAPES:
        close = difflib.get_close_matches(name, NAMES, n=1)
        remedy = f"did you mean {close[0]!r}?" if close else f"choose one of {', '.join(NAMES)}"
        raise UsageError(f"no shape is called {name!r}: {remedy}")
    return Truth(name, SHAPES[name]())
