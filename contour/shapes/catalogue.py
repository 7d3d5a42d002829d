"""The named shapes and their dimensions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from contour.shapes.base import Shape
from contour.shapes.implicit import Blob, Mug, Sphere
from contour.shapes.path import Path
from contour.shapes.swept import Box, Bracket, Extruded, Revolved

__all__ = ["SHAPES"]

MM = 1e-3  # [m]


def _profile(vertices: Sequence[tuple[float, float]], fillets: Sequence[float]) -> Path:
    """An open section from the axis to the axis, in mm."""
    return Path.rounded([(r * MM, z * MM) for r, z in vertices], [f * MM for f in fillets], closed=False)


def _bar(radius: float, length: float) -> Revolved:
    """A cylinder with flat ends, in mm."""
    return Revolved(_profile([(0, 0), (radius, 0), (radius, length), (0, length)], [0] * 4))


def _vase() -> Revolved:
    """A belly, a neck and a flaring mouth around a cavity; the wall is about 5 mm."""
    outer = [(0, 0), (34, 0), (62, 62), (25, 120), (40, 158)]
    inner = [(35, 158), (20, 120), (57, 62), (29, 6), (0, 6)]
    return Revolved(_profile(outer + inner, [0, 3, 40, 45, 2, 2, 50, 35, 3, 0]))


def _shaft() -> Revolved:
    """Steps with sharp and rounded shoulders, a groove and a chamfer."""
    vertices = [
        (0, 0),
        (13, 0),
        (15, 2),
        (15, 30),
        (25, 30),
        (25, 62),
        (38, 62),
        (38, 86),
        (22, 86),
        (22, 108),
    ]
    vertices += [(18, 108), (18, 114), (22, 114), (22, 150), (0, 150)]
    return Revolved(_profile(vertices, [0, 0, 0, 4, 0, 2, 3, 0, 8, 0, 0, 0, 0, 2, 0]))


def _gear() -> Extruded:
    """Twenty straight-sided teeth, tips and roots rounded with 2 mm."""
    teeth, root, tip = 20, 50.0, 61.0
    at = np.array([-0.30, -0.17, 0.17, 0.30]) * (2.0 * np.pi / teeth)
    radii = np.array([root, tip, tip, root])
    angle = (np.arange(teeth)[:, None] * (2.0 * np.pi / teeth) + at).reshape(-1)
    radius = np.tile(radii, teeth)
    vertices = [
        (float(x), float(y))
        for x, y in zip(radius * np.cos(angle) * MM, radius * np.sin(angle) * MM, strict=True)
    ]
    outline = Path.rounded(vertices, [2.0 * MM] * len(vertices), closed=True)
    return Extruded(outline, 0.0, 28 * MM, Path.circle((0.0, 0.0), 14 * MM, hole=True))


def _fin() -> Extruded:
    """A plate 1 mm thick and 120 mm long with round ends."""
    x, y = 60 * MM, 0.5 * MM
    outline = Path.rounded([(x, -y), (x, y), (-x, y), (-x, -y)], [y] * 4, closed=True)
    return Extruded(outline, 0.0, 100 * MM)


SHAPES: dict[str, Callable[[], Shape]] = {
    "box": lambda: Box((160 * MM, 120 * MM, 100 * MM)),
    "rod12": lambda: _bar(12, 160),
    "rod2": lambda: _bar(2, 150),
    "cylinder": lambda: _bar(50, 120),
    "sphere": lambda: Sphere(60 * MM),
    "torus": lambda: Revolved(Path.circle((60 * MM, 0.0), 25 * MM), closed=True),
    "vase": _vase,
    "gear": _gear,
    "shaft": _shaft,
    "bracket": lambda: Bracket((3, 2), 40 * MM, 10 * MM, {(0, 1): 8 * MM, (2, 1): 8 * MM}, {(1, 1): 12 * MM}),
    "fin": _fin,
    "blob": Blob,
    "mug": Mug,
}
"""Name of each shape and how it is made."""
