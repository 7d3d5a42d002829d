"""What a strategy is asked and told: the touch, the next action, and binned readings.

A strategy localises n contacts at once. :func:`binned` turns the samples of a push into bins of both
strokes: the zero of free air and the weight of the beam taken out, the sensor's spin taken out sample by
sample.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts
from contour.frames import Mount, carried_push, plane_angle, rotation_base_sensor
from contour.instrument import ApproachReading, PushReading, Samples, Stroke, Watch

__all__ = [
    "BINS",
    "Action",
    "Ask",
    "Bins",
    "RunawayWatch",
    "Strategy",
    "Touch",
    "binned",
    "locate",
    "make_touch",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BINS = 5
"""Bins of each stroke. Fewer blur the turning point of the friction, more only cost time."""


OUT_RANGE = (0.0, 1.001)
BACK_RANGE = (0.05, 0.95)
"""Shares of the peak angle that the bins of each stroke span. After the turning point friction along the beam
turns round, and at the end of the way back the slide that is left turns the force faster than a bin can
follow."""


class Action(IntEnum):
    """What a strategy wants next for a contact."""

    DONE = 0
    """Nothing: the contact is as good as it gets."""
    PUSH = 1
    """A push from the present touch."""
    REAPPROACH = 2
    """Let go and touch again, shifted along the beam by ``shift``, then a push: friction's memory is gone."""
    ZERO = 3
    """Let go and zero in free air first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ask:
    """The next action for each of n contacts; the other fields mean something where the action uses them."""

    action: NDArray[np.int8]
    """(n,) :class:`Action`"""
    phi: FloatArray
    """(n,) rad, direction of the next push in Pi."""
    angle: FloatArray
    """(n,) rad, angle of the next push."""
    moment_limit: FloatArray
    """(n,) N m"""
    shift: FloatArray
    """(n,) m, base moved along the beam before touching again."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touch:
    """n contacts at the edge of touch, as the readings tell, and what the contour leads to expect."""

    which: IntArray
    """(n,) antenna."""
    joints: FloatArray
    """(n, 2) rad, phi1 and phi2 at touch."""
    base_in_plane: FloatArray
    """(n, 2) m, centre of rotation in Pi: components along x_s and z_s of the world position."""
    base_along: FloatArray
    """(n,) m, its component along the beam."""
    approach: FloatArray
    """(n,) rad, direction in Pi of the motion that touched."""
    approach_share: FloatArray
    """(n,) length of that direction's part in Pi (1 for an approach square to the beam)."""
    tare: FloatArray
    """(n, 2) N m, mean (m_x, m_z) in free air."""
    tare_time: FloatArray
    """(n,) s, machine time at the middle of that mean."""
    tare_samples: IntArray
    """(n,) samples in it; 0 where the touch came too soon."""
    preload: FloatArray
    """(n, 2) N m, (s f_x, s f_z) at rest at the edge of touch, relative to the tare."""
    preload_samples: IntArray
    """(n,) samples in that mean."""
    rise: FloatArray
    """(n,) N m per m, how the moment rose while touching; its inverse square root is a first guess of s."""
    expected: FloatArray
    """(n,) rad, outer normal in Pi that the contour leads to expect."""
    expected_sigma: FloatArray
    """(n,) rad, one standard deviation of that."""
    fresh: NDArray[np.bool_]
    """(n,) whether this touch begins a contour or follows a break: earlier contacts then say nothing."""

    def __len__(self) -> int:
        return int(self.which.size)

    def take(self, rows: IntArray) -> Self:
        """The touches ``rows``."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bins:
    """Bins of P pushes, K = 2 BINS of them: out, then back; in the frame at touch carried without spin."""

    theta: FloatArray
    """(P, K) rad"""
    force: FloatArray
    """(P, K, 2) N m, (s f_x, s f_z); zero and weight of the free beam taken out."""
    time: FloatArray
    """(P, K) s since the tare."""
    count: FloatArray
    """(P, K) samples in each bin; a bin without samples has 0 and counts for nothing."""
    peak: FloatArray
    """(P,) rad, where the push turned back."""
    phi: FloatArray
    """(P,) rad, direction of the push in Pi."""
    up: FloatArray
    """(P, 2) share of the world's up along x_s and z_s at touch."""
    up_along: FloatArray
    """(P,) share of the world's up along the beam at touch."""

    def take(self, rows: IntArray) -> Self:
        """The pushes ``rows``."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


class Strategy(Protocol):
    """From pushes to contacts, n at once."""

    name: str

    def start(self, touch: Touch) -> None:
        """Begin n contacts."""
        ...

    def ask(self) -> Ask:
        """The next action for each of them."""
        ...

    def tell(self, rows: IntArray, touch: Touch, reading: PushReading) -> None:
        """Readings of the pushes asked for: contacts ``rows``, touched as ``touch`` (n rows each)."""
        ...

    def drop(self, rows: IntArray) -> None:
        """Contacts ``rows`` were not found again: nothing more will be told of them."""
        ...

    def watch(self, rows: IntArray) -> Watch | None:
        """What watches the pushes of contacts ``rows`` while they are made."""
        ...

    def contacts(self) -> Contacts:
        """The contacts, once every action is DONE."""
        ...


def _means(samples: Samples, stroke: Stroke, runs: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Mean moment (runs, 2) and time (runs,) of one stroke, and the number of samples."""
    rows = samples.stroke == stroke
    run = samples.run[rows]
    count = np.bincount(run, minlength=runs)
    safe = np.maximum(count, 1)
    moment = np.stack(
        [np.bincount(run, weights=samples.moment[rows, i], minlength=runs) / safe for i in range(2)], axis=1
    )
    return moment, np.bincount(run, weights=samples.time[rows], minlength=runs) / safe, count


