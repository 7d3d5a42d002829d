"""Triangles against a swept plane: the segment each leaves in it, and the travel at which the beam meets it.

A beam that translates, or that turns about its base, sweeps a plane. In plane coordinates (x along the beam,
y along the motion) every triangle that crosses the plane is a straight segment, and on a segment clipped to
the beam's reach the travel is monotone: the first touch is at one of its two ends (docs/derivations-
geometry.md). An end on a mesh edge is a touch of the beam's side; an end made by the clip is a touch of its
tip or of its base.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pieces", "Where", "axial_pieces", "plane_segments", "slide_pieces", "turn_pieces"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Where(IntEnum):
    """The part of a triangle or of the beam at which they first meet."""

    EDGE_0 = 0
    """The triangle's edge from vertex 0 to 1."""
    EDGE_1 = 1
    """From vertex 1 to 2."""
    EDGE_2 = 2
    """From vertex 2 to 0."""
    TIP = 3
    """The beam's end, inside the triangle."""
    BASE = 4
    """The beam's root, inside the triangle: the carrier runs into the object."""
    THROUGH = 5
    """The beam pierces the triangle where it stands."""


@dataclass(slots=True)
class Pieces:
    """What is left of k triangles inside the swept plane: segments, and the travel at which they are met."""

    travel: FloatArray
    distance: FloatArray
    where: IntArray
    x: FloatArray  # (k, 2) ends of the clipped segment
    y: FloatArray  # (k, 2)


def plane_segments(
    local: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray, IntArray]:
    """Where triangles (k, 3 corners, 3 coordinates) cut z = 0, which they cross: xa, ya, xb, yb, edges."""
    z = local[..., 2]
    above = z >= 0.0
    one_above = above.sum(axis=1) == 1
    lone = np.where(one_above, above.argmax(axis=1), above.argmin(axis=1))
    at = 3 * np.arange(len(local))
    flat = local.reshape(-1, 3)
    i, j, k = flat.take(at + lone, 0), flat.take(at + (lone + 1) % 3, 0), flat.take(at + (lone + 2) % 3, 0)
    # Symmetric in the two vertices: both triangles of an edge find the very same point.
    a = (i[:, 2:] * j[:, :2] - j[:, 2:] * i[:, :2]) / (i[:, 2] - j[:, 2])[:, None]
    b = (i[:, 2:] * k[:, :2] - k[:, 2:] * i[:, :2]) / (i[:, 2] - k[:, 2])[:, None]
    return a[:, 0], a[:, 1], b[:, 0], b[:, 1], lone, (lone + 2) % 3


def slide_pieces(local: FloatArray, length: FloatArray) -> Pieces:
    """Triangles (k, 3, 3) that cross z = 0 against beams of length (k,) that translate, y the travel."""
    xa, ya, xb, yb, edge_a, edge_b = plane_segments(local)
    swap = xa > xb
    xa, xb = np.where(swap, xb, xa), np.where(swap, xa, xb)
    ya, yb = np.where(swap, yb, ya), np.where(swap, ya, yb)
    edge_a, edge_b = np.where(swap, edge_b, edge_a), np.where(swap, edge_a, edge_b)
    span = xb - xa
    slope = (yb - ya) / np.where(span > 0.0, span, 1.0)
    x0, x1 = np.maximum(xa, 0.0), np.minimum(xb, length)
    y0 = np.where(xa < 0.0, ya - xa * slope, ya)
    y1 = np.where(xb > length, yb - (xb - length) * slope, yb)
    where0 = np.where(xa < 0.0, Where.BASE, edge_a)
    where1 = np.where(xb > length, Where.TIP, edge_b)
    first = y0 <= y1
    low, high = np.where(first, y0, y1), np.where(first, y1, y0)
    through = (low <= 0.0) & (high >= 0.0)
    share = -low / np.where(high > low, high - low, 1.0)
    x_low, x_high = np.where(first, x0, x1), np.where(first, x1, x0)
    met = (x0 <= x1) & (high >= 0.0)
    return Pieces(
        travel=np.where(met, np.maximum(low, 0.0), np.inf),
        distance=np.where(through, x_low + share * (x_high - x_low), x_low),
        where=np.where(through, Where.THROUGH, np.where(first, where0, where1)),
        x=np.stack([x0, x1], axis=1),
        y=np.stack([y0, y1], axis=1),
    )


