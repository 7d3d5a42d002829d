"""The exact rod in contact: with its side on a doubly curved body, or with its tip on a tilted one.

The body's surface is its silhouette swept with the radius R along the beam: with e_t, e_n, e_y as in
contour.slip, a profile point c(a) with normal n(a), and the angle zeta by which the contact's normal leans
from the sensing plane towards the base,

    n(a, zeta) = cos zeta n(a) - sin zeta e_y,   P = e_y + c(a) + R (n(a, zeta) - n(a)).

The rod touches where its end tangent is perpendicular to n(a, zeta); it is a planar elastica
(contour.planar_elastica) in the plane of the base tangent t0 and of P. That leaves three unknowns, a, zeta
and eta (the angle from end tangent to force), and three equations: the rod reaches P, and Coulomb's law for
the two components of friction with the slip of the rod's material point, dP - t_end dl (contour.rod_path
solves them). Lengths are in units of s.

A tip has no such tangency, and all of the rod is bent: l = s. Its surface's axes are tilted by chi towards
the base, e_n' = cos chi e_n - sin chi e_y, e_y' = cos chi e_y + sin chi e_n; the surface is the profile in
(e_t, e_n') swept along a second one in the plane of e_n' and e_y', and the tip is a material point, whose
slip is dP.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from contour.planar_elastica import shape
from contour.silhouette import ArcProfile, Profile

__all__ = ["Body", "Contact", "Memory", "Pose", "SideBody", "TipBody"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MAX_LEAN = 1.4
"""Lean of the contact's normal out of the sensing plane beyond which the rod has left the body [rad]."""
ROUNDING = 1e-13
"""Corrections of a tip contact's bend below this share of it are rounding."""


class Contact(NamedTuple):
    """Unknowns of a contact: b (profile parameter), zeta and eta [rad]."""

    b: FloatArray
    zeta: FloatArray
    eta: FloatArray


class Memory(NamedTuple):
    """What friction remembers: the last b, zeta and l, and the slip that counts as made already.

    Where a stroke goes on, this is w^2/(1 + 2w) of the slip of the step before, w being the ratio of the
    steps: then the direction of what is left is that of the rate of slip at the end of the step, to second
        order.
    """

    b: FloatArray
    zeta: FloatArray
    length: FloatArray
    slip_lat: FloatArray
    slip_lon: FloatArray


class Pose(NamedTuple):
    """Everything that follows from the unknowns at one angle of the base."""

    gap: FloatArray
    """What the rod's end misses P by, across the base tangent, relative to theta."""
    slip_lat: FloatArray
    """Slip of the rod's material point since the last step along e_a."""
    slip_lon: FloatArray
    """The same along e_zeta."""
    force_lat: FloatArray
    """Component along e_a of the unit force on the rod."""
    force_lon: FloatArray
    """The same along e_zeta."""
    force_n: FloatArray
    length: FloatArray
    bend: FloatArray
    root_force: FloatArray
    delta: FloatArray


class Body(Protocol):
    """What some rows touch, and what stays the same along their push."""

    friction: FloatArray
    """mu."""
    grip: FloatArray
    """Sine of the friction angle: largest friction of a unit force."""
    profile: Profile
    """The silhouette in the sensing plane."""
    eta_weight: float
    """How much eta counts where iterates are compared, per radian of theta, at most 1."""
    eta_blur: float
    """Difference of eta that rounding asks for, times theta^3 [rad^4]."""

    def pose(self, theta: FloatArray, c: Contact, before: Memory) -> Pose:
        """Geometry, elastica and friction at the unknowns."""
        ...

    def holds(self, c: Contact) -> BoolArray:
        """Whether the body is there."""
        ...

    def rows(self, index: NDArray[np.int64]) -> Body:
        """The same for a selection."""
        ...


