"""The exact rod followed step by step through a push, with Coulomb friction, sticking and slipping off.

At each step the contact's unknowns solve its geometry (contour.rod) and Coulomb's law for the two components
of friction with the slip of the step. A step starts from the increment of the reduced rod; rows that do not
settle try the jump that it makes, then smaller steps; rows that find no contact have slipped off, or did not
converge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.planar_elastica import base_curvature
from contour.rod import Body, Contact, Memory, Pose
from contour.slip import pace

__all__ = ["Hint", "RodPath", "follow_rod"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CHUNK = 1024
"""Rows worked on at once; the Jacobian's four evaluations are stacked beside them."""
ITERATIONS = 12
"""Newton steps before a row is followed in smaller steps."""
TOLERANCE = 1e-6
"""Newton steps below this, in theta or rad, are the last: the next would be 1e-4 of it or less."""
DIFFERENCE = 1e-5
"""Differences of the Jacobian, in theta or rad: truncation 1e-5, rounding 1e-8 for theta of 1 mrad."""
DIFFERENCE_ETA = 1e-4
"""The same for eta [rad], on which lengths depend by theta^3 alone; more where rounding asks for it."""
LONGEST_ETA = 0.03
"""No difference of eta is larger [rad]."""
SPLIT = 8
"""Parts in which a step that does not settle is taken."""
ROUND = 0.7
"""Cosine of the turn along the profile from which on a contact that cannot be found has left the body."""
LONGEST = 0.5
"""No Newton step is longer, in theta or rad."""
LEAST_GRIP = 1e-9
"""Friction angles [rad] below this are taken as this: no force can tell."""
SECULAR_STEPS = 6
"""Newton steps on the amount of slip."""


Angles = tuple[FloatArray, FloatArray, FloatArray]
"""theta at the end of a step, the step, and the step before [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RodPath:
    """A push followed through k angles, n at a time, arrays (k, n), lengths in s."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi."""
    moment_angle: FloatArray
    """|M| s/(3 EI) [rad]."""
    slide: FloatArray
    """a, positive towards e_t."""
    lean: FloatArray
    """zeta [rad]."""
    arc_length: FloatArray
    """l."""
    slipped_off: BoolArray
    """The contact has left the body; the values are those of the last contact."""
    converged: BoolArray
    """All equations hold to tolerance up to here."""


class Hint(NamedTuple):
    """What the reduced rod says of the contact at the end of a step, or of all steps."""

    b: FloatArray
    zeta: FloatArray
    eta: FloatArray
    slipped: BoolArray

    @property
    def contact(self) -> Contact:
        """The unknowns."""
        return Contact(self.b, self.zeta, self.eta)

    def rows(self, index: NDArray[np.int64] | slice) -> Hint:
        """The same for a selection of the last axis."""
        return Hint(self.b[..., index], self.zeta[..., index], self.eta[..., index], self.slipped[..., index])

    def step(self, index: int) -> Hint:
        """One step of all."""
        return Hint(self.b[index], self.zeta[index], self.eta[index], self.slipped[index])


