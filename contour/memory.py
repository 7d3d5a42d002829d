"""What a contour has learned so far, and what it therefore expects of the next contact.

Kept per antenna (an antenna follows one contour at a time): the friction angle, from contacts that slid; the body's
radius along the beam; distance and normal of the last contact; the last touches, whose circle gives tangent and
curvature at the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Kind
from contour.fit import Prior
from contour.frames import wrap_angle
from contour.information import BEND, LN_S, LN_TAN_ALPHA, NU, PARAMETERS, R_ALONG
from contour.sensing import Touch

__all__ = ["Memory", "Tangent", "touch_position"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FRICTION = (np.log(np.tan(np.deg2rad(9.0))), 0.9)
"""Mean and sigma of ln tan alpha of an unknown body: 95 % between 1.5 and 43 deg."""
FRICTION_WANDER = 0.04
"""What ln tan alpha may change by from one contact to the next."""
RADIUS_ALONG = (0.02, 0.045)
"""Mean and sigma [m] of R on an unknown body."""
CURVATURE_SIGMA = 60.0
"""Sigma of the curvature across on an unknown body [1/m]."""
SHARP_TURN = np.deg2rad(25.0)
"""Turn between two chords above which the contour is at a corner."""
DISTANCE_SIGMA = 0.35
"""Sigma of ln s relative to the last contact's."""


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """Outer normal and curvature that the touches of a contour lead to expect at the newest of them."""

    outward: FloatArray
    """(n,) rad; the direction expected by the tracer where touches say nothing."""
    sigma: FloatArray
    """(n,) rad"""
    curvature: FloatArray
    """(n,) 1/m"""
    curvature_sigma: FloatArray
    """(n,) 1/m"""
    corner: BoolArray
    """(n,) whether the chords turn too sharply to be trusted."""


def touch_position(touch: Touch, distance: FloatArray, antenna: Antenna) -> FloatArray:
    """(n, 2) m, the beam's axis in Pi at zero force: the base, less the depth at which the beam stands."""
    held = -(touch.preload[:, 0] * np.cos(touch.approach) + touch.preload[:, 1] * np.sin(touch.approach))
    depth = np.maximum(held, 0.0) * distance**2 / antenna.stiffness3
    direction = np.stack((np.cos(touch.approach), np.sin(touch.approach)), axis=1)
    return np.asarray(touch.base_in_plane - depth[:, None] * direction)


