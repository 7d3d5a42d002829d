"""The seam: what any antenna on any gantry offers, over n antennas at once.

Above it nobody sees a mesh, a true contact, a socket or a clock; below it nobody sees a strategy. Every call
names the antennas it means (``which``, indices) and gives one value per named antenna. Poses are (X, Y, Z,
phi1, phi2) in the base frame, ``direction_world`` are unit 3-vectors in the world, ``phi`` are angles in the
sensing plane Pi.

A pass over one contact is ``approach`` -> ``push`` (as often as needed) -> ``release``. Each push starts at
touch and comes back to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.errors import InstrumentError
from contour.frames import Mount

__all__ = [
    "ApproachReading",
    "Instrument",
    "Outcome",
    "PushReading",
    "RecordingInstrument",
    "ReplayInstrument",
    "Samples",
    "Stop",
    "Stroke",
    "Watch",
    "ZeroReading",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Outcome(IntEnum):
    """How an approach ended."""

    FOUND = 0
    """Touched; the antenna stands at the edge of touch."""
    NOT_FOUND = 1
    """No touch within the travel; the antenna stands at the end of it."""
    TOUCHING = 2
    """Touching already at the start of the guarded move; the antenna went back to where it was free."""
    BLOCKED = 3
    """Something was in the way of the move to the start; the antenna stands there, backed off."""


class Stroke(IntEnum):
    """What the machine did while a sample was taken."""

    FREE = 0
    """Guarded move before touch."""
    PRESS = 1
    """Touch until standstill."""
    RETREAT = 2
    """Backing off to the edge of touch."""
    REST = 3
    """Standing still."""
    OUT = 4
    """Turning towards phi."""
    BACK = 5
    """Turning back to touch."""


class Stop(IntEnum):
    """Why the out stroke of a push ended."""

    ANGLE = 0
    """The angle asked for was reached."""
    MOMENT = 1
    """The moment limit was reached."""
    WATCH = 2
    """The watch asked for it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Samples of n runs, one after the other: run i owns rows ``start[i]:start[i + 1]``."""

    start: IntArray
    """(n + 1,)"""
    time: FloatArray
    """(m,) s, machine time of the antenna."""
    angles: FloatArray
    """(m, 2) rad, encoders phi1 and phi2."""
    moment: FloatArray
    """(m, 2) N m, m_x and m_z of the sensor frame, raw: offset, drift and gravity are in it."""
    stroke: NDArray[np.int8]
    """(m,) :class:`Stroke`"""

    @property
    def run(self) -> IntArray:
        """(m,) index of the run that each sample belongs to."""
        return np.repeat(np.arange(self.start.size - 1), np.diff(self.start))

    def take(self, rows: IntArray) -> Self:
        """The samples of the runs ``rows``, in that order."""
        counts = np.diff(self.start)[rows]
        start = np.concatenate(([0], np.cumsum(counts)))
        index = np.arange(start[-1]) + np.repeat(self.start[rows] - start[:-1], counts)
        return type(self)(
            start=start,
            time=self.time[index],
            angles=self.angles[index],
            moment=self.moment[index],
            stroke=self.stroke[index],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZeroReading:
    """Offsets in free air."""

    which: IntArray
    """(n,) antennas."""
    moment: FloatArray
    """(n, 2) N m, mean of (m_x, m_z): offset and weight of the beam at this pose."""
    sigma: FloatArray
    """(n,) N m, standard deviation of each mean."""
    time: FloatArray
    """(n,) s, machine time at the middle of the averaging."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ApproachReading:
    """What an approach found, and the samples of its end."""

    which: IntArray
    """(n,) antennas."""
    outcome: NDArray[np.int8]
    """(n,) :class:`Outcome`"""
    pose: FloatArray
    """(n, 5) m and rad, where the antenna stands now: at the edge of touch when found or blocked."""
    direction_world: FloatArray
    """(n, 3) unit, direction of the motion that touched (of the move to the start when blocked)."""
    travel: FloatArray
    """(n,) m, along that direction from the start of the motion to ``pose``."""
    samples: Samples
    """The last samples in free air, of the touch and of standing at its edge; none where nothing was met."""
    depth_per_sample: float
    """m moved between two samples of the guarded move."""

    @property
    def touched(self) -> NDArray[np.bool_]:
        """(n,) whether the antenna now stands at the edge of touch."""
        return np.asarray((self.outcome == Outcome.FOUND) | (self.outcome == Outcome.BLOCKED))

    def take(self, rows: IntArray) -> Self:
        """The approaches ``rows``."""
        return type(self)(
            which=self.which[rows],
            outcome=self.outcome[rows],
            pose=self.pose[rows],
            direction_world=self.direction_world[rows],
            travel=self.travel[rows],
            samples=self.samples.take(rows),
            depth_per_sample=self.depth_per_sample,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushReading:
    """Samples of both strokes of a push."""

    which: IntArray
    """(n,) antennas."""
    phi: FloatArray
    """(n,) rad, direction of the push in Pi at touch."""
    angle: FloatArray
    """(n,) rad, where the out stroke turned back."""
    touch: FloatArray
    """(n, 2) rad, encoders at touch."""
    stop: NDArray[np.int8]
    """(n,) :class:`Stop`"""
    samples: Samples
    """Both strokes, and the rest before and after."""


Watch = Callable[[IntArray, Samples], FloatArray]
"""``watch(rows, chunk)`` is shown each fixed chunk of out-stroke samples of the pushes ``rows`` (indices into
the call) as they come, and gives for each the angle to go on to, rad; one that is already passed turns the
push back at once.
"""


class Instrument(Protocol):
    """n antennas, each on its own gantry: simulated, real, or read from a log."""

    @property
    def antennas(self) -> int:
        """How many."""
        ...

    @property
    def antenna(self) -> Antenna:
        """Beam, sensor and moment limit as calibrated."""
        ...

    @property
    def mount(self) -> Mount:
        """Where the gantry's base stands in the world."""
        ...

    @property
    def machine_time(self) -> FloatArray:
        """(antennas,) s, time that each machine has spent so far."""
        ...

    def zero(self, which: IntArray) -> ZeroReading:
        """Average the moments in free air; refused (:class:`InstrumentError`) while touching."""
        ...

    def approach(
        self, which: IntArray, pose: FloatArray, direction_world: FloatArray, travel: FloatArray
    ) -> ApproachReading:
        """Checked move to ``pose`` (n, 5), then a guarded straight move along ``direction_world`` (n, 3).

        It goes on for at most ``travel`` (n,) m, and ends backed off to the edge of touch if touch there was.
        """
        ...

    def push(
        self,
        which: IntArray,
        phi: FloatArray,
        angle: FloatArray,
        *,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> PushReading:
        """Turn the beam by ``angle`` (n,) rad along the great circle towards ``phi`` (n,) in Pi, and back.

        The out stroke ends early at ``moment_limit`` (n,) N m or when ``watch`` says so.
        """
        ...

    def release(self, which: IntArray, clearance: FloatArray) -> FloatArray:
        """Back along the last approach by ``clearance`` (n,) m; the poses (n, 5) reached."""
        ...


SAME_DIRECTION = 1e-6
"""Directions of a replayed push may differ by the rounding of another machine, no more [rad]."""

_Reading = ZeroReading | ApproachReading | PushReading | FloatArray
_R = TypeVar("_R", bound=_Reading)
_KINDS: dict[str, type[ZeroReading | ApproachReading | PushReading]] = {
    "zero": ZeroReading,
    "approach": ApproachReading,
    "push": PushReading,
}
_SAMPLE_FIELDS = tuple(f.name for f in fields(Samples))


def _pack(prefix: str, reading: _Reading) -> dict[str, NDArray[np.generic]]:
    if isinstance(reading, np.ndarray):
        return {f"{prefix}/poses": reading}
    arrays: dict[str, NDArray[np.generic]] = {}
    for field in fields(reading):
        value = getattr(reading, field.name)
        if isinstance(value, Samples):
            arrays.update({f"{prefix}/samples.{name}": getattr(value, name) for name in _SAMPLE_FIELDS})
        else:
            arrays[f"{prefix}/{field.name}"] = np.asarray(value)
    return arrays


class RecordingInstrument:
    """Passes every call on to ``instrument`` and keeps what it answered, for :class:`ReplayInstrument`."""

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument
        self._calls: list[tuple[str, IntArray, _Reading, FloatArray]] = []

    @property
    def antennas(self) -> int:
        """How many."""
        return self._instrument.antennas

    @property
    def antenna(self) -> Antenna:
        """Beam, sensor and moment limit."""
        return self._instrument.antenna

    @property
    def mount(self) -> Mount:
        """Where the gantry's base stands in the world."""
        return self._instrument.mount

    @property
    def machine_time(self) -> FloatArray:
        """(antennas,) s."""
        return self._instrument.machine_time

    @property
    def calls(self) -> list[tuple[str, IntArray, ZeroReading | ApproachReading | PushReading | FloatArray]]:
        """Every call so far: its kind, the antennas asked and what was answered."""
        return [(kind, which, reading) for kind, which, reading, _ in self._calls]

    def _keep(self, kind: str, which: IntArray, reading: _R) -> _R:
        self._calls.append((kind, which.copy(), reading, self._instrument.machine_time.copy()))
        return reading

    def zero(self, which: IntArray) -> ZeroReading:
        """As :meth:`Instrument.zero`."""
        return self._keep("zero", which, self._instrument.zero(which))

    def approach(
        self, which: IntArray, pose: FloatArray, direction_world: FloatArray, travel: FloatArray
    ) -> ApproachReading:
        """As :meth:`Instrument.approach`."""
        return self._keep("approach", which, self._instrument.approach(which, pose, direction_world, travel))

    def push(
        self,
        which: IntArray,
        phi: FloatArray,
        angle: FloatArray,
        *,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> PushReading:
        """As :meth:`Instrument.push`."""
        reading = self._instrument.push(which, phi, angle, moment_limit=moment_limit, watch=watch)
        return self._keep("push", which, reading)

    def release(self, which: IntArray, clearance: FloatArray) -> FloatArray:
        """As :meth:`Instrument.release`."""
        return self._keep("release", which, self._instrument.release(which, clearance))

    def log(self) -> dict[str, NDArray[np.generic]]:
        """Every call and what it answered as named arrays, ready for ``numpy.savez``."""
        arrays: dict[str, NDArray[np.generic]] = {
            "kinds": np.array([kind for kind, *_ in self._calls], dtype="U8"),
            "antennas": np.array(self.antennas),
        }
        for i, (_, which, reading, machine_time) in enumerate(self._calls):
            arrays[f"{i}/asked"] = which
            arrays[f"{i}/machine_time"] = machine_time
            arrays.update(_pack(str(i), reading))
        return arrays


class ReplayInstrument:
    """Gives the readings of a log again, call by call, whatever machine they came from."""

    def __init__(self, log: dict[str, NDArray[np.generic]], *, antenna: Antenna, mount: Mount) -> None:
        self._calls: dict[str, dict[str, NDArray[np.generic]]] = {}
        for name, value in log.items():
            call, _, field = name.partition("/")
            self._calls.setdefault(call, {})[field] = value
        self._kinds = [str(kind) for kind in log["kinds"]]
        self._next = 0
        self._antennas = int(log["antennas"])
        self._antenna = antenna
        self._mount = mount
        self._machine_time = np.zeros(self._antennas)

    @property
    def antennas(self) -> int:
        """How many."""
        return self._antennas

    @property
    def antenna(self) -> Antenna:
        """Beam, sensor and moment limit."""
        return self._antenna

    @property
    def mount(self) -> Mount:
        """Where the gantry's base stood in the world."""
        return self._mount

    @property
    def machine_time(self) -> FloatArray:
        """(antennas,) s, as logged after the last call replayed."""
        return self._machine_time

    @property
    def finished(self) -> bool:
        """Whether every call of the log has been replayed."""
        return self._next == len(self._kinds)

    def _fetch(self, kind: str, which: IntArray) -> dict[str, NDArray[np.generic]]:
        if self.finished:
            raise InstrumentError(
                f"the log ends before this {kind}: it was made with another strategy or another version"
            )
        found = self._calls[str(self._next)]
        if self._kinds[self._next] != kind or not np.array_equal(found["asked"], which):
            raise InstrumentError(
                f"call {self._next} of the log is a {self._kinds[self._next]}, or of other antennas than "
                f"this {kind}: replay it with the configuration it was made with"
            )
        self._next += 1
        self._machine_time = np.asarray(found["machine_time"], dtype=np.float64)
        return found

    def _reading(self, kind: str, which: IntArray) -> _Reading:
        found = self._fetch(kind, which)
        values: dict[str, object] = {}
        for field in fields(_KINDS[kind]):
            if field.name == "samples":
                values["samples"] = Samples(**{name: found[f"samples.{name}"] for name in _SAMPLE_FIELDS})  # type: ignore[arg-type]
            else:
                value = found[field.name]
                values[field.name] = value if value.ndim else value.item()
        return _KINDS[kind](**values)  # type: ignore[arg-type]

    def zero(self, which: IntArray) -> ZeroReading:
        """As :meth:`Instrument.zero`."""
        reading = self._reading("zero", which)
        assert isinstance(reading, ZeroReading)
        return reading

    def approach(
        self, which: IntArray, pose: FloatArray, direction_world: FloatArray, travel: FloatArray
    ) -> ApproachReading:
        """As :meth:`Instrument.approach`; what was asked for is taken from the log."""
        reading = self._reading("approach", which)
        assert isinstance(reading, ApproachReading)
        return reading

    def push(
        self,
        which: IntArray,
        phi: FloatArray,
        angle: FloatArray,
        *,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> PushReading:
        """As :meth:`Instrument.push`; the watch was heard when the log was made."""
        reading = self._reading("push", which)
        assert isinstance(reading, PushReading)
        if not np.allclose(reading.phi, phi, rtol=0.0, atol=SAME_DIRECTION):
            raise InstrumentError(
                f"call {self._next - 1} of the log pushes another way than asked: replay it with the strategy and "
                "the version it was made with"
            )
        return reading

    def release(self, which: IntArray, clearance: FloatArray) -> FloatArray:
        """As :meth:`Instrument.release`."""
        return np.asarray(self._fetch("release", which)["poses"], dtype=np.float64)
