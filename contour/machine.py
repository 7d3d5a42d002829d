"""The machine that carries an antenna: scan ticks, ramps, speeds, time, touch threshold, quantisation, noise.

One component of both the simulated instrument and the embedded controller, so that both give the same
readings. Whatever is touched enters only as a moment per depth (approach) or as a moment along the stroke
(push).

Noise is keyed by antenna, approach, push and sample, never drawn from a common stream: a reading does not
depend on which other antennas are served in the same call.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.antenna import Sensor
from contour.errors import UsageError
from contour.instrument import Stroke

__all__ = [
    "MachineModel",
    "NoiseKey",
    "Timeline",
    "TouchTimeline",
    "trapezoid_duration",
    "trapezoid_position",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FREE_SAMPLES = 20
"""Samples in free air that an approach keeps: the zero of the push that follows."""
REST_SAMPLES = 10
"""Samples at standstill after an approach."""
PRESS_TICKS = 64
"""Scans within which a touch must be felt; at 10 mm/s and 100 Hz that is 6.4 mm of bending."""
TOUCH_SCANS = 2
"""Scans in a row above the threshold before touch is declared: one alone would stop free approaches."""


def trapezoid_duration(distance: ArrayLike, speed: float, acceleration: float) -> FloatArray:
    """Time [s] of a move from rest to rest over ``distance`` with ramps.

    >>> float(trapezoid_duration(1.0, 0.5, 0.5))
    3.0
    """
    d = np.abs(np.asarray(distance, dtype=np.float64))
    full = d >= speed**2 / acceleration
    return np.where(full, d / speed + speed / acceleration, 2.0 * np.sqrt(d / acceleration))


def trapezoid_position(
    time: FloatArray, distance: FloatArray, duration: FloatArray, acceleration: float
) -> FloatArray:
    """Position at ``time`` of the move of :func:`trapezoid_duration`; all arguments broadcast."""
    # Speed reached: from duration T and distance d of a trapezoid, v = (T - sqrt(T^2 - 4 d/a)) a / 2.
    lost = np.sqrt(np.maximum(duration**2 - 4.0 * distance / acceleration, 0.0))
    speed = 0.5 * acceleration * (duration - lost)
    ramp = speed / acceleration
    begin = np.minimum(time, ramp)
    end = np.maximum(time - (duration - ramp), 0.0)
    return (
        begin * (0.5 * acceleration * begin)
        + speed * np.maximum(time - ramp, 0.0)
        - 0.5 * acceleration * end**2
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseKey:
    """What the noise of n runs is keyed by."""

    antenna: IntArray
    """(n,) antenna."""
    approach: IntArray
    """(n,) approaches made by that antenna before."""
    push: IntArray
    """(n,) 0 for the approach itself, then the count of its pushes from 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timeline:
    """Ticks of n pushes, one after the other."""

    start: IntArray
    """(n + 1,) rows of each push."""
    run: IntArray
    """(m,) push of each row."""
    theta: FloatArray
    """(m,) rad, commanded angle of the beam along the great circle."""
    time: FloatArray
    """(m,) s since the push began."""
    stroke: NDArray[np.int8]
    """(m,) :class:`Stroke`"""
    duration: FloatArray
    """(n,) s"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TouchTimeline:
    """Ticks of the end of n approaches, one after the other."""

    start: IntArray
    """(n + 1,)"""
    run: IntArray
    """(m,)"""
    time: FloatArray
    """(m,) s since the guarded move began."""
    stroke: NDArray[np.int8]
    """(m,)"""
    noise: FloatArray
    """(m, 2) N m"""
    elastic: FloatArray
    """(m,) N m, magnitude of the moment by bending."""
    rest_depth: FloatArray
    """(n,) m past (or short of, if negative) first touch where the antenna stands in the end."""
    peak: FloatArray
    """(n,) N m, largest elastic moment."""
    duration: FloatArray
    """(n,) s from the begin of the guarded move to standstill."""


def _ragged(counts: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    start = np.concatenate(([0], np.cumsum(counts)))
    run = np.repeat(np.arange(counts.size), counts)
    return start, run, np.arange(start[-1]) - start[:-1][run]


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineModel:
    """Speeds, ramps, thresholds and noise of one machine."""

    sensor: Sensor = field(default_factory=Sensor)
    """Moment sensor, encoders and sample rate."""
    seed: int = 0
    """Key of all noise."""
    travel_speed: float = 0.050
    """Unguarded moves [m/s]."""
    approach_speed: float = 0.010
    """Guarded moves [m/s]."""
    retreat_speed: float = 0.001
    """Backing off to the edge of touch [m/s]."""
    acceleration: float = 0.5
    """Linear ramps [m/s^2]."""
    push_speed: float = float(np.deg2rad(2.0))
    """Out stroke [rad/s]."""
    return_speed: float = float(np.deg2rad(5.0))
    """Back stroke [rad/s]."""
    turn_speed: float = float(np.deg2rad(20.0))
    """Turns between contacts [rad/s]."""
    turn_acceleration: float = 1.0
    """Rotary ramps [rad/s^2]."""
    initial_offset: float = 100e-6
    """Standard deviation of the moment sensor's offset when switched on, each axis [N m]."""

    def __post_init__(self) -> None:
        for number in fields(self):
            value = getattr(self, number.name)
            free = number.name in {"sensor", "seed", "initial_offset"}
            if not (free or (np.isfinite(value) and value > 0.0)):
                raise UsageError(f"gantry {number.name} is {value!r}: it must be a finite number above zero")
        if not (np.isfinite(self.initial_offset) and self.initial_offset >= 0.0):
            raise UsageError(
                f"gantry initial_offset is {self.initial_offset!r}: it must be zero or more, in N m"
            )
        if self.seed < 0:
            raise UsageError(f"seed is {self.seed}: it must be zero or more")

    def move_time(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """(n,) s of an unguarded move between poses (n, 5): the slower of the straight line and the turns."""
        line = np.linalg.norm(end[:, :3] - start[:, :3], axis=1)
        turn = np.max(np.abs(end[:, 3:] - start[:, 3:]), axis=1)
        return np.maximum(
            trapezoid_duration(line, self.travel_speed, self.acceleration),
            trapezoid_duration(turn, self.turn_speed, self.turn_acceleration),
        )

    def noise(self, key: NoiseKey, counts: IntArray) -> FloatArray:
        """(sum(counts), 2) N m, white noise of the moment samples, run after run.

        The first k samples of a run are the same for any count of at least k.
        """
        generator = np.random.Generator(bits := np.random.Philox(key=np.zeros(2, dtype=np.uint64)))
        parts = []
        for antenna, approach, push, count in zip(
            key.antenna.tolist(), key.approach.tolist(), key.push.tolist(), counts.tolist(), strict=True
        ):
            bits.state = {
                "bit_generator": "Philox",
                "state": {
                    "counter": np.array([0, 0, push, approach], dtype=np.uint64),
                    "key": np.array([self.seed, antenna], dtype=np.uint64),
                },
                "buffer": np.zeros(4, dtype=np.uint64),
                "buffer_pos": 4,
                "has_uint32": 0,
                "uinteger": 0,
            }
            parts.append(generator.standard_normal((count, 2)))
        if not parts:
            return np.zeros((0, 2))
        return self.sensor.moment_noise * np.concatenate(parts)

    def offset(self, antenna: IntArray, time: FloatArray) -> FloatArray:
        """(m, 2) N m, the sensor's offset at machine time ``time`` (m,): a start value and a ramp each."""
        unique, inverse = np.unique(antenna, return_inverse=True)
        start, slope = np.zeros((unique.size, 2)), np.zeros((unique.size, 2))
        for i, a in enumerate(unique.tolist()):
            # An own key: the counter's first words are never reached by the noise of readings.
            draw = np.random.Generator(np.random.Philox(key=[self.seed, a], counter=[0, 1, 0, 0]))
            start[i] = self.initial_offset * draw.standard_normal(2)
            slope[i] = self.sensor.moment_drift * (2.0 * draw.integers(0, 2, 2) - 1.0)
        return start[inverse] + slope[inverse] * time[:, None]

    def encode(self, angles: FloatArray) -> FloatArray:
        """Angles as the encoders give them."""
        return np.round(angles / self.sensor.encoder_step) * self.sensor.encoder_step

    def push_timeline(self, angle: FloatArray) -> Timeline:
        """Ticks of pushes to ``angle`` (n,) rad and back."""
        rate, ramp = self.sensor.sample_rate, self.turn_acceleration
        out = trapezoid_duration(angle, self.push_speed, ramp)
        back = trapezoid_duration(angle, self.return_speed, ramp)
        n_out, n_back = np.ceil(out * rate).astype(np.int64), np.ceil(back * rate).astype(np.int64)
        start, run, tick = _ragged(n_out + n_back)
        returning = tick >= n_out[run]
        lap = (np.where(returning, tick - n_out[run], tick) + 1.0) / rate
        duration = np.where(returning, back[run], out[run])
        position = trapezoid_position(np.minimum(lap, duration), angle[run], duration, ramp)
        return Timeline(
            start=start,
            run=run,
            theta=np.where(returning, angle[run] - position, position),
            time=np.asarray((tick + 1.0) / rate, dtype=np.float64),
            stroke=np.where(returning, np.int8(Stroke.BACK), np.int8(Stroke.OUT)),
            duration=(n_out + n_back) / rate,
        )

    def touch_timeline(self, key: NoiseKey, distance: FloatArray, slope: FloatArray) -> TouchTimeline:
        """The end of guarded moves that touch after ``distance`` (n,) m; ``slope`` (n,) N m per m of depth.

        Touch is declared after :data:`TOUCH_SCANS` scans above the threshold, relative to the mean in free
        air; the machine brakes, then backs off until the moment is under half the threshold, and stands.
        """
        tick = self.approach_speed / self.sensor.sample_rate
        threshold = self.sensor.touch_moment
        n = distance.size
        n_free = np.minimum(np.floor(distance / tick).astype(np.int64), FREE_SAMPLES)
        creep = self.retreat_speed / self.sensor.sample_rate
        brake = self.approach_speed**2 / (2.0 * self.acceleration)
        first = (np.floor(distance / tick) + 1.0) * tick - distance  # depth at the first scan after touch
        depth_in = first[:, None] + tick * np.arange(PRESS_TICKS)
        fixed = FREE_SAMPLES + PRESS_TICKS + REST_SAMPLES
        # As many retreat scans as the deepest possible stop can need.
        felt = np.minimum(np.ceil(1.5 * threshold / (slope * tick)) + TOUCH_SCANS, PRESS_TICKS - 1)
        n_retreat = np.ceil(((felt + 2.0) * tick + brake) / creep).astype(np.int64) + 2
        raw = self.noise(key, fixed + n_retreat)
        head = (np.cumsum(fixed + n_retreat) - (fixed + n_retreat))[:, None]
        free = raw[head + np.arange(FREE_SAMPLES)]
        used = np.arange(FREE_SAMPLES) >= FREE_SAMPLES - n_free[:, None]
        tare = (free * used[..., None]).sum(axis=1) / np.maximum(n_free, 1)[:, None]
        press = raw[head + FREE_SAMPLES + np.arange(PRESS_TICKS)] - tare[:, None, :]
        over = np.hypot(slope[:, None] * depth_in + press[..., 0], press[..., 1]) > threshold
        declared = over[:, 1:] & over[:, :-1]
        j_stop = np.where(declared.any(axis=1), np.argmax(declared, axis=1) + 1, PRESS_TICKS - 1)
        bottom = depth_in[np.arange(n), j_stop] + brake
        width = int(n_retreat.max(initial=0))
        column = np.arange(width)
        depth_out = np.maximum(bottom[:, None] - creep * (column + 1.0), -creep)
        index = np.minimum(head + fixed + column, raw.shape[0] - 1)
        away = raw[index] - tare[:, None, :]
        clear = (
            np.hypot(slope[:, None] * np.maximum(depth_out, 0.0) + away[..., 0], away[..., 1])
            < 0.5 * threshold
        )
        clear |= column >= (n_retreat - 1)[:, None]
        i_stop = np.argmax(clear, axis=1)
        rest = depth_out[np.arange(n), i_stop]
        counts = n_free + (j_stop + 1) + (i_stop + 1) + REST_SAMPLES
        start, run, tick_no = _ragged(counts)
        free_end = n_free[run]
        press_end, retreat_end = free_end + j_stop[run] + 1, free_end + j_stop[run] + i_stop[run] + 2
        stroke = np.select(
            [tick_no < free_end, tick_no < press_end, tick_no < retreat_end],
            [np.int8(Stroke.FREE), np.int8(Stroke.PRESS), np.int8(Stroke.RETREAT)],
            np.int8(Stroke.REST),
        )
        source = np.select(
            [tick_no < free_end, tick_no < press_end, tick_no < retreat_end],
            [
                FREE_SAMPLES - free_end + tick_no,
                FREE_SAMPLES + tick_no - free_end,
                fixed + tick_no - press_end,
            ],
            FREE_SAMPLES + PRESS_TICKS + tick_no - retreat_end,
        )
        inside = np.clip(tick_no - free_end, 0, PRESS_TICKS - 1)
        leaving = np.clip(tick_no - press_end, 0, max(width - 1, 0))
        depth = np.select(
            [tick_no < free_end, tick_no < press_end, tick_no < retreat_end],
            [np.zeros(run.size), depth_in[run, inside], depth_out[run, leaving]],
            rest[run],
        )
        before = np.floor(distance / tick) / self.sensor.sample_rate
        return TouchTimeline(
            start=start,
            run=run,
            time=before[run] + (tick_no - free_end + 1.0) / self.sensor.sample_rate,
            stroke=stroke,
            noise=raw[head[:, 0][run] + source],
            elastic=slope[run] * np.maximum(depth, 0.0),
            rest_depth=rest,
            peak=slope * bottom,
            duration=before + (counts - n_free) / self.sensor.sample_rate,
        )
