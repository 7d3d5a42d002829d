"""The simulated instrument: n antennas on n gantries over one mesh scene.

What a beam meets comes from :class:`contour.mesh_env.MeshEnvironment`; what the machine makes of it from
:class:`contour.machine.MachineModel`; how the push is answered from the ladder of forward models. Strategy
and tracing see none of them.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contour.antenna import Antenna
from contour.contacts import Kind
from contour.errors import InstrumentError
from contour.frames import Mount, plane_angle
from contour.instrument import ApproachReading, Outcome, PushReading, Samples, Watch, ZeroReading
from contour.ladder import Ladder
from contour.local_shape import FirstContact, TouchKind
from contour.machine import MachineModel, NoiseKey, TouchTimeline, trapezoid_duration
from contour.mesh_env import MeshEnvironment
from contour.virtual import TrueContact, VirtualAntenna

__all__ = ["MeshInstrument"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

GUARDED_MOVE = 0.02
"""Moves to a start no longer than this are made at approach speed: they end near the body [m]."""
ZERO_TIME = 0.5
"""Averaging of a zero [s]."""
SMOOTH_RISE = 0.5e-3
"""How far the smooth surface may stand above the mesh along a motion [m]."""
SHORTEST = 4e-3
"""Contacts nearer to the centre of rotation are taken to be here: the adaptor's, not the beam's [m]."""
ROUND_SHARE = 0.35
"""Part of the profile's radius within which it counts as a circle."""
CREASE_PITCH = 1e-3
"""Distance of the points that creases are sampled at to find the nearest [m]."""
PROFILE_SAMPLES = 41
"""Points that a silhouette is sampled at; odd, so that one is the touch."""
STEEPEST = 1.35
"""Tilt of a tipped surface beyond which the push is answered as if it were this [rad]: the tip all but runs into it."""
SMALLEST_RADIUS = 1e-6
"""Radii of curvature below this are edges [m]."""


def _blank(n: int) -> TrueContact:
    kinds = {"kind": np.int8, "region": np.int8, "body": np.int64}
    shapes = {"point": (n, 3), "normal": (n, 3)}
    return TrueContact(
        **{
            f.name: np.zeros(shapes.get(f.name, (n,)), dtype=kinds.get(f.name, np.float64))
            for f in fields(TrueContact)
        }
    )


