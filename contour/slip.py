"""The reduced rod: one scalar unknown, the slide along the profile, followed step by step through a push.

The contact slides in the sensing plane on the body's silhouette and leans along the beam over its radius R;
the beam is a spring that points from its own base tangent to the touching point; Coulomb friction acts on the
lateral and longitudinal slip together, so that the memory of friction comes by itself. Lengths are in units
of the distance s at touch.

Frame at touch (fixed in the world during the push): e_t, e_n, e_y, where e_y is the beam, e_n the outer
normal and e_t lies a quarter turn past e_n in the sense of the angles of the sensing plane (from +x_s to
+z_s). A push with eps > 0 turns the beam towards -e_t, so the slide is negative.

At the slide a, with the profile's point c, tangent t and normal n there, the lean zeta of the touching point
P is the small-angle rod's, the root of a quadratic equation:

    P = e_y + c + R ((cos zeta - 1) n - sin zeta e_y),   zeta so that the rod is tangent there,
    X = P . t0,  W = P - X t0,  Y = |W|,  r = Y/X,  l = |P| (1 + r^2/10),  L = l + R zeta,

t0 the base tangent. The force is along W + h t0, its axial part h = tau Y - 3/2 r Y (1 + tau^2) with the
friction tau = mu dL/slip along a rod that is bent by 3/2 r; a solves Coulomb's law across,

    F . t + mu (F . n) dA/slip = 0,   slip^2 = dA^2 + dL^2,

dA and dL the step's increments of lateral slip, da - (t_end . t) dl, and of L. The base moment follows:
|M| s/(3 EI) = (r/X) / (1 + (15/14) r^2 - tau r/5). docs/derivations.md derives this; a converged rod is in
contour.elastica.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.silhouette import Profile

__all__ = ["Path", "follow", "pace"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CHUNK = 8192
"""Rows worked on at once: enough to hide the interpreter, few enough for a core's caches."""
INNER_STEPS = (2, 2)
"""Newton steps on the friction law within each step on the geometry, all rows."""
INNER_STEPS_HARD = (2, 3, 4, 6, 6, 6, 6)
"""The same on the rows that have not settled, before the bracketing search."""
SETTLED = 1e-8
"""What the next step would change, relative to the depth of the push: the last is accepted below this."""
BRACKETS = 300
"""Most search intervals of the fallback."""
FIRST_BRACKET = 1e-7
"""Length of the first, relative to the depth of the push."""
GROWTH = 1.4
"""How much longer each is than the one before."""
BISECTIONS = 52
"""Halvings of the fallback: a double's precision."""
NOTHING = 1e-40
"""Square of a slip that counts as none [s^2]; keeps 0/0 out of a step that does not move."""
LEAST_SLIP = 1e-20
"""Its root."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """A push followed through k angles, n at a time, arrays (k, n), lengths in s."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi."""
    moment_angle: FloatArray
    """|M| s/(3 EI) [rad]."""
    slope: FloatArray
    """r, tangent of the angle between base tangent and chord."""
    lever: FloatArray
    """r/X, the moment of a rod that bends little."""
    parameter: FloatArray
    """The profile's own parameter b of the contact."""
    slide: FloatArray
    """a, positive towards e_t."""
    lean: FloatArray
    """zeta [rad]."""
    arc_length: FloatArray
    """l."""
    along: FloatArray
    """dL/slip, the share of friction that acts along the beam, with its sign."""
    slipped_off: BoolArray
    """The contact has left the body; the values are those of a contact held where it last was."""


class _Memory(NamedTuple):
    """What friction remembers of the steps before.

    The slip of a step counts from here. Where a stroke goes on, ``paid`` and ``slid`` hold in addition
    w^2/(1 + 2w) of the slip of the step before, w being the ratio of the steps: then the direction of the
    slip is that of its rate at the end of the step, to second order.
    """

    b: FloatArray
    length: FloatArray
    """l at the last step."""
    paid: FloatArray
    """L to count from."""
    slid: FloatArray
    """Lateral slip to count from."""

    def rows(self, index: NDArray[np.int64]) -> _Memory:
        """The same for a selection."""
        return _Memory(*(v[index] for v in self))


