"""Straight beams that translate, or that turn about their bases, and the planes they sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.vectors import cross

__all__ = ["AXIAL", "Motions", "slides", "turns"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

AXIAL = 1e-8
"""A translation within this angle of the beam's axis sweeps a line, not a plane [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motions:
    """n beams and how they move, in coordinates (x, y, z) = frame (p - base) of the plane they sweep."""

    turning: bool
    """Whether the beams turn about their bases (y then is a length in the plane, the travel an angle)."""
    base: FloatArray
    """(n, 3) [m]."""
    direction: FloatArray
    """Unit, from the base to the tip (n, 3)."""
    advance: FloatArray
    """Unit: along the translation, or of the tip's first movement in a turn (n, 3)."""
    frame: FloatArray
    """The functionals x, y, z as rows (n, 3, 3): oblique for a translation, z normal to the plane."""
    length: FloatArray
    """(n,) [m]."""
    limit: FloatArray
    """Farthest travel (n,) [m] or [rad]."""

    def rows(self, index: IntArray | slice) -> Motions:
        """Some of the motions."""
        return Motions(
            turning=self.turning,
            base=self.base[index],
            direction=self.direction[index],
            advance=self.advance[index],
            frame=self.frame[index],
            length=self.length[index],
            limit=self.limit[index],
        )

    def moved(self, travel: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Base (n, 3) [m], direction and way of the beam's points (n, 3) after the travel (n,)."""
        if not self.turning:
            return self.base + travel[:, None] * self.advance, self.direction, self.advance
        c, s = np.cos(travel)[:, None], np.sin(travel)[:, None]
        return self.base, c * self.direction + s * self.advance, c * self.advance - s * self.direction


def _any_square(direction: FloatArray) -> FloatArray:
    """Unit vectors square to directions (n, 3)."""
    square = cross(direction, np.eye(3)[np.argmin(np.abs(direction), axis=1)])
    return np.asarray(square / np.linalg.norm(square, axis=1)[:, None])


def slides(base: FloatArray, direction: FloatArray, length: FloatArray, translation: FloatArray) -> Motions:
    """Beams that keep their direction while the base moves along the translation (n, 3) [m]."""
    limit = np.linalg.norm(translation, axis=1)
    # Beams that stay where they are are only asked whether they touch; any plane through them will do.
    still = limit <= 0.0
    way = np.where(still[:, None], _any_square(direction), translation)
    advance = way / np.where(still, 1.0, limit)[:, None]
    along = np.einsum("ij,ij->i", advance, direction)
    # Twice, because the first difference loses digits where the motion is nearly along the beam.
    across = advance - along[:, None] * direction
    across -= np.einsum("ij,ij->i", across, direction)[:, None] * direction
    sine = np.linalg.norm(across, axis=1)
    axial = sine < AXIAL
    # Beams that move along themselves sweep a line; any plane through it does.
    across[axial] = _any_square(direction[axial])
    across[~axial] /= sine[~axial, None]
    sine[axial] = np.inf
    frame = np.zeros((len(base), 3, 3))
    frame[:, 0] = direction - (along / sine)[:, None] * across
    frame[:, 1] = across / np.where(axial, 1.0, sine)[:, None]
    frame[:, 2] = cross(direction, across)
    return Motions(
        turning=False,
        base=base,
        direction=direction,
        advance=advance,
        frame=frame,
        length=length,
        limit=limit,
    )


def turns(
    base: FloatArray, direction: FloatArray, length: FloatArray, axis: FloatArray, angle: FloatArray
) -> Motions:
    """Beams that turn about their bases, by angle (n,) [rad] >= 0 about unit axes (n, 3) normal to them."""
    advance = cross(axis, direction)
    frame = np.stack([direction, advance, axis], axis=1)
    return Motions(
        turning=True, base=base, direction=direction, advance=advance, frame=frame, length=length, limit=angle
    )