class Memory:
    """State of every contour; arrays over antennas."""

    def __init__(self, antennas: int) -> None:
        self.friction = np.full(antennas, FRICTION[0])
        self.friction_sigma = np.full(antennas, FRICTION[1])
        self.along = np.full(antennas, RADIUS_ALONG[0])
        self.along_sigma = np.full(antennas, RADIUS_ALONG[1])
        self.distance = np.full(antennas, np.nan)
        self.outward = np.zeros(antennas)
        self.outward_sigma = np.full(antennas, np.inf)
        self.touches = np.zeros((antennas, 2, 2))  # the newest first
        self.known = np.zeros(antennas, dtype=np.int64)  # touches that count
        self.contacts = np.zeros(antennas, dtype=np.int64)
        self.tipped = np.zeros(antennas, dtype=bool)

    def forget(self, which: IntArray) -> None:
        """A new contour or a break: neighbours say nothing any more; friction stays as a rumour."""
        self.known[which] = 0
        self.tipped[which] = False
        self.outward_sigma[which] = np.inf
        self.along[which], self.along_sigma[which] = RADIUS_ALONG
        self.friction_sigma[which] = np.maximum(self.friction_sigma[which], 0.15)

    def learn(self, contacts: Contacts, state: FloatArray, sigma: FloatArray, slid: BoolArray) -> None:
        """Take up contacts without flags: their states (n, 5), sigmas (n, 5) and whether their friction was seen."""
        which = contacts.which
        self.contacts[which] += 1
        good = contacts.good
        w = which[good]
        self.distance[w] = contacts.distance[good]
        self.outward[w] = contacts.outward[good]
        self.outward_sigma[w] = contacts.sigma_normal[good]
        self.tipped[w] = contacts.kind[good] == Kind.TIP
        side = good & (contacts.kind != Kind.TIP)  # a tip says nothing of R
        v = which[side]
        self.along[v] = np.maximum(contacts.radius_along[side], 0.0)
        spread = sigma[side, R_ALONG] * contacts.distance[side]
        self.along_sigma[v] = np.minimum(np.hypot(spread, 0.5 * self.along[v] + 0.008), RADIUS_ALONG[1])
        self.touches[w, 1] = self.touches[w, 0]
        self.touches[w, 0] = contacts.touch[good]
        self.known[w] = np.minimum(self.known[w] + 1, 2)
        seen = good & slid
        self.friction[which[seen]] = state[seen, LN_TAN_ALPHA]
        self.friction_sigma[which[seen]] = sigma[seen, LN_TAN_ALPHA]
        self.friction_sigma[w] = np.minimum(np.hypot(self.friction_sigma[w], FRICTION_WANDER), FRICTION[1])
        # A flagged contact breaks the chain of touches: the next chord would span an unknown piece.
        self.known[which[~good]] = 0

    def tangent(self, touch: Touch, distance: FloatArray, antenna: Antenna) -> Tangent:
        """Normal and curvature at the newest touch from the circle through it and the touches before."""
        w = touch.which
        here = touch_position(touch, distance, antenna)
        last, before = self.touches[w, 0], self.touches[w, 1]
        chord, chord_before = here - last, last - before
        length = np.maximum(np.linalg.norm(chord, axis=1), 1e-9)
        length_before = np.maximum(np.linalg.norm(chord_before, axis=1), 1e-9)
        noise = antenna.sensor.moment_noise * 0.4 * distance**2 / antenna.stiffness3
        position = np.hypot(8e-6, noise)
        heading = np.arctan2(chord[:, 1], chord[:, 0])
        # The chord's normal on the side that the last normal points to.
        quarter = np.where(np.cos(heading + 0.5 * np.pi - self.outward[w]) > 0.0, 0.5 * np.pi, -0.5 * np.pi)
        side = heading + quarter
        two = (self.known[w] >= 2) & ~touch.fresh
        one = (self.known[w] == 1) & ~touch.fresh
        bend = wrap_angle(heading - np.arctan2(chord_before[:, 1], chord_before[:, 0]))
        bend = np.where(two, bend, 2.0 * wrap_angle(side - self.outward[w]))
        share = np.where(two, length / (length + length_before), 0.5)
        turn = bend * share
        sigma_two = np.hypot(
            2.6 * position / np.minimum(length, length_before), 0.3 * np.abs(turn) + np.deg2rad(0.15)
        )
        sigma_one = np.hypot(
            np.hypot(2.9 * position / length, self.outward_sigma[w]), 0.35 * np.abs(turn) + np.deg2rad(0.3)
        )
        usable = (two | one) & (length > 20.0 * position) & (length < 0.03)
        corner = usable & (
            (np.abs(bend) > SHARP_TURN) | (np.abs(wrap_angle(side + turn - touch.expected)) > 2 * SHARP_TURN)
        )
        trusted = usable & ~corner
        span = np.where(two, 0.5 * (length + length_before), length)
        # A profile is convex where the normal turns with the sense of travel.
        sense = -np.sign(quarter)
        curvature = sense * bend / span
        return Tangent(
            outward=np.where(trusted, side + turn, touch.expected),
            sigma=np.where(
                trusted,
                np.where(two, sigma_two, sigma_one),
                np.where(touch.fresh, touch.expected_sigma, np.deg2rad(30.0)),
            ),
            curvature=np.where(trusted, curvature, 0.0),
            curvature_sigma=np.where(trusted, 0.7 * np.abs(curvature) + 16.0, CURVATURE_SIGMA),
            corner=corner,
        )

    def prior(self, touch: Touch, antenna: Antenna) -> tuple[Prior, Tangent]:
        """Prior of the contacts that begin, and the tangent it uses."""
        w = touch.which
        n = w.size
        rise = np.sqrt(antenna.stiffness3 / touch.rise)
        guess = np.clip(rise, 0.1 * antenna.beam.length, antenna.beam.length)
        remembered = np.isfinite(self.distance[w]) & ~touch.fresh
        distance = np.where(remembered, np.nan_to_num(self.distance[w], nan=0.1), guess)
        tangent = self.tangent(touch, distance, antenna)
        mean, sigma = np.zeros((n, PARAMETERS)), np.zeros((n, PARAMETERS))
        mean[:, LN_S], sigma[:, LN_S] = np.log(distance), np.where(remembered, DISTANCE_SIGMA, 1.0)
        mean[:, NU], sigma[:, NU] = tangent.outward + np.pi, tangent.sigma
        mean[:, LN_TAN_ALPHA], sigma[:, LN_TAN_ALPHA] = self.friction[w], self.friction_sigma[w]
        mean[:, R_ALONG], sigma[:, R_ALONG] = self.along[w] / distance, self.along_sigma[w] / distance
        mean[:, BEND], sigma[:, BEND] = tangent.curvature * distance, tangent.curvature_sigma * distance
        return Prior(mean=mean, sigma=sigma), tangent
