"""The virtual antenna: what the sensor of a machine reads when its beam presses against a known contact.

Mechanics come from the ladder of forward models (edge, reduced, profile, elastica), one rung per push;
ticks, noise and quantisation from the machine. No strategy and no estimator is known here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.frames import Mount, rotation_base_sensor, spun_push
from contour.instrument import PushReading, Samples, Stop, Stroke, Watch
from contour.machine import MachineModel, NoiseKey, Timeline

__all__ = ["CHUNK", "Response", "TrueContact", "VirtualAntenna"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CHUNK = 20
"""Samples that a watch is shown at once."""
NODES_OUT = np.concatenate(([0.0, 0.01], np.arange(1, 33) / 32.0))
NODES_BACK = np.concatenate(([1.0, 0.99, 0.98], np.arange(31, 0, -1) / 32.0, [0.02, 0.01, 0.0]))
"""Shares of the peak angle at which the mechanics is evaluated on each stroke. The force between them is
linear in the angle, as a sticking contact's is; after the turning point friction along the beam changes sign
at once, and near the end of the way back the slide that is left turns the force."""
GRAZING = 0.05
"""Pushes with a smaller cosine to the inner normal leave the body instead of pressing it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueContact:
    """What the beam truly touches, n contacts; known to simulation and evaluation alone."""

    distance: FloatArray
    """(n,) m, s."""
    outward: FloatArray
    """(n,) rad, angle of the outer normal's part in Pi."""
    tilt: FloatArray
    """(n,) rad, angle of the outer normal out of Pi, positive towards the base; zero but for tips."""
    kind: NDArray[np.int8]
    """(n,) :class:`Kind`"""
    radius_along: FloatArray
    """(n,) m, R, 0 for an edge."""
    radius_across: FloatArray
    """(n,) m, R_l; inf flat, negative concave."""
    friction: FloatArray
    """(n,) mu"""
    point: FloatArray
    """(n, 3) m, surface point in the world."""
    normal: FloatArray
    """(n, 3) outer normal of the surface in the world."""
    body: IntArray
    """(n,) body touched."""
    region: NDArray[np.int8]
    """(n,) region of the surface where the scene knows one, else -1."""
    extent: FloatArray
    """(n,) m, how far to the sides the two radii describe the silhouette."""
    depth: FloatArray
    """(n,) m, how far the beam is pressed against the inner normal at rest; negative for a gap."""

    def take(self, rows: IntArray) -> Self:
        """The contacts ``rows``."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


Response = Callable[[TrueContact, FloatArray, FloatArray, IntArray], tuple[FloatArray, FloatArray]]
"""``response(contact, eps, path, rows)``: moment angle |M| s/(3 EI) and delta, (n, k), along ``path`` (n, k)
rad of pushes at ``eps`` (n,) off the inner normal. ``rows`` are indices of the contacts for whoever keeps
more about them."""


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """Forces of n pushes at the nodes of both strokes."""

    force: FloatArray  # (n, K, 2) N m
    lever: FloatArray  # (n,) m^2, (6 L^2 - 4 L s + s^2)/8

    def at(self, timeline: Timeline, peak: FloatArray) -> FloatArray:
        """(m, 2) N m along the timeline."""
        share = np.clip(timeline.theta / peak[timeline.run], 0.0, 1.0)
        back = timeline.stroke == Stroke.BACK
        steps = np.arange(_FRACTION.size, dtype=np.float64)
        place = np.interp(share, NODES_OUT, steps[: NODES_OUT.size])
        place[back] = np.interp(-share[back], -NODES_BACK, steps[NODES_OUT.size - 1 :])
        left = np.minimum(place.astype(np.int64), _FRACTION.size - 2)
        weight = (place - left)[:, None]
        flat = self.force.reshape(-1, 2)
        index = timeline.run * _FRACTION.size + left
        before = flat[index]
        return np.asarray(before + weight * (flat[index + 1] - before))


_FRACTION = np.concatenate((NODES_OUT, NODES_BACK[1:]))


class VirtualAntenna:
    """Readings of pushes against known contacts."""

    def __init__(self, antenna: Antenna, machine: MachineModel, mount: Mount, response: Response) -> None:
        self.antenna = antenna
        self.machine = machine
        self.mount = mount
        self._response = response

    def _course(self, contact: TrueContact, phi: FloatArray, peak: FloatArray, rows: IntArray) -> _Course:
        eps = np.mod(phi - contact.outward, 2.0 * np.pi) - np.pi
        facing = np.cos(eps)
        start = contact.depth / (contact.distance * np.maximum(facing, GRAZING))
        path = np.maximum(peak[:, None] * _FRACTION + start[:, None], 0.0)
        pressed = facing > GRAZING
        moment, delta = np.zeros_like(path), np.full_like(path, np.pi)
        some = np.flatnonzero(pressed)
        if some.size:
            moment[some], delta[some] = self._response(contact.take(some), eps[some], path[some], rows[some])
        moment = np.where(path > 0.0, moment, 0.0)
        psi = phi[:, None] - delta
        scale = self.antenna.stiffness3 / contact.distance
        force = (scale[:, None] * moment)[..., None] * np.stack((np.cos(psi), np.sin(psi)), axis=-1)
        length = self.antenna.beam.length
        lever = (6.0 * length**2 - 4.0 * length * contact.distance + contact.distance**2) / 8.0
        return _Course(force, lever)

    def _limited(
        self, course: _Course, peak: FloatArray, limit: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Peak angles at which the moment limit stops the out stroke."""
        size = np.linalg.norm(course.force[:, : NODES_OUT.size], axis=2)
        over = size > limit[:, None]
        hit = over.any(axis=1)
        j = np.maximum(np.argmax(over, axis=1), 1)
        rows = np.arange(peak.size)
        low, high = size[rows, j - 1], size[rows, j]
        share = np.clip((limit - low) / np.maximum(high - low, 1e-30), 0.0, 1.0)
        reached = (NODES_OUT[j - 1] + share * (NODES_OUT[j] - NODES_OUT[j - 1])) * peak
        return np.where(hit, np.minimum(reached, peak), peak), hit

    def push(
        self,
        contact: TrueContact,
        *,
        which: IntArray,
        key: NoiseKey,
        clock: FloatArray,
        joints: FloatArray,
        phi: FloatArray,
        angle: FloatArray,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> tuple[PushReading, FloatArray]:
        """Samples of both strokes of n pushes begun at machine time ``clock``, and how long each took [s].

        ``joints`` (n, 2) rad are the true joint angles at touch; the rest as for ``Instrument.push``.
        """
        rows = np.arange(which.size)
        peak = angle.copy()
        course = self._course(contact, phi, peak, rows)
        peak, limited = self._limited(course, peak, moment_limit)
        stop = np.where(limited, np.int8(Stop.MOMENT), np.int8(Stop.ANGLE))
        if limited.any():
            course = self._replace(course, contact, phi, peak, np.flatnonzero(limited))
        timeline = self.machine.push_timeline(peak)
        samples = self._samples(course, timeline, which, key, clock, joints, phi, peak)
        if watch is not None:
            peak, stopped = self._watched(samples, timeline, watch, peak)
            changed = np.flatnonzero(stopped)
            stop[changed] = np.int8(Stop.WATCH)
            if changed.size:
                course = self._replace(course, contact, phi, peak, changed)
                timeline = self.machine.push_timeline(peak)
                samples = self._samples(course, timeline, which, key, clock, joints, phi, peak)
        reading = PushReading(
            which=which, phi=phi, angle=peak, touch=self.machine.encode(joints), stop=stop, samples=samples
        )
        return reading, timeline.duration

    def _replace(
        self, course: _Course, contact: TrueContact, phi: FloatArray, peak: FloatArray, rows: IntArray
    ) -> _Course:
        force = course.force.copy()
        force[rows] = self._course(contact.take(rows), phi[rows], peak[rows], rows).force
        return _Course(force, course.lever)

    def _samples(
        self,
        course: _Course,
        timeline: Timeline,
        which: IntArray,
        key: NoiseKey,
        clock: FloatArray,
        joints: FloatArray,
        phi: FloatArray,
        peak: FloatArray,
    ) -> Samples:
        run = timeline.run
        force = course.at(timeline, peak)
        up = rotation_base_sensor(joints[:, 0], joints[:, 1]).transpose(0, 2, 1) @ self.mount.rotation[2]
        force = force + self._weight(force, up, phi, run, timeline.theta, course.lever)
        angles, moment = spun_push(timeline.theta, force, touch=joints[run], phi=phi[run])
        time = clock[run] + timeline.time
        moment += self.machine.noise(key, np.diff(timeline.start))
        moment += self.machine.offset(which[run], time)
        return Samples(
            start=timeline.start,
            time=time,
            angles=self.machine.encode(angles),
            moment=moment,
            stroke=timeline.stroke,
        )

    def _weight(
        self,
        force: FloatArray,
        up: FloatArray,
        phi: FloatArray,
        run: IntArray,
        theta: FloatArray,
        lever: FloatArray,
    ) -> FloatArray:
        """(m, 2) N m in the carried frame: the beam's weight, and how the support answers its change.

        A beam clamped at the base, with a load q per length in Pi and a support at s, is held there by
        q (6 L^2 - 4 L s + s^2)/(8 s) = q lever/s.
        """
        push = np.stack((np.cos(phi), np.sin(phi)), axis=1)
        plane = up[:, [0, 2]]
        along = np.sum(plane * push, axis=1)
        change = -up[run, 1] * np.sin(theta) - along[run] * (1.0 - np.cos(theta))
        now = plane[run] + change[:, None] * push[run]
        size = np.linalg.norm(force, axis=1, keepdims=True)
        unit = force / np.maximum(size, 1e-12)
        held = lever[run] * self.antenna.beam.line_weight * change * np.sum(push[run] * unit, axis=1)
        return np.asarray(-self.antenna.beam.gravity_moment * now + held[:, None] * unit)

    def _watched(
        self, samples: Samples, timeline: Timeline, watch: Watch, peak: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Peak angles after the watch has seen the out strokes chunk by chunk."""
        out = np.bincount(timeline.run[timeline.stroke == Stroke.OUT], minlength=peak.size)
        peak, stopped = peak.copy(), np.zeros(peak.size, dtype=bool)
        brake = self.machine.push_speed**2 / (2.0 * self.machine.turn_acceleration)
        for first in range(0, int(out.max(initial=0)), CHUNK):
            live = np.flatnonzero((out > first) & ~stopped)
            if live.size == 0:
                break
            count = np.minimum(out[live] - first, CHUNK)
            start = np.concatenate(([0], np.cumsum(count)))
            index = np.arange(start[-1]) + np.repeat(timeline.start[live] + first - start[:-1], count)
            chunk = Samples(
                start=start,
                time=samples.time[index],
                angles=samples.angles[index],
                moment=samples.moment[index],
                stroke=samples.stroke[index],
            )
            wanted = watch(live, chunk)
            reached = timeline.theta[index[start[1:] - 1]]
            soonest = np.minimum(reached + brake, peak[live])
            changed = wanted < peak[live] - 1e-12
            rows = live[changed]
            peak[rows] = np.maximum(wanted[changed], soonest[changed])
            stopped[rows] = True
        return peak, stopped
