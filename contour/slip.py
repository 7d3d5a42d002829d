"""The reduced rod: one scalar unknown, the slide along the profile, followed step by step through a push.

The contact point slides in the sensing plane on the body's silhouette; the beam is a spring that always points from
its own base tangent to the contact point; Coulomb friction acts on the lateral and longitudinal slip together, so
that the memory of friction comes by itself. Lengths are in units of the distance s at touch.

Frame at touch (fixed in the world during the push): e_t, e_n, e_y, where e_y is the beam, e_n the outer normal and
e_t lies a quarter turn past e_n in the sense of the angles of the sensing plane (from +x_s to +z_s). A push with
eps > 0 turns the beam towards -e_t, so the slide is negative.

For the slide at arc length a, contact point p = e_y + c_t e_t + c_n e_n, base tangent t0, x = p . t0,
w = p - x t0, r = |w|/x, the force is along w and the arc length of the beam up to the contact is

    l = |p| (1 + r^2/10),

and a solves, with da and dl the increments of the step,

    w . t + mu (w . n) da / sqrt(da^2 + dl^2) = 0.

The derivation is in docs/derivations.md; a converged rod is in contour.elastica.
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
INNER_STEPS_HARD = (6, 6, 6, 6)
"""The same on the rows that have not settled, before the bracketing search."""
SETTLED = 1e-8
"""What the next step would change, relative to the depth of the push: the last is accepted below this."""
BRACKETS = 300
"""Growing search intervals of the fallback, the first FIRST_BRACKET of the depth long, each GROWTH times longer."""
FIRST_BRACKET = 1e-7
GROWTH = 1.4
BISECTIONS = 52
"""Halvings of the fallback: a double's precision."""
TINY = 1e-20
NOTHING = 1e-40
"""Square of a slip that counts as none [s^2]; keeps 0/0 out of a step that does not move."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """A push followed through k angles, n at a time, arrays (k, n), lengths in s."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi."""
    lever: FloatArray
    """r/x, the tangent of the bending over the lever arm; |M| s/(3 EI) of a rod that bends little, on an edge."""
    slope: FloatArray
    """r = |w|/x, tangent of the angle between the base tangent and the chord."""
    parameter: FloatArray
    """The profile's own parameter b of the contact."""
    slide: FloatArray
    """a, positive towards e_t."""
    arc_length: FloatArray
    """l."""
    along: FloatArray
    """dl/sqrt(da^2 + dl^2), the share of friction that acts along the beam, with its sign."""
    slipped_off: BoolArray
    """The contact has left the body; the values are those of the last contact."""


class _Memory(NamedTuple):
    """What friction remembers of the steps before.

    The slip of a step counts from here. Where a stroke goes on, ``length`` and ``slid`` hold in addition
    w^2/(1 + 2w) of the slip of the step before, w being the ratio of the steps: then the direction of the
    slip is that of its rate at the end of the step, to second order.
    """

    b: FloatArray
    length: FloatArray
    slid: FloatArray

    def rows(self, index: NDArray[np.int64]) -> _Memory:
        """The same for a selection."""
        return _Memory(self.b[index], self.length[index], self.slid[index])


class _Rows:
    """What stays the same along the push for some rows: eps' sine and cosine, friction, profile."""

    def __init__(
        self, sin_eps: FloatArray, cos_eps: FloatArray, friction: FloatArray, profile: Profile
    ) -> None:
        self.sin_eps = sin_eps
        self.cos_eps = cos_eps
        self.friction = friction
        self.profile = profile

    def rows(self, index: NDArray[np.int64]) -> _Rows:
        return _Rows(self.sin_eps[index], self.cos_eps[index], self.friction[index], self.profile.rows(index))


def _linearise(
    rows: _Rows, turn: tuple[FloatArray, FloatArray, FloatArray], b: FloatArray, before: _Memory
) -> tuple[FloatArray, ...]:
    """What the contact condition is made of, at b, with its derivatives along the profile.

    ``turn`` = (cos theta, sin theta sin eps, sin theta cos eps); ``before`` = (b, l) of the last step.
    Gives (force . t, its slope, force . n, its slope, da, dl, its slope, db/da).
    """
    cos_turn, turn_t, turn_n = turn
    along, out, cos, sin, curvature, speed = rows.profile.at(b)
    x = cos_turn - turn_t * along
    x -= turn_n * out
    w_t = x * turn_t
    w_t += along
    w_n = x * turn_n
    w_n += out
    force_t = w_t * cos
    force_t -= w_n * sin
    force_n = w_t * sin
    force_n += w_n * cos
    m_t = turn_t * cos
    m_t -= turn_n * sin
    m_n = turn_t * sin
    m_n += turn_n * cos
    slope_t = m_t * m_t
    np.subtract(1.0, slope_t, out=slope_t)
    slope_t -= curvature * force_n
    slope_n = curvature * force_t
    m_n *= m_t
    slope_n -= m_n
    square = along * along
    square += out * out
    square += 1.0
    chord = np.sqrt(square)
    secant = chord / x
    secant2 = secant * secant
    along *= cos
    out *= sin
    along -= out
    along /= chord
    m_t *= secant
    m_t *= 0.2
    d_l_slope = 0.3 * secant2
    d_l_slope += 0.9
    d_l_slope *= along
    m_t *= secant2
    d_l_slope += m_t
    secant2 *= 0.1
    secant2 += 0.9
    secant2 *= chord
    secant2 -= before.length
    d_a = rows.profile.chord(b, before.b)
    d_a -= before.slid
    return force_t, slope_t, force_n, slope_n, d_a, secant2, d_l_slope, speed


