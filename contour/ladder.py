"""The simulator's ladder of forward models: the cheapest rung whose estimated error is under the tolerance.

    edge      the closed forms of Kaneko1998, slips mended: no memory, no curvature
    reduced   the reduced rod on the contact's two radii
    profile   the reduced rod on the true silhouette of the mesh
    elastica  the geometrically exact rod on the two radii

``auto`` picks per push from u = R theta/s, q = R_l/(s theta), theta, mu theta and the slide.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour import contact as reduced
from contour import elastica
from contour.contacts import Kind
from contour.errors import UsageError
from contour.laws import finite_angle, slip_law
from contour.virtual import TrueContact

__all__ = ["RUNGS", "Ladder", "Rung", "choose", "slide_estimate"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Rung(IntEnum):
    """Forward models, cheapest first."""

    EDGE = 0
    REDUCED = 1
    PROFILE = 2
    ELASTICA = 3


RUNGS = ("auto", *(rung.name.lower() for rung in Rung))
"""Names that a scene may ask for."""

Silhouette = Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]]
"""``silhouette(rows, reach)``: offsets (m,) shares and heights (n, m) of the outlines of the contacts
``rows``, out to ``reach`` (n,) m on both sides."""


def slide_estimate(contact: TrueContact, eps: FloatArray, peak: FloatArray) -> FloatArray:
    """(n,) m, how far a push may slide across: all of its part outside the cone, a creep inside it."""
    alpha = np.arctan(contact.friction)
    depth = contact.distance * peak
    outside = np.sin(np.abs(eps)) - np.cos(eps) * np.tan(np.minimum(alpha, 1.4))
    creep = 0.12 * np.abs(eps) / np.maximum(alpha, 0.02) * peak
    return np.asarray(depth * np.maximum(np.maximum(outside, 0.0), np.minimum(creep, 1.0)) + 1e-6)


def choose(contact: TrueContact, eps: FloatArray, peak: FloatArray, tolerance: float) -> NDArray[np.int8]:
    """Cheapest rung of each push with an estimated error of the force, over its largest, under ``tolerance``.

    The estimates bound what was measured against the exact rung on both strokes (tests/test_ladder.py): the edge
    forms leave out 3/8 u, the turn of the normal by the slide and friction's memory, which shows most on the way
    back; the reduced rod leaves out second orders of u and of 1/q. A tip has its own (:func:`_tip_error`).
    """
    depth = contact.distance * peak
    slide = slide_estimate(contact, eps, peak)
    u = contact.radius_along * peak / contact.distance
    bend = np.abs(1.0 / np.where(contact.radius_across == 0.0, 1e-9, contact.radius_across))
    alpha = np.arctan(contact.friction)
    outside = np.abs(eps) > 0.9 * alpha
    creep = 0.22 * np.abs(eps) * peak / np.maximum(contact.friction, 0.02)
    edge = 0.375 * u + slide * bend + np.where(outside, 1.0, creep)
    q_inverse = np.minimum(depth * bend, 4.0)
    reach = np.tan(np.minimum(np.abs(eps), 1.4)) ** 2
    exact = 0.06 * u * u + 0.02 * u * contact.friction + np.where(outside, 0.012 * q_inverse**2 * reach, 0.0)
    exact = np.where(contact.kind == Kind.TIP, _tip_error(contact, eps, peak), exact)
    rung = np.where(edge <= tolerance, Rung.EDGE, Rung.REDUCED)
    rung = np.where((rung == Rung.REDUCED) & (exact > tolerance), Rung.ELASTICA, rung)
    return np.where(slide > contact.extent, Rung.PROFILE, rung).astype(np.int8)


def _tip_error(contact: TrueContact, eps: FloatArray, peak: FloatArray) -> FloatArray:
    """(n,) error of a tip's force on the reduced rod, over its largest.

    Three things: a tip that runs round a body as sharp as the push is deep, where the lean adds to the curvature in the
    sensing plane; one that leans away from the base, outside the cone but not far, which creeps under more friction
    than it slides under and so goes in jerks; and the turn of the push, where friction along the lean turns round.
    """
    mu, tilt = contact.friction, np.tan(contact.tilt)
    cone = mu / np.cos(contact.tilt)
    pushed = np.tan(np.minimum(np.abs(eps), 1.4))
    outside = pushed > 0.9 * cone
    radius = np.where(contact.radius_across == 0.0, 1e-9, contact.radius_across)
    bend = contact.distance / (radius * np.cos(contact.tilt)) + tilt
    run = np.where(pushed > 0.75 * cone, 0.002 * np.clip(peak * bend, 0.0, 4.0) ** 3, 0.0)
    grip = np.minimum(mu * np.abs(tilt), 0.99)
    held = cone / np.sqrt(1.0 - grip * grip)
    jerks = np.where(outside & (pushed < 1.7 * held) & (tilt < 0.0), 0.1 * grip * grip, 0.0)
    return np.asarray(run + jerks + 0.005 * peak * mu * (tilt / (1.0 - grip)) ** 2)


PROFILE_MARGIN = 1e-3
"""What a silhouette is sampled beyond the slide expected [m]."""


class Ladder:
    """Answers pushes with the rung asked for, or the cheapest that holds, and remembers which it was."""

    def __init__(self, rung: str, tolerance: float, silhouette: Silhouette) -> None:
        if rung not in RUNGS:
            raise UsageError(f"rung {rung!r} is not known: use one of {', '.join(RUNGS)}")
        self._fixed = None if rung == "auto" else Rung[rung.upper()]
        self._tolerance = tolerance
        self._silhouette = silhouette
        self.used = np.zeros(0, dtype=np.int8)
        """(n,) :class:`Rung` that answered row i last, -1 for none; whoever counts sets it back before a push."""
        self.unconverged = 0
        """Pushes so far on which the exact rung did not converge, and the reduced rod answered."""

    def __call__(
        self, contact: TrueContact, eps: FloatArray, path: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Moment angle and delta (n, k) along ``path`` (n, k); a :data:`contour.virtual.Response`."""
        peak = path.max(axis=1)
        if self._fixed is None:
            rung = choose(contact, eps, peak, self._tolerance)
        else:
            rung = np.full(eps.size, self._fixed, dtype=np.int8)
        # A tip keeps its place on the beam: it has no silhouette to slide over, and no closed form of its own.
        tip = contact.kind == Kind.TIP
        rung = np.where(tip & (rung < Rung.ELASTICA), np.int8(Rung.REDUCED), rung)
        moment, delta = np.zeros_like(path), np.full_like(path, np.pi)
        # The exact rung comes first: pushes on which it does not converge are left to the reduced rod, and counted.
        # Its tips have mechanics of their own: no call of it mixes them with contacts of the side.
        exact = Rung.ELASTICA
        groups = [(exact, tip), (exact, ~tip), *((level, True) for level in reversed(Rung) if level != exact)]
        for level, among in groups:
            some = np.flatnonzero((rung == level) & among)
            if some.size:
                moment[some], delta[some], settled = self._answer(
                    level, contact.take(some), eps[some], path[some], rows[some]
                )
                rung[some[~settled]] = Rung.REDUCED
                self.unconverged += int(np.count_nonzero(~settled))
        missing = int(rows.max(initial=-1)) + 1 - self.used.size
        if missing > 0:
            self.used = np.concatenate((self.used, np.full(missing, -1, dtype=np.int8)))
        self.used[rows] = rung
        return moment, delta

    def _answer(
        self, level: Rung, contact: TrueContact, eps: FloatArray, path: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Moment angle and delta (n, k) of one rung, and whether it found them (n,)."""
        settled: NDArray[np.bool_] = np.ones(eps.size, dtype=np.bool_)
        common: dict[str, Any] = {
            "distance": contact.distance,
            "friction": contact.friction,
            "radius_along": contact.radius_along,
        }
        tip = contact.kind == Kind.TIP
        across, tilt = contact.radius_across, contact.tilt
        if level == Rung.EDGE:
            return *self._edge(contact, eps, path), settled
        if level == Rung.PROFILE:
            reach = 1.2 * slide_estimate(contact, eps, path.max(axis=1)) + PROFILE_MARGIN
            cycle = reduced.push_cycle_profile(eps, path, **common, profile=self._silhouette(rows, reach))
        elif level == Rung.REDUCED:
            surface = {"radius_across": across, "tilt": tilt, "tip": tip, "ridge": contact.radius_along}
            cycle = reduced.push_cycle_mixed(eps, path, **common, **surface)
        elif tip[0]:
            cycle = elastica.push_cycle_tip(eps, path, **common, radius_across=across, tilt=tilt)
        else:
            cycle = elastica.push_cycle(eps, path, **common, radius_across=across)
        if isinstance(cycle, elastica.RodCycleResponse):
            settled = np.all(cycle.converged | cycle.slipped_off, axis=1)
        return np.where(cycle.slipped_off, 0.0, cycle.moment_angle), cycle.delta, settled

    @staticmethod
    def _edge(contact: TrueContact, eps: FloatArray, path: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The paper's closed forms: slip law and finite angle of a flat edge, the same on both strokes but for the sign
        of the friction along the beam.
        """
        theta = np.maximum(path, 1e-6)
        slip = slip_law(eps[:, None], theta, contact.friction[:, None])
        back = np.arange(path.shape[1]) > np.argmax(path, axis=1)[:, None]
        along = np.where(back, -1.0, 1.0) * contact.friction[:, None]
        return theta / (slip.compliance_ratio * finite_angle(theta, along)), slip.delta
