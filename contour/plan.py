"""Plans: which contours to follow, before anything has been touched.

A contour is a beam direction d in the world, fixed while it is followed, and a level: the coordinate along d
of the centre of rotation [m]. Fixed joint angles fix the axes x_s and z_s of the sensing plane Pi in the
world, so that the base moves in two coordinates u = (p . x_s, p . z_s) [m]. What the beam meets there is the
outline, seen along d, of the part of the object between the depths level and level + L: its side touches
where that outline is a silhouette, its tip where the plane at depth level + L cuts the object.

Silhouettes never show the inside of a face, so the default plan spreads its directions, all oblique to
whatever faces the object has, and moves the tip's plane through the object: the tip then draws plane sections
over caps and faces. Approaches stay within Pi, perpendicular to the beam, so that a tip is never pushed along
its axis.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.antenna import Antenna
from contour.errors import UsageError
from contour.frames import Mount, joint_angles
from contour.reach import Reach

__all__ = ["Plan", "Reach", "default_plan", "levels_plan", "orientation_plan"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LARGEST_TILT = float(np.deg2rad(48.0))
"""A tip shall not meet surfaces whose normal is farther out of Pi than this [rad]: beyond, neither moment nor direction
say much."""
LARGEST_PHI2 = float(np.deg2rad(50.0))
"""Default plans keep the inner joint within this, well off its singularity at 90 deg [rad]."""
NEAREST = 0.1
"""The base keeps this share of L off the object's box: contacts nearer than 0.1 L overload the wire."""
STEPS_PER_SIZE = 16.0
"""Longest edge of the box over the default step."""
LAST_SECTION = 0.2
"""Sections end this share of the depth before the middle: there side and tip touch too near to each other."""
CONTOURS = 60
"""Contours of a default plan: 20 directions with 3 levels."""
LEVELS_POWER = 0.27
"""Levels grow as this power of the contours: 3 of 60, 4 of 256. More directions say more than more levels, since side
contacts know their normal and tips only its part within Pi."""
HEADINGS = 8
"""Ways, evenly round Pi, from which a first contact may be sought."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """n contours to follow. Coordinates in Pi are those of each contour's own orientation."""

    direction: FloatArray
    """(n, 3) unit, the beam, world."""
    level: FloatArray
    """(n,) m, coordinate of the centre of rotation along ``direction``."""
    start: FloatArray
    """(n, 2) m in Pi, where the search for the first contact begins, outside the object's box."""
    heading: FloatArray
    """(n, 2) unit in Pi, which way it goes."""
    travel: FloatArray
    """(n,) m, how far: to the other side of the box."""
    width: FloatArray
    """(n,) m, half the box across ``heading``: parallel lines are tried within it."""
    perimeter: FloatArray
    """(n,) m, of the box's projection on Pi: what bounds the number of contacts."""
    near: FloatArray
    """(n,) m, least coordinate along ``direction`` of the object's box."""
    plane: IntArray
    """(n,) contours with one number share direction and level and are followed one after the other."""
    label: tuple[str, ...]
    """n names."""
    step: float
    """Distance between contacts on smooth parts [m]."""
    reach: Reach
    """Where the base may go."""

    @property
    def contours(self) -> int:
        """n."""
        return int(self.level.size)

    def take(self, rows: IntArray) -> Self:
        """The contours ``rows``, in that order."""
        same = {"label", "step", "reach"}
        arrays = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name not in same}
        return replace(self, **arrays, label=tuple(self.label[int(row)] for row in rows))


def _checked_bounds(bounds: ArrayLike) -> FloatArray:
    box = np.array(bounds, dtype=np.float64)
    if box.shape != (2, 3) or not np.isfinite(box).all() or np.any(box[0] > box[1]):
        raise UsageError(
            "object bounds must be finite, lower corner then upper corner (2, 3), in m: "
            "check the mesh and its unit"
        )
    if np.max(box[1] - box[0]) <= 0.0:
        raise UsageError("object bounds are a single point: check the mesh")
    return box