class _Rows(NamedTuple):
    """What stays the same along the push for some rows."""

    sin_eps: FloatArray
    cos_eps: FloatArray
    friction: FloatArray
    radius: FloatArray
    profile: Profile

    def rows(self, index: NDArray[np.int64]) -> _Rows:
        """The same for a selection."""
        return _Rows(
            self.sin_eps[index],
            self.cos_eps[index],
            self.friction[index],
            self.radius[index],
            self.profile.rows(index),
        )


class _Turn(NamedTuple):
    """The base's attitude at a step: cos theta, sin theta sin eps, sin theta cos eps."""

    cos: FloatArray
    t: FloatArray
    n: FloatArray
    lift: FloatArray
    """3/2 sin^2 theta."""
    drag: FloatArray
    """tau/20, as far as the stroke tells."""

    def rows(self, index: NDArray[np.int64]) -> _Turn:
        """The same for a selection."""
        return _Turn(*(v[index] for v in self))


class _Place(NamedTuple):
    """The touching point at b, in the directions t and n there, and what follows from it."""

    p_t: FloatArray
    p_n: FloatArray
    p_y: FloatArray
    ahead: FloatArray
    """X."""
    tilt_t: FloatArray
    """-t0 . t."""
    tilt_n: FloatArray
    """-t0 . n."""
    zeta: FloatArray
    spread: FloatArray
    """Slope of the equation for zeta."""
    drop: FloatArray
    """R (1 - cos zeta)."""
    lateral: FloatArray
    """W . t."""
    normal: FloatArray
    """W . n."""
    square: FloatArray
    """|P|^2."""
    cos: FloatArray
    sin: FloatArray
    curvature: FloatArray
    speed: FloatArray


def _place(rows: _Rows, turn: _Turn, b: FloatArray) -> _Place:
    along, out, cos, sin, curvature, speed = rows.profile.at(b)
    tilt_t = turn.t * cos
    tilt_t -= turn.n * sin
    tilt_n = turn.t * sin
    tilt_n += turn.n * cos
    p_t = along * cos
    p_t -= out * sin
    p_n = along * sin
    p_n += out * cos
    level = turn.cos - turn.t * along
    level -= turn.n * out
    # zeta: tan(bend) = tilt_n + cos zeta, times X, a quadratic but for terms that the edge's own lean stands
    # in for.
    level_tilt = level * tilt_n
    depth = level_tilt + p_n
    rho = depth / level
    edge = 1.5 * rho
    edge -= tilt_n
    constant = (3.0 / 7.0) * rho
    constant -= turn.drag
    constant *= rho
    constant += 1.0
    constant *= depth
    constant *= 1.5
    constant -= level_tilt
    rho = edge * edge
    rho *= 1.0 / 3.0
    rho += turn.lift
    rho *= edge
    constant -= rho
    spread = (0.5 * rows.radius) * tilt_n
    spread += level
    spread *= turn.cos
    zeta = (4.0 * turn.cos * turn.cos - 3.0) * rows.radius
    zeta *= constant
    root = spread * spread
    root -= zeta
    np.maximum(root, 0.0, out=root)
    np.sqrt(root, out=root)
    root += spread
    zeta = constant + constant
    zeta /= root
    shift = rows.radius * zeta
    drop = shift * zeta
    drop *= 0.5
    shift -= drop * zeta / 3.0
    p_n -= drop
    ahead = level - turn.cos * shift
    ahead += tilt_n * drop
    lateral = ahead * tilt_t
    lateral += p_t
    normal = ahead * tilt_n
    normal += p_n
    p_y = 1.0 - shift
    square = p_t * p_t
    square += p_n * p_n
    square += p_y * p_y
    return _Place(
        p_t,
        p_n,
        p_y,
        ahead,
        tilt_t,
        tilt_n,
        zeta,
        spread,
        drop,
        lateral,
        normal,
        square,
        cos,
        sin,
        curvature,
        speed,
    )


class _Conditions(NamedTuple):
    """Coulomb's law across at a place, in the slips since the last step."""

    slid: FloatArray
    """dA."""
    paid: FloatArray
    """dL."""
    aside: FloatArray
    """Y."""
    bent: FloatArray
    """3/2 r Y, the axial part of a force across the end of the bent rod."""
    length: FloatArray
    """l."""
    secant: FloatArray
    """|P|/X."""


