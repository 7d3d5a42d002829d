"""Where the base of an antenna may go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.errors import UsageError
from contour.frames import SINGULAR_MARGIN, Mount

__all__ = ["Reach"]

FloatArray = NDArray[np.float64]

PUSH_TURN = float(np.deg2rad(6.0))
"""Room that pushes need at the joints' limits [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """Where the base may go: axis limits of the gantry, and a floor."""

    lower: FloatArray
    """(5,) m and rad: least (X, Y, Z, phi1, phi2) in the base frame; -inf where there is no limit."""
    upper: FloatArray
    """(5,) m and rad: largest."""
    floor: float = -np.inf
    """Height in the world [m] that neither the base nor the beam's end may go under."""

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            limit = np.array(getattr(self, name), dtype=np.float64)
            if limit.shape != (5,) or np.isnan(limit).any():
                raise UsageError(
                    f"reach {name} must be five numbers (X, Y, Z in m, phi1, phi2 in rad), got {limit!r}"
                )
            limit.setflags(write=False)
            object.__setattr__(self, name, limit)
        if np.any(self.lower >= self.upper):
            axis = ("X", "Y", "Z", "phi1", "phi2")[int(np.argmax(self.lower >= self.upper))]
            raise UsageError(f"reach of axis {axis} is empty: its lower limit must be below its upper limit")

    @classmethod
    def unlimited(cls, *, floor: float = -np.inf) -> Reach:
        """No axis limits."""
        return cls(lower=np.full(5, -np.inf), upper=np.full(5, np.inf), floor=floor)

    def half_planes(
        self, rotation: FloatArray, level: FloatArray, length: float, mount: Mount
    ) -> tuple[FloatArray, FloatArray]:
        """A (n, 8, 2) and b (n, 8) [m] such that the base may stand at u in Pi where A u <= b.

        Args:
            rotation: (n, 3, 3), sensor to world.
            level: (n,) m, coordinate of the base along the beam.
            length: L [m].
            mount: of the gantry's base.
        """
        plane = rotation[:, :, [0, 2]]  # (n, 3, 2)
        depth = rotation[:, :, 1] * level[:, None]
        at_zero = (depth - mount.origin) @ mount.rotation  # (n, 3) base position for u = 0
        across = np.einsum("ji,njk->nik", mount.rotation, plane)  # (n, 3, 2) base position per u
        down = -plane[:, 2, :]
        tip = length * rotation[:, 2, 1]
        a = np.concatenate((across, -across, down[:, None, :], down[:, None, :]), axis=1)
        b = np.concatenate(
            (
                self.upper[:3] - at_zero,
                at_zero - self.lower[:3],
                (depth[:, 2] - self.floor)[:, None],
                (depth[:, 2] + tip - self.floor)[:, None],
            ),
            axis=1,
        )
        return a, b

    def turns(self, direction_base: FloatArray) -> NDArray[np.bool_]:
        """(n,) whether the joints can turn the beam to ``direction_base`` (n, 3), with room for pushes."""
        phi2 = np.arcsin(np.clip(direction_base[:, 2], -1.0, 1.0))
        ok: NDArray[np.bool_] = np.abs(phi2) <= np.pi / 2 - SINGULAR_MARGIN - PUSH_TURN
        phi1 = np.arctan2(-direction_base[:, 0], direction_base[:, 1])
        for angle, axis in ((phi1, 3), (phi2, 4)):
            ok &= (angle >= self.lower[axis] + PUSH_TURN) & (angle <= self.upper[axis] - PUSH_TURN)
        return ok
