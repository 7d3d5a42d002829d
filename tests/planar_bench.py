"""An analytic instrument for the tracer alone: signed distances in Pi, contacts as they truly are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from contour.antenna import Antenna
from contour.contacts import Contacts, Kind
from contour.frames import Mount
from contour.instrument import ApproachReading, Outcome, Samples
from contour.plan import Plan, Reach
from contour.tracing import Expectation, Trace, Tracer

Shape = Callable[[np.ndarray], np.ndarray]
"""Signed distance (k,) m of points (k, 2) m, exact outside."""

ROUNDS = 3000
"""More moves than any contour here may need."""
EDGE = 1e-5
"""How far off the surface the antenna stands at the edge of touch [m]."""


def circle(radius: float, centre=(0.0, 0.0)) -> Shape:
    """A disc."""
    return lambda p: np.linalg.norm(p - np.array(centre), axis=1) - radius


def rounded_box(half, radius: float = 0.0, centre=(0.0, 0.0)) -> Shape:
    """A rectangle of half edges ``half`` whose corners have ``radius``."""

    def distance(p):
        q = np.abs(p - np.array(centre)) - np.array(half) + radius
        return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - radius

    return distance


def polygon(corners) -> Shape:
    """A simple polygon."""
    a = np.array(corners, dtype=float)
    b = np.roll(a, -1, axis=0)

    def distance(p):
        away = p[:, None, :] - a
        edge = b - a
        share = np.clip((away * edge).sum(2) / (edge**2).sum(1), 0.0, 1.0)
        least = np.linalg.norm(away - share[..., None] * edge, axis=2).min(axis=1)
        crosses = (a[:, 1] > p[:, None, 1]) != (b[:, 1] > p[:, None, 1])
        rise = np.where(edge[:, 1] == 0.0, 1.0, edge[:, 1])
        at = a[:, 0] + (p[:, None, 1] - a[:, 1]) / rise * edge[:, 0]
        inside = (crosses & (p[:, None, 0] < at)).sum(axis=1) % 2 == 1
        return np.where(inside, -least, least)

    return distance


def ellipse(a: float, b: float) -> Shape:
    """An ellipse as a fine polygon."""
    t = np.linspace(0.0, 2.0 * np.pi, 241)[:-1]
    return polygon(np.column_stack((a * np.cos(t), b * np.sin(t))))


def union(*shapes: Shape) -> Shape:
    """Several bodies."""
    return lambda p: np.min([shape(p) for shape in shapes], axis=0)


def plane_plan(
    count: int, step: float, *, size: float = 0.2, reach: Reach | None = None, start=None, heading=None
) -> Plan:
    """``count`` contours with the beam along +y of the world: u = (x, z). The box is ``size`` wide."""
    start = np.tile([-size, 0.003], (count, 1)) if start is None else np.array(start, dtype=float)
    heading = np.tile([1.0, 0.0], (count, 1)) if heading is None else np.array(heading, dtype=float)
    return Plan(
        direction=np.tile([0.0, 1.0, 0.0], (count, 1)),
        level=np.full(count, -0.15),
        start=start,
        heading=heading,
        travel=np.full(count, 2.0 * size),
        width=np.full(count, 0.5 * size),
        perimeter=np.full(count, 4.0 * size),
        near=np.full(count, -0.02),
        plane=np.arange(count),
        label=tuple(f"contour {i}" for i in range(count)),
        step=step,
        reach=Reach.unlimited() if reach is None else reach,
    )


@dataclass
class PlanarBench:
    """Approaches with the guarded semantics of the instrument, on one shape for each contour."""

    plan: Plan
    shapes: list[Shape]
    antenna: Antenna
    normal_sigma: float = 0.0
    seed: int = 0

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.mount = Mount.identity()
        self.here = self.plan.start - 0.01 * self.plan.heading
        self.deep = self.plan.level.copy()
        self.way = np.zeros_like(self.here)
        self.order = np.zeros(self.plan.contours, dtype=np.int64)
        self.groups: dict[Shape, list[int]] = {}
        for i, shape in enumerate(self.shapes):
            self.groups.setdefault(shape, []).append(i)

    def gap(self, which, u):
        """(k,) m, distance of the beam's surface from the outline."""
        out = np.zeros(which.size)
        for shape, members in self.groups.items():
            mine = np.isin(which, members)
            if mine.any():
                out[mine] = shape(u[mine]) - self.antenna.beam.radius
        return out

    def march(self, which, start, way, travel):
        """(k,) m to first touch along ``way``, or inf."""
        gone = np.zeros(which.size)
        hit = np.zeros(which.size, dtype=bool)
        open_ = np.ones(which.size, dtype=bool)
        for _ in range(400):
            rows = np.flatnonzero(open_)
            if not rows.size:
                break
            gap = self.gap(which[rows], start[rows] + gone[rows, None] * way[rows])
            hit[rows] = gap <= EDGE
            gone[rows] += np.where(gap <= EDGE, 0.0, np.maximum(gap - 0.5 * EDGE, 0.2 * EDGE))
            open_[rows] = ~hit[rows] & (gone[rows] < travel[rows])
        return np.where(hit, gone, np.inf)

    def approach(self, which, pose, direction_world, travel):
        """As the protocol's."""
        start = pose[:, [0, 2]]
        goal_depth = pose[:, 1]
        assert np.all(travel > 0.0)
        assert np.allclose(np.linalg.norm(direction_world, axis=1), 1.0)
        level = self.plan.level[which]
        in_plane = (np.abs(goal_depth - level) < 1e-9) & (np.abs(self.deep[which] - level) < 1e-9)
        to_start = start - self.here[which]
        far = np.linalg.norm(to_start, axis=1)
        move = to_start / np.where(far > 1e-12, far, 1.0)[:, None]
        stop = np.where(in_plane & (far > 1e-9), self.march(which, self.here[which], move, far), np.inf)
        blocked = stop < far
        way = direction_world[:, [0, 2]]
        flat = np.linalg.norm(way, axis=1) > 1e-9
        went = np.where(
            flat & (np.abs(goal_depth - level) < 1e-9), self.march(which, start, way, travel), np.inf
        )
        touching = ~blocked & (went <= 0.0)
        found = ~blocked & ~touching & (went < travel)
        end = start + np.where(np.isfinite(went), np.minimum(went, travel), travel)[:, None] * way
        end = np.where(blocked[:, None], self.here[which] + np.where(blocked, stop, 0.0)[:, None] * move, end)
        end = np.where(touching[:, None], self.here[which], end)
        outcome = np.select(
            [blocked, touching, found], [Outcome.BLOCKED, Outcome.TOUCHING, Outcome.FOUND], Outcome.NOT_FOUND
        )
        self.deep[which] = np.where(blocked | touching, self.deep[which], goal_depth)
        self.here[which] = end
        self.way[which] = np.where(blocked[:, None], move, way)
        back = pose.copy()
        back[:, [0, 2]] = end
        went_world = np.zeros_like(direction_world)
        went_world[:, [0, 2]] = self.way[which]
        none = np.zeros(0)
        return ApproachReading(
            which=which,
            outcome=outcome.astype(np.int8),
            pose=back,
            direction_world=np.where(flat[:, None] | blocked[:, None], went_world, direction_world),
            travel=np.where(blocked, stop, np.minimum(went, travel)),
            depth_per_sample=0.0,
            samples=Samples(
                start=np.zeros(which.size + 1, dtype=np.int64),
                time=none,
                angles=np.zeros((0, 2)),
                moment=np.zeros((0, 2)),
                stroke=none.astype(np.int8),
            ),
        )

    def normals(self, which, u):
        """(k, 2) outward unit normals by central differences."""
        h = 1e-7
        slope = np.stack(
            [(self.gap(which, u + h * e) - self.gap(which, u - h * e)) / (2.0 * h) for e in np.eye(2)], axis=1
        )
        return slope / np.linalg.norm(slope, axis=1)[:, None]

    def localise(self, which):
        """True contacts, the normal with noise."""
        u = self.here[which]
        normal = self.normals(which, u)
        outward = np.arctan2(normal[:, 1], normal[:, 0]) + self.normal_sigma * self.rng.standard_normal(
            which.size
        )
        return make_contacts(
            which, u, outward, sigma=max(self.normal_sigma, 1e-4), order=self.take_order(which)
        )

    def take_order(self, which):
        """Count contacts of each contour."""
        order = self.order[which].copy()
        self.order[which] += 1
        return order

    def release(self, which, clearance):
        """Back along the last motion."""
        self.here[which] -= clearance[:, None] * self.way[which]


