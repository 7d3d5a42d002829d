"""Closed forms: the laws of Kaneko1998 with their slips mended, and the one-push rule of Solomon2008.

Each takes and gives arrays that broadcast, in SI units; derivations and corrections are in docs/derivations.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["k_of_h", "softening"]

FloatArray = NDArray[np.float64]


def k_of_h(h: ArrayLike) -> FloatArray:
    """Share k of the edge's compliance that is left on a round body, h = s/(R theta), for small angles.

    (23), (31) and (32) of Kaneko1998 solved without linearising in 1/h; to first order k = 1 - 3/(8h).

    >>> round(float(k_of_h(10.0)), 4)
    0.9636
    """
    return softening(1.0 / np.asarray(h, dtype=np.float64))


def softening(u: FloatArray) -> FloatArray:
    """k as a function of u = 1/h = R theta/s, which may be zero."""
    # zeta/theta = ((2 + u) - sqrt((2 + u)^2 - 2u))/u, without its cancellation.
    zeta = 2.0 / (2.0 + u + np.sqrt(u * (u + 2.0) + 4.0))
    return np.asarray(1.5 * (1.0 - u * zeta) / (1.0 + zeta))
