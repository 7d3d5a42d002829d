"""Triangles of the zero level of a field: the field is asked only near the surface, and VTK draws the triangles.

A grid twice as fine is asked at each level, and only where the coarser one says that the surface may pass; the
rest is interpolated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from contour.errors import UsageError

__all__ = ["Grid", "Triangles", "closed", "sample", "triangles"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Field = Callable[[FloatArray], FloatArray]

LEVELS = 3
"""Halvings from the first grid, all of which is asked, to the last."""
STEEPEST = 1.5
"""Gradient of fields that are about signed distances near their zero level, at most."""
MOST_NODES = 40_000_000
"""Of the last grid: 320 MB."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Values on a regular grid."""

    origin: FloatArray
    """(3,) m, of node (0, 0, 0)."""
    spacing: float
    """[m]"""
    values: FloatArray
    """(nx, ny, nz), positive outside."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triangles:
    """A triangle mesh, faces counter-clockwise seen from outside."""

    vertices: FloatArray
    """(v, 3) m."""
    faces: IntArray
    """(f, 3)"""


def sample(field: Field, low: FloatArray, high: FloatArray, spacing: float) -> Grid:
    """``field`` on a grid of ``spacing`` [m] over the box ``low`` (3,) to ``high`` (3,) [m] or a little more.

    Values are exact near the zero level and interpolated elsewhere.
    """
    coarse = 2**LEVELS
    cells = np.ceil((high - low) / (coarse * spacing)).astype(np.int64) * coarse
    if float(np.prod(cells + 1.0)) > MOST_NODES:
        least = spacing * float(np.prod(cells + 1.0) / MOST_NODES) ** (1.0 / 3.0)
        raise UsageError(
            f"a grid of {spacing * 1e3:.3g} mm over {np.array2string((high - low) * 1e3, precision=0)} mm has "
            f"{np.prod(cells + 1.0):.3g} nodes: choose a spacing of at least {least * 1e3:.2g} mm"
        )
    origin = (low + high - cells * spacing) / 2.0
    step = coarse
    shape = cells // step + 1
    values = field(_nodes(np.argwhere(np.ones(shape, dtype=bool)), origin, step * spacing)).reshape(shape)
    while step > 1:
        step //= 2
        band = np.abs(values) < STEEPEST * np.sqrt(3.0) * step * spacing
        values = _twice(values)
        ask = np.argwhere(ndimage.maximum_filter(_repeat(band), size=3))
        values[tuple(ask.T)] = field(_nodes(ask, origin, step * spacing))
    return Grid(origin=origin, spacing=spacing, values=values)


def triangles(grid: Grid) -> Triangles:
    """Zero level of ``grid``, wound so that normals point to where it is positive."""
    import pyvista

    image = pyvista.ImageData(dimensions=grid.values.shape, spacing=[grid.spacing] * 3, origin=grid.origin)
    image["field"] = grid.values.ravel(order="F")
    surface = image.contour([0.0], scalars="field", method="flying_edges", compute_normals=False)
    surface = surface.clean(tolerance=0.0)  # VTK winds faces towards lower values
    vertices = np.array(surface.points, dtype=np.float64)
    faces = np.array(surface.faces, dtype=np.int64).reshape(-1, 4)[:, :0:-1]
    return Triangles(vertices=vertices, faces=faces)


def closed(faces: IntArray) -> bool:
    """Whether every edge of ``faces`` (f, 3) has two faces, wound against each other: no border, no overlap."""
    if not len(faces):
        return False
    ways = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    count = int(faces.max()) + 1
    forth, back = ways @ np.array([count, 1]), ways @ np.array([1, count])
    return bool(np.array_equal(np.unique(forth), np.sort(back)))


def _nodes(index: IntArray, origin: FloatArray, spacing: float) -> FloatArray:
    return np.asarray(origin + index * spacing)


def _twice(values: FloatArray) -> FloatArray:
    """Trilinear interpolation of (n + 1) nodes an axis at (2 n + 1)."""
    for axis in range(3):
        v = np.moveaxis(values, axis, 0)
        fine = np.zeros((2 * len(v) - 1, *v.shape[1:]))
        fine[::2] = v
        fine[1::2] = (v[1:] + v[:-1]) / 2.0
        values = np.moveaxis(fine, 0, axis)
    return np.ascontiguousarray(values)


def _repeat(band: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``band`` at twice the nodes; those between two nodes follow from the filter after."""
    fine = np.zeros([2 * n - 1 for n in band.shape], dtype=bool)
    fine[::2, ::2, ::2] = band
    return fine
