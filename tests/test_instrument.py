"""Records of the seam, and that a log gives its readings again, bit for bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from contour.antenna import Antenna
from contour.errors import InstrumentError
from contour.frames import Mount
from contour.instrument import (
    ApproachReading,
    Outcome,
    PushReading,
    RecordingInstrument,
    ReplayInstrument,
    Samples,
    Stop,
    Stroke,
    ZeroReading,
)


def _samples(rng, counts):
    start = np.concatenate(([0], np.cumsum(counts)))
    m = int(start[-1])
    return Samples(
        start=start,
        time=rng.normal(size=m),
        angles=rng.normal(size=(m, 2)),
        moment=rng.normal(size=(m, 2)),
        stroke=rng.integers(0, len(Stroke), m).astype(np.int8),
    )


def _approach(rng, which):
    n = which.size
    outcome = np.arange(n, dtype=np.int8) % len(Outcome)
    return ApproachReading(
        which=which,
        outcome=outcome,
        pose=rng.normal(size=(n, 5)),
        direction_world=rng.normal(size=(n, 3)),
        travel=rng.normal(size=n),
        samples=_samples(rng, rng.integers(0, 5, n)),
        depth_per_sample=1e-4,
    )


class _Noisemaker:
    """Answers with random numbers, never the same twice."""

    antennas = 4
    antenna = Antenna()
    mount = Mount.identity()

    def __init__(self, rng):
        self._rng = rng
        self.machine_time = np.zeros(4)

    def _tick(self, which):
        self.machine_time = self.machine_time.copy()
        self.machine_time[which] += self._rng.random(which.size)

    def zero(self, which):
        self._tick(which)
        n = which.size
        moment, sigma = self._rng.normal(size=(n, 2)), self._rng.random(n)
        return ZeroReading(which=which, moment=moment, sigma=sigma, time=self._rng.random(n))

    def approach(self, which, pose, direction_world, travel):
        self._tick(which)
        return _approach(self._rng, which)

    def push(self, which, phi, angle, *, moment_limit, watch=None):
        self._tick(which)
        n = which.size
        return PushReading(
            which=which,
            phi=phi,
            angle=angle,
            touch=self._rng.normal(size=(n, 2)),
            stop=np.full(n, np.int8(Stop.WATCH)),
            samples=_samples(self._rng, self._rng.integers(1, 9, n)),
        )

    def release(self, which, clearance):
        self._tick(which)
        return self._rng.normal(size=(which.size, 5))


def _pass(instrument):
    """One of each call; answers and machine times."""
    all_of, some = np.arange(4), np.array([2, 0])
    phi = np.array([0.3, -1.0])
    calls = (
        lambda: instrument.zero(all_of),
        lambda: instrument.approach(all_of, np.zeros((4, 5)), np.eye(3)[[0] * 4], np.ones(4)),
        lambda: instrument.push(some, phi, np.full(2, 0.05), moment_limit=np.full(2, 0.01)),
        lambda: instrument.release(some, np.full(2, 1e-3)),
    )
    return [(call(), instrument.machine_time.copy()) for call in calls]


def _assert_same(one, other):
    """The same type, shapes, kinds of number and bits."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif hasattr(one, "__dataclass_fields__"):
        for field in fields(one):
            _assert_same(getattr(one, field.name), getattr(other, field.name))
    else:
        assert one == other


@pytest.fixture
def recorded(rng):
    """What was answered, and the log of it."""
    recorder = RecordingInstrument(_Noisemaker(rng))
    return _pass(recorder), recorder.log()


def _replay(log):
    return ReplayInstrument(log, antenna=Antenna(), mount=Mount.identity())


def test_a_log_gives_its_readings_again(recorded, tmp_path):
    """Through a file: every array bit for bit, every number, and the machine times."""
    answers, log = recorded
    np.savez_compressed(tmp_path / "readings.npz", **log)
    with np.load(tmp_path / "readings.npz", allow_pickle=False) as file:
        replayed = _replay(dict(file))
    assert replayed.antennas == 4
    assert not replayed.finished
    for (one, one_time), (other, other_time) in zip(answers, _pass(replayed), strict=True):
        _assert_same(one, other)
        np.testing.assert_array_equal(one_time, other_time)
    assert replayed.finished


def test_recording_changes_nothing():
    """The recorder passes on what the instrument answered."""
    plain = _pass(_Noisemaker(np.random.default_rng(5)))
    for (one, _), (other, _) in zip(
        plain, _pass(RecordingInstrument(_Noisemaker(np.random.default_rng(5)))), strict=True
    ):
        _assert_same(one, other)


def test_calls_name_kind_and_antennas(rng):
    """The record of calls, for the log of events."""
    recorder = RecordingInstrument(_Noisemaker(rng))
    _pass(recorder)
    assert [kind for kind, *_ in recorder.calls] == ["zero", "approach", "push", "release"]
    np.testing.assert_array_equal(recorder.calls[2][1], [2, 0])


def test_another_sequence_is_refused(recorded):
    """Another call, other antennas or another direction than logged: the message names the call and the remedy."""
    _, log = recorded
    with pytest.raises(
        InstrumentError, match="call 0 of the log is a zero, or of other antennas than this push"
    ):
        _replay(log).push(np.arange(4), np.zeros(4), np.ones(4), moment_limit=np.ones(4))
    with pytest.raises(InstrumentError, match="configuration it was made with"):
        _replay(log).zero(np.arange(3))
    replayed = _replay(log)
    replayed.zero(np.arange(4))
    replayed.approach(np.arange(4), np.zeros((4, 5)), np.zeros((4, 3)), np.ones(4))
    with pytest.raises(InstrumentError, match="call 2 of the log pushes another way than asked"):
        replayed.push(np.array([2, 0]), np.array([0.3, -0.9]), np.ones(2), moment_limit=np.ones(2))


def test_a_log_that_is_used_up_says_so(recorded):
    """One call more than was logged."""
    replayed = _replay(recorded[1])
    _pass(replayed)
    with pytest.raises(InstrumentError, match="the log ends before this zero"):
        replayed.zero(np.arange(4))


def test_taking_runs_keeps_their_samples_together(rng):
    """Runs in another order, one twice, empty ones among them."""
    samples = _samples(rng, np.array([3, 0, 5, 1]))
    rows = np.array([2, 1, 0, 2])
    taken = samples.take(rows)
    np.testing.assert_array_equal(taken.start, [0, 5, 5, 8, 13])
    np.testing.assert_array_equal(taken.run, np.repeat(np.arange(4), [5, 0, 3, 5]))
    for place, row in enumerate(rows):
        for name in ("time", "angles", "moment", "stroke"):
            np.testing.assert_array_equal(
                getattr(taken, name)[taken.start[place] : taken.start[place + 1]],
                getattr(samples, name)[samples.start[row] : samples.start[row + 1]],
            )


def test_taking_approaches_takes_their_samples(rng):
    """Every field follows the rows."""
    reading = _approach(rng, np.arange(4))
    taken = reading.take(np.array([3, 1]))
    np.testing.assert_array_equal(taken.which, [3, 1])
    np.testing.assert_array_equal(taken.pose, reading.pose[[3, 1]])
    _assert_same(taken.samples, reading.samples.take(np.array([3, 1])))
    assert taken.depth_per_sample == reading.depth_per_sample


def test_found_and_blocked_stand_at_touch(rng):
    """The other two outcomes stand in free air."""
    reading = _approach(rng, np.arange(4))
    touched = {Outcome(o) for o in reading.outcome[reading.touched].tolist()}
    assert touched == {Outcome.FOUND, Outcome.BLOCKED}