def make_contacts(which, touch, outward, *, sigma, order, flags=None) -> Contacts:
    """Contacts at ``touch`` (k, 2) m with normals ``outward`` (k,) rad; the rest is filler."""
    n = which.size
    fill = np.zeros(n)
    normal = np.column_stack((np.cos(outward), np.zeros(n), np.sin(outward)))
    return Contacts(
        which=which,
        touch=touch.copy(),
        point=np.zeros((n, 3)),
        normal=normal,
        distance=np.full(n, 0.1),
        sigma_distance=np.full(n, 1e-4),
        outward=outward,
        sigma_normal=np.broadcast_to(np.asarray(sigma, dtype=float), (n,)).copy(),
        friction_angle=fill,
        sigma_friction=fill,
        radius_along=fill,
        curvature_across=fill,
        kind=np.full(n, Kind.SIDE, dtype=np.int8),
        pushes=np.ones(n, dtype=np.int64),
        flags=np.zeros(n, dtype=np.int64) if flags is None else flags,
        machine_time=fill,
        sequence=order,
    )


def follow(bench, settings=None) -> tuple[Contacts, Trace, list[tuple[np.ndarray, Expectation, np.ndarray]]]:
    """Every contour to its end; the contacts, the summary, and each prior beside the true normals."""
    tracer = Tracer(bench.plan, bench.mount, bench.antenna, settings)
    parts, priors = [], []
    for _ in range(ROUNDS):
        if not tracer.active.size:
            break
        reading = bench.approach(*tracer.ask())
        rows = tracer.touched(reading)
        if rows.size:
            which = reading.which[rows]
            prior = tracer.expected(which)
            contacts = bench.localise(which)
            priors.append((which, prior, contacts.outward))
            tracer.tell(contacts)
            bench.release(which, tracer.clearance(which))
            parts.append(contacts)
    assert not tracer.active.size, "contours that never end"
    return tracer.place(Contacts.concatenate(parts)), tracer.summary(), priors
