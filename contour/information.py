"""What pushes tell: their bins as data, the forward model of them with its derivatives, and the information they hold.

State of a contact, with what it is a nuisance for:

    x = (ln s, nu, ln tan alpha, R/s, s/R_l)

nu the inner normal's angle in Pi, R along the beam, R_l across; of a tip tan(tilt) stands in the place of R/s. The
forward model is the reduced rod of :mod:`contour.contact`, followed through both strokes. What belongs to a single push
is eliminated from its bins before they are put together: offset and drift of both moment axes, the residual depth of
the touch, and the model's own error (a bias of the force's direction on each stroke, the shape of the moment's growth,
a curvature that changes along the slide).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contact import push_cycle_mixed
from contour.sensing import BACK_RANGE, OUT_RANGE, Bins, Touch

__all__ = [
    "BEND",
    "LN_S",
    "LN_TAN_ALPHA",
    "NU",
    "PARAMETERS",
    "R_ALONG",
    "ModelError",
    "PushData",
    "Reply",
    "bare",
    "linearised",
    "normal_equations",
    "prepare",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LN_S, NU, LN_TAN_ALPHA, R_ALONG, BEND = range(5)
PARAMETERS = 5
"""Of the state x = (ln s, nu, ln tan alpha, R/s, s/R_l)."""

_STEP = np.array([0.0, 2e-4, 2e-3, 2e-3, 1e-2])
"""Differences for the derivatives; the moment follows ln s exactly and needs none."""
_VARIED = (NU, LN_TAN_ALPHA, R_ALONG, BEND)
STEPS = 8
"""No step along a push is longer than this part of it."""
GAUSS = 0.5 / np.sqrt(3.0) * np.array([-1.0, 1.0])
"""Where to evaluate the mean over a bin, in widths of it from its middle: exact for a force cubic in the angle."""
NUISANCES = 9
"""Unknowns that belong to one push: two offsets, two drifts, the depth of touch, two biases of direction, a gain, how
the curvature changes along the slide.
"""
UNSEEN_TILT = 0.2
"""Squared tangent of a tip's tilt that may always be there: pushes hardly tell it."""
NO_GAIN = 1e-9
"""Standard deviation that stands for none."""
DEPTH_SIGMA = 6e-6
"""How far from the edge of touch the machine may stand where no moment tells: its last step back [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelError:
    """Standard deviations of the forward model's own error, and of the instrument's slow ones.

    Direction and moment of the reduced rod against the exact one, binned, on both strokes. Chosen so that intervals
    cover as they claim on readings of the exact rod at the default noise (``tests/test_fit.py``); at a tenth of that
    noise they are too small for pushes outside the cone.
    """

    direction_bias: float = float(np.deg2rad(0.015))
    """Of the force's direction, one value a stroke [rad]."""
    direction_bin: float = float(np.deg2rad(0.02))
    """Of the force's direction, each bin on its own [rad]."""
    gain: float = 1.5e-4
    """Of the moment, one value a push, relative; it cannot be told from s."""
    gain_outside: float = 5e-4
    """More of it per squared tangent of the angle between push and normal beyond the friction cone."""
    tip_direction: float = float(np.deg2rad(0.03))
    """Of the force's direction at the tip, one value a stroke and one a bin, per squared tangent of the tilt [rad]."""
    tip_gain: float = 1.5e-4
    """Of the moment of a touch with the tip, one value a push, relative."""
    tip_gain_tilt: float = 2e-4
    """More of it per squared tangent of the tilt."""
    bending: float = 1.5
    """Of the curvature's change along the slide, per curvature squared: an ellipse's between its vertices."""
    bending_at_least: float = 5.0
    """Curvature that this always counts with [1/m]."""
    bending_rest: float = 0.3
    """Of the normal's turn by it, each bin on its own, relative."""
    moment_bin: float = 8e-5
    """Of the moment, each bin on its own, relative to the peak."""


