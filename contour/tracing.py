"""Following contours: where to touch next.

:class:`Tracer` follows all contours of a plan in lockstep and knows only what was touched. In Pi everything is plane
geometry: the beam is a point, dilated by its radius; at a contact with outer normal n the contour goes on along the
tangent t = sense (n turned by +90 deg). As in Fig. 15 of Kaneko1998 each new contact is approached along the last
inner normal: from the start u + h n + D t, h the clearance and D the step, towards -n. Then

- found: localise, and go on from there, with a shorter step where the normal turns much over the last one;
- nothing there (a convex corner): walk round it, along -t beneath the last contact, then along +n behind it, which
  also goes round the end of a thin fin; still nothing: again with a third of the step, then the way is lost;
- touched on the way to the start (a concave corner): that is the contact;
- out of the gantry's reach: the way ends there. The other way from the first contact is tried then, reached by
  withdrawing the beam along itself until it is clear of the object's box.

A contour is closed when a step passes the first contact, or, two steps in a row, earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag
from contour.errors import UsageError
from contour.frames import Mount, wrap_angle
from contour.instrument import ApproachReading, Outcome
from contour.outline import Outlines, quarter_turn, unit
from contour.plan import Plan

__all__ = ["Expectation", "Move", "Status", "Trace", "TraceSettings", "Tracer"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Status(IntEnum):
    """How far a contour is."""

    WAITING = 0
    """Others of its plane come first."""
    SEARCHING = 1
    """On lines of first contact."""
    FOLLOWING = 2
    """Along the outline."""
    RETURNING = 3
    """On the way back to the first contact, to go the other way from there."""
    CLOSED = 4
    """Came back to a contact of its own."""
    ENDED = 5
    """Followed both ways to where the gantry's reach ends."""
    LOST = 6
    """Nothing was found where the outline should go on, or no contact at all."""
    DUPLICATE = 7
    """Its first contact lies on an outline followed before."""


class _Leg(IntEnum):
    """Moves of a return."""

    LIFT = 0
    OVER = 1
    DOWN = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSettings:
    """Numbers of the stepping; lengths as shares of the plan's step."""

    clearance: float = 0.3
    """h: off the surface before a move."""
    depth: float = 0.4
    """How far below the last contact's level stage 0 looks for the surface."""
    smallest_step: float = 0.1
    """Steps are never shorter."""
    largest_turn: float = float(np.deg2rad(27.0))
    """Steps shorten until the normal turns no more than this from one to the next [rad]."""
    growth: float = 2.0
    """A step is at most this much longer than the last one."""
    trusted_sigma: float = float(np.deg2rad(8.0))
    """A measured normal steers if its sigma is below this [rad]; else the chord of the last touches does."""
    fresh_sigma: float = float(np.deg2rad(25.0))
    """Expected deviation of the normal from the approach where neighbours say nothing [rad]."""
    turns: float = 4.0
    """Contacts of a contour end at this many times the perimeter of its box's projection over the step."""

    def __post_init__(self) -> None:
        for name in ("clearance", "depth", "smallest_step", "largest_turn", "trusted_sigma", "fresh_sigma", "turns"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"tracing {name} is {value!r}: it must be a finite number above zero")
        if self.growth <= 1.0:
            raise UsageError(f"tracing growth is {self.growth!r}: steps could never grow back, make it above 1")


class Move(NamedTuple):
    """What the instrument's ``approach`` is asked for; one row a contour."""

    which: IntArray
    """(k,) contours, which are also the antennas."""
    pose: FloatArray
    """(k, 5) m and rad, where the guarded move starts."""
    direction_world: FloatArray
    """(k, 3) unit."""
    travel: FloatArray
    """(k,) m."""