def _improve(
    rows: _Rows,
    turn: tuple[FloatArray, FloatArray, FloatArray],
    b: FloatArray,
    before: _Memory,
    inner: int,
) -> tuple[FloatArray, FloatArray]:
    """A better b, and how far it still was, squared and compared with the slip (relative to the second order left).

    Geometry and force are nearly linear in the slide; friction, da/sqrt(da^2 + dl^2), is not. So the geometry is
    linearised, and the friction law is solved on it by Newton steps that only walk from the side where the residual
    is convex, with the length y = |da| as unknown.
    """
    force_t, slope_t, force_n, slope_n, d_a, d_l, d_l_slope, speed = _linearise(rows, turn, b, before)
    force_t -= slope_t * d_a  # the force for no slide in this step
    sense = -np.sign(force_t)
    pull = np.abs(force_t, out=force_t)
    slope_n *= sense
    slope_n *= rows.friction
    d_l_slope *= sense
    y_old = sense * d_a
    force_n *= rows.friction
    force_n -= slope_n * y_old
    d_l -= d_l_slope * y_old
    # Two lower bounds of the root: full friction, and friction's initial slope.
    y = pull - force_n
    y /= slope_t
    low = force_n / (np.abs(d_l) + TINY)
    low += slope_t
    np.divide(pull, low, out=low)
    np.maximum(low, y, out=low)
    np.maximum(low, 0.0, out=low)
    y = np.maximum(y_old, low)
    for _ in range(inner):
        along = d_l_slope * y
        along += d_l
        slip2 = along * along
        slip2 += y * y
        slip2 += NOTHING
        slip = np.sqrt(slip2)
        normal = slope_n * y
        normal += force_n
        lateral = y / slip
        value = slope_t * y
        value -= pull
        value += normal * lateral
        # d(y/slip)/dy = (dl at y = 0) dl / slip^3.
        along *= d_l
        along /= slip2
        along /= slip
        along *= normal
        along += slope_t
        lateral *= slope_n
        along += lateral
        value /= along
        y -= value
        np.maximum(y, low, out=y)
    value *= value
    value /= slip
    y_old -= y
    moved = y_old * sense
    y_old *= y_old
    value += y_old
    moved *= speed
    return b - moved, value


