"""The side door to the truth of a simulation, for evaluation alone; strategy and tracing cannot import it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contour.virtual import TrueContact

__all__ = ["Simulated", "truth_of"]

IntArray = NDArray[np.int64]


class Simulated(Protocol):
    """An instrument that knows what it touches."""

    def true_contacts(self, which: IntArray) -> tuple[TrueContact, NDArray[np.int8]]:
        """The contacts that the antennas ``which`` touch now, and the rung of the last push of each."""
        ...


def truth_of(instrument: Simulated, which: IntArray) -> tuple[TrueContact, NDArray[np.int8]]:
    """What the antennas ``which`` (n,) truly touch, and the rung that answered their last push."""
    return instrument.true_contacts(which)