def _conditions(rows: _Rows, p: _Place, b: FloatArray, before: _Memory) -> _Conditions:
    chord = np.sqrt(p.square)
    secant = chord / p.ahead
    length = secant * secant
    r2 = length - 1.0
    bent = (1.5 * p.ahead) * r2
    aside = p.ahead * np.sqrt(np.maximum(r2, 0.0))
    length *= 0.1
    length += 0.9
    length *= chord
    paid = rows.radius * p.zeta
    paid += length
    paid -= before.paid
    slid = p.curvature * p.drop
    np.subtract(1.0, slid, out=slid)
    slid *= rows.profile.chord(b, before.b)
    # The end tangent's part across, -tilt_t + 3/2 W . t/X, carries the rod sideways as it pays out.
    carry = 1.5 * p.lateral
    carry /= p.ahead
    carry -= p.tilt_t
    carry *= length - before.length
    slid -= carry
    slid -= before.slid
    return _Conditions(slid, paid, aside, bent, length, secant)


def _improve(
    rows: _Rows, turn: _Turn, b: FloatArray, before: _Memory, inner: int
) -> tuple[FloatArray, FloatArray]:
    """A better b, and how far it still was, squared and compared with the slip (relative to the second order
    left).

    Geometry and elastic force are nearly linear in the slide; friction, dA/slip, is not. So the geometry is
    linearised, and the friction law is solved on it by Newton steps, which come to the root of a concave
    function from below, with y = |dA| as unknown.
    """
    p = _place(rows, turn, b)
    c = _conditions(rows, p, b, before)
    mu, radius = rows.friction, rows.radius
    # Derivatives along the profile.
    lean = 1.5 * p.curvature * p.lateral
    lean -= p.tilt_t * (p.curvature * p.ahead + 0.5 * p.tilt_n)
    lean /= p.spread
    lean *= radius
    forward = turn.cos * lean
    forward += p.tilt_t
    slope_t = p.curvature * p.normal
    slope_t += forward * p.tilt_t
    np.subtract(1.0, slope_t, out=slope_t)
    slope_n = p.curvature * p.lateral
    slope_n -= forward * p.tilt_n
    secant2 = c.secant * c.secant
    pay = p.p_t - lean
    pay /= p.ahead * c.secant
    pay *= 0.3 * secant2 + 0.9
    forward *= 0.2 * secant2 * c.secant
    pay += forward
    pay += lean
    # The law in y: sense p_t-force + friction (force_n) y/slip = 0, from its values at no lateral slip.
    axial = mu * np.sign(c.paid)
    level = p.lateral - slope_t * c.slid
    sense = -np.sign(level - (axial * c.aside - c.bent * (1.0 + axial * axial)) * p.tilt_t)
    pull = sense * level
    sense_tilt = sense * p.tilt_t
    lean_n = p.tilt_n + p.zeta
    grip_slope = mu * slope_n
    grip_slope *= sense
    pay *= sense
    y_old = sense * c.slid
    grip = mu * p.normal
    grip -= grip_slope * y_old
    still = c.paid - pay * y_old
    low = grip / (np.abs(still) + LEAST_SLIP)
    low += slope_t
    np.divide(-pull, low, out=low)
    np.maximum(low, 0.0, out=low)
    y = -pull
    y -= grip
    y /= slope_t
    np.maximum(y, y_old, out=y)
    # Where the body curves away faster than the rod follows, the law has a second root: stay this side of it.
    np.copyto(y, 0.0, where=slope_t <= 0.0)
    np.maximum(y, low, out=y)
    low *= 0.5
    for _ in range(inner):
        along = pay * y
        along += still
        slip2 = along * along
        slip2 += y * y
        slip2 += NOTHING
        slip = np.sqrt(slip2)
        slip2 *= slip
        lateral = y / slip
        tau = along / slip
        tau *= mu
        axial = tau * tau
        axial += 1.0
        axial *= c.bent
        np.subtract(tau * c.aside, axial, out=axial)
        normal = grip_slope * y
        normal += grip
        normal -= mu * axial * lean_n
        value = slope_t * y
        value += pull
        value -= axial * sense_tilt
        value += normal * lateral
        # d(y/slip)/dy = still along/slip^3, d(along/slip)/dy = -still y/slip^3.
        still_slip = still / slip2
        along *= still_slip
        along *= normal
        along += slope_t
        along += grip_slope * lateral
        tau *= -2.0 * c.bent
        tau += c.aside
        tau *= mu
        still_slip *= y
        tau *= still_slip
        tau *= sense_tilt + mu * lateral * lean_n
        along += tau
        value /= along
        y -= value
        np.maximum(y, low, out=y)
    value *= value
    value /= slip
    y_old -= y
    moved = y_old * sense
    y_old *= y_old
    value += y_old
    moved *= p.speed
    return b - moved, value