def _newton(body: Body, theta: FloatArray, c: Contact, before: Memory) -> tuple[Contact, FloatArray]:
    """A better contact, and how far it moved: shares of theta for b and zeta, radians for eta.

    Geometry and elastica are smooth in the unknowns and are linearised (Jacobian by differences); Coulomb's
    law is not, and is solved as it stands on that linearisation, with the two slips as unknowns.
    """
    h = DIFFERENCE * theta
    h_eta = np.clip(body.eta_blur / theta**3, DIFFERENCE_ETA, LONGEST_ETA)
    _, _, _, _, _, speed = body.profile.at(c.b)
    p = body.pose(
        theta,
        Contact(
            np.stack((c.b, c.b + h * speed, c.b, c.b)),
            np.stack((c.zeta, c.zeta, c.zeta + h, c.zeta)),
            np.stack((c.eta, c.eta, c.eta, c.eta + h_eta)),
        ),
        before,
    )
    steps = (h, h, h_eta)
    values = (p.gap, p.slip_lat, p.slip_lon, p.force_lat, p.force_lon)
    here = [v[0] for v in values]
    column = [[(v[j] - v[0]) / steps[j - 1] for v in values] for j in (1, 2, 3)]
    # Rows of the inverse of d(gap, slips)/d(b, zeta, eta).
    cross = [_cross(column[1], column[2]), _cross(column[2], column[0]), _cross(column[0], column[1])]
    det = column[0][0] * cross[0][0] + column[0][1] * cross[0][1] + column[0][2] * cross[0][2]
    inverse = [[v / det for v in row] for row in cross]
    # Force as a linear function of the slips where the gap is closed.
    stiff = [[sum(column[i][3 + f] * inverse[i][g] for i in range(3)) for g in range(3)] for f in range(2)]
    force = [
        here[3 + f] - stiff[f][0] * here[0] - stiff[f][1] * here[1] - stiff[f][2] * here[2] for f in range(2)
    ]
    slip = _coulomb(
        (stiff[0][1], stiff[0][2], stiff[1][1], stiff[1][2]),
        (force[0], force[1]),
        body.grip,
        (here[1], here[2]),
    )
    held = body.profile.held()
    if held.any():
        # On a corner nothing slides across, and what the rod pays out is held by the grip alone.
        lon = -np.sign(force[1]) * np.maximum(np.abs(force[1]) - body.grip, 0.0) / stiff[1][2]
        slip = (np.where(held, -before.slip_lat, slip[0]), np.where(held, lon, slip[1]))
    target = (-here[0], slip[0] - here[1], slip[1] - here[2])
    move = [row[0] * target[0] + row[1] * target[1] + row[2] * target[2] for row in inverse]
    turned = np.abs(move[2]) * np.minimum(body.eta_weight * theta, 1.0)
    far = np.maximum(np.maximum(np.abs(move[0]), np.abs(move[1])) / theta, turned)
    cut = np.minimum(1.0, LONGEST / np.maximum(far, LONGEST))
    return Contact(
        c.b + move[0] * speed * cut,
        c.zeta + move[1] * cut,
        np.clip(c.eta + move[2] * cut, 0.05, np.pi - 0.05),
    ), far


