"""A strategy's questions against an instrument: pushes, touching again, contacts that are not found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contour.antenna import Antenna
from contour.contacts import Contacts
from contour.frames import Mount
from contour.instrument import ApproachReading, Outcome, PushReading, Samples, Stop, Stroke
from contour.localise import LET_GO, ROUNDS, localise
from contour.sensing import Action, Ask

FREE, REST = 4, 2
"""Samples of each touch made here."""


def _samples(n, level):
    stroke = np.repeat(np.int8([Stroke.FREE, Stroke.PRESS, Stroke.REST]), [FREE, 2, REST])
    m = n * stroke.size
    return Samples(
        start=np.arange(n + 1) * stroke.size,
        time=np.arange(m) * 0.01,
        angles=np.zeros((m, 2)),
        moment=np.full((m, 2), level),
        stroke=np.tile(stroke, n),
    )


class _Instrument:
    """Notes what it is asked; antennas in ``gone`` find nothing when they approach again."""

    antennas = 5
    antenna = Antenna()
    mount = Mount.identity()

    def __init__(self, gone=()):
        self.calls = []
        self.machine_time = np.zeros(5)
        self._gone = np.array(gone, dtype=np.int64)

    def reading(self, which, pose, direction, outcome=None):
        n = which.size
        self.touches = getattr(self, "touches", 0) + 1
        return ApproachReading(
            which=which,
            outcome=np.full(n, np.int8(Outcome.FOUND)) if outcome is None else outcome,
            pose=pose,
            direction_world=direction,
            travel=np.zeros(n),
            samples=_samples(n, 1e-6 * self.touches),
            depth_per_sample=1e-4,
        )

    def first(self, which):
        pose = np.zeros((which.size, 5))
        pose[:, 0] = 0.01 * which
        return self.reading(which, pose, np.tile([0.0, 0.0, 1.0], (which.size, 1)))

    def approach(self, which, pose, direction_world, travel):
        self.calls.append(("approach", which, pose, direction_world, travel))
        outcome = np.where(np.isin(which, self._gone), np.int8(Outcome.NOT_FOUND), np.int8(Outcome.FOUND))
        return self.reading(which, pose, direction_world, outcome)

    def push(self, which, phi, angle, *, moment_limit, watch=None):
        self.calls.append(("push", which, phi, angle, moment_limit, watch))
        return PushReading(
            which=which,
            phi=phi,
            angle=angle,
            touch=np.zeros((which.size, 2)),
            stop=np.full(which.size, np.int8(Stop.ANGLE)),
            samples=_samples(which.size, 0.0),
        )

    def release(self, which, clearance):
        self.calls.append(("release", which, clearance))
        pose = np.zeros((which.size, 5))
        pose[:, 0] = 0.01 * which
        pose[:, 2] = -clearance
        return pose


class _Script:
    """Asks what its script says, round by round, and notes what it is told."""

    name = "script"

    def __init__(self, *rounds):
        self._rounds = [np.array(r, dtype=np.int8) for r in rounds]
        self.told, self.dropped = [], []

    def start(self, touch):
        self.touch = touch

    def ask(self):
        n = len(self.touch)
        action = self._rounds.pop(0) if self._rounds else np.zeros(n, dtype=np.int8)
        for rows in self.dropped:
            action[rows] = Action.DONE
        base = np.arange(n, dtype=np.float64)
        return Ask(
            action=action, phi=base, angle=0.01 + 0.01 * base, moment_limit=1e-3 + base, shift=1e-3 * base
        )

    def tell(self, rows, touch, reading):
        self.told.append((rows, touch, reading))

    def drop(self, rows):
        self.dropped.append(rows)

    def watch(self, rows):
        return lambda *_: rows

    def contacts(self):
        return replace(Contacts.none(), which=self.touch.which)


PUSH, AGAIN, ZERO, DONE = Action.PUSH, Action.REAPPROACH, Action.ZERO, Action.DONE


def _run(instrument, script, which):
    n = which.size
    return localise(
        instrument,
        script,
        instrument.first(which),
        expected=np.linspace(0.1, 0.3, n),
        expected_sigma=np.full(n, 0.2),
        fresh=np.arange(n) == 0,
    )


def test_each_round_pushes_who_asks():
    """Antennas, directions, angles and limits are those of the rows that ask; the answer goes back to them."""
    instrument, script, which = (
        _Instrument(),
        _Script([PUSH, DONE, PUSH], [DONE, DONE, PUSH]),
        np.array([4, 0, 2]),
    )
    contacts = _run(instrument, script, which)
    np.testing.assert_array_equal(contacts.which, which)
    assert [call[0] for call in instrument.calls] == ["push", "push"]
    for (_, asked, phi, angle, limit, watch), rows in zip(instrument.calls, ([0, 2], [2]), strict=True):
        np.testing.assert_array_equal(asked, which[rows])
        np.testing.assert_array_equal(phi, rows)
        np.testing.assert_allclose(angle, 0.01 + 0.01 * np.array(rows))
        np.testing.assert_allclose(limit, 1e-3 + np.array(rows))
        np.testing.assert_array_equal(watch(), rows)
    for (rows, touch, reading), expected in zip(script.told, ([0, 2], [2]), strict=True):
        np.testing.assert_array_equal(rows, expected)
        np.testing.assert_array_equal(touch.which, which[expected])
        np.testing.assert_array_equal(reading.which, which[expected])
    np.testing.assert_allclose(script.touch.expected, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(script.touch.fresh, [True, False, False])


@pytest.mark.parametrize("action", [AGAIN, ZERO])
def test_touching_again_lets_go_shifts_and_comes_back(action):
    """Release, the base moved along the beam, the same direction for twice the way; then the new push."""
    instrument, script, which = _Instrument(), _Script([PUSH, action, action]), np.array([1, 2, 3])
    _run(instrument, script, which)
    assert [call[0] for call in instrument.calls] == ["release", "approach", "push"]
    release, approach, push = instrument.calls
    np.testing.assert_array_equal(release[1], [2, 3])
    np.testing.assert_allclose(release[2], LET_GO)
    np.testing.assert_array_equal(approach[1], [2, 3])
    # At joints zero the beam lies along y: shifts of 1 and 2 mm.
    np.testing.assert_allclose(approach[2][:, :3], [[0.02, 1e-3, -LET_GO], [0.03, 2e-3, -LET_GO]])
    np.testing.assert_allclose(approach[3], [[0.0, 0.0, 1.0]] * 2)
    np.testing.assert_allclose(approach[4], 2.0 * LET_GO)
    np.testing.assert_array_equal(push[1], which)
    rows, touch, _ = script.told[0]
    np.testing.assert_array_equal(rows, [0, 1, 2])
    # The first touch of the first row, the second touch of the others; what was expected stays.
    np.testing.assert_allclose(touch.tare[:, 0], [1e-6, 2e-6, 2e-6])
    np.testing.assert_allclose(touch.expected, [0.1, 0.2, 0.3])


def test_contacts_that_are_not_found_again_are_dropped():
    """The strategy is told which rows; the others are pushed all the same."""
    instrument, script = _Instrument(gone=[2]), _Script([AGAIN, AGAIN, PUSH])
    _run(instrument, script, np.array([1, 2, 3]))
    np.testing.assert_array_equal(script.dropped, [[1]])
    np.testing.assert_array_equal(script.told[0][0], [0, 2])
    np.testing.assert_array_equal(instrument.calls[-1][1], [1, 3])


def test_a_round_in_which_all_are_lost_pushes_nobody():
    """The instrument is not asked for no pushes."""
    instrument, script = _Instrument(gone=[1]), _Script([AGAIN])
    _run(instrument, script, np.array([1]))
    assert [call[0] for call in instrument.calls] == ["release", "approach"]
    assert not script.told


def test_a_strategy_that_never_ends_is_a_bug():
    """More rounds than any strategy needs."""
    script = _Script(*[[PUSH]] * (ROUNDS + 1))
    with pytest.raises(AssertionError, match=f"more than {ROUNDS} actions"):
        _run(_Instrument(), script, np.array([0]))