def _forward(
    x: FloatArray, phi: FloatArray, path: FloatArray, tip: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Moment angle, direction psi and slide over s along ``path`` for states ``x``; all (p, k). A negative R counts as
    none.
    """
    bend = x[:, BEND]
    across = np.where(np.abs(bend) > 1e-6, 1.0 / np.where(np.abs(bend) > 1e-6, bend, 1.0), np.inf)
    cycle = push_cycle_mixed(
        phi - x[:, NU],
        path,
        distance=1.0,
        friction=np.exp(x[:, LN_TAN_ALPHA]),
        radius_along=np.maximum(x[:, R_ALONG], 0.0),
        radius_across=across,
        tilt=np.arctan(x[:, R_ALONG]),
        tip=tip,
        steps=STEPS,
    )
    return cycle.moment_angle, phi[:, None] - cycle.delta, cycle.slide


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushData:
    """The bins of P pushes, ready to be fitted, and what is known of the nuisances that belong to each push."""

    phi: FloatArray
    """(P,) rad"""
    path: FloatArray
    """(P, 4B + 1) rad, two angles for the mean over each bin, and the turning point between the strokes."""
    force: FloatArray
    """(P, 2B, 2) N m"""
    count: FloatArray
    """(P, 2B) samples"""
    time: FloatArray
    """(P, 2B) s since the tare."""
    gravity: FloatArray
    """(P, 2B, 2) N/m, change of the weight per length in Pi since touch."""
    depth: FloatArray
    """(P,) m, depth of the beam at rest at touch, along the push."""
    depth_sigma: FloatArray
    """(P,) m"""
    tare_sigma: FloatArray
    """(P,) N m"""
    tip: BoolArray
    """(P,) whether the push is taken to be one with the tip; its state has tan(tilt) in the place of R/s."""
    contact: IntArray
    """(P,) contact that each push belongs to."""

    def take(self, rows: IntArray, contact: IntArray) -> PushData:
        """The pushes ``rows``, with new contact numbers."""
        taken = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "contact"}
        return PushData(**taken, contact=contact)

    @staticmethod
    def concatenate(parts: list[PushData]) -> PushData:
        """All pushes of ``parts``."""
        if len(parts) == 1:
            return parts[0]
        return PushData(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(PushData)}
        )


class Reply(NamedTuple):
    """What P pushes are answered with."""

    force: FloatArray
    """(P, 2B, 2) N m, mean over each bin."""
    slide: FloatArray
    """(P, 2B) mean slide over each bin, in s."""
    derivative: FloatArray
    """(P, 2B, 2, m) of the force."""


def _response(data: PushData, x: FloatArray, antenna: Antenna) -> tuple[FloatArray, FloatArray]:
    """Mean force over each bin, (v, P, 2B, 2) N m, for v variants of the states (v, P, 5), and the slide of the first
    variant, (P, 2B) in s.
    """
    variants, pushes, _ = x.shape
    nodes = data.path.shape[1]
    distance = np.exp(x[..., LN_S])
    path = np.maximum(data.path[None] + (data.depth[None] / distance)[..., None], 0.0)
    tip = np.tile(data.tip, variants)
    moment, psi, slide = _forward(
        x.reshape(-1, PARAMETERS), np.tile(data.phi, variants), path.reshape(-1, nodes), tip
    )
    force = moment[..., None] * np.stack((np.cos(psi), np.sin(psi)), axis=-1)
    keep = np.arange(nodes) != nodes // 2
    force = force[:, keep].reshape(variants, pushes, -1, len(GAUSS), 2).mean(axis=3)
    slide = slide[:pushes, keep].reshape(pushes, -1, len(GAUSS)).mean(axis=2)
    return np.asarray((antenna.stiffness3 / distance)[..., None, None] * force), slide


def bare(data: PushData, x: FloatArray, antenna: Antenna) -> Reply:
    """Without derivatives."""
    force, slide = _response(data, x[None], antenna)
    return Reply(force[0], slide, np.zeros((*force.shape[1:], 0)))


def linearised(data: PushData, x: FloatArray, antenna: Antenna) -> Reply:
    """With the derivatives along the state; a negative R (concave along the beam, or the noise of an edge) is continued
    from R = 0.
    """
    clipped = x.copy()
    clipped[:, R_ALONG] = np.where(data.tip, x[:, R_ALONG], np.maximum(x[:, R_ALONG], 0.0))
    stack = np.repeat(clipped[None], len(_VARIED) + 1, axis=0)
    for i, parameter in enumerate(_VARIED):
        stack[i + 1, :, parameter] += _STEP[parameter]
    force, slide = _response(data, stack, antenna)
    derivative = np.empty((*force.shape[1:], PARAMETERS))
    derivative[..., LN_S] = -force[0]
    for i, parameter in enumerate(_VARIED):
        derivative[..., parameter] = (force[i + 1] - force[0]) / _STEP[parameter]
    beyond = np.where(data.tip, 0.0, np.minimum(x[:, R_ALONG], 0.0))
    return Reply(force[0] + beyond[:, None, None] * derivative[..., R_ALONG], slide, derivative)


def _held_weight(data: PushData, distance: FloatArray, unit: FloatArray, antenna: Antenna) -> FloatArray:
    """(P, 2B, 2) N m: the support carries part of the weight, and its reaction changes as the beam turns in gravity."""
    length = antenna.beam.length
    lever = (6.0 * length**2 - 4.0 * length * distance + distance**2) / 8.0
    return np.asarray((-lever[:, None] * np.sum(data.gravity * unit, axis=-1))[..., None] * unit)


def normal_equations(
    data: PushData, x: FloatArray, reply: Reply, antenna: Antenna, error: ModelError
) -> FloatArray:
    """Information with everything that belongs to one push eliminated: (P, m + 1, m + 1), the last row for the
    residual.
    """
    bare_force, derivative = reply.force, reply.derivative
    pushes, bins, _ = bare_force.shape
    distance = np.exp(x[:, LN_S])
    moment = np.maximum(np.linalg.norm(bare_force, axis=-1), NO_GAIN)
    unit = bare_force / moment[..., None]
    force = bare_force + _held_weight(data, distance, unit, antenna)
    aside = np.stack((-unit[..., 1], unit[..., 0]), axis=-1)
    peak = moment.max(axis=1, keepdims=True)
    used = data.count > 0.0
    noise = antenna.sensor.moment_noise**2 / np.maximum(data.count, 1.0)
    along = noise + (error.moment_bin * peak) ** 2
    tilt = np.where(data.tip, x[:, R_ALONG] ** 2 + UNSEEN_TILT, 0.0)
    astray = np.hypot(error.direction_bin, error.tip_direction * tilt)
    # The curvature is that at touch; as the contact slides the normal turns a little otherwise.
    bent = error.bending * (np.abs(x[:, BEND]) + distance * error.bending_at_least) ** 2
    turned_by = bent[:, None] * reply.slide**2
    across = noise + (astray[:, None] * moment) ** 2 + (error.bending_rest * turned_by * moment) ** 2
    weight = np.where(
        used[..., None], 1.0 / np.stack((along, across), axis=-1), 0.0
    )  # in the frame (unit, aside)

    def turned(vector: FloatArray) -> FloatArray:
        """(P, 2B, 2, ...) from axes x, z to (unit, aside)."""
        a, b = vector[:, :, 0], vector[:, :, 1]
        extra = (1,) * (vector.ndim - 3)
        u, v = unit.reshape(*unit.shape, *extra), aside.reshape(*aside.shape, *extra)
        return np.stack((u[:, :, 0] * a + u[:, :, 1] * b, v[:, :, 0] * a + v[:, :, 1] * b), axis=2)

    back = np.arange(bins) >= bins // 2
    nuisance = np.zeros((pushes, bins, 2, NUISANCES))
    nuisance[:, :, 0, 0], nuisance[:, :, 1, 0] = unit[..., 0], aside[..., 0]
    nuisance[:, :, 0, 1], nuisance[:, :, 1, 1] = unit[..., 1], aside[..., 1]
    nuisance[..., 2:4] = nuisance[..., 0:2] * data.time[:, :, None, None]
    nuisance[:, :, 0, 4] = (antenna.stiffness3 / distance**2)[:, None]  # moment per depth of touch
    nuisance[:, :, 1, 5] = np.where(back, 0.0, moment)
    nuisance[:, :, 1, 6] = np.where(back, moment, 0.0)
    nuisance[:, :, 0, 7] = moment
    nuisance[:, :, 1, 8] = 0.5 * turned_by * moment
    spread = np.empty((pushes, NUISANCES))
    spread[:, 0:2] = data.tare_sigma[:, None] ** 2
    spread[:, 2:4] = max(antenna.sensor.moment_drift, 1e-9) ** 2
    spread[:, 4] = data.depth_sigma**2
    spread[:, 5:7] = (error.direction_bias**2 + (error.tip_direction * tilt) ** 2)[:, None]
    # Of side contacts the gain cannot be told from s; it is put to the distance's sigma in the end.
    tip_gain = error.tip_gain + error.tip_gain_tilt * tilt
    spread[:, 7] = np.where(data.tip, tip_gain, NO_GAIN) ** 2
    spread[:, 8] = 1.0
    columns = np.concatenate((turned(derivative), turned(data.force - force)[..., None]), axis=3)
    columns = columns.reshape(pushes, 2 * bins, derivative.shape[3] + 1)
    removed = nuisance.reshape(pushes, 2 * bins, NUISANCES)
    w = weight.reshape(pushes, 2 * bins, 1)
    weighted = (w * removed).transpose(0, 2, 1)
    inner = weighted @ removed + np.eye(NUISANCES) / spread[:, :, None]
    cross = weighted @ columns
    information = (w * columns).transpose(0, 2, 1) @ columns - cross.transpose(0, 2, 1) @ np.linalg.solve(
        inner, cross
    )
    return np.asarray(information, dtype=np.float64)


def prepare(bins: Bins, touch: Touch, distance: FloatArray, contact: IntArray, antenna: Antenna) -> PushData:
    """Bins of P pushes from ``touch`` (P rows) as data; ``distance`` (P,) m is a first guess of s.

    The moment at rest tells how deep the beam stands; without one it may also stand a little clear of the body.
    """
    half = bins.theta.shape[1] // 2
    slots = (np.arange(half) + 0.5) / half
    out = OUT_RANGE[0] + (OUT_RANGE[1] - OUT_RANGE[0]) * slots
    back = BACK_RANGE[0] + (BACK_RANGE[1] - BACK_RANGE[0]) * slots[::-1]
    middle = np.concatenate((out, back)) * bins.peak[:, None]
    theta = np.where(bins.count > 0.0, bins.theta, middle)
    spread = np.array([OUT_RANGE[1] - OUT_RANGE[0], BACK_RANGE[0] - BACK_RANGE[1]]) / half
    spread = np.repeat(spread, half)[None, :, None] * bins.peak[:, None, None] * GAUSS
    nodes = np.maximum(theta[..., None] + spread, 0.0).reshape(theta.shape[0], -1)
    push = np.stack((np.cos(bins.phi), np.sin(bins.phi)), axis=1)
    along = np.sum(bins.up * push, axis=1)
    change = -bins.up_along[:, None] * np.sin(theta) - along[:, None] * (1.0 - np.cos(theta))
    noise = antenna.sensor.moment_noise
    tare_sigma = noise / np.sqrt(np.maximum(touch.tare_samples, 1))
    rest_sigma = np.hypot(tare_sigma, noise / np.sqrt(np.maximum(touch.preload_samples, 1)))
    held = -(touch.preload[:, 0] * np.cos(touch.approach) + touch.preload[:, 1] * np.sin(touch.approach))
    per_moment = distance**2 / antenna.stiffness3
    return PushData(
        phi=bins.phi,
        path=np.insert(nodes, nodes.shape[1] // 2, bins.peak, axis=1),
        force=bins.force,
        count=bins.count,
        time=bins.time,
        gravity=-antenna.beam.line_weight * change[..., None] * push[:, None, :],
        depth=np.maximum(held, 0.0) * per_moment,
        depth_sigma=np.hypot(DEPTH_SIGMA, rest_sigma * per_moment),
        tare_sigma=tare_sigma,
        tip=np.zeros(contact.size, dtype=np.bool_),
        contact=contact,
    )