def _rise(samples: Samples, tare: FloatArray, runs: int, speed_per_sample: float) -> FloatArray:
    """Slope [N m per m] of the moment over the samples of the press."""
    rows = samples.stroke == Stroke.PRESS
    run = samples.run[rows]
    size = np.hypot(*(samples.moment[rows] - tare[run]).T)
    first = np.searchsorted(run, np.arange(runs))
    depth = (np.arange(run.size) - first[run]) * speed_per_sample
    count = np.maximum(np.bincount(run, minlength=runs), 1)
    mean_depth = np.bincount(run, weights=depth, minlength=runs) / count
    mean_size = np.bincount(run, weights=size, minlength=runs) / count
    away = depth - mean_depth[run]
    spread = np.bincount(run, weights=away * away, minlength=runs)
    slope = np.bincount(run, weights=away * (size - mean_size[run]), minlength=runs) / np.maximum(
        spread, 1e-18
    )
    return np.asarray(np.maximum(slope, 1.0e-3))


def make_touch(
    reading: ApproachReading,
    mount: Mount,
    *,
    expected: FloatArray,
    expected_sigma: FloatArray,
    fresh: NDArray[np.bool_],
) -> Touch:
    """The touch that an approach ended with; every row of ``reading`` must be touched.

    Where the approach had no free air (it touched within its first scan), the tare has no samples and the
    strategy must zero first.
    """
    runs = reading.which.size
    tare, tare_time, tare_samples = _means(reading.samples, Stroke.FREE, runs)
    rest, _, rest_samples = _means(reading.samples, Stroke.REST, runs)
    over = rest - tare
    rotation = mount.rotation_world_sensor(reading.pose)
    position = mount.position_world(reading.pose)
    in_plane = np.stack(
        (np.sum(position * rotation[:, :, 0], 1), np.sum(position * rotation[:, :, 2], 1)), axis=1
    )
    share = np.hypot(
        np.sum(reading.direction_world * rotation[:, :, 0], 1),
        np.sum(reading.direction_world * rotation[:, :, 2], 1),
    )
    return Touch(
        which=reading.which,
        joints=reading.pose[:, 3:5],
        base_in_plane=in_plane,
        base_along=np.sum(position * rotation[:, :, 1], axis=1),
        approach=plane_angle(reading.direction_world, rotation),
        approach_share=share,
        tare=tare,
        tare_time=tare_time,
        tare_samples=tare_samples,
        preload=np.stack((-over[:, 1], over[:, 0]), axis=1),
        preload_samples=rest_samples,
        rise=_rise(reading.samples, tare, runs, reading.depth_per_sample),
        expected=expected,
        expected_sigma=expected_sigma,
        fresh=fresh,
    )