def _coulomb(
    stiff: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    force: tuple[FloatArray, FloatArray],
    grip: FloatArray,
    slip: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Slips that satisfy Coulomb's law where the friction force is force + stiff slip.

    Sticking, slip = 0, where |force| <= grip; else force + stiff slip = -grip slip/|slip|, that is
    slip = -p (1 + p stiff)^-1 force with |(1 + p stiff)^-1 force| = grip. The inverse of that norm is a
    concave, rising function of p, so that Newton's steps come to its root from below, wherever they start.
    """
    a, b, c, d = stiff
    trace, det = a + d, a * d - b * c
    p = np.sqrt(slip[0] ** 2 + slip[1] ** 2) / np.maximum(grip, LEAST_GRIP)
    limit = np.maximum(grip, LEAST_GRIP)
    for _ in range(SECULAR_STEPS):
        x, y, scale = _shifted(stiff, force, trace, det, p)
        norm2 = x * x + y * y
        norm = np.sqrt(norm2)
        # d(1 + p A)^-1 f/dp = -(1 + p A)^-1 A (1 + p A)^-1 f.
        g_x, g_y = a * x + b * y, c * x + d * y
        rate_x, rate_y = (
            ((1.0 + p * d) * g_x - p * b * g_y) / scale,
            ((1.0 + p * a) * g_y - p * c * g_x) / scale,
        )
        rate = x * rate_x + y * rate_y
        p = np.maximum(p + (norm / limit - 1.0) * norm2 / rate, 0.0)
    # Where the body curves away faster than the rod follows there are roots beyond; what sticks, sticks.
    p = np.where(np.hypot(*force) <= limit, 0.0, p)
    x, y, _ = _shifted(stiff, force, trace, det, p)
    return -p * x, -p * y


def _shifted(
    stiff: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    force: tuple[FloatArray, FloatArray],
    trace: FloatArray,
    det: FloatArray,
    p: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(1 + p stiff)^-1 force, and the determinant."""
    a, b, c, d = stiff
    scale = 1.0 + p * trace + p * p * det
    x = ((1.0 + p * d) * force[0] - p * b * force[1]) / scale
    y = ((1.0 + p * a) * force[1] - p * c * force[0]) / scale
    return x, y, scale


def _cross(a: list[FloatArray], b: list[FloatArray]) -> list[FloatArray]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _solve(body: Body, theta: FloatArray, guess: Contact, before: Memory) -> tuple[Contact, BoolArray]:
    """The contact at the end of one step, and whether it was found."""
    b, zeta, eta = (v.copy() for v in guess)
    good = np.zeros(theta.shape, dtype=np.bool_)
    active = np.arange(theta.size)
    part, angle, memory = body, theta, before
    for _ in range(ITERATIONS):
        now = Contact(b[active], zeta[active], eta[active])
        new, far = _newton(part, angle, now, memory)
        with np.errstate(invalid="ignore"):
            done = far <= TOLERANCE
        finite = np.isfinite(new.b) & np.isfinite(new.zeta) & np.isfinite(new.eta)
        settled = active[done]
        good[settled] = True
        b[settled], zeta[settled], eta[settled] = new.b[done], new.zeta[done], new.eta[done]
        going = ~done & finite
        if not going.any():
            break
        keep = active[going]
        b[keep], zeta[keep], eta[keep] = new.b[going], new.zeta[going], new.eta[going]
        if keep.size < active.size:
            active = keep
            part, angle = body.rows(active), theta[active]
            memory = Memory(*(v[active] for v in before))
    return Contact(b, zeta, eta), good


def follow_rod(body: Body, thetas: FloatArray, hints: Hint) -> RodPath:
    """Follow n pushes through k angles.

    Args:
        body: what they touch, n rows.
        thetas: angles of the base from touch [rad], (k, n), all above zero.
        hints: the reduced rod on the same path, (k, n), from whose increments each step starts.
    """
    size = thetas.shape
    fields = {name: np.zeros(size) for name in ("delta", "moment_angle", "slide", "lean", "arc_length")}
    slipped = np.zeros(size, dtype=np.bool_)
    converged = np.zeros(size, dtype=np.bool_)
    for first in range(0, size[1], CHUNK):
        part = slice(first, min(first + CHUNK, size[1]))
        walk = _Walk(body.rows(np.arange(part.start, part.stop)), {k: v[:, part] for k, v in fields.items()})
        some = hints.rows(part)
        for step, theta in enumerate(thetas[:, part]):
            walk.go(step, theta, some.step(step))
            slipped[step, part] = walk.slipped
            converged[step, part] = walk.converged
    return RodPath(slipped_off=slipped, converged=converged, **fields)


class _Walk:
    """The state of some rows on their way through a push; rows that slip off or fail stay where they were."""

    def __init__(self, body: Body, out: dict[str, FloatArray]) -> None:
        n = body.friction.size
        self.body = body
        self.out = out
        self.live = np.arange(n)
        self.last = Memory(np.zeros(n), np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n))
        self.start: dict[str, FloatArray | float] = {"delta": np.pi, "arc_length": 1.0}
        self.hint_b, self.hint_zeta = np.zeros(n), np.zeros(n)
        self.theta = np.zeros(n)
        self.moved = np.zeros(n)
        self.slipped = np.zeros(n, dtype=np.bool_)
        self.converged = np.ones(n, dtype=np.bool_)

    def go(self, step: int, theta_all: FloatArray, hint_all: Hint) -> None:
        """One step of all rows."""
        self.start.setdefault("moment_angle", theta_all)
        for name, values in self.out.items():
            if step:
                values[step] = values[step - 1]
            elif name in self.start:
                values[0] = self.start[name]
        theta, hint = theta_all[self.live], hint_all.rows(self.live)
        moved = theta - self.theta
        angles = (theta, moved, self.moved)
        with np.errstate(all="ignore"):
            guess = Contact(
                self.last.b + (hint.b - self.hint_b), self.last.zeta + (hint.zeta - self.hint_zeta), hint.eta
            )
            new, after, pose, found = _advance(self.body, angles, guess, self.last)
            # Where the base has not turned all stays as it was, force and all.
            still = np.flatnonzero(moved == 0.0)
            _stay(new, after, self.last, still)
            found[still] = True
            lost = np.flatnonzero(~found & ~hint.slipped)
            if lost.size:
                _replace((new, after, pose, found), lost, self._rescue(lost, angles, hint, guess))
            written = found & (moved != 0.0)
            self._write(step, self.live[written], new, pose, written)
        lost = np.flatnonzero(~found)
        if lost.size:
            _, _, cos, _, _, _ = self.body.profile.rows(lost).at(self.last.b[lost])
            off = hint.slipped[lost] | (cos < ROUND)
            self.slipped[self.live[lost[off]]] = True
            self.converged[self.live[lost[~off]]] = False
            keep = np.flatnonzero(found)
            self.live, self.body = self.live[keep], self.body.rows(keep)
            after = Memory(*(v[keep] for v in after))
            hint, theta, moved = hint.rows(keep), theta[keep], moved[keep]
        self.last, self.theta, self.moved = after, theta, moved
        self.hint_b, self.hint_zeta = hint.b, hint.zeta

    def _write(self, step: int, rows: NDArray[np.int64], new: Contact, pose: Pose, found: BoolArray) -> None:
        moment = base_curvature(pose.bend, new.eta, pose.root_force) / 3.0
        values = (pose.delta, moment, self.body.profile.arc(new.b), new.zeta, pose.length)
        for name, value in zip(("delta", "moment_angle", "slide", "lean", "arc_length"), values, strict=True):
            self.out[name][step, rows] = value[found]

    def _rescue(
        self, lost: NDArray[np.int64], angles: Angles, hint: Hint, guess: Contact
    ) -> tuple[Contact, Memory, Pose, BoolArray]:
        """Rows that did not settle: the jump that the reduced rod makes, then the step in parts."""
        body, last = self.body.rows(lost), Memory(*(v[lost] for v in self.last))
        part = (angles[0][lost], angles[1][lost], angles[2][lost])
        result = _advance(body, part, hint.rows(lost).contact, last)
        still = np.flatnonzero(~result[3])
        if still.size:
            aim = Contact(*(v[lost[still]] for v in guess))
            again = _split(
                body.rows(still),
                (part[0][still], part[1][still], part[2][still]),
                Memory(*(v[still] for v in last)),
                aim,
            )
            _replace(result, still, again)
        return result


