"""Following contours: where to touch next.

:class:`Tracer` follows all contours of a plan in lockstep and knows only what was touched. In Pi everything
is plane geometry: the beam is a point, dilated by its radius; at a contact with outer normal n the contour
goes on along the tangent t = sense (n turned by +90 deg). As in Fig. 15 of Kaneko1998 each new contact is
approached along the last inner normal: from the start u + h n + D t, h the clearance and D the step, towards
-n. Then

- found: localise, and go on from there, with a shorter step where the normal turns much over the last one;
- nothing there (a convex corner): walk round it, along -t beneath the last contact, then along +n behind it,
which
  also goes round the end of a thin fin; still nothing: again with a third of the step, then the way is lost;
- touched on the way to the start (a concave corner): that is the contact;
- out of the gantry's reach: the way ends there. The other way from the first contact is tried then, reached
by
  withdrawing the beam along itself until it is clear of the object's box.

A contour is closed when a step passes the first contact, or, two steps in a row, earlier ones.
"""

from __future__ import annotations

from dataclasses import replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag
from contour.frames import Mount, wrap_angle
from contour.instrument import ApproachReading, Outcome
from contour.outline import Outlines, predicted_normal, quarter_turn, unit
from contour.plan import Plan
from contour.planes import SensingPlanes
from contour.trace import Expectation, Move, Status, Trace, TraceSettings

