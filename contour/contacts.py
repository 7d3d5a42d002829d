"""The outcome of sensing: contacts as arrays, each with its uncertainty, its kind and its flags.

A contact that went wrong is flagged, never silently wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["Contacts", "Flag", "Kind", "flag_names"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Kind(IntEnum):
    """What the beam touches, as far as the readings tell."""

    SIDE = 0
    """Its side lies on a smooth surface."""
    EDGE = 1
    """Its side lies on an edge or corner."""
    TIP = 2
    """Its end touches; the normal is known in Pi only."""
    LINE = 3
    """It lies along a generator; the end nearest the base is what is sensed."""


class Flag(IntFlag):
    """Why a contact must not be trusted as it stands."""

    NONE = 0
    SLIP_OFF = 1
    """A push slid off the body and no other push made up for it."""
    UNRESOLVED = 2
    """The tolerance was not reached, or the samples contradict the model."""
    OVER_MOMENT = 4
    """The moment limit left too little of the push to measure."""
    LOST = 8
    """The push felt nothing."""
    SOFT_OR_TIP = 16
    """A soft body nearby and the beam's end cannot be told apart."""


def flag_names(flags: int) -> str:
    """Flags as text, joined by ``|``; empty when there are none.

    >>> flag_names(3)
    'slip-off|unresolved'
    """
    return "|".join(flag.name.lower().replace("_", "-") for flag in Flag if flag & flags and flag.name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """n contacts; every field has one row a contact."""

    which: IntArray
    """(n,) antenna, which is also the contour that it follows."""
    touch: FloatArray
    """(n, 2) m, the beam's axis in Pi at zero force: components along x_s and z_s at touch."""
    point: FloatArray
    """(n, 3) m, surface point in the world, the beam's radius compensated."""
    normal: FloatArray
    """(n, 3) unit outward normal in the world, within Pi."""
    distance: FloatArray
    """(n,) m, s from the centre of rotation to the contact on the undeformed axis."""
    sigma_distance: FloatArray
    """(n,) m, one standard deviation, the model's error included."""
    outward: FloatArray
    """(n,) rad, angle nu+ of the outer normal in Pi."""
    sigma_normal: FloatArray
    """(n,) rad, one standard deviation of that angle."""
    friction_angle: FloatArray
    """(n,) rad, alpha as estimated."""
    sigma_friction: FloatArray
    """(n,) rad"""
    radius_along: FloatArray
    """(n,) m, R along the beam as estimated."""
    curvature_across: FloatArray
    """(n,) 1/m, 1/R_l as estimated, positive on a convex profile."""
    kind: NDArray[np.int8]
    """(n,) :class:`Kind`"""
    pushes: IntArray
    """(n,) pushes made for this contact, aborted ones too."""
    flags: IntArray
    """(n,) :class:`Flag`, 0 when good."""
    machine_time: FloatArray
    """(n,) s, spent on this contact, moves included."""
    sequence: IntArray
    """(n,) place of the contact along its contour, from 0."""

    def __len__(self) -> int:
        return int(self.which.size)

    @property
    def good(self) -> NDArray[np.bool_]:
        """(n,) contacts without a flag."""
        return np.asarray(self.flags == 0)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Self:
        """The contacts ``rows``, as indices or mask."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def none(cls) -> Self:
        """No contacts at all."""
        wide = {"touch": 2, "point": 3, "normal": 3}
        whole = {
            "which": np.int64,
            "kind": np.int8,
            "pushes": np.int64,
            "flags": np.int64,
            "sequence": np.int64,
        }
        return cls(
            **{
                f.name: np.zeros(
                    (0, wide[f.name]) if f.name in wide else 0, dtype=whole.get(f.name, np.float64)
                )
                for f in fields(cls)
            }
        )

    @classmethod
    def concatenate(cls, parts: list[Self]) -> Self:
        """All contacts of ``parts``, in their order."""
        if not parts:
            return cls.none()
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})
