"""Records of tracing: settings, moves, expectations, and how contours went."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.errors import UsageError

__all__ = ["Expectation", "Move", "Status", "Trace", "TraceSettings"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Status(IntEnum):
    """How far a contour is."""

    WAITING = 0
    """Others of its plane come first."""
    SEARCHING = 1
    """On lines of first contact."""
    FOLLOWING = 2
    """Along the outline."""
    RETURNING = 3
    """On the way back to the first contact, to go the other way from there."""
    CLOSED = 4
    """Came back to a contact of its own."""
    ENDED = 5
    """Followed both ways to where the gantry's reach ends."""
    LOST = 6
    """Nothing was found where the outline should go on, or no contact at all."""
    DUPLICATE = 7
    """Its first contact lies on an outline followed before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSettings:
    """Numbers of the stepping; lengths as shares of the plan's step."""

    clearance: float = 0.3
    """h: off the surface before a move."""
    depth: float = 0.4
    """How far below the last contact's level stage 0 looks for the surface."""
    smallest_step: float = 0.1
    """Steps are never shorter."""
    largest_turn: float = float(np.deg2rad(20.0))
    """Steps shorten until the normal turns no more than this from one to the next [rad]."""
    growth: float = 2.0
    """A step is at most this much longer than the last one."""
    trusted_sigma: float = float(np.deg2rad(8.0))
    """A measured normal steers if its sigma is below this [rad]; else the chord of the last touches does."""
    fresh_sigma: float = float(np.deg2rad(25.0))
    """Expected deviation of the normal from the approach where neighbours say nothing [rad]."""
    turns: float = 4.0
    """Contacts of a contour end at this many times the perimeter of its box's projection over the step."""

    def __post_init__(self) -> None:
        for name in (
            "clearance",
            "depth",
            "smallest_step",
            "largest_turn",
            "trusted_sigma",
            "fresh_sigma",
            "turns",
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"tracing {name} is {value!r}: it must be a finite number above zero")
        if self.growth <= 1.0:
            raise UsageError(
                f"tracing growth is {self.growth!r}: steps could never grow back, make it above 1"
            )


class Move(NamedTuple):
    """What the instrument's ``approach`` is asked for; one row a contour."""

    which: IntArray
    """(k,) contours, which are also the antennas."""
    pose: FloatArray
    """(k, 5) m and rad, where the guarded move starts."""
    direction_world: FloatArray
    """(k, 3) unit."""
    travel: FloatArray
    """(k,) m."""


class Expectation(NamedTuple):
    """What neighbours say of the normal at the contact just touched."""

    outward: FloatArray
    """(k,) rad, angle of the outer normal in Pi."""
    sigma: FloatArray
    """(k,) rad, one standard deviation."""
    fresh: BoolArray
    """(k,) whether nothing but the approach is behind it: a first contact, or one after a corner."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """How the contours of a plan went."""

    status: NDArray[np.int8]
    """(n,) :class:`Status`"""
    contacts: IntArray
    """(n,) localised."""
    approaches: IntArray
    """(n,) guarded moves made."""
    reason: tuple[str, ...]
    """n short sentences; empty while a contour is followed."""

    @property
    def closed(self) -> BoolArray:
        """(n,)"""
        return np.asarray(self.status == Status.CLOSED)