class Expectation(NamedTuple):
    """What neighbours say of the normal at the contact just touched."""

    outward: FloatArray
    """(k,) rad, angle of the outer normal in Pi."""
    sigma: FloatArray
    """(k,) rad, one standard deviation."""
    fresh: BoolArray
    """(k,) whether nothing but the approach is behind it: a first contact, or one after a corner."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """How the contours of a plan went."""

    status: NDArray[np.int8]
    """(n,) :class:`Status`"""
    contacts: IntArray
    """(n,) localised."""
    approaches: IntArray
    """(n,) guarded moves made."""
    reason: tuple[str, ...]
    """n short sentences; empty while a contour is followed."""

    @property
    def closed(self) -> BoolArray:
        """(n,)"""
        return self.status == Status.CLOSED


SEARCH_LINES = (0.0, 0.4, -0.4, 0.8, -0.8)
"""Offsets of the lines of first contact, as shares of half the box's width."""
SHORTER = 1.0 / 3.0
"""A step is tried again this much shorter when walking round found nothing."""
LARGEST_TRIES = 3
"""Shorter steps, higher starts or steps on the spot in a row, before a way is given up."""
STANDSTILL = 0.1
"""A step that gets on by less than this share of its length has made no progress."""
TRANSPORT_TRAVEL = 1e-4
"""Guarded end of a move that is only there to get somewhere [m]."""
CHANGE_GAIN = 3.0
"""Expected deviation of the normal over what two extrapolations of it differ by more than their noise."""
TOUCH_SHARE = 0.25
"""Spread of where a touch is declared, as share of the bending at the touch moment at the beam's end."""