def _rotations(direction: FloatArray, mount: Mount) -> FloatArray:
    return mount.rotation_world_sensor(mount.poses(np.zeros_like(direction), direction))


def _support(half: FloatArray, axis: FloatArray) -> FloatArray:
    """Half extent of a box with half edges ``half`` (3,) along unit vectors ``axis`` (..., 3)."""
    return np.asarray(np.abs(axis) @ half)


def _inner_support(half: FloatArray, axis: FloatArray) -> FloatArray:
    """The same for the ellipsoid inscribed in the box."""
    return np.asarray(np.sqrt((axis * half) ** 2 @ np.ones(3)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Lines:
    """Lines of first contact, m for each of n contours: where they start, which way, how far they may go."""

    start: FloatArray  # (n, m, 2)
    heading: FloatArray  # (m, 2)
    travel: FloatArray  # (n, m)
    width: FloatArray  # (n, m)
    room: FloatArray  # (n, m), up to travel; negative where the start is out of reach


def _lines(
    box: FloatArray,
    rotation: FloatArray,
    level: FloatArray,
    tip: FloatArray,
    margin: float,
    length: float,
    mount: Mount,
    reach: Reach,
) -> _Lines:
    half, centre = 0.5 * (box[1] - box[0]), 0.5 * (box[0] + box[1])
    plane = rotation[:, :, [0, 2]]
    inner = _inner_support(half, rotation[:, :, 1])
    # Centres of an ellipsoid's parallel sections lie on the line to the point whose normal is their own.
    pole = rotation[:, :, 1] * half**2 / np.maximum(inner, 1e-12)[:, None]
    share = np.clip((tip - rotation[:, :, 1] @ centre) / np.maximum(inner, 1e-12), -1.0, 0.0)
    aim = np.einsum("njk,nj->nk", plane, centre + share[:, None] * pole)
    angle = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    heading = np.column_stack((np.cos(angle), np.sin(angle)))
    ahead = np.einsum("njk,mk->nmj", plane, heading)
    aside = np.einsum("njk,mk->nmj", plane, np.column_stack((-heading[:, 1], heading[:, 0])))
    middle = np.einsum("njk,j->nk", plane, centre)
    offset = np.einsum("nk,mk->nm", aim - middle, heading)
    back = _support(half, ahead) + margin + offset
    start = aim[:, None, :] - back[..., None] * heading
    travel = 2.0 * (_support(half, ahead) + margin)
    a, b = reach.half_planes(rotation, level, length, mount)
    slack = b[:, None, :] - np.einsum("nck,nmk->nmc", a, start)
    rate = np.einsum("nck,mk->nmc", a, heading)
    room = np.min(np.where(rate > 1e-12, slack / np.where(rate > 1e-12, rate, 1.0), np.inf), axis=2)
    room = np.where((slack >= 0.0).all(axis=2), np.minimum(room, travel), -1.0)
    # A line that ends before the middle of the box may have passed nothing at all.
    room = np.where(room >= back, room, -1.0)
    return _Lines(start=start, heading=heading, travel=travel, width=_support(half, aside), room=room)


def _build(
    direction: FloatArray,
    tip: FloatArray,
    label: list[str],
    *,
    box: FloatArray,
    antenna: Antenna,
    mount: Mount,
    reach: Reach,
    step: float,
    starts: int,
) -> Plan:
    """Contours whose tip's plane lies at the depths ``tip`` (n,) m; those that the gantry cannot begin are
    left out.
    """
    half, length = 0.5 * (box[1] - box[0]), antenna.beam.length
    rotation = _rotations(direction, mount)
    level = tip - length
    margin = 2.0 * antenna.beam.radius + step
    lines = _lines(box, rotation, level, tip, margin, length, mount, reach)
    best = np.argmax(lines.room > 0.0, axis=1)
    fits = np.max(lines.room, axis=1) > 0.0
    best = np.where(
        fits, np.argmax(lines.room >= np.max(lines.room, axis=1, keepdims=True) - 1e-9, axis=1), best
    )
    turns = (np.arange(starts) * HEADINGS) // starts
    chosen = (best[:, None] + turns) % HEADINGS  # (n, starts)
    rows = np.arange(level.size)[:, None]
    keep = (fits & reach.turns(direction @ mount.rotation))[:, None] & (lines.room[rows, chosen] > 0.0)
    i, j = np.nonzero(keep)
    line = chosen[i, j]
    flat = 4.0 * (_support(half, rotation[:, :, 0]) + _support(half, rotation[:, :, 2]))
    centre = 0.5 * (box[0] + box[1])
    return Plan(
        direction=direction[i],
        level=level[i],
        start=lines.start[i, line],
        heading=lines.heading[line],
        travel=lines.room[i, line],
        width=lines.width[i, line],
        perimeter=flat[i],
        near=(direction @ centre - _support(half, direction))[i],
        plane=i.astype(np.int64),
        label=tuple(
            label[a] if starts == 1 else f"{label[a]} start {b}"
            for a, b in zip(i.tolist(), j.tolist(), strict=True)
        ),
        step=step,
        reach=reach,
    )


def _checked_step(step: float | None, box: FloatArray) -> float:
    size = float(np.max(box[1] - box[0]))
    value = size / STEPS_PER_SIZE if step is None else float(step)
    if not (np.isfinite(value) and 0.0 < value <= size):
        raise UsageError(
            f"step is {value * 1e3:.4g} mm: it must be above zero and not above the object's size "
            f"({size * 1e3:.4g} mm)"
        )
    return value


def _unit(direction: ArrayLike, name: str) -> FloatArray:
    d = np.atleast_2d(np.array(direction, dtype=np.float64))
    norm = np.linalg.norm(d, axis=1)
    if d.shape[1] != 3 or not np.isfinite(d).all() or np.any(norm < 1e-9):
        raise UsageError(f"{name} must be non-zero vectors of three finite numbers, got {direction!r}")
    return np.asarray(d / norm[:, None])


def _require(plan: Plan, box: FloatArray, antenna: Antenna) -> Plan:
    if plan.contours == 0:
        size = " x ".join(f"{edge * 1e3:.3g}" for edge in box[1] - box[0])
        raise UsageError(
            f"object of {size} mm is out of the beam's reach (L = {antenna.beam.length * 1e3:.3g} mm): "
            "no contour can begin within the gantry's limits and above the floor; move the object, "
            "mount the base another way or take a longer beam"
        )
    return plan


def orientation_plan(
    directions: ArrayLike,
    bounds: ArrayLike,
    antenna: Antenna,
    mount: Mount,
    reach: Reach | None = None,
    *,
    step: float | None = None,
    starts: int = 1,
) -> Plan:
    """One silhouette for each beam direction, from as near as the object's box allows.

    Args:
        directions: (n, 3), world, of any length.
        bounds: (2, 3) m, lower and upper corner of the object's box in the world.
        antenna: its beam's length decides how deep the contours reach.
        mount: of the gantry's base.
        reach: where the base may go; anywhere if not given.
        step: distance between contacts [m]; a sixteenth of the longest edge if not given.
        starts: lines of first contact for each outline, from different sides: more find further bodies.
    """
    box, d = _checked_bounds(bounds), _unit(directions, "directions")
    half, centre = 0.5 * (box[1] - box[0]), 0.5 * (box[0] + box[1])
    joint_angles(d @ mount.rotation)  # refuses directions near the singularity by name
    tip = d @ centre - _support(half, d) + (1.0 - NEAREST) * antenna.beam.length
    plan = _build(
        d,
        tip,
        [f"orientation {k}" for k in range(tip.size)],
        box=box,
        antenna=antenna,
        mount=mount,
        reach=Reach.unlimited() if reach is None else reach,
        step=_checked_step(step, box),
        starts=starts,
    )
    return _require(plan, box, antenna)


def levels_plan(
    axis: ArrayLike,
    heights: ArrayLike,
    bounds: ArrayLike,
    antenna: Antenna,
    mount: Mount,
    reach: Reach | None = None,
    *,
    step: float | None = None,
    starts: int = 1,
) -> Plan:
    """Levels along one axis: the beam points along ``axis`` and its tip's plane lies at ``heights``.

    Args:
        axis: (3,), world, also the beam's direction.
        heights: (n,) m, coordinates along ``axis`` of the tip.
        bounds: (2, 3) m, as in :func:`orientation_plan`.
        antenna: as there.
        mount: as there.
        reach: as there.
        step: as there.
        starts: as there.

    Raises:
        UsageError: a height at which the base would be nearer to the object's box than a tenth of L.
    """
    box, d = _checked_bounds(bounds), _unit(axis, "axis")
    tip = np.atleast_1d(np.array(heights, dtype=np.float64))
    joint_angles(d @ mount.rotation)
    half, centre, length = 0.5 * (box[1] - box[0]), 0.5 * (box[0] + box[1]), antenna.beam.length
    deepest = float((d @ centre)[0] - _support(half, d)[0] + (1.0 - NEAREST) * length)
    if not np.isfinite(tip).all() or tip.size == 0 or np.max(tip) > deepest + 1e-9:
        raise UsageError(
            f"heights reach {np.max(tip, initial=-np.inf) * 1e3:.4g} mm along the axis, but the tip gets to "
            f"{deepest * 1e3:.4g} mm with the base {NEAREST * length * 1e3:.3g} mm off the "
            "object's box: lower them or take a longer beam"
        )
    plan = _build(
        np.repeat(d, tip.size, axis=0),
        tip,
        [f"level {h * 1e3:.1f} mm" for h in tip.tolist()],
        box=box,
        antenna=antenna,
        mount=mount,
        reach=Reach.unlimited() if reach is None else reach,
        step=_checked_step(step, box),
        starts=starts,
    )
    return _require(plan, box, antenna)


def _spread(count: int, mount: Mount) -> FloatArray:
    """(count, 3) beam directions, world, even over what gimbal and tips are good at."""
    # Faces mostly lie square to the axes of their box: a direction nearer to one would tip them too steeply.
    steepest = np.sin(LARGEST_TILT) + 1e-9
    drawn = count
    while True:
        k = np.arange(drawn)
        z = np.sin(LARGEST_PHI2) * (2.0 * k + 1.0 - drawn) / drawn
        azimuth = np.pi * (3.0 - np.sqrt(5.0)) * k
        flat = np.sqrt(1.0 - z**2)
        direction = np.column_stack((flat * np.cos(azimuth), flat * np.sin(azimuth), z)) @ mount.rotation.T
        kept = np.asarray(direction[np.max(np.abs(direction), axis=1) <= steepest])
        if kept.shape[0] >= count:
            return np.asarray(kept[(np.arange(count) * kept.shape[0]) // count])
        drawn += 1


def _shallowest(direction: FloatArray, box: FloatArray) -> FloatArray:
    """(n,) m, depth where the normal of the box's inscribed ellipsoid is LARGEST_TILT out of Pi; beyond, less."""
    middle = direction @ (0.5 * (box[0] + box[1]))
    return np.asarray(middle - np.sin(LARGEST_TILT) * _inner_support(0.5 * (box[1] - box[0]), direction))


def _tip_levels(direction: FloatArray, count: int, box: FloatArray, length: float) -> FloatArray:
    """(n, count) m, depths of the tip's plane: through the half facing the base, the last the deepest."""
    half, centre = 0.5 * (box[1] - box[0]), 0.5 * (box[0] + box[1])
    middle, inner = direction @ centre, _inner_support(half, direction)
    deepest = middle - _support(half, direction) + (1.0 - NEAREST) * length
    first = _shallowest(direction, box)
    if count == 1:
        return np.asarray(deepest[:, None])
    last = middle - LAST_SECTION * inner
    share = np.arange(count - 1) / max(count - 2, 1)
    sections = np.column_stack((first[:, None] + share * (last - first)[:, None], deepest))
    # A short beam does not get through: all planes then share the way it goes.
    even = first[:, None] + np.arange(count) / (count - 1) * (deepest - first)[:, None]
    levels = np.where((deepest > last)[:, None], sections, even)
    return np.where((deepest > first)[:, None], levels, deepest[:, None])


def default_plan(
    bounds: ArrayLike,
    antenna: Antenna,
    mount: Mount,
    reach: Reach | None = None,
    *,
    step: float | None = None,
    contours: int = CONTOURS,
    starts: int = 1,
) -> Plan:
    """A plan for an unknown object, from its bounding box alone, caps included.

    Beam directions spread evenly over the band |phi2| <= 50 deg, opposite ones among them, none nearer than
    42 deg to an axis of the box: faces square to the box then tilt at most 48 deg out of Pi. For each
    direction, planes of the tip run from where an ellipsoid inscribed in the box would tilt that much, nearly
    to its middle; the last contour goes as deep as leaves the base 0.1 L outside the box: the silhouette from
    nearby. Directions that the gantry cannot serve are replaced by others. The step is a sixteenth of the
    longest edge. That makes 60 contours and 1000 to 3500 contacts, whatever the size; more where there are
    many corners, since steps shorten round them (a gear: 5600).

    Args:
        bounds: (2, 3) m, lower and upper corner of the object's box in the world.
        antenna: its beam's length decides how deep contours reach.
        mount: of the gantry's base.
        reach: where the base may go; anywhere if not given.
        step: distance between contacts [m].
        contours: how many at most.
        starts: lines of first contact for each outline, from different sides: more find further bodies.

    Raises:
        UsageError: bad bounds, or no contour can begin within the gantry's reach.
    """
    box = _checked_bounds(bounds)
    if contours < 1 or starts < 1:
        raise UsageError(f"a plan needs at least one contour and one start, got {contours} and {starts}")
    levels = max(1, round((contours / starts) ** LEVELS_POWER))
    wanted = max(1, contours // (levels * starts))
    limits = Reach.unlimited() if reach is None else reach
    plan: Plan | None = None
    for more in (1, 2, 4, 8):
        direction = _spread(wanted * more, mount)
        tip = _tip_levels(direction, levels, box, antenna.beam.length)
        # Of an object too large for the beam only a corner could be tipped, and that too steeply.
        i, j = np.nonzero(tip >= _shallowest(direction, box)[:, None] - 1e-9)
        plan = _build(
            direction[i],
            tip[i, j],
            [f"direction {a} level {b}" for a, b in zip(i.tolist(), j.tolist(), strict=True)],
            box=box,
            antenna=antenna,
            mount=mount,
            reach=limits,
            step=_checked_step(step, box),
            starts=starts,
        )
        if plan.contours >= 0.8 * wanted * levels * starts:
            break
    assert plan is not None
    return _require(_thinned(plan, contours), box, antenna)


def _thinned(plan: Plan, contours: int) -> Plan:
    """At most ``contours`` of the plan, evenly taken, planes kept whole."""
    planes = np.unique(plan.plane)
    share = contours / max(plan.contours, 1)
    if share >= 1.0:
        return plan
    kept = planes[np.unique(np.floor(np.arange(max(1, int(planes.size * share))) / share).astype(np.int64))]
    return plan.take(np.flatnonzero(np.isin(plan.plane, kept)))