class SideBody:
    """Bodies that the rod's side touches."""

    eta_weight = np.inf
    eta_blur = 0.0

    def __init__(self, eps: FloatArray, friction: FloatArray, radius: FloatArray, profile: Profile) -> None:
        self.eps = eps
        self.sin_eps, self.cos_eps = np.sin(eps), np.cos(eps)
        self.friction = friction
        self.grip = friction / np.hypot(1.0, friction)
        self.radius = radius
        self.profile = profile

    def pose(self, theta: FloatArray, c: Contact, before: Memory) -> Pose:
        """Geometry, elastica and friction at the unknowns."""
        sine, cosine = np.sin(theta), np.cos(theta)
        t_t, t_n, t_y = -sine * self.sin_eps, -sine * self.cos_eps, cosine
        along, out, cos, sin, curvature, _ = self.profile.at(c.b)
        sin_z, cos_z = np.sin(c.zeta), np.cos(c.zeta)
        drop = -2.0 * np.sin(0.5 * c.zeta) ** 2 * self.radius  # R (cos zeta - 1)
        p_t, p_n, p_y = along + drop * sin, out + drop * cos, 1.0 - self.radius * sin_z
        ahead = p_t * t_t + p_n * t_n + p_y * t_y
        w_t, w_n, w_y = p_t - ahead * t_t, p_n - ahead * t_n, p_y - ahead * t_y
        aside = np.sqrt(w_t * w_t + w_n * w_n + w_y * w_y)
        normal_d = (cos_z * (w_t * sin + w_n * cos) - sin_z * w_y) / aside
        normal_0 = cos_z * (t_t * sin + t_n * cos) - sin_z * t_y
        bend = np.arctan2(-normal_0, normal_d)
        rod = shape(bend, c.eta)
        scale = ahead / rod.ahead
        length = scale * rod.length
        sin_b, cos_b = np.sin(bend), np.cos(bend)
        # Components along e_a and e_zeta of base tangent and bending direction, then of end tangent and
        # force.
        lat_0, lat_d = t_t * cos - t_n * sin, (w_t * cos - w_n * sin) / aside
        lon_0 = -sin_z * (t_t * sin + t_n * cos) - cos_z * t_y
        lon_d = (-sin_z * (w_t * sin + w_n * cos) - cos_z * w_y) / aside
        end_lat, end_lon = cos_b * lat_0 + sin_b * lat_d, cos_b * lon_0 + sin_b * lon_d
        sin_e, cos_e = np.sin(c.eta), np.cos(c.eta)
        force_lat = cos_e * end_lat + sin_e * (cos_b * lat_d - sin_b * lat_0)
        force_lon = cos_e * end_lon + sin_e * (cos_b * lon_d - sin_b * lon_0)
        force_n = sin_e * (cos_b * normal_d - sin_b * normal_0)
        d_l = length - before.length
        slip_lat = (1.0 + curvature * drop) * self.profile.chord(c.b, before.b) - end_lat * d_l
        slip_lon = self.radius * (c.zeta - before.zeta) - end_lon * d_l
        towards = -(self.sin_eps * p_t + self.cos_eps * p_n)
        across = self.sin_eps * p_n - self.cos_eps * p_t
        return Pose(
            gap=(aside - scale * rod.aside) / theta,
            slip_lat=slip_lat - before.slip_lat,
            slip_lon=slip_lon - before.slip_lon,
            force_lat=force_lat,
            force_lon=force_lon,
            force_n=force_n,
            length=length,
            bend=bend,
            root_force=np.sqrt(2.0 * np.maximum(bend, 0.0)) / scale,
            delta=np.pi + np.arctan2(across, sine * p_y - cosine * towards),
        )

    def holds(self, c: Contact) -> BoolArray:
        """Whether c is on the profile and not leant over."""
        return np.asarray(self.profile.within(c.b) & (np.abs(c.zeta) < MAX_LEAN))

    def rows(self, index: NDArray[np.int64]) -> SideBody:
        """The same for a selection."""
        return SideBody(self.eps[index], self.friction[index], self.radius[index], self.profile.rows(index))


