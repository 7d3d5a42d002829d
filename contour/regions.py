"""Where on a known shape contacts lie, and what the truth is there: figures of accuracy are given by region.

A mesh only samples its shape. Where the shape is known in closed form (:mod:`contour.shapes`) its normal at
the contact is the truth, not the mesh's: facets and interpolation then count as errors. At sharp edges the
normal of a contact is square to beam and edge, whose tangent is the shape's: of a rim the mesh has a polygon only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Kind
from contour.frames import plane_angle
from contour.shapes import Region, Surface, Truth
from contour.virtual import TrueContact

__all__ = ["REGIONS", "TIP", "analytic_truth"]

FloatArray = NDArray[np.float64]

TIP = len(Region)
"""Region of contacts with the beam's end, wherever on the shape they are."""
REGIONS = (*(region.name.lower() for region in Region), "tip")
"""Names of the regions, by their codes."""
STRAIGHT = 0.1
"""Curvature along the beam below which a surface counts as straight [1/m]: it leans too little to matter."""
INTO_LINE = 1e-3
"""How far from its end a line contact is looked up: the end itself lies on an edge [m]."""
NEAR = 0.2e-3
"""Contacts nearer to a sharp edge count as on it: the mesh's facets stand off the shape by this much [m]."""

CLEAR = np.sin(np.deg2rad(3.0))
"""Sine of the angle between beam and edge from which on their normal means something."""
SAME_EDGE = np.cos(np.deg2rad(5.0))
"""Least cosine between that normal and the mesh's: near a vertex the nearest edge may not be the touched one."""


def _square_to_beam(surface: Surface, beam: FloatArray) -> FloatArray:
    """Normals (n, 3) where the smooth surface, not its facets, is touched by the side of ``beam`` (n, 3).

    The side touches where the normal n is square to the beam b; on facets it touches a little farther along.
    From b . n = delta a shift tau b with tau b . S b = -delta leads there, S the shape operator: n + tau S b.
    """
    along = np.einsum("nij,nj->ni", surface.axes, beam)
    turned = np.einsum("ni,nij->nj", surface.curvatures * along, surface.axes)  # S b
    bend = np.sum(along**2 * surface.curvatures, axis=1)
    lean = np.sum(beam * surface.normal, axis=1)
    curved = bend > STRAIGHT
    shift = np.where(curved, -lean / np.where(curved, bend, 1.0), 0.0)
    normal = surface.normal + shift[:, None] * turned
    normal -= np.sum(normal * beam, axis=1, keepdims=True) * beam
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _square_to_edge(surface: Surface, beam: FloatArray, normal: FloatArray) -> FloatArray:
    """Normals (n, 3) square to beams (n, 3) and edges, on the side of the mesh's ``normal`` (n, 3).

    Where the edge beside the contact is not the one that the mesh was touched at, the mesh's stays.
    """
    if surface.edge_tangent is None:
        return normal
    square = np.cross(beam, surface.edge_tangent)
    sine = np.linalg.norm(square, axis=1)
    square /= np.where(sine > CLEAR, sine, 1.0)[:, None]
    cosine = np.sum(square * normal, axis=1)
    known = (sine > CLEAR) & (np.abs(cosine) > SAME_EDGE)
    return np.where(known[:, None], square * np.sign(cosine)[:, None], normal)


def analytic_truth(
    truth: TrueContact, rotation: FloatArray, shape: Truth, placement: FloatArray
) -> TrueContact:
    """``truth`` with region, point and normal from the shape itself.

    Args:
        truth: n contacts with the mesh of ``shape``.
        rotation: (n, 3, 3) sensor to world at each of them; the beam is its second column.
        shape: what the mesh was made from.
        placement: (n, 3) m, where the origin of the touched copy of the shape lies in the world.
    """
    line = truth.kind == Kind.LINE
    looked_up = truth.point - placement + np.where(line, INTO_LINE, 0.0)[:, None] * rotation[:, :, 1]
    surface = shape.surface(looked_up)
    sideways = np.isin(truth.kind, (Kind.TIP, Kind.LINE), invert=True)
    smooth = np.where(sideways[:, None], _square_to_beam(surface, rotation[:, :, 1]), surface.normal)
    region = shape.region(looked_up, within=NEAR)
    known = region != Region.EDGE
    at_edge = (~known & (truth.kind == Kind.EDGE))[:, None]
    edge = np.where(at_edge, _square_to_edge(surface, rotation[:, :, 1], truth.normal), truth.normal)
    normal = np.where(known[:, None], smooth, edge)
    point = np.where((known & ~line)[:, None], surface.point + placement, truth.point)
    return replace(
        truth,
        normal=normal,
        point=point,
        outward=np.where(known | at_edge[:, 0], plane_angle(normal, rotation), truth.outward),
        region=np.where(truth.kind == Kind.TIP, np.int8(TIP), region).astype(np.int8),
    )