__all__ = ["Expectation", "Move", "Status", "Trace", "TraceSettings", "Tracer"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class _Leg(IntEnum):
    """Moves of a return."""

    LIFT = 0
    OVER = 1
    DOWN = 2


SEARCH_LINES = (0.0, 0.24, -0.24, 0.48, -0.48, 0.72, -0.72, 0.96, -0.96)
"""Offsets of the lines of first contact, as shares of half the box's width."""
OPPOSITE = float(np.deg2rad(110.0))
"""Surfaces whose normals differ by more face each other across a gap [rad]."""
CORNER_STEP = 0.3
"""Step after a first contact, and shortest step after one beyond a corner, as share of the plan's step."""
SHORTER = 1.0 / 3.0
"""A step is tried again this much shorter when walking round found nothing."""
LARGEST_TRIES = 3
"""Shorter steps, higher starts or steps on the spot in a row, before a way is given up."""
STANDSTILL = 0.1
"""A step that gets on by less than this share of its length has made no progress."""
TRANSPORT_TRAVEL = 1e-4
"""Guarded end of a move that is only there to get somewhere [m]."""
TOUCH_SHARE = 0.25
"""Spread of where a touch is declared, as share of the bending at the touch moment at the beam's end."""


class Tracer:
    """Ask and tell for all contours of ``plan``: contour i is followed with antenna i.

    One round: ``move = ask()``, the instrument's ``approach``, ``rows = touched(reading)``, localise those
    rows with :meth:`expected` as prior, ``tell(contacts)``, and the instrument's ``release`` by
    :meth:`clearance`; until ``active`` is empty. Rows of a reading that are not localised need no release:
    they stand free or are done.
    """

    def __init__(
        self, plan: Plan, mount: Mount, antenna: Antenna, settings: TraceSettings | None = None
    ) -> None:
        self._plan = plan
        self._set = TraceSettings() if settings is None else settings
        n = plan.contours
        self._planes = SensingPlanes(plan, mount, antenna.beam.length)
        beam = antenna.beam
        self._touch_sigma = TOUCH_SHARE * antenna.sensor.touch_moment * beam.length**2 / antenna.stiffness3
        self._highest = max(self._set.clearance * plan.step, 4.0 * beam.radius)
        self._height = np.full(n, self._highest)
        self._run = np.zeros(n)  # [m] of the motion that touched
        self._withdraw = np.maximum(plan.level + beam.length - plan.near + self._highest, 0.0)
        self._limit = np.ceil(12.0 + self._set.turns * plan.perimeter / plan.step).astype(np.int64)
        self._outlines = Outlines(n)
        self._status = np.full(n, Status.WAITING, dtype=np.int8)
        self._final = np.full(n, Status.ENDED, dtype=np.int8)  # what it will be when both ways are done
        self._reason = np.full(n, "", dtype=object)
        self._approaches = np.zeros(n, dtype=np.int64)
        self._line = np.zeros(n, dtype=np.int64)
        self._stage = np.zeros(n, dtype=np.int64)
        self._leg = np.zeros(n, dtype=np.int64)
        self._shorter, self._higher, self._stalls, self._meets = (
            np.zeros(n, dtype=np.int64) for _ in range(4)
        )
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

    # ------------------------------------------------------------------------------------------------- asking

    @property
    def active(self) -> IntArray:
        """(k,) contours that :meth:`ask` has a move for."""
        return np.flatnonzero((self._status >= Status.SEARCHING) & (self._status <= Status.RETURNING))

    def ask(self) -> Move:
        """The next guarded move of every active contour."""
        w = self.active
        return Move(w, self._planes.poses(w, self._start[w], self._depth[w]), self._way[w], self._travel[w])

    def clearance(self, which: IntArray) -> FloatArray:
        """(k,) m to release by before the next move: never past where the motion that touched began."""
        return np.asarray(np.minimum(self._height[which], self._run[which]))

    def expected(self, which: IntArray) -> Expectation:
        """Prior for localising the contacts just touched: a parabola through them and the last two, if those
        count.
        """
        here = self._position[which] + self._offset[which]
        away = np.arctan2(-self._heading[which, 1], -self._heading[which, 0])
        outward, sigma = predicted_normal(
            here,
            self._last[which],
            self._before[which],
            np.arctan2(self._normal[which, 1], self._normal[which, 0]),
            np.where(self._trusted[which], self._sigma[which], np.inf),
            sense=self._sense[which],
            three=self._since[which] > 1,
            touch_sigma=self._touch_sigma,
        )
        fresh = self._broken[which] | (self._since[which] == 0)
        # The approach says no more than the side, but that for sure.
        wild = np.abs(wrap_angle(outward - away)) > 0.45 * np.pi
        fresh |= wild
        return Expectation(
            wrap_angle(np.where(fresh, away, outward)),
            np.where(fresh, self._set.fresh_sigma, np.minimum(sigma, self._set.fresh_sigma)),
            fresh,
        )

    # ------------------------------------------------------------------------------------------------ telling

    def touched(self, reading: ApproachReading) -> IntArray:
        """Take note of where the approaches ended; rows of the reading to be localised now."""
        w = reading.which
        self._position[w] = self._planes.in_plane(reading.pose, w)
        self._run[w] = reading.travel
        self._approaches[w] += 1
        status = self._status[w].copy()
        contact = reading.touched & (status != Status.RETURNING)
        flat = self._planes.flat(reading.direction_world, w)
        # A move to the start of a search may come along the beam: then the search's own heading is all there
        # is.
        flat = np.where(np.linalg.norm(flat, axis=1, keepdims=True) > 0.1, flat, self._heading[w])
        self._heading[w[contact]] = unit(flat[contact])
        self._broken[w] = (
            (self._stage[w] > 0) | (reading.outcome == Outcome.BLOCKED) | (status == Status.SEARCHING)
        )
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

        Contours followed both ways from their first contact run from the end of the second way to that of the
        first.
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

    # ---------------------------------------------------------------------------------------- after a contact

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

    def _advance(
        self, w: IntArray, touch: FloatArray, normal: FloatArray, sigma: FloatArray, trusted: BoolArray
    ) -> None:
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
        # Nothing is known of the curvature yet: begin with a short step.
        self._step[begin] = CORNER_STEP * self._plan.step
        full = w[(self._outlines.count[w] >= self._limit[w]) & (self._status[w] == Status.FOLLOWING)]
        self._done(full, Status.LOST, "more contacts than the object's box explains")
        stuck = w[(self._stalls[w] > LARGEST_TRIES) & (self._status[w] == Status.FOLLOWING)]
        self._end_way(stuck, Status.LOST, "no progress")

    def _close(self, w: IntArray, touch: FloatArray, normal: FloatArray) -> None:
        """End contours whose last step passes the first contact, or for the second time in a row an earlier
        one.
        """
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
        growth = np.where(stalled, 1.0, self._set.growth)
        step = np.minimum(growth * self._step[w], np.where(known, bound, self._plan.step))
        # Round a corner the turn lies behind, not ahead: no need to creep on after it.
        behind = np.minimum(CORNER_STEP * self._plan.step, 0.5 * chord)
        smallest = np.maximum(
            self._set.smallest_step * self._plan.step, np.where(self._broken[w], behind, 0.0)
        )
        step = np.clip(step, smallest, self._plan.step)
        # A wall opposite to the last one: the gap between them must hold the clearance, and may widen slowly.
        opposite = self._broken[w] & (self._stage[w] == 0) & (np.abs(turn) > OPPOSITE)
        gap = np.abs(np.einsum("nk,nk->n", touch - self._last[w], normal))
        height = np.minimum(self._set.growth * self._height[w], self._highest)
        self._height[w] = np.where(
            opposite,
            np.minimum(np.maximum(self._set.clearance * gap, 4.0 * self._touch_sigma), height),
            height,
        )
        self._step[w] = np.where(opposite, np.minimum(step, np.maximum(2.0 * gap, smallest)), step)

    # -------------------------------------------------------------------------------------- without a contact

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
        self._end_way(
            again[short | (self._shorter[again] > LARGEST_TRIES)], Status.LOST, "the outline was lost"
        )

    def _unfelt(self, w: IntArray) -> None:
        """A touch that no push could feel: go on searching, or come down again a little nearer."""
        self._line[w[self._status[w] == Status.SEARCHING]] += 1
        follow = w[self._status[w] == Status.FOLLOWING]
        self._stage[follow] = 0
        self._shorter[follow] += 1
        self._step[follow] *= 0.7
        self._end_way(
            follow[self._shorter[follow] > LARGEST_TRIES], Status.LOST, "touches that no push could feel"
        )

    def _raise(self, w: IntArray) -> None:
        """Touching already at a start: the next one lies higher and nearer."""
        self._higher[w] += 1
        self._stage[w] = 0
        self._step[w] = np.maximum(0.5 * self._step[w], self._set.smallest_step * self._plan.step)
        self._end_way(
            w[self._higher[w] > LARGEST_TRIES], Status.LOST, "always in touch at the start of an approach"
        )

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
        said = np.array(
            [f"{old}; {reason}" if old and old != reason else reason for old in self._reason[w]], dtype=object
        )
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
        self._step[w] = CORNER_STEP * self._plan.step

    def _drop_duplicates(self, w: IntArray) -> None:
        """Contours whose first touch lies on a finished outline of their plane are done."""
        if not w.size:
            return
        done = np.flatnonzero((self._status >= Status.CLOSED) & (self._outlines.count > 1))
        i, j = np.nonzero(self._plan.plane[w][:, None] == self._plan.plane[done])
        if i.size:
            on = self._outlines.lies_on(self._position[w[i]], done[j], self._status[done[j]] == Status.CLOSED)
            self._done(w[np.unique(i[on])], Status.DUPLICATE, "on an outline followed before")

    # --------------------------------------------------------------------------------------------- next moves

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
        """Set the next move of the contours ``w``; those that have none within reach go on to what comes
        then.
        """
        for status, aim in (
            (Status.SEARCHING, self._aim_searching),
            (Status.FOLLOWING, self._aim_following),
            (Status.RETURNING, self._aim_returning),  # last: a way that ends within reach begins the way back
        ):
            rows = w[self._status[w] == status]
            if rows.size:
                aim(rows)

    def _aim_following(self, w: IntArray) -> None:
        step, stage, normal = self._step[w], self._stage[w], self._normal[w]
        tangent = self._sense[w, None] * quarter_turn(normal)
        drop = 0.5 * self._bend[w] * step**2
        # A concave outline rises towards the beam: start above it.
        clear = self._height[w]
        height = clear * 2.0 ** self._higher[w] + np.clip(-drop, 0.0, step)
        depth = self._set.depth * step
        fore = self._stand[w] + height[:, None] * normal + step[:, None] * tangent
        zero = (stage == 0)[:, None]
        one = (stage == 1)[:, None]
        start = np.where(zero, fore, self._position[w])
        heading = np.where(zero, -normal, np.where(one, -tangent, normal))
        travel = np.select([stage == 0, stage == 1], [height + depth, 1.25 * step], depth + clear)
        slack, room = self._planes.room(w, start, heading)
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
            slack, room = self._planes.room(w, start, heading)
            self._put(w, start, heading, np.minimum(plan.travel[w], np.maximum(room, TRANSPORT_TRAVEL)))
            self._heading[w] = heading
            w = w[(slack < 0.0) | (room <= 0.0)]
            self._line[w] += 1

    def _aim_returning(self, w: IntArray) -> None:
        """Out along the beam, over to the first contact, in along the beam."""
        above = self._first[w] + self._highest * self._first_normal[w]
        level = self._plan.level[w]
        high = level - self._withdraw[w]
        lift, down = self._leg[w] == _Leg.LIFT, self._leg[w] == _Leg.DOWN
        start = np.where(lift[:, None], self._position[w], above)
        fits = self._planes.reachable(w, start, high)
        self._put(w, start, self._first_normal[w], np.full(w.size, TRANSPORT_TRAVEL))
        self._depth[w] = np.where(down, level, high)
        self._way[w] = np.where(down[:, None], self._way[w], -self._plan.direction[w])
        cramped = w[lift & ~fits]
        self._done(cramped, self._final[cramped], "no room to withdraw the beam and go the other way")

    def _put(self, w: IntArray, start: FloatArray, heading: FloatArray, travel: FloatArray) -> None:
        self._start[w], self._travel[w], self._depth[w] = start, travel, self._plan.level[w]
        self._way[w] = self._planes.world(heading, w)