def turn_pieces(local: FloatArray, length: FloatArray) -> Pieces:
    """Triangles (k, 3, 3) that cross z = 0 against beams of length (k,) that turn from x towards y."""
    xa, ya, xb, yb, edge_a, edge_b = plane_segments(local)
    dx, dy = xb - xa, yb - ya
    # |a + u (b - a)|^2 = length^2: the disc cuts the segment to u0 <= u <= u1.
    square = dx * dx + dy * dy
    half = xa * dx + ya * dy
    outside_a, outside_b = np.hypot(xa, ya) > length, np.hypot(xb, yb) > length
    root = half * half - square * (xa * xa + ya * ya - length * length)
    met = (root >= 0.0) | ~outside_a
    root = np.sqrt(np.maximum(root, 0.0))
    safe = np.where(square > 0.0, square, 1.0)
    u0 = np.where(outside_a, (-half - root) / safe, 0.0)
    u1 = np.where(outside_b, (-half + root) / safe, 1.0)
    met &= (u0 <= u1) & (u0 >= 0.0) & (u1 <= 1.0)
    x = np.stack([np.where(outside_a, xa + u0 * dx, xa), np.where(outside_b, xa + u1 * dx, xb)], axis=1)
    y = np.stack([np.where(outside_a, ya + u0 * dy, ya), np.where(outside_b, ya + u1 * dy, yb)], axis=1)
    angle = np.arctan2(y, x)
    angle = np.where(angle < 0.0, angle + 2.0 * np.pi, angle)
    drop = y[:, 0] - y[:, 1]
    straddles = (y.min(axis=1) <= 0.0) & (y.max(axis=1) >= 0.0)
    share = y[:, 0] / np.where(drop != 0.0, drop, 1.0)
    crossing = x[:, 0] + share * (x[:, 1] - x[:, 0])
    through = straddles & (crossing >= 0.0)
    first = angle[:, 0] <= angle[:, 1]
    end = np.where(first, 0, 1)[:, None]
    where = np.where(first, np.where(outside_a, Where.TIP, edge_a), np.where(outside_b, Where.TIP, edge_b))
    radius = np.take_along_axis(np.hypot(x, y), end, axis=1)[:, 0]
    travel = np.where(through, 0.0, np.take_along_axis(angle, end, axis=1)[:, 0])
    return Pieces(
        travel=np.where(met, travel, np.inf),
        distance=np.where(through, crossing, np.minimum(radius, length)),
        where=np.where(through, Where.THROUGH, where),
        x=x,
        y=y,
    )


def axial_pieces(local: FloatArray, length: FloatArray, forward: NDArray[np.bool_]) -> Pieces:
    """Beams that move along themselves: the line y = z = 0 is all they sweep."""
    xa, ya, xb, yb, _, _ = plane_segments(local)
    drop = ya - yb
    met = (np.minimum(ya, yb) <= 0.0) & (np.maximum(ya, yb) >= 0.0)
    x = xa + ya / np.where(drop != 0.0, drop, 1.0) * (xb - xa)
    travel = np.where(forward, x - length, -x)
    through = (x >= 0.0) & (x <= length)
    met &= through | (travel > 0.0)
    return Pieces(
        travel=np.where(met, np.maximum(travel, 0.0), np.inf),
        distance=np.where(through, x, np.where(forward, length, 0.0)),
        where=np.where(through, Where.THROUGH, np.where(forward, Where.TIP, Where.BASE)),
        x=np.stack([x, x], axis=1),
        y=np.zeros((len(x), 2)),
    )
