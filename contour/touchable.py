"""Which part of a known surface a plan's beams could touch at all: what a scan can fairly be measured by.

A place counts as touchable if, for some beam direction d of the plan,

- a tip can stand on it: its outward normal n leans towards the base, 0 <= -n . d <= sin(48 deg), what plans
  allow a tip to meet, and the straight beam, laid off the surface by its radius, is free of all bodies from its
  end at the place back to its base; or
- its side can: n is within 5 deg of square to d (a contour is a line, and this the band it stands for), and the
  beam, turned along the surface, is free from its base to a little beyond the place;

and the base then stands where the plan lets it: at least 0.1 L off the object's box, within the axes' limits and
with base and tip above the floor. Depths are not only those of the plan's levels but all between. How the beam
comes there is not asked: a place in sight through an opening counts, though a beam that moves square to itself
may not find a way in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.frames import Mount
from contour.plan import LARGEST_TILT, NEAREST, Plan
from contour.rays import RayCaster

__all__ = ["touchable"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SIDE = float(np.deg2rad(5.0))
"""Between the side of a beam and the surface it lies on, at most, before the beam is turned along it [rad]."""
BEYOND = 2e-3
"""Beam past a contact of its side [m]."""
CLEAR = 20e-6
"""Kept off the surface besides the beam's radius; rays are single precision [m]."""
LINES = 8
"""Lines round a beam that must be free too: slits thinner than it hold it back."""
SAME = 1e-9
"""Directions nearer than this are one."""


def touchable(
    points: FloatArray, normals: FloatArray, triangles: FloatArray, plan: Plan, antenna: Antenna, mount: Mount
) -> BoolArray:
    """Which of ``points`` (m, 3) [m] with outward unit ``normals`` (m, 3) could be touched (m,).

    Args:
        points: on the bodies, in the world.
        normals: there.
        triangles: the bodies, (f, 3, 3) m.
        plan: its directions and where the base may go.
        antenna: its beam.
        mount: of the gantry's base.
    """
    middle = triangles.reshape(-1, 3).mean(axis=0)
    rays = RayCaster(triangles - middle)
    length = antenna.beam.length
    off = points + (antenna.beam.radius + CLEAR) * normals
    found = np.zeros(len(points), dtype=bool)
    for beam, near in _beams(plan):
        lean = -(normals @ beam)
        low, high = _stand(off, beam, near, plan, length, mount)
        tip = (lean >= 0.0) & (lean <= np.sin(LARGEST_TILT)) & (low <= length) & (length <= high)
        rows = np.flatnonzero(tip & ~found)
        if rows.size:
            start = off[rows] - middle
            found[rows] = _free(rays, start, start - length * beam, normals[rows], antenna.beam.radius)
        side = (np.abs(lean) <= np.sin(SIDE)) & (low <= np.minimum(high, length - BEYOND))
        rows = np.flatnonzero(side & ~found)
        if rows.size:
            along = beam + lean[rows, None] * normals[rows]
            along /= np.linalg.norm(along, axis=1)[:, None]
            start, end = off[rows] - middle + BEYOND * along, off[rows] - middle - length * along
            found[rows] = _free(rays, start, end, normals[rows], antenna.beam.radius)
    return found


def _free(
    rays: RayCaster, start: FloatArray, end: FloatArray, normals: FloatArray, radius: float
) -> BoolArray:
    """Whether beams from ``start`` (k, 3) to ``end`` (k, 3) [m] are free (k,): their axis and lines on them."""
    along = end - start
    aside = np.cross(along, normals)
    aside *= radius / np.linalg.norm(aside, axis=1)[:, None]
    up = np.cross(aside, along)
    up *= radius / np.linalg.norm(up, axis=1)[:, None]
    free = ~rays.blocked(start, end)
    for turn in 2.0 * np.pi * np.arange(LINES) / LINES:
        rows = np.flatnonzero(free)
        shift = np.cos(turn) * up[rows] + np.sin(turn) * aside[rows]
        free[rows] = ~rays.blocked(start[rows] + shift, end[rows] + shift)
    return free


def _beams(plan: Plan) -> list[tuple[FloatArray, float]]:
    """Each direction of the plan once, with the object's least coordinate along it [m]."""
    _, first = np.unique(np.round(plan.direction / SAME), axis=0, return_index=True)
    return [(plan.direction[row], float(plan.near[row])) for row in np.sort(first).tolist()]


def _stand(
    points: FloatArray, beam: FloatArray, near: float, plan: Plan, length: float, mount: Mount
) -> tuple[FloatArray, FloatArray]:
    """Least and largest distance (m,) [m] from the base to points (m, 3) at which the base may stand; their
    order is reversed where it may not.
    """
    low = points @ beam - near + NEAREST * length
    high = np.full(len(points), length)
    at, back = (points - mount.origin) @ mount.rotation, -(beam @ mount.rotation)
    floor = plan.reach.floor
    limits = [(at[:, i], back[i], plan.reach.upper[i]) for i in range(3)]
    limits += [(-at[:, i], -back[i], -plan.reach.lower[i]) for i in range(3)]
    limits += [(-points[:, 2], beam[2], -floor), (-points[:, 2] - length * beam[2], beam[2], -floor)]
    for value, slope, most in limits:  # value + slope s <= most
        room = most - value
        if abs(slope) < SAME:
            high = np.where(room < 0.0, -np.inf, high)
        elif slope > 0.0:
            high = np.minimum(high, room / slope)
        else:
            low = np.maximum(low, room / slope)
    return np.asarray(low), np.asarray(high)
