"""Where on a known shape contacts lie, and what the truth is there: figures of accuracy are given by region.

A mesh only samples its shape. Where the shape is known in closed form (:mod:`contour.shapes`) its normal at
the contact is the truth, not the mesh's: facets and interpolation then count as errors. At sharp edges the
normal of a contact is that of the pair beam and edge, which the mesh has exactly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Kind
from contour.frames import plane_angle
from contour.shapes import Region, Truth
from contour.virtual import TrueContact

__all__ = ["REGIONS", "TIP", "analytic_truth"]

FloatArray = NDArray[np.float64]

TIP = len(Region)
"""Region of contacts with the beam's end, wherever on the shape they are."""
REGIONS = (*(region.name.lower() for region in Region), "tip")
"""Names of the regions, by their codes."""
INTO_LINE = 1e-3
"""How far from its end a line contact is looked up: the end itself lies on an edge [m]."""
NEAR = 0.2e-3
"""Contacts nearer to a sharp edge count as on it: the mesh's facets stand off the shape by this much [m]."""


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
    region = shape.region(looked_up, within=NEAR)
    known = region != Region.EDGE
    normal = np.where(known[:, None], surface.normal, truth.normal)
    point = np.where((known & ~line)[:, None], surface.point + placement, truth.point)
    return replace(
        truth,
        normal=normal,
        point=point,
        outward=np.where(known, plane_angle(normal, rotation), truth.outward),
        region=np.where(truth.kind == Kind.TIP, np.int8(TIP), region).astype(np.int8),
    )