class Tracer:
    """Ask and tell for all contours of ``plan``: contour i is followed with antenna i.

    One round: ``move = ask()``, the instrument's ``approach``, ``rows = touched(reading)``, localise those rows with
    :meth:`expected` as prior, ``tell(contacts)``, and the instrument's ``release`` by :meth:`clearance`; until
    ``active`` is empty. Rows of a reading that are not localised need no release: they stand free or are done.
    """

    def __init__(self, plan: Plan, mount: Mount, antenna: Antenna, settings: TraceSettings | None = None) -> None:
        self._plan, self._mount = plan, mount
        self._set = TraceSettings() if settings is None else settings
        n = plan.contours
        poses = mount.poses(np.zeros((n, 3)), plan.direction)
        self._joints = poses[:, 3:]
        rotation = mount.rotation_world_sensor(poses)
        self._axes = rotation[:, :, [0, 2]]  # (n, 3, 2) x_s and z_s in the world
        self._a, self._b = plan.reach.half_planes(rotation, plan.level, antenna.beam.length, mount)
        beam = antenna.beam
        self._touch_sigma = TOUCH_SHARE * antenna.sensor.touch_moment * beam.length**2 / antenna.stiffness3
        self._height = max(self._set.clearance * plan.step, 4.0 * beam.radius)
        self._withdraw = np.maximum(plan.level + beam.length - plan.near + self._height, 0.0)
        self._limit = np.ceil(12.0 + self._set.turns * plan.perimeter / plan.step).astype(np.int64)
        self._outlines = Outlines(n)
        self._status = np.full(n, Status.WAITING, dtype=np.int8)
        self._final = np.full(n, Status.ENDED, dtype=np.int8)  # what it will be when both ways are done
        self._reason = np.full(n, "", dtype=object)
        self._approaches = np.zeros(n, dtype=np.int64)
        self._line = np.zeros(n, dtype=np.int64)
        self._stage = np.zeros(n, dtype=np.int64)
        self._leg = np.zeros(n, dtype=np.int64)
        self._shorter, self._higher, self._stalls, self._meets = (np.zeros(n, dtype=np.int64) for _ in range(4))
        self._reversed = np.zeros(n, dtype=np.bool_)
        self._sense = np.ones(n)
        self._step = np.full(n, plan.step)
        self._bend = np.zeros(n)  # [1/m] of the outline over the last step, positive where convex
        self._since = np.zeros(n, dtype=np.int64)  # contacts since the last break
        self._first, self._stand, self._last, self._before = (np.zeros((n, 2)) for _ in range(4))
        self._first_normal, self._normal, self._offset = (np.zeros((n, 2)) for _ in range(3))
        self._trusted = np.zeros(n, dtype=np.bool_)
        self._sigma = np.zeros(n)
        self._position, self._heading = plan.start.copy(), plan.heading.copy()
        self._broken = np.ones(n, dtype=np.bool_)  # how the contact just touched was come to
        self._start, self._depth = np.zeros((n, 2)), plan.level.copy()
        self._way, self._travel = np.zeros((n, 3)), np.zeros(n)
        self._clipped = np.zeros(n, dtype=np.bool_)
        self._wake()

    # -------------------------------------------------------------------------------------------------- asking

    @property
    def active(self) -> IntArray:
        """(k,) contours that :meth:`ask` has a move for."""
        return np.flatnonzero((self._status >= Status.SEARCHING) & (self._status <= Status.RETURNING))

    def ask(self) -> Move:
        """The next guarded move of every active contour."""
        w = self.active
        return Move(w, self._poses(w, self._start[w], self._depth[w]), self._way[w], self._travel[w])

    def clearance(self, which: IntArray) -> FloatArray:
        """(k,) m to release by before the next move."""
        return np.full(which.size, self._height)

    def withdrawal(self, which: IntArray) -> Move:
        """A move that draws the beams ``which`` out of the object's box along themselves, for after they are done."""
        depth = self._plan.level[which] - self._withdraw[which]
        pose = self._poses(which, self._position[which], depth)
        return Move(which, pose, -self._plan.direction[which], np.full(which.size, TRANSPORT_TRAVEL))

    def expected(self, which: IntArray) -> Expectation:
        """Prior for localising the contacts just touched: a parabola through them and the last two, if those count."""
        here, last, before = self._position[which] + self._offset[which], self._last[which], self._before[which]
        away = np.arctan2(-self._heading[which, 1], -self._heading[which, 0])
        fresh = self._broken[which] | (self._since[which] == 0)
        side = -0.5 * np.pi * self._sense[which]  # from tangent to outer normal
        d2 = np.maximum(np.linalg.norm(here - last, axis=1), 1e-9)
        d1 = np.maximum(np.linalg.norm(last - before, axis=1), 1e-9)
        chord = np.arctan2(*(here - last).T[::-1]) + side
        earlier = np.arctan2(*(last - before).T[::-1]) + side
        measured = np.arctan2(self._normal[which, 1], self._normal[which, 0])
        # The chord's normal is halfway between those of its ends; the turn per length of two chords gives the rest.
        mirrored = chord + wrap_angle(chord - measured)
        lean = d2 / (d1 + d2)
        parabola = chord + lean * wrap_angle(chord - earlier)
        both = self._since[which] > 1
        outward = np.where(both, parabola, mirrored)
        noise = self._touch_sigma * np.sqrt(((1.0 + lean) / d2) ** 2 + ((1.0 + lean) / d2 + lean / d1) ** 2 + (lean / d1) ** 2)
        # Where the curvature changes the two disagree beyond their noise. The change may have begun anywhere in the
        # last step; from its middle on the normal has turned more by five times the difference of the two.
        change = np.where(self._trusted[which], wrap_angle(parabola - mirrored), wrap_angle(chord - earlier))
        excess = np.sqrt(np.maximum(change**2 - noise**2 - self._sigma[which] ** 2, 0.0))
        alone = np.hypot(wrap_angle(chord - measured), self._sigma[which])
        sigma = np.hypot(noise, np.where(both, CHANGE_GAIN * excess, alone))
        # The approach says no more than the side, but that for sure.
        wild = np.abs(wrap_angle(outward - away)) > 0.45 * np.pi
        fresh |= wild
        return Expectation(
            wrap_angle(np.where(fresh, away, outward)),
            np.where(fresh, self._set.fresh_sigma, np.minimum(sigma, self._set.fresh_sigma)),
            fresh,
        )

    # ------------------------------------------------------------------------------------------------- telling

    def touched(self, reading: ApproachReading) -> IntArray:
        """Take note of where the approaches ended; rows of the reading to be localised now."""
        w = reading.which
        self._position[w] = self._in_plane(reading.pose, w)
        self._approaches[w] += 1
        status = self._status[w].copy()
        contact = reading.touched & (status != Status.RETURNING)
        flat = np.einsum("nj,njk->nk", reading.direction_world, self._axes[w])
        # A move to the start of a search may come along the beam: then the search's own heading is all there is.
        flat = np.where(np.linalg.norm(flat, axis=1, keepdims=True) > 0.1, flat, self._heading[w])
        self._heading[w[contact]] = unit(flat[contact])
        self._broken[w] = (self._stage[w] > 0) | (reading.outcome == Outcome.BLOCKED) | (status == Status.SEARCHING)
        self._drop_duplicates(w[contact & (status == Status.SEARCHING)])
        rows = np.flatnonzero(contact & (self._status[w] < Status.CLOSED))
        self._returned(w[status == Status.RETURNING], reading.outcome[status == Status.RETURNING])
        free = ~reading.touched & (status != Status.RETURNING)
        grazing = free & (reading.outcome == Outcome.TOUCHING) & (status == Status.FOLLOWING)
        self._raise(w[grazing])
        self._missed(w[free & ~grazing])
        self._aim(w[~contact])
        self._wake()
        return rows

    def tell(self, contacts: Contacts) -> None:
        """The contacts just localised, one row each."""
        w = contacts.which
        felt = (contacts.flags & Flag.LOST) == 0
        normal, trusted = self._steering(contacts)
        self._outlines.add(w, contacts.touch, normal, felt)
        self._unfelt(w[~felt])
        self._advance(w[felt], contacts.touch[felt], normal[felt], contacts.sigma_normal[felt], trusted[felt])
        self._aim(w)
        self._wake()

    def place(self, contacts: Contacts) -> Contacts:
        """``contacts`` with ``sequence``, so far the order of localising, as the place along each contour.

        Contours followed both ways from their first contact run from the end of the second way to that of the first.
        """
        return replace(contacts, sequence=self._outlines.place(contacts.which, contacts.sequence))

    def summary(self) -> Trace:
        """How the contours stand."""
        return Trace(
            status=self._status.copy(),
            contacts=self._outlines.count.copy(),
            approaches=self._approaches.copy(),
            reason=tuple(str(reason) for reason in self._reason),
        )

    # ------------------------------------------------------------------------------------------ after a contact

    def _steering(self, contacts: Contacts) -> tuple[FloatArray, BoolArray]:
        """Outer normals to go on from, and whether they were measured."""
        w = contacts.which
        measured = np.column_stack((np.cos(contacts.outward), np.sin(contacts.outward)))
        facing = -np.einsum("nk,nk->n", measured, self._heading[w])
        trusted = (contacts.flags == 0) & (contacts.sigma_normal < self._set.trusted_sigma) & (facing > -0.2)
        chord = contacts.touch - self._last[w]
        normal = -self._sense[w, None] * quarter_turn(unit(chord))
        usable = (self._outlines.felt[w] > 0) & (np.linalg.norm(chord, axis=1) > STANDSTILL * self._step[w])
        usable &= np.einsum("nk,nk->n", normal, self._heading[w]) < 0.2
        guess = np.where(usable[:, None], normal, -self._heading[w])
        return np.where(trusted[:, None], measured, guess), trusted

    def _advance(self, w: IntArray, touch: FloatArray, normal: FloatArray, sigma: FloatArray, trusted: BoolArray) -> None:
        """Go on from contacts ``touch`` (k, 2) with outer normals ``normal`` (k, 2)."""
        first = self._status[w] == Status.SEARCHING
        ahead = w[~first]
        if ahead.size:
            self._close(ahead, touch[~first], normal[~first])
            self._adapt(ahead, touch[~first], normal[~first], trusted[~first])
        begin = w[first]
        self._first[begin], self._first_normal[begin] = self._position[begin], normal[first]
        self._since[w] = np.where(self._broken[w], 1, self._since[w] + 1)
        self._before[w] = np.where(first[:, None], touch, self._last[w])
        self._last[w], self._normal[w], self._trusted[w] = touch, normal, trusted
        self._sigma[w] = sigma
        self._stand[w] = self._position[w]
        self._offset[w] = touch - self._position[w]
        self._stage[w] = 0
        self._shorter[w] = 0
        self._higher[w] = 0
        self._status[begin] = Status.FOLLOWING
        full = w[(self._outlines.count[w] >= self._limit[w]) & (self._status[w] == Status.FOLLOWING)]
        self._done(full, Status.LOST, "more contacts than the object's box explains")
        stuck = w[(self._stalls[w] > LARGEST_TRIES) & (self._status[w] == Status.FOLLOWING)]
        self._end_way(stuck, Status.LOST, "no progress")

    def _close(self, w: IntArray, touch: FloatArray, normal: FloatArray) -> None:
        """End contours whose last step passes the first contact, or for the second time in a row an earlier one."""
        first, other = self._outlines.passed(w, self._last[w], self._normal[w], touch, normal)
        self._done(w[first & ~self._reversed[w]], Status.CLOSED, "closed")
        self._meets[w] = np.where(other, self._meets[w] + 1, 0)
        met = w[(self._meets[w] > 1) & (self._status[w] == Status.FOLLOWING)]
        self._done(met[~self._reversed[met]], Status.CLOSED, "closed on a later contact")
        self._done(met[self._reversed[met]], Status.ENDED, "both ways met")

    def _adapt(self, w: IntArray, touch: FloatArray, normal: FloatArray, trusted: BoolArray) -> None:
        """The next step, from how much the normal turned over the last one."""
        chord = np.linalg.norm(touch - self._last[w], axis=1)
        cross = self._normal[w, 0] * normal[:, 1] - self._normal[w, 1] * normal[:, 0]
        turn = self._sense[w] * np.arctan2(cross, np.einsum("nk,nk->n", self._normal[w], normal))
        known = trusted & self._trusted[w] & (chord > STANDSTILL * self._step[w])
        self._bend[w] = np.where(known, turn / np.maximum(chord, 1e-9), 0.0)
        stalled = chord < STANDSTILL * self._step[w]
        self._stalls[w] = np.where(stalled, self._stalls[w] + 1, 0)
        bound = self._set.largest_turn / np.maximum(np.abs(self._bend[w]), 1e-9)
        step = np.minimum(self._set.growth * self._step[w], np.where(known, bound, self._plan.step))
        smallest = self._set.smallest_step * self._plan.step
        self._step[w] = np.clip(step, smallest, self._plan.step)

    # ---------------------------------------------------------------------------------------- without a contact

    def _missed(self, w: IntArray) -> None:
        """Nothing was touched: the next line, the next stage, or a shorter step."""
        search = w[self._status[w] == Status.SEARCHING]
        self._line[search] += 1
        follow = w[self._status[w] == Status.FOLLOWING]
        clipped = self._clipped[follow]
        self._end_way(follow[clipped], Status.ENDED, "the gantry's reach ends")
        follow = follow[~clipped]
        last = self._stage[follow] >= 2
        self._stage[follow[~last]] += 1
        again = follow[last]
        self._stage[again] = 0
        self._shorter[again] += 1
        self._step[again] *= SHORTER
        short = self._step[again] < SHORTER * self._set.smallest_step * self._plan.step
        self._end_way(again[short | (self._shorter[again] > LARGEST_TRIES)], Status.LOST, "the outline was lost")

    def _unfelt(self, w: IntArray) -> None:
        """A touch that no push could feel: go on searching, or come down again a little nearer."""
        self._line[w[self._status[w] == Status.SEARCHING]] += 1
        follow = w[self._status[w] == Status.FOLLOWING]
        self._stage[follow] = 0
        self._shorter[follow] += 1
        self._step[follow] *= 0.7
        self._end_way(follow[self._shorter[follow] > LARGEST_TRIES], Status.LOST, "touches that no push could feel")

    def _raise(self, w: IntArray) -> None:
        """Touching already at a start: the next one lies higher and nearer."""
        self._higher[w] += 1
        self._stage[w] = 0
        self._step[w] = np.maximum(0.5 * self._step[w], self._set.smallest_step * self._plan.step)
        self._end_way(w[self._higher[w] > LARGEST_TRIES], Status.LOST, "always in touch at the start of an approach")

    def _end_way(self, w: IntArray, status: Status, reason: str) -> None:
        """One way along the outline is over: try the other one from the first contact, or be done."""
        self._final[w] = np.maximum(self._final[w], status)
        over = w[self._reversed[w]]
        self._done(over, self._final[over], reason)
        back = w[~self._reversed[w]]
        self._reason[back] = reason
        self._reversed[back] = True
        self._outlines.turn_round(back)
        self._sense[back] *= -1.0
        self._status[back] = Status.RETURNING
        self._leg[back] = _Leg.LIFT
        self._stage[back] = 0
        self._shorter[back] = 0
        self._higher[back] = 0
        self._stalls[back] = 0
        self._meets[back] = 0

    def _done(self, w: IntArray, status: Status | NDArray[np.int8], reason: str) -> None:
        self._status[w] = status
        said = np.array([f"{old}; {reason}" if old and old != reason else reason for old in self._reason[w]], dtype=object)
        self._reason[w] = said

    def _returned(self, w: IntArray, outcome: NDArray[np.int8]) -> None:
        """A move of a return is over."""
        stopped = (outcome == Outcome.BLOCKED) | (outcome == Outcome.TOUCHING)
        self._done(w[stopped], self._final[w[stopped]], "something stood in the way back")
        w = w[~stopped]
        self._leg[w] += 1
        self._begin_again(w[self._leg[w] > _Leg.DOWN])

    def _begin_again(self, w: IntArray) -> None:
        """Follow from the first contact."""
        first, first_normal = self._outlines.first(w)
        self._status[w] = Status.FOLLOWING
        self._stand[w] = self._first[w]
        self._last[w] = self._before[w] = first
        self._normal[w] = first_normal
        self._offset[w] = first - self._first[w]
        self._since[w] = 1
        self._bend[w] = 0.0
        self._step[w] = self._plan.step

    def _drop_duplicates(self, w: IntArray) -> None:
        """Contours whose first touch lies on a finished outline of their plane are done."""
        if not w.size:
            return
        done = np.flatnonzero((self._status >= Status.CLOSED) & (self._outlines.count > 1))
        i, j = np.nonzero(self._plan.plane[w][:, None] == self._plan.plane[done])
        if i.size:
            on = self._outlines.lies_on(self._position[w[i]], done[j], self._status[done[j]] == Status.CLOSED)
            self._done(w[np.unique(i[on])], Status.DUPLICATE, "on an outline followed before")

    # ---------------------------------------------------------------------------------------------- next moves

    def _wake(self) -> None:
        """Begin contours that waited for others of their plane."""
        waiting = np.flatnonzero(self._status == Status.WAITING)
        if waiting.size:
            busy = self._plan.plane[self.active]
            _, lowest = np.unique(self._plan.plane[waiting], return_index=True)
            begin = waiting[lowest]
            begin = begin[~np.isin(self._plan.plane[begin], busy)]
            self._status[begin] = Status.SEARCHING
            self._aim(begin)

    def _aim(self, w: IntArray) -> None:
        """Set the next move of the contours ``w``; those that have none within reach go on to what comes then."""
        follow = w[self._status[w] == Status.FOLLOWING]
        if follow.size:
            self._aim_following(follow)
        self._aim_searching(w[self._status[w] == Status.SEARCHING])
        self._aim_returning(w[self._status[w] == Status.RETURNING])
        again = w[(self._status[w] == Status.FOLLOWING) & ~np.isin(w, follow)]
        if again.size:
            self._aim(again)

    def _aim_following(self, w: IntArray) -> None:
        step, stage, normal = self._step[w], self._stage[w], self._normal[w]
        tangent = self._sense[w, None] * quarter_turn(normal)
        drop = 0.5 * self._bend[w] * step**2
        # A concave outline rises towards the beam: start above it.
        height = self._height * 2.0 ** self._higher[w] + np.clip(-drop, 0.0, step)
        depth = self._set.depth * step
        fore = self._stand[w] + height[:, None] * normal + step[:, None] * tangent
        zero = (stage == 0)[:, None]
        one = (stage == 1)[:, None]
        start = np.where(zero, fore, self._position[w])
        heading = np.where(zero, -normal, np.where(one, -tangent, normal))
        travel = np.select([stage == 0, stage == 1], [height + depth, 1.6 * step + self._height], depth + self._height)
        slack, room = self._room(w, start, heading)
        self._put(w, start, heading, np.minimum(travel, np.maximum(room, TRANSPORT_TRAVEL)))
        self._clipped[w] = room < travel
        # A start out of reach, or one without room to come down to the surface, ends the way.
        barred = (slack < 0.0) | ((stage == 0) & (room < height))
        self._end_way(w[barred], Status.ENDED, "the gantry's reach ends")

    def _aim_searching(self, w: IntArray) -> None:
        plan = self._plan
        while w.size:
            gone = self._line[w] >= len(SEARCH_LINES)
            self._done(w[gone], Status.LOST, "no contact")
            w = w[~gone]
            line = self._line[w]
            # Every other line is run the other way, so that moves between them pass beside the box.
            there = line % 2 == 1
            heading = plan.heading[w]
            offset = np.array(SEARCH_LINES)[line] * plan.width[w]
            start = plan.start[w] + offset[:, None] * quarter_turn(heading)
            start = np.where(there[:, None], start + plan.travel[w, None] * heading, start)
            heading = np.where(there[:, None], -heading, heading)
            slack, room = self._room(w, start, heading)
            self._put(w, start, heading, np.minimum(plan.travel[w], np.maximum(room, TRANSPORT_TRAVEL)))
            self._heading[w] = heading
            w = w[(slack < 0.0) | (room <= 0.0)]
            self._line[w] += 1

    def _aim_returning(self, w: IntArray) -> None:
        """Out along the beam, over to the first contact, in along the beam; straight where there is no room for it."""
        above = self._first[w] + self._height * self._first_normal[w]
        level = self._plan.level[w]
        high = level - self._withdraw[w]
        lift, down = self._leg[w] == _Leg.LIFT, self._leg[w] == _Leg.DOWN
        start = np.where(lift[:, None], self._position[w], above)
        base = self._base(w, start, high)
        fits = ((base >= self._plan.reach.lower[:3]) & (base <= self._plan.reach.upper[:3])).all(axis=1)
        self._put(w, start, self._first_normal[w], np.full(w.size, TRANSPORT_TRAVEL))
        self._depth[w] = np.where(down, level, high)
        self._way[w] = np.where(down[:, None], self._way[w], -self._plan.direction[w])
        self._begin_again(w[lift & ~fits])

    def _put(self, w: IntArray, start: FloatArray, heading: FloatArray, travel: FloatArray) -> None:
        self._start[w], self._travel[w], self._depth[w] = start, travel, self._plan.level[w]
        self._way[w] = np.einsum("njk,nk->nj", self._axes[w], heading)

    def _room(self, w: IntArray, start: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far inside the reach ``start`` lies (negative: outside), and how far one can go along ``heading`` [m]."""
        slack = self._b[w] - np.einsum("nck,nk->nc", self._a[w], start)
        rate = np.einsum("nck,nk->nc", self._a[w], heading)
        ahead = rate > 1e-12
        return slack.min(axis=1), np.where(ahead, slack / np.where(ahead, rate, 1.0), np.inf).min(axis=1)

    def _base(self, w: IntArray, u: FloatArray, depth: FloatArray) -> FloatArray:
        """(k, 3) m, base position in the base frame."""
        world = np.einsum("njk,nk->nj", self._axes[w], u) + depth[:, None] * self._plan.direction[w]
        return np.asarray((world - self._mount.origin) @ self._mount.rotation)

    def _poses(self, w: IntArray, u: FloatArray, depth: FloatArray) -> FloatArray:
        return np.column_stack((self._base(w, u, depth), self._joints[w]))

    def _in_plane(self, pose: FloatArray, w: IntArray) -> FloatArray:
        return np.einsum("nj,njk->nk", self._mount.position_world(pose), self._axes[w])
