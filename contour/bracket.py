"""The first equilibrium of a contact past its last position, by growing brackets: the fallback where Newton wanders.

Rows are contacts; each has its own bracket and all are evaluated together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["first_root"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BRACKETS = 300
"""Most brackets."""
FIRST = 1e-6
"""Length of the first, relative to the depth of the push."""
GROWTH = 1.5
"""How much longer each is than the one before."""
NARROW = 60
"""Most steps that narrow the last bracket."""
CLOSE = 1e-13
"""Length of a bracket that counts as a point, relative to the depth of the push."""

Evaluate = Callable[[FloatArray], tuple[FloatArray, BoolArray]]
"""``evaluate(b)``: the residual at b, and whether a contact can be there."""


def first_root(
    evaluate: Evaluate, start: FloatArray, depth: FloatArray, longest: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The first root of a residual past ``start`` (n,), on the side that its sign there points to.

    Args:
        evaluate: the residual; it falls through zero from ``start`` on if it is positive there.
        start: where to begin, (n,).
        depth: what lengths are compared with, (n,).
        longest: longest bracket that resolves the residual, (n,).

    Returns:
        The roots (n,), ``start`` where there are none, and where there are.
    """
    first, _ = evaluate(start)
    sense = -np.sign(first)
    width = np.minimum(FIRST * depth, longest)
    low, low_value = start.copy(), first
    high = start + sense * width
    high_value = first.copy()
    found = first == 0.0
    lost = np.zeros_like(found)
    for _ in range(BRACKETS):
        value, fits = evaluate(high)
        going = ~(found | lost)
        high_value = np.where(going, value, high_value)
        lost |= going & ~fits
        found |= going & fits & (value * sense >= 0.0)
        going = ~(found | lost)
        if not going.any():
            break
        low, low_value = np.where(going, high, low), np.where(going, value, low_value)
        width = np.where(going, np.minimum(width * GROWTH, longest), width)
        high = np.where(going, high + sense * width, high)
    root = _narrowed(evaluate, (low, low_value), (high, high_value), found & (first != 0.0), CLOSE * depth)
    return np.where(found & (first != 0.0), root, start), found


def _narrowed(
    evaluate: Evaluate,
    low: tuple[FloatArray, FloatArray],
    high: tuple[FloatArray, FloatArray],
    among: BoolArray,
    close: FloatArray,
) -> FloatArray:
    """A point of each bracket where the residual changes its sign: false position in the manner of Illinois, every
    third step a halving.
    """
    (a, at_a), (b, at_b) = low, high
    point = b
    for step in range(NARROW):
        open_ = among & (np.abs(b - a) > close) & (at_b != 0.0)
        if not open_.any():
            break
        share = at_b / (at_b - at_a)
        if step % 3 == 2:
            share = np.full_like(share, 0.5)
        point = np.where(open_, b - np.where(np.isfinite(share), share, 0.5) * (b - a), b)
        value, _ = evaluate(point)
        value = np.where(open_, value, at_b)
        crossed = value * at_b < 0.0
        # The end that stays counts half, so that the next step falls beyond the root.
        a, at_a = np.where(open_ & crossed, b, a), np.where(open_, np.where(crossed, at_b, 0.5 * at_a), at_a)
        b, at_b = np.where(open_, point, b), value
    return b
