"""Points on triangles, and how far they are: even samples of a surface, closest points, signed distances.

Distances are from points to triangles, exact in float64, not from points to samples. VTK's locators find
the triangles; no part of VTK that draws is loaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contour.errors import UsageError

__all__ = ["Closest", "Samples", "Target", "as_faces", "sample_evenly"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """m points on triangles, each for the same share of the area."""

    points: FloatArray
    """(m, 3) m."""
    normals: FloatArray
    """(m, 3) unit, of the face."""
    face: IntArray
    """(m,)"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closest:
    """What m points are nearest to."""

    distance: FloatArray
    """(m,) m, zero or more."""
    point: FloatArray
    """(m, 3) m, on the triangles."""
    face: IntArray
    """(m,)"""


class Target:
    """Triangles that distances are measured to.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), counter-clockwise seen from outside where signs shall mean anything.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        from vtkmodules.util import numpy_support
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator

        if not len(faces):
            raise UsageError("no triangles to measure distances to: give a surface with faces")
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        """(v, 3) m."""
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        """(f, 3)"""
        convert: Any = numpy_support
        points = vtkPoints()
        points.SetData(convert.numpy_to_vtk(self.vertices, deep=True))
        cells = vtkCellArray()
        cells.SetData(
            convert.numpy_to_vtkIdTypeArray(np.arange(0, self.faces.size + 1, 3), deep=True),
            convert.numpy_to_vtkIdTypeArray(self.faces.ravel(), deep=True),
        )
        self._mesh: Any = vtkPolyData()
        self._mesh.SetPoints(points)
        self._mesh.SetPolys(cells)
        self._locator: Any = vtkStaticCellLocator()
        self._locator.SetDataSet(self._mesh)
        self._locator.BuildLocator()

    def closest(self, points: FloatArray) -> Closest:
        """What each of ``points`` (m, 3) [m] is nearest to."""
        from vtkmodules import vtkCommonCore
        from vtkmodules.vtkCommonDataModel import vtkGenericCell

        asked = np.ascontiguousarray(points, dtype=np.float64)
        near, face = np.zeros_like(asked), np.zeros(len(asked), dtype=np.int64)
        reference: Any = vtkCommonCore.reference
        at, cell = [0.0] * 3, vtkGenericCell()
        number, part, squared = reference(0), reference(0), reference(0.0)
        for row, point in enumerate(asked.tolist()):  # VTK takes them one by one, some 8 us each
            self._locator.FindClosestPoint(point, at, cell, number, part, squared)
            near[row], face[row] = at, number.get()
        return Closest(distance=np.linalg.norm(asked - near, axis=1), point=near, face=face)

    def signed(self, points: FloatArray) -> FloatArray:
        """Distance (m,) [m] of ``points`` (m, 3) [m], positive on the side that the faces look to.

        Nearest to an edge or a corner, the side is that of the mean normal, weighted by the angles of the
        faces there (Baerentzen2005).
        """
        from vtkmodules.util import numpy_support
        from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

        if not len(points):
            return np.zeros(0)
        convert: Any = numpy_support
        field = vtkImplicitPolyDataDistance()
        field.SetInput(self._mesh)
        asked = convert.numpy_to_vtk(np.ascontiguousarray(points, dtype=np.float64), deep=True)
        found = convert.numpy_to_vtk(np.zeros(len(points)), deep=True)
        field.FunctionValue(asked, found)
        return np.array(convert.vtk_to_numpy(found), dtype=np.float64)

    def normals(self) -> FloatArray:
        """Unit normals (f, 3) of the faces."""
        return _crossed(self.vertices, self.faces)[0]

    def pieces(self) -> IntArray:
        """(f,) number of the connected piece that each face belongs to."""
        count = len(self.vertices)
        ends = self.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
        links = sparse.coo_array((np.ones(len(ends), dtype=np.int8), ends.T), shape=(count, count))
        _, piece = sparse.csgraph.connected_components(links, directed=False)
        return np.unique(piece[self.faces[:, 0]], return_inverse=True)[1].astype(np.int64)


def as_faces(triangles: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (v, 3) [m] and faces (f, 3) of triangles (m, 3, 3) [m]; equal corners become one vertex, faces
    without area are dropped.
    """
    corners = np.asarray(triangles, dtype=np.float64)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not np.isfinite(corners).all():
        raise UsageError(f"triangles have shape {corners.shape}: give (m, 3, 3) finite numbers, in metres")
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int64)
    if len(faces):
        faces = faces[_crossed(vertices, faces)[1] > 0.0]
    return vertices, faces


def sample_evenly(vertices: FloatArray, faces: IntArray, count: int, *, seed: int) -> Samples:
    """``count`` points spread evenly over the area: one in each of as many equal parts of it, face after face."""
    rng = np.random.default_rng(seed)
    normal, double = _crossed(vertices, faces)
    reached = np.cumsum(double)
    drawn = (np.arange(count) + rng.random(count)) * (reached[-1] / count)
    face = np.minimum(np.searchsorted(reached, drawn, side="right"), len(faces) - 1).astype(np.int64)
    root, part = np.sqrt(rng.random(count)), rng.random(count)
    weight = np.stack((1.0 - root, root * (1.0 - part), root * part), axis=1)
    points = np.einsum("mk,mkj->mj", weight, vertices[faces[face]])
    return Samples(points=points, normals=normal[face], face=face)


def _crossed(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (f, 3) of faces, zero where there is no area, and twice their areas (f,) [m^2]."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    return cross / np.where(double > 0.0, double, 1.0)[:, None], double