def _stay(new: Contact, after: Memory, last: Memory, index: NDArray[np.int64]) -> None:
    """Put the rows ``index`` back where they were."""
    new.b[index], new.zeta[index] = last.b[index], last.zeta[index]
    for target, source in zip(after, last, strict=True):
        target[index] = source[index]
    after.slip_lat[index], after.slip_lon[index] = 0.0, 0.0


def _replace(
    whole: tuple[Contact, Memory, Pose, BoolArray],
    index: NDArray[np.int64],
    part: tuple[Contact, Memory, Pose, BoolArray],
) -> None:
    """Put the rows of ``part`` at ``index`` of ``whole``."""
    for old, new in zip(whole[:3], part[:3], strict=True):
        for target, source in zip(old, new, strict=True):
            target[index] = source
    whole[3][index] = part[3]


def _advance(
    body: Body, angles: Angles, guess: Contact, last: Memory
) -> tuple[Contact, Memory, Pose, BoolArray]:
    """One step: the contact, what friction remembers of it, all that follows, and whether it was found."""
    theta, moved, moved_before = angles
    w = pace(moved, moved_before)
    carry = w * w / (1.0 + 2.0 * w)
    before = last._replace(slip_lat=carry * last.slip_lat, slip_lon=carry * last.slip_lon)
    new, found = _solve(body, theta, guess, before)
    pose = body.pose(theta, new, before)
    found &= (pose.force_n > 0.0) & body.holds(new)
    after = Memory(
        new.b, new.zeta, pose.length, pose.slip_lat + before.slip_lat, pose.slip_lon + before.slip_lon
    )
    return new, after, pose, found


def _split(body: Body, angles: Angles, last: Memory, aim: Contact) -> tuple[Contact, Memory, Pose, BoolArray]:
    """The same step in SPLIT parts."""
    theta, moved, moved_before = angles
    found = np.ones(theta.size, dtype=np.bool_)
    at = Contact(last.b, last.zeta, aim.eta)
    for part in range(1, SPLIT + 1):
        share = 1.0 / (SPLIT - part + 1)
        near = Contact(*(s + share * (a - s) for s, a in zip(at, aim, strict=True)))
        here = theta - moved * (1.0 - part / SPLIT)
        at, last, pose, fine = _advance(body, (here, moved / SPLIT, moved_before), near, last)
        found &= fine
        moved_before = moved / SPLIT
    return at, last, pose, found