class TipBody:
    """Bodies that the rod's tip touches; the unknown ``zeta`` is here the parameter of the profile along the
    beam.
    """

    eta_weight = 1.0
    """The rod's length depends on eta by 0.03 theta^3 alone, which rounding blurs; the moment does by theta/5."""
    eta_blur = 3e-13

    def __init__(
        self, eps: FloatArray, friction: FloatArray, tilt: FloatArray, ridge: ArcProfile, profile: Profile
    ) -> None:
        self.eps = eps
        self.sin_eps, self.cos_eps = np.sin(eps), np.cos(eps)
        self.friction = friction
        self.grip = friction / np.hypot(1.0, friction)
        self.tilt = tilt
        self.sin_tilt, self.cos_tilt = np.sin(tilt), np.cos(tilt)
        self.ridge = ridge
        self.profile = profile

    def pose(self, theta: FloatArray, c: Contact, before: Memory) -> Pose:
        """Geometry, elastica and friction at the unknowns."""
        sine, cosine = np.sin(theta), np.cos(theta)
        t_t, t_n, t_y = -sine * self.sin_eps, -sine * self.cos_eps, cosine
        across, ridge = self.profile.at(c.b), self.ridge.at(c.zeta)
        # Components (t, n', y') on the tilted axes, then (t, n, y).
        sunk = across.out + ridge.out * across.cos
        p_t = across.along + ridge.out * across.sin
        p_n = self.cos_tilt * sunk + self.sin_tilt * ridge.along
        p_y = 1.0 - self.sin_tilt * sunk + self.cos_tilt * ridge.along
        ahead = p_t * t_t + p_n * t_n + p_y * t_y
        w = (p_t - ahead * t_t, p_n - ahead * t_n, p_y - ahead * t_y)
        aside = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        wanted = aside / ahead
        # The bend of a rod that bends little; its correction's limit is the same whatever it starts from.
        axial = np.cos(c.eta) / np.sin(c.eta)
        bend = 1.5 * wanted * (1.0 - wanted * (axial / 20.0 + (9.0 / 28.0) * wanted))
        rod = shape(bend, c.eta)
        once = bend * wanted * rod.ahead / rod.aside
        rod = shape(once, c.eta)
        twice = once * wanted * rod.ahead / rod.aside
        # Each correction is 1/5 of the bend squared of the one before: the sum of those to come.
        first, second = once - bend, twice - once
        ratio = np.divide(second, first, out=np.zeros_like(first), where=np.abs(first) > ROUNDING * bend)
        ratio = np.clip(ratio, -0.9, 0.9)
        bend = twice + second * ratio / (1.0 - ratio)
        rod = shape(bend, c.eta)
        scale = ahead / rod.ahead
        length = scale * rod.length
        turn = bend + c.eta
        ahead_share, aside_share = np.cos(turn), np.sin(turn) / aside
        force = tuple(ahead_share * t + aside_share * d for t, d in zip((t_t, t_n, t_y), w, strict=True))
        force_lift = self.cos_tilt * force[1] - self.sin_tilt * force[2]
        force_up = force[0] * across.sin + force_lift * across.cos
        force_back = self.cos_tilt * force[2] + self.sin_tilt * force[1]
        widen = 1.0 + across.curvature * ridge.out
        along_e = -(self.sin_eps * p_t + self.cos_eps * p_n)
        beside_e = self.sin_eps * p_n - self.cos_eps * p_t
        return Pose(
            gap=(length - 1.0) / theta,
            slip_lat=widen * self.profile.chord(c.b, before.b) - before.slip_lat,
            slip_lon=self.ridge.chord(c.zeta, before.zeta) - before.slip_lon,
            force_lat=force[0] * across.cos - force_lift * across.sin,
            force_lon=force_back * ridge.cos - force_up * ridge.sin,
            force_n=force_up * ridge.cos + force_back * ridge.sin,
            length=length,
            bend=bend,
            root_force=np.sqrt(2.0 * np.maximum(bend, 0.0)) / scale,
            delta=np.pi + np.arctan2(beside_e, sine * p_y - cosine * along_e),
        )

    def holds(self, c: Contact) -> BoolArray:
        """Whether c is on both profiles."""
        return np.asarray(self.profile.within(c.b) & self.ridge.within(c.zeta))

    def rows(self, index: NDArray[np.int64]) -> TipBody:
        """The same for a selection."""
        return TipBody(
            self.eps[index],
            self.friction[index],
            self.tilt[index],
            self.ridge.rows(index),
            self.profile.rows(index),
        )