def binned(reading: PushReading, touch: Touch, antenna: Antenna, mount: Mount) -> Bins:
    """Bins of both strokes of each push of ``reading``; row i was pushed from row i of ``touch``."""
    pushes = reading.which.size
    samples = reading.samples
    run = samples.run
    up = rotation_base_sensor(reading.touch[:, 0], reading.touch[:, 1]).transpose(0, 2, 1) @ mount.rotation[2]
    up_plane, up_along = up[:, [0, 2]], up[:, 1]
    # The offset stays with the sensor, the weight with the world: only the offset may be subtracted before
    # the spin.
    weight = antenna.gravity_force(up)
    offset = touch.tare - np.stack((weight[:, 1], -weight[:, 0]), axis=1)
    carried = carried_push(
        samples.angles[:, 0],
        samples.angles[:, 1],
        samples.moment - offset[run],
        touch=reading.touch[run],
        phi=reading.phi[run],
    )
    share = carried.theta / reading.angle[run]
    back = samples.stroke == Stroke.BACK
    low, high = np.where(back, BACK_RANGE[0], OUT_RANGE[0]), np.where(back, BACK_RANGE[1], OUT_RANGE[1])
    slot = np.floor((share - low) / (high - low) * BINS).astype(np.int64)
    inside = (slot >= 0) & (slot < BINS)
    size = pushes * 2 * BINS
    # Samples outside the ranges go to one bin more, which is cut off.
    index = np.where(inside, run * (2 * BINS) + np.where(back, 2 * BINS - 1 - slot, slot), size)

    def total(values: FloatArray) -> FloatArray:
        sums = np.bincount(index, weights=values, minlength=size)[:size]
        return np.asarray(sums.reshape(pushes, 2 * BINS), dtype=np.float64)

    count = np.bincount(index, minlength=size)[:size].reshape(pushes, 2 * BINS).astype(np.float64)
    safe = np.maximum(count, 1.0)
    theta = total(carried.theta) / safe
    force = np.stack((total(carried.force[:, 0]), total(carried.force[:, 1])), axis=2) / safe[..., None]
    # The carried axis e along the push turns with the beam: up . e changes by
    # -up_along sin - (up . e)(1 - cos).
    push = np.stack((np.cos(reading.phi), np.sin(reading.phi)), axis=1)
    along = np.sum(up_plane * push, axis=1)
    change = -up_along[:, None] * np.sin(theta) - along[:, None] * (1.0 - np.cos(theta))
    force -= weight[:, None, :] - antenna.beam.gravity_moment * change[..., None] * push[:, None, :]
    return Bins(
        theta=theta,
        force=force,
        time=total(samples.time - touch.tare_time[run]) / safe,
        count=count,
        peak=reading.angle,
        phi=reading.phi,
        up=up_plane,
        up_along=up_along,
    )


def locate(
    touch: Touch, axis: FloatArray, distance: FloatArray, outward: FloatArray, antenna: Antenna, mount: Mount
) -> tuple[FloatArray, FloatArray]:
    """Surface points and outward normals in the world, (n, 3) each, of contacts ``distance`` (n,) m along.

    ``axis`` (n, 2) m is the beam's axis in Pi; the surface lies one beam radius from it, against the normal.
    """
    frame = mount.rotation @ rotation_base_sensor(touch.joints[:, 0], touch.joints[:, 1])
    normal = np.cos(outward)[:, None] * frame[:, :, 0] + np.sin(outward)[:, None] * frame[:, :, 2]
    along = touch.base_along + distance
    base = axis[:, :1] * frame[:, :, 0] + axis[:, 1:] * frame[:, :, 2]
    return base + along[:, None] * frame[:, :, 1] - antenna.beam.radius * normal, normal


RUN = np.deg2rad(35.0)
"""Turn of the force during a push from which it runs round the body."""
FALL = 0.35
"""Share of its largest moment to which a push may fall on the way out before it has slipped off."""


class RunawayWatch:
    """Ends pushes whose force runs round the body or falls away (q = R_l/(s theta) is too small)."""

    def __init__(self, touch: Touch, phi: FloatArray, angle: FloatArray, antenna: Antenna) -> None:
        self._touch = touch
        self._angle = angle
        self._noise = antenna.sensor.moment_noise
        self._first = np.full(phi.size, np.nan)
        self._largest = np.zeros(phi.size)

    def __call__(self, rows: IntArray, chunk: Samples) -> FloatArray:
        """Angles to go on to, from the newest samples of the pushes ``rows``."""
        count = np.diff(chunk.start)
        over = chunk.moment - self._touch.tare[rows][chunk.run]
        late = np.maximum(chunk.start[1:] - 5, chunk.start[:-1])  # the newest five samples
        total = np.add.reduceat(
            np.vstack((over, np.zeros((1, 2)))), np.stack((late, chunk.start[1:]), 1).ravel()
        )[::2]
        mean = total / np.minimum(count, 5)[:, None]
        size = np.hypot(mean[:, 0], mean[:, 1])
        psi = np.arctan2(mean[:, 0], -mean[:, 1])
        loaded = size > 12.0 * self._noise
        begins = loaded & np.isnan(self._first[rows])
        self._first[rows[begins]] = psi[begins]
        turned = np.abs(np.mod(psi - np.nan_to_num(self._first[rows]) + np.pi, 2.0 * np.pi) - np.pi)
        self._largest[rows] = np.maximum(self._largest[rows], size)
        runs = loaded & (turned > RUN)
        falls = (self._largest[rows] > 30.0 * self._noise) & (size < FALL * self._largest[rows])
        return np.where(runs | falls, 0.0, self._angle[rows])