def _state(
    rows: _Rows, turn: tuple[FloatArray, FloatArray, FloatArray], b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """(c_t, c_n, x, |p|^2, force . t, force . n) at b."""
    cos_turn, turn_t, turn_n = turn
    along, out, cos, sin, _, _ = rows.profile.at(b)
    x = cos_turn - turn_t * along - turn_n * out
    w_t = along + x * turn_t
    w_n = out + x * turn_n
    return along, out, x, 1.0 + along * along + out * out, w_t * cos - w_n * sin, w_t * sin + w_n * cos


def _arc_length(x: FloatArray, square: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(square) * (0.9 + 0.1 * square / (x * x)))


def _residual(
    rows: _Rows, turn: tuple[FloatArray, FloatArray, FloatArray], b: FloatArray, before: _Memory
) -> tuple[FloatArray, FloatArray]:
    """The contact condition at b, and force . n."""
    _, _, x, square, force_t, force_n = _state(rows, turn, b)
    d_a = rows.profile.chord(b, before.b) - before.slid
    d_l = _arc_length(x, square) - before.length
    return force_t + rows.friction * force_n * d_a / np.sqrt(d_a * d_a + d_l * d_l + NOTHING), force_n


def _search(
    rows: _Rows, turn: tuple[FloatArray, FloatArray, FloatArray], before: _Memory, depth: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The first equilibrium past the last position, by growing brackets and bisection; False where there is none."""
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
    rows: _Rows,
    turn: tuple[FloatArray, FloatArray, FloatArray],
    guess: FloatArray,
    before: _Memory,
    depth: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """The position at the end of one step: Newton from the guess, on all rows, then on the few that need more."""
    b = guess
    for inner in INNER_STEPS:
        b, left = _improve(rows, turn, b, before, inner)
    on_body = np.ones(b.shape, dtype=np.bool_)
    rest = np.flatnonzero(~((left <= SETTLED * depth) & rows.profile.within(b)))
    if rest.size:
        b[rest], on_body[rest] = _solve_hard(
            rows.rows(rest),
            (turn[0][rest], turn[1][rest], turn[2][rest]),
            b[rest],
            before.rows(rest),
            depth[rest],
        )
    return b, on_body


def _solve_hard(
    rows: _Rows,
    turn: tuple[FloatArray, FloatArray, FloatArray],
    guess: FloatArray,
    before: _Memory,
    depth: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """More Newton steps on a few rows; the search on those that wander or settle where no contact can be."""
    b = guess
    for inner in INNER_STEPS_HARD:
        b, left = _improve(rows, turn, b, before, inner)
    _, force_n = _residual(rows, turn, b, before)
    bad = np.flatnonzero(~((left <= SETTLED * depth) & rows.profile.within(b) & (force_n > 0.0)))
    on_body = np.ones(b.shape, dtype=np.bool_)
    if bad.size:
        b[bad], on_body[bad] = _search(
            rows.rows(bad),
            (turn[0][bad], turn[1][bad], turn[2][bad]),
            before.rows(bad),
            depth[bad],
        )
    return b, on_body


def follow(eps: FloatArray, thetas: FloatArray, friction: FloatArray, profile: Profile) -> Path:
    """Follow n pushes through k angles.

    Args:
        eps: pushing direction off the inner normal [rad], (n,).
        thetas: angles of the base from touch [rad], (k, n), all above zero.
        friction: mu, (n,).
        profile: the silhouettes, n of them, lengths in units of s.
    """
    count, n = thetas.shape
    shape = (count, n)
    fields = {name: np.zeros(shape) for name in ("delta", "lever", "slope", "slide", "arc_length", "along")}
    fields["parameter"] = np.zeros(shape)
    slipped = np.zeros(shape, dtype=np.bool_)
    for first in range(0, n, CHUNK):
        part = slice(first, min(first + CHUNK, n))
        index = np.arange(part.start, part.stop)
        rows = _Rows(np.sin(eps[part]), np.cos(eps[part]), friction[part], profile.rows(index))
        # Iterates of a push that runs away may overflow; they are caught by where they land.
        with np.errstate(all="ignore"):
            _follow_rows(rows, thetas[:, part], {k: v[:, part] for k, v in fields.items()}, slipped[:, part])
    return Path(slipped_off=slipped, **fields)


def _follow_rows(rows: _Rows, thetas: FloatArray, out: dict[str, FloatArray], slipped: BoolArray) -> None:
    n = thetas.shape[1]
    zero = np.zeros(n)
    b, length = zero, np.ones(n)
    d_a = d_l = rate = moved_before = theta_before = zero
    gone = np.zeros(n, dtype=np.bool_)
    for step, theta in enumerate(thetas):
        sine = np.sin(theta)
        turn = (np.cos(theta), sine * rows.sin_eps, sine * rows.cos_eps)
        moved = theta - theta_before
        w = pace(moved, moved_before)
        carry = w * w / (1.0 + 2.0 * w)
        before = _Memory(b, length + carry * d_l, carry * d_a)
        new, on_body = _solve(rows, turn, b + rate * (w * moved_before), before, theta)
        gone |= ~on_body
        if gone.any():
            new = np.where(gone, b, new)
        along_t, out_n, x, square, force_t, force_n = _state(rows, turn, new)
        new_length = _arc_length(x, square)
        d_a, d_l = rows.profile.chord(new, b), new_length - length
        rate = np.divide(new - b, moved, out=np.zeros(n), where=moved != 0.0)
        lateral, along = d_a - before.slid, new_length - before.length
        b, length = new, new_length
        # |w| from its components: |p|^2 - x^2 would lose the digits of a small push.
        force_y = 1.0 - x * turn[0]
        slope = np.sqrt(force_t * force_t + force_n * force_n + force_y * force_y) / x
        towards = -(rows.sin_eps * along_t + rows.cos_eps * out_n)
        across = rows.sin_eps * out_n - rows.cos_eps * along_t
        out["delta"][step] = np.pi + np.arctan2(across, sine - turn[0] * towards)
        out["slope"][step] = slope
        out["lever"][step] = slope / x
        out["parameter"][step] = b
        out["slide"][step] = rows.profile.arc(b)
        out["arc_length"][step] = length
        out["along"][step] = along / np.sqrt(lateral * lateral + along * along + NOTHING)
        slipped[step] = gone
        theta_before, moved_before = theta, moved


def pace(moved: FloatArray, moved_before: FloatArray) -> FloatArray:
    """Ratio of a step to the one before where the stroke goes on, 0 where one begins."""
    onward = moved * moved_before > 0.0
    return np.divide(moved, moved_before, out=np.zeros_like(moved), where=onward)