def _residual(rows: _Rows, turn: _Turn, b: FloatArray, before: _Memory) -> tuple[FloatArray, FloatArray]:
    """F . t + mu (F . n) dA/slip at b, and W . n."""
    p = _place(rows, turn, b)
    c = _conditions(rows, p, b, before)
    slip = np.sqrt(c.slid * c.slid + c.paid * c.paid + NOTHING)
    tau = rows.friction * c.paid / slip
    axial = tau * c.aside - c.bent * (1.0 + tau * tau)
    force_n = p.normal - axial * (p.tilt_n + p.zeta)
    return p.lateral - axial * p.tilt_t + rows.friction * force_n * c.slid / slip, p.normal


def _search(rows: _Rows, turn: _Turn, before: _Memory, depth: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The first equilibrium past the last position, by growing brackets and bisection; False where there is
    none.
    """
    start = before.b
    first, _ = _residual(rows, turn, start, before)
    sense = -np.sign(first)
    width = FIRST_BRACKET * depth
    longest = rows.profile.reach()
    low = start.copy()
    high = start + sense * width
    found = first == 0.0
    lost = np.zeros_like(found)
    for _ in range(BRACKETS):
        value, normal = _residual(rows, turn, high, before)
        lost |= ~found & ((normal <= 0.0) | ~rows.profile.within(high))
        found |= ~lost & (value * sense >= 0.0)
        going = ~(found | lost)
        if not going.any():
            break
        low = np.where(going, high, low)
        width = np.minimum(width * GROWTH, longest)
        high = np.where(going, high + sense * width, high)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        value, _ = _residual(rows, turn, middle, before)
        past = value * sense >= 0.0
        high = np.where(past, middle, high)
        low = np.where(past, low, middle)
    return np.where(found, 0.5 * (low + high), start), found


def _solve(
    rows: _Rows, turn: _Turn, guess: FloatArray, before: _Memory, depth: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The position at the end of one step: Newton from the guess on all rows, then on the few that need more.

    The search takes the rows that wander or settle where no contact can be.
    """
    b = guess
    for inner in INNER_STEPS:
        b, left = _improve(rows, turn, b, before, inner)
    on_body = np.ones(b.shape, dtype=np.bool_)
    rest = np.flatnonzero(~((left <= SETTLED * depth) & rows.profile.within(b)))
    if not rest.size:
        return b, on_body
    bad = _Stragglers(rest, rows.rows(rest), turn.rows(rest), before.rows(rest), depth[rest])
    for inner in INNER_STEPS_HARD:
        new, left = _improve(bad.rows, bad.turn, b[bad.which], bad.before, inner)
        b[bad.which] = new
        settled = (left <= SETTLED * bad.depth) & bad.rows.profile.within(new)
        bad = bad.take(np.flatnonzero(~settled))
        if not bad.which.size:
            break
    if bad.which.size:
        b[bad.which], on_body[bad.which] = _search(bad.rows, bad.turn, bad.before, bad.depth)
    return b, on_body


class _Stragglers(NamedTuple):
    """Rows that have not settled, with all that their next step needs."""

    which: NDArray[np.int64]
    rows: _Rows
    turn: _Turn
    before: _Memory
    depth: FloatArray

    def take(self, keep: NDArray[np.int64]) -> _Stragglers:
        """Some of them."""
        return _Stragglers(
            self.which[keep],
            self.rows.rows(keep),
            self.turn.rows(keep),
            self.before.rows(keep),
            self.depth[keep],
        )


def follow(
    eps: FloatArray, thetas: FloatArray, friction: FloatArray, radius: FloatArray, profile: Profile
) -> Path:
    """Follow n pushes through k angles.

    Args:
        eps: pushing direction off the inner normal [rad], (n,).
        thetas: angles of the base from touch [rad], (k, n), all above zero.
        friction: mu, (n,).
        radius: R along the beam, (n,), in units of s.
        profile: the silhouettes, n of them, lengths in units of s.
    """
    count, n = thetas.shape
    names = ("delta", "moment_angle", "slope", "lever", "parameter", "slide", "lean", "arc_length", "along")
    fields = {name: np.zeros((count, n)) for name in names}
    slipped = np.zeros((count, n), dtype=np.bool_)
    for first in range(0, n, CHUNK):
        part = slice(first, min(first + CHUNK, n))
        index = np.arange(part.start, part.stop)
        rows = _Rows(np.sin(eps[part]), np.cos(eps[part]), friction[part], radius[part], profile.rows(index))
        # Iterates of a push that runs away may overflow; they are caught by where they land.
        with np.errstate(all="ignore"):
            _follow_rows(rows, thetas[:, part], {k: v[:, part] for k, v in fields.items()}, slipped[:, part])
    return Path(slipped_off=slipped, **fields)


def _follow_rows(rows: _Rows, thetas: FloatArray, out: dict[str, FloatArray], slipped: BoolArray) -> None:
    n = thetas.shape[1]
    zero = np.zeros(n)
    b, length, paid = zero, np.ones(n), np.ones(n)
    slid = pay = rate = along = moved_before = theta_before = zero
    gone = np.zeros(n, dtype=np.bool_)
    free = np.flatnonzero(~rows.profile.held())
    for step, theta in enumerate(thetas):
        sine = np.sin(theta)
        moved = theta - theta_before
        w = pace(moved, moved_before)
        turn = _Turn(
            np.cos(theta),
            sine * rows.sin_eps,
            sine * rows.cos_eps,
            1.5 * sine * sine,
            0.05 * rows.friction * np.where(w > 0.0, along, np.sign(moved)),
        )
        carry = w * w / (1.0 + 2.0 * w)
        before = _Memory(b, length, paid + carry * pay, carry * slid)
        guess = b + rate * (w * moved_before)
        if free.size == n:
            new, on_body = _solve(rows, turn, guess, before, theta)
            gone |= ~on_body
        else:
            new = b.copy()
            new[free], on_body = _solve(
                rows.rows(free), turn.rows(free), guess[free], before.rows(free), theta[free]
            )
            gone[free] |= ~on_body
        if gone.any():
            new = np.where(gone, b, new)
        p = _place(rows, turn, new)
        pulled = np.flatnonzero((p.normal <= 0.0) & ~gone)
        if pulled.size:
            # A root at which the body would have to pull: look for one further on, or the contact is lost.
            new[pulled], on_body = _search(
                rows.rows(pulled), turn.rows(pulled), before.rows(pulled), theta[pulled]
            )
            gone[pulled] = ~on_body
            p = _place(rows, turn, new)
        c = _conditions(rows, p, new, before)
        along = c.paid / np.sqrt(c.slid * c.slid + c.paid * c.paid + NOTHING)
        slid, pay = c.slid + before.slid, c.paid + before.paid - paid
        paid, length = paid + pay, c.length
        rate = np.divide(new - b, moved, out=np.zeros(n), where=moved != 0.0)
        b = new
        # |W| from its components: |P|^2 - X^2 would lose the digits of a small push.
        w_y = p.p_y - p.ahead * turn.cos
        slope = np.sqrt(p.lateral * p.lateral + p.normal * p.normal + w_y * w_y) / p.ahead
        lever = slope / p.ahead
        # P on the axes at touch, then along and across the push.
        at_t, at_n = p.p_t * p.cos + p.p_n * p.sin, p.p_n * p.cos - p.p_t * p.sin
        towards = -(rows.sin_eps * at_t + rows.cos_eps * at_n)
        across = rows.sin_eps * at_n - rows.cos_eps * at_t
        out["delta"][step] = np.pi + np.arctan2(across, sine * p.p_y - turn.cos * towards)
        out["moment_angle"][step] = lever / (
            1.0 + slope * ((15.0 / 14.0) * slope - (0.2 * rows.friction) * along)
        )
        out["slope"][step] = slope
        out["lever"][step] = lever
        out["parameter"][step] = b
        out["slide"][step] = rows.profile.arc(b)
        out["lean"][step] = p.zeta
        out["arc_length"][step] = c.length
        out["along"][step] = along
        slipped[step] = gone
        theta_before, moved_before = theta, moved


def pace(moved: FloatArray, moved_before: FloatArray) -> FloatArray:
    """Ratio of a step to the one before where the stroke goes on, 0 where one begins."""
    onward = moved * moved_before > 0.0
    return np.divide(moved, moved_before, out=np.zeros_like(moved), where=onward)