def _crease_tree(environment: MeshEnvironment) -> cKDTree | None:
    """Points along all creases of the scene; None where there are none."""
    topology = environment.topology
    if not topology.sharp.any():
        return None
    vertices = np.zeros((int(topology.corners.max()) + 1, 3))
    vertices[topology.corners.ravel()] = environment.triangles.reshape(-1, 3)
    ends = vertices[topology.edge_vertices[topology.sharp]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    count = np.ceil(length / CREASE_PITCH).astype(np.int64) + 1
    edge = np.repeat(np.arange(count.size), count)
    first = np.cumsum(count) - count
    share = (np.arange(edge.size) - first[edge]) / np.maximum(count[edge] - 1, 1)
    return cKDTree(ends[edge, 0] + share[:, None] * (ends[edge, 1] - ends[edge, 0]))


def _tilt(normal: FloatArray, direction: FloatArray) -> FloatArray:
    """Angle of the normals out of Pi, positive towards the base; no steeper than the mechanics of a tip goes."""
    tilt = np.arcsin(np.clip(-np.sum(normal * direction, axis=1), -1.0, 1.0))
    return np.asarray(np.clip(tilt, -STEEPEST, STEEPEST))


class MeshInstrument:
    """Antennas that touch a mesh scene.

    Args:
        environment: bodies and their friction.
        antennas: how many, each on a gantry of its own.
        antenna: beam, sensor, moment limit.
        machine: speeds, thresholds, noise.
        mount: of the gantries' bases in the world.
        rung: forward model, one of :data:`contour.ladder.RUNGS`.
        tolerance: relative error of the moment that ``auto`` allows.
    """

    def __init__(
        self,
        environment: MeshEnvironment,
        *,
        antennas: int,
        antenna: Antenna,
        machine: MachineModel,
        mount: Mount,
        rung: str = "auto",
        tolerance: float = 1e-3,
    ) -> None:
        self._env = environment
        self._antenna = antenna
        self._machine = machine
        self._mount = mount
        self._n = antennas
        self._creases = _crease_tree(environment)
        self._ladder = Ladder(rung, tolerance, self._silhouette)
        self._pushing = np.zeros(0, dtype=np.int64)
        self._virtual = VirtualAntenna(antenna, machine, mount, self._ladder)
        self._pose = np.full((antennas, 5), np.nan)
        self._clock = np.zeros(antennas)
        self._touching = np.zeros(antennas, dtype=bool)
        self._way = np.zeros((antennas, 3))
        self._approaches = np.zeros(antennas, dtype=np.int64)
        self._pushes = np.zeros(antennas, dtype=np.int64)
        self._contact = _blank(antennas)
        self._rung = np.full(antennas, -1, dtype=np.int8)

    @property
    def antennas(self) -> int:
        """How many."""
        return self._n

    @property
    def antenna(self) -> Antenna:
        """Beam, sensor and moment limit."""
        return self._antenna

    @property
    def mount(self) -> Mount:
        """Where the gantries' bases stand in the world."""
        return self._mount

    @property
    def machine_time(self) -> FloatArray:
        """(antennas,) s."""
        return self._clock.copy()

    @property
    def unconverged(self) -> int:
        """Pushes on which the exact rung did not converge so far."""
        return self._ladder.unconverged

    def true_contacts(self, which: IntArray) -> tuple[TrueContact, NDArray[np.int8]]:
        """For :mod:`contour.truth` alone."""
        return self._contact.take(which), self._rung[which]

    # -- moves -----------------------------------------------------------------------------------------

    def zero(self, which: IntArray) -> ZeroReading:
        """Average the moments in free air."""
        if self._touching[which].any():
            raise InstrumentError("zero asked for while touching: release the antenna first")
        if np.isnan(self._pose[which]).any():
            raise InstrumentError("zero asked for before any approach: give the antenna a pose first")
        self._approaches[which] += 1
        samples = int(ZERO_TIME * self._machine.sensor.sample_rate)
        noise = self._machine.noise(self._key(which, 0), np.full(which.size, samples))
        middle = self._clock[which] + 0.5 * ZERO_TIME
        moment = noise.reshape(which.size, samples, 2).mean(axis=1) + self._machine.offset(which, middle)
        moment += self._weight(which)
        self._clock[which] += ZERO_TIME
        sigma = np.full(which.size, self._machine.sensor.moment_noise / np.sqrt(samples))
        return ZeroReading(which=which, moment=moment, sigma=sigma, time=middle)

    def _weight(self, which: IntArray) -> FloatArray:
        """(n, 2) N m, (m_x, m_z) of the free beam's weight at the present poses."""
        up = self._mount.rotation_world_sensor(self._pose[which])[:, 2, :]
        force = self._antenna.gravity_force(up)
        return np.stack((force[:, 1], -force[:, 0]), axis=1)

    def _key(self, which: IntArray, push: int | IntArray) -> NoiseKey:
        return NoiseKey(
            antenna=which,
            approach=self._approaches[which],
            push=np.broadcast_to(np.asarray(push, np.int64), which.shape),
        )

    def approach(
        self, which: IntArray, pose: FloatArray, direction_world: FloatArray, travel: FloatArray
    ) -> ApproachReading:
        """Move to ``pose`` and then along ``direction_world`` until touch."""
        n = which.size
        self._approaches[which] += 1
        self._pushes[which] = 0
        outcome = np.full(n, np.int8(Outcome.NOT_FOUND))
        moved, way = travel.copy(), direction_world.copy()
        begin = self._begin(which, pose)
        step = self._mount.position_world(pose) - self._mount.position_world(begin)
        length = np.linalg.norm(step, axis=1)
        found = _blank(n)
        # The move to the start, for antennas that come from somewhere.
        rows = np.flatnonzero(length > 1e-9)
        stopped = np.zeros(n, dtype=bool)
        if rows.size:
            unit = step[rows] / length[rows, None]
            first, hit = self._first(begin[rows], unit, length[rows], found, rows)
            blocked = rows[hit]
            stopped[blocked] = True
            outcome[blocked] = np.int8(Outcome.BLOCKED)
            way[blocked], moved[blocked] = unit[hit], first[hit]
        guarded = length <= GUARDED_MOVE
        lead = trapezoid_duration(length, self._machine.approach_speed, self._machine.acceleration)
        lead = np.where(guarded, lead, self._machine.move_time(begin, pose))
        rows = np.flatnonzero(~stopped)
        if rows.size:
            first, hit = self._first(pose[rows], direction_world[rows], travel[rows], found, rows)
            outcome[rows[hit]] = np.int8(Outcome.FOUND)
            moved[rows[hit]] = first[hit]
            touching = hit & (first <= 0.0)
            outcome[rows[touching]] = np.int8(Outcome.TOUCHING)
        return self._arrive(which, begin, pose, way, moved, outcome, lead, found)

    def _begin(self, which: IntArray, pose: FloatArray) -> FloatArray:
        """Where the move to the start begins; an antenna that is new here, or turns, comes from outside."""
        begin = self._pose[which]
        elsewhere = np.isnan(begin[:, 0]) | (np.abs(begin[:, 3:] - pose[:, 3:]).max(axis=1) > 1e-9)
        return np.where(elsewhere[:, None], pose, begin)

    def _first(
        self, pose: FloatArray, direction: FloatArray, travel: FloatArray, found: TrueContact, rows: IntArray
    ) -> tuple[FloatArray, BoolArray]:
        """Travel to first touch and whether there is one; what is touched goes into ``rows`` of ``found``."""
        rotation = self._mount.rotation_world_sensor(pose)
        origin = self._mount.position_world(pose)
        beam = self._antenna.beam
        first = self._env.first_contact(
            origin,
            rotation[:, :, 1],
            beam.length,
            translation=direction * (travel + SMOOTH_RISE)[:, None],
            radius=beam.radius,
        )
        # Between creases the mesh stands for the smooth surface that it samples, which is met
        # a little sooner.
        facing = np.maximum(-np.sum(direction * first.normal, axis=1), 0.05)
        reached = np.where(first.touching, 0.0, first.travel - first.lift / facing)
        hit = (first.hit | first.touching) & (reached <= travel)
        self._note(found, rows[hit], first, np.flatnonzero(hit), rotation)
        return np.maximum(reached, 0.0), hit

    def _note(
        self,
        found: TrueContact,
        rows: IntArray,
        first: FirstContact,
        index: IntArray,
        rotation: FloatArray,
    ) -> None:
        beam = self._antenna.beam
        along, across = first.curvature_along[index], first.curvature_across[index]
        normal_here, frame = first.normal[index], rotation[index]
        tip = first.kind[index] == TouchKind.TIP
        found.distance[rows] = np.where(tip, beam.length, np.maximum(first.distance[index], SHORTEST))
        found.outward[rows] = plane_angle(normal_here, frame)
        found.tilt[rows] = np.where(tip, _tilt(normal_here, frame[:, :, 1]), 0.0)
        kinds = np.where(
            tip,
            np.int8(Kind.TIP),
            np.where(first.kind[index] == TouchKind.EDGE, np.int8(Kind.EDGE), np.int8(Kind.SIDE)),
        )
        found.kind[rows] = np.where(first.line[index], np.int8(Kind.LINE), kinds)
        # The beam's axis moves on the body's surface offset by the beam's radius.
        radius_along = np.where(along > 1.0 / SMALLEST_RADIUS, 0.0, 1.0 / np.maximum(along, 1.0))
        radius_along = np.where(first.line[index], 0.0, radius_along)
        found.radius_along[rows] = np.minimum(radius_along, 1.0) + beam.radius
        flat = np.abs(across) < 1e-3
        radius_across = np.where(np.isinf(across), 0.0, 1.0 / np.where(flat | np.isinf(across), 1.0, across))
        found.radius_across[rows] = np.where(flat, np.inf, radius_across + beam.radius)
        found.friction[rows] = self._env.friction[first.body[index]]
        found.point[rows], found.normal[rows] = first.point[index], normal_here
        found.body[rows] = first.body[index]
        found.region[rows] = -1
        found.extent[rows] = self._extent(first, index)

    def _extent(self, first: FirstContact, index: IntArray) -> FloatArray:
        """How far to the sides the contact's radii hold: to the crease's end, the next one, a part of R_l."""
        across = np.abs(first.curvature_across[index])
        extent = np.where(np.isfinite(across), ROUND_SHARE / np.maximum(across, 1e-3), 0.0)
        edge = first.kind[index] == TouchKind.EDGE
        ends = np.abs(first.edge_interval[index]).min(axis=1)
        if self._creases is None:
            return np.where(edge, np.minimum(extent, ends), extent)
        near, _ = self._creases.query(first.point[index])
        return np.minimum(extent, np.where(edge, ends, np.maximum(near - CREASE_PITCH, 0.0)))

    def _arrive(
        self,
        which: IntArray,
        begin: FloatArray,
        pose: FloatArray,
        way: FloatArray,
        moved: FloatArray,
        outcome: NDArray[np.int8],
        lead: FloatArray,
        found: TrueContact,
    ) -> ApproachReading:
        """End of the moves: readings of the touch, poses, clocks."""
        base_way = way @ self._mount.rotation
        origin = np.where((outcome == Outcome.BLOCKED)[:, None], begin, pose)
        end = origin.copy()
        end[:, :3] += base_way * moved[:, None]
        touching = outcome == Outcome.TOUCHING
        # Back to where it was free; an antenna that is new here has no such place yet.
        before = self._pose[which]
        end[touching] = np.where(np.isnan(before), begin, before)[touching]
        touched = (outcome == Outcome.FOUND) | (outcome == Outcome.BLOCKED)
        rows = np.flatnonzero(touched)
        normal_share = np.maximum(-np.sum(way * found.normal, axis=1), 0.05)
        stiffness = self._antenna.stiffness3 / np.maximum(found.distance, 1e-3) ** 2
        # A tilted (tipped) surface gives way along its normal: the beam bends by the depth over the cosine
        # of the tilt.
        slope = stiffness * normal_share / np.cos(found.tilt)
        speed = self._machine.approach_speed
        guarded = moved / speed
        time = lead + np.where(outcome == Outcome.BLOCKED, 0.0, guarded)
        if rows.size:
            timeline = self._machine.touch_timeline(self._key(which[rows], 0), moved[rows], slope[rows])
            end[rows, :3] += base_way[rows] * timeline.rest_depth[:, None]
            moved[rows] += timeline.rest_depth
            found.depth[rows] = timeline.rest_depth * normal_share[rows] / np.cos(found.tilt[rows])
            before = self._clock[which[rows]] + np.where(outcome[rows] == Outcome.BLOCKED, 0.0, lead[rows])
            time[rows] = np.where(outcome[rows] == Outcome.BLOCKED, 0.0, lead[rows]) + timeline.duration
            samples = self._touch_samples(
                which[rows], end[rows], way[rows], found.take(rows), timeline, before
            )
            start = np.zeros(which.size + 1, dtype=np.int64)
            start[rows + 1] = np.diff(samples.start)
            samples = Samples(
                start=np.cumsum(start),
                time=samples.time,
                angles=samples.angles,
                moment=samples.moment,
                stroke=samples.stroke,
            )
        else:
            empty = np.zeros((0, 2))
            samples = Samples(
                start=np.zeros(which.size + 1, dtype=np.int64),
                time=np.zeros(0),
                angles=empty,
                moment=empty,
                stroke=np.zeros(0, dtype=np.int8),
            )
        self._clock[which] += time
        self._pose[which], self._touching[which], self._way[which] = end, touched, way
        for field in fields(TrueContact):
            getattr(self._contact, field.name)[which[rows]] = getattr(found, field.name)[rows]
        self._rung[which] = -1
        return ApproachReading(
            which=which,
            outcome=outcome,
            pose=end,
            direction_world=way,
            travel=moved,
            samples=samples,
            depth_per_sample=speed / self._machine.sensor.sample_rate,
        )

    def _touch_samples(
        self,
        which: IntArray,
        pose: FloatArray,
        way: FloatArray,
        contact: TrueContact,
        timeline: TouchTimeline,
        before: FloatArray,
    ) -> Samples:
        """Samples of the touch: an edge's answer along the approach, its direction held by friction."""
        rotation = self._mount.rotation_world_sensor(pose)
        eps = np.mod(plane_angle(way, rotation) - contact.outward, 2.0 * np.pi) - np.pi
        cone = np.arctan(contact.friction)
        psi = contact.outward + np.clip(eps, -cone, cone)
        run = timeline.run
        force = timeline.elastic[:, None] * np.stack((np.cos(psi), np.sin(psi)), axis=1)[run]
        moment = np.stack((force[:, 1], -force[:, 0]), axis=1) + timeline.noise
        time = before[run] + timeline.time
        moment += self._weight_at(rotation)[run] + self._machine.offset(which[run], time)
        angles = self._machine.encode(pose[:, 3:5])[run]
        return Samples(start=timeline.start, time=time, angles=angles, moment=moment, stroke=timeline.stroke)

    def _weight_at(self, rotation: FloatArray) -> FloatArray:
        force = self._antenna.gravity_force(rotation[:, 2, :])
        return np.stack((force[:, 1], -force[:, 0]), axis=1)

    # -- pushes ----------------------------------------------------------------------------------------

    def push(
        self,
        which: IntArray,
        phi: FloatArray,
        angle: FloatArray,
        *,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> PushReading:
        """Turn towards ``phi`` by ``angle`` and back."""
        if not self._touching[which].all():
            raise InstrumentError("push asked for in free air: approach first")
        self._pushes[which] += 1
        self._ladder.used = np.full(which.size, -1, dtype=np.int8)
        self._pushing = which
        reading, duration = self._virtual.push(
            self._contact.take(which),
            which=which,
            key=self._key(which, self._pushes[which]),
            clock=self._clock[which],
            joints=self._pose[which, 3:5],
            phi=phi,
            angle=angle,
            moment_limit=moment_limit,
            watch=watch,
        )
        self._clock[which] += duration
        answered = np.flatnonzero(self._ladder.used >= 0)
        self._rung[which[answered]] = self._ladder.used[answered]
        return reading

    def _silhouette(self, rows: IntArray, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Offsets and heights (n, m) of the silhouettes that the pushes ``rows`` of the present call slide on."""
        which = self._pushing[rows]
        contact = self._contact.take(which)
        pose = self._pose[which]
        direction = self._mount.rotation_world_sensor(pose)[:, :, 1]
        axis = self._mount.position_world(pose) + contact.distance[:, None] * direction
        # Sampled along direction x normal; the mechanics counts the other way round.
        offsets = reach[:, None] * np.linspace(-1.0, 1.0, PROFILE_SAMPLES)
        heights = self._env.profile(
            axis,
            direction,
            contact.distance,
            contact.normal,
            self._antenna.beam.length,
            offsets,
            radius=self._antenna.beam.radius,
        )[:, ::-1]
        heights = heights - heights[:, PROFILE_SAMPLES // 2, None]
        return offsets, np.where(np.isfinite(heights), heights, np.nan)

    def release(self, which: IntArray, clearance: FloatArray) -> FloatArray:
        """Back along the last approach."""
        end = self._pose[which].copy()
        end[:, :3] -= (self._way[which] @ self._mount.rotation) * clearance[:, None]
        self._clock[which] += trapezoid_duration(
            clearance, self._machine.travel_speed, self._machine.acceleration
        )
        self._pose[which], self._touching[which] = end, False
        return end
