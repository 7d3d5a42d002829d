"""From touches to contacts: runs a strategy's questions against an instrument, n contacts at once."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Contacts
from contour.instrument import ApproachReading, Instrument
from contour.sensing import Action, Strategy, Touch, make_touch

__all__ = ["localise"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LET_GO = 1.5e-3
"""Clearance between a contact and touching it again [m]."""
ROUNDS = 32
"""Actions that one contact may ask for; a strategy that wants more is broken."""


def localise(
    instrument: Instrument,
    strategy: Strategy,
    reading: ApproachReading,
    *,
    expected: FloatArray,
    expected_sigma: FloatArray,
    fresh: NDArray[np.bool_],
) -> Contacts:
    """Contacts of the touches of ``reading``, every row of which stands at the edge of touch.

    Args:
        instrument: where the pushes are made.
        strategy: which pushes to make.
        reading: touches (n rows).
        expected: (n,) rad, outer normal in Pi that the contour leads to expect.
        expected_sigma: (n,) rad
        fresh: (n,) whether earlier contacts say nothing.
    """
    touch = make_touch(
        reading,
        instrument.mount,
        expected=expected,
        expected_sigma=expected_sigma,
        fresh=fresh,
    )
    strategy.start(touch)
    for _ in range(ROUNDS):
        ask = strategy.ask()
        rows = np.flatnonzero(ask.action != Action.DONE)
        if rows.size == 0:
            return strategy.contacts()
        again = rows[ask.action[rows] != Action.PUSH]
        if again.size:
            touch, lost = _touch_again(instrument, touch, reading, again, ask.shift[again])
            if lost.size:
                strategy.drop(lost)
                rows = np.setdiff1d(rows, lost)
        if rows.size == 0:
            continue
        pushed = instrument.push(
            touch.which[rows],
            ask.phi[rows],
            ask.angle[rows],
            moment_limit=ask.moment_limit[rows],
            watch=strategy.watch(rows),
        )
        strategy.tell(rows, touch.take(rows), pushed)
    raise AssertionError(f"a contact asked for more than {ROUNDS} actions")


def _touch_again(
    instrument: Instrument, touch: Touch, reading: ApproachReading, rows: IntArray, shift: FloatArray
) -> tuple[Touch, IntArray]:
    """Let go and approach as before; the touches with ``rows`` renewed, and those rows that found nothing."""
    which = touch.which[rows]
    start = instrument.release(which, np.full(rows.size, LET_GO))
    if np.any(shift != 0.0):
        rotation = instrument.mount.rotation_world_sensor(start)
        start[:, :3] += shift[:, None] * (rotation[:, :, 1] @ instrument.mount.rotation)
    renewed = instrument.approach(
        which, start, reading.direction_world[rows], np.full(rows.size, 2.0 * LET_GO)
    )
    good = np.flatnonzero(renewed.touched)
    new = make_touch(
        renewed.take(good),
        instrument.mount,
        expected=touch.expected[rows[good]],
        expected_sigma=touch.expected_sigma[rows[good]],
        fresh=touch.fresh[rows[good]],
    )
    merged = {}
    for field in fields(Touch):
        values = getattr(touch, field.name).copy()
        values[rows[good]] = getattr(new, field.name)
        merged[field.name] = values
    return Touch(**merged), np.setdiff1d(rows, rows[good])
