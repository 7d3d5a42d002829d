"""How the antenna stood at a contact: its base, the beam's direction, the push and the force that answered.

``contacts.csv`` has no poses; they are taken from ``readings.npz``, where every call of the instrument is kept.
A folder without it still tells the line of the beam, since all normals of a contour are square to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Kind, flag_names
from contour.frames import Mount, carried_push, plane_direction
from contour.instrument import Outcome, Stroke
from contour.results import Run

__all__ = ["READINGS", "Stance", "beam_directions", "stance_of"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

READINGS = "readings.npz"
SEEN_TURN = 0.05
"""Normals of a contour that vary less than this do not tell the beam's line [rad]."""
LAST_SAMPLES = 5
"""Samples at the end of the out stroke over which the force is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stance:
    """The antenna at one contact; vectors in the world."""

    row: int
    """Row of the contact in ``contacts.csv``, its id."""
    kind: str
    """What the beam touched: side, edge, tip or line."""
    flags: str
    """Names of its flags; empty when there are none."""
    base: FloatArray
    """(3,) m, centre of rotation."""
    tip: FloatArray
    """(3,) m, end of the undeformed beam."""
    point: FloatArray
    """(3,) m, on the surface."""
    normal: FloatArray
    """(3,) unit, outward."""
    distance: float
    """s [m], from the base to the contact."""
    sigma_distance: float
    """m, one standard deviation."""
    radius: float
    """m, of the beam."""
    push: FloatArray | None
    """(3,) unit, direction in which the contact point was pushed; None where no push is on record."""
    angle: float | None
    """rad, turn of the beam at the end of that push."""
    force: FloatArray | None
    """(3,) N, in Pi, ON the beam at the end of that push; the moment's change since free air over s."""
    source: str
    """Where pose and push were taken from, in words."""


def beam_directions(run: Run) -> FloatArray:
    """Direction (n, 3) of the undeformed beam at every contact, in the world; nan where nothing tells it.

    It is fixed along a contour. With readings it is that of the contour's first pose. Without, it is the line
    that the contour's normals are square to, pointed so that the base is farther from the object than the tip.
    """
    path = run.folder / READINGS
    direction = np.full((run.contour.size, 3), np.nan)
    if path.is_file():
        mount = _mount(run)
        wanted = set(np.unique(run.contour).tolist())
        with np.load(path) as log:
            for number in _calls(log, "approach"):
                for contour in wanted & set(log[f"{number}/which"].tolist()):
                    row = np.flatnonzero(log[f"{number}/which"] == contour)
                    rotation = mount.rotation_world_sensor(log[f"{number}/pose"][row])
                    direction[run.contour == contour] = rotation[0, :, 1]
                    wanted.discard(contour)
                if not wanted:
                    break
        return direction
    middle = run.points.mean(axis=0)
    for contour in np.unique(run.contour):
        rows = np.flatnonzero((run.contour == contour) & run.good)
        if rows.size < 2:
            continue
        _, spread, axes = np.linalg.svd(run.normals[rows])
        if spread[1] > SEEN_TURN * np.sqrt(rows.size):
            away = run.points[rows] - run.contacts["s_m"][rows, None] * axes[2] - middle
            inside = np.linalg.norm(away, axis=1).mean()
            other = np.linalg.norm(away + 2.0 * run.contacts["s_m"][rows, None] * axes[2], axis=1).mean()
            direction[run.contour == contour] = axes[2] if inside >= other else -axes[2]
    return direction


def stance_of(run: Run, row: int) -> Stance | None:
    """The antenna at contact ``row``; None where neither readings nor normals tell the beam's direction."""
    found = _from_readings(run, row) if (run.folder / READINGS).is_file() else None
    beam = run.record["scene"]["antenna"]["beam"]
    length, radius = float(beam["length"]), 0.5 * float(beam["diameter"])
    point, normal = run.points[row], run.normals[row]
    distance = float(run.contacts["s_m"][row])
    if found is None:
        direction = beam_directions(run)[row]
        if not np.isfinite(direction).all():
            return None
        base = point + radius * normal - distance * direction
        found = {"base": base, "direction": direction, "push": None, "angle": None, "force": None}
        found["source"] = f"no {READINGS}: the beam's line is that square to the contour's normals"
    return Stance(
        row=row,
        kind=Kind(int(run.contacts["kind"][row])).name.lower(),
        flags=flag_names(int(run.contacts["flags"][row])),
        base=found["base"],
        tip=found["base"] + length * found["direction"],
        point=point,
        normal=normal,
        distance=distance,
        sigma_distance=float(run.contacts["sigma_s_m"][row]),
        radius=radius,
        push=found["push"],
        angle=found["angle"],
        force=found["force"],
        source=found["source"],
    )


def _mount(run: Run) -> Mount:
    mount = run.record["scene"]["mount"]
    return Mount(np.array(mount["rotation"]), np.array(mount["origin"]))


def _calls(log: Any, kind: str) -> list[int]:
    """Numbers of the calls of a ``kind``, in their order."""
    return np.flatnonzero(log["kinds"] == kind).tolist()


def _from_readings(run: Run, row: int) -> dict[str, Any] | None:
    """Pose, push and force on record of contact ``row``; None where the record does not have it.

    The pushes of a contour follow each other in the order of its contacts, as many as each contact says.
    """
    contour = int(run.contour[row])
    rows = np.flatnonzero(run.contour == contour)  # ascending, as the contacts were made
    pushes = run.contacts["pushes"][rows]
    before = int(pushes[rows < row].sum())
    mine = int(run.contacts["pushes"][row])
    with np.load(run.folder / READINGS) as log:
        made = [
            (n, w) for n in _calls(log, "push") for w in np.flatnonzero(log[f"{n}/which"] == contour).tolist()
        ]
        if not mine or len(made) != int(pushes.sum()):
            return None
        push, at = made[before + mine - 1]
        touched = _touched_before(log, push, contour)
        if touched is None:
            return None
        approach, of = touched
        pose = log[f"{approach}/pose"][of : of + 1]
        mount = _mount(run)
        rotation = mount.rotation_world_sensor(pose)[0]
        phi, joints = log[f"{push}/phi"][at], log[f"{push}/touch"][at]
        taken = _run_of(log, push, at)
        free = _run_of(log, approach, of)
        tare = free["moment"][free["stroke"] == Stroke.FREE]
        out = np.flatnonzero(taken["stroke"] == Stroke.OUT)[-LAST_SAMPLES:]
        force: FloatArray | None = None
        if len(tare) and out.size:
            carried = carried_push(
                taken["angles"][out, 0],
                taken["angles"][out, 1],
                taken["moment"][out] - tare.mean(axis=0),
                touch=np.repeat(joints[None], out.size, axis=0),
                phi=np.full(out.size, phi),
            ).force.mean(axis=0)
            force = (carried[0] * rotation[:, 0] + carried[1] * rotation[:, 2]) / run.contacts["s_m"][row]
        return {
            "base": mount.position_world(pose)[0],
            "direction": rotation[:, 1],
            "push": plane_direction(np.array(phi), rotation),
            "angle": float(log[f"{push}/angle"][at]),
            "force": force,
            "source": f"pose and push from {READINGS}",
        }


def _touched_before(log: Any, push: int, contour: int) -> tuple[int, int] | None:
    """The last approach before call ``push`` that left the antenna of ``contour`` touching, and its row."""
    for number in reversed([n for n in _calls(log, "approach") if n < push]):
        which, outcome = log[f"{number}/which"], log[f"{number}/outcome"]
        good = (which == contour) & ((outcome == Outcome.FOUND) | (outcome == Outcome.BLOCKED))
        if good.any():
            return number, int(np.flatnonzero(good)[0])
    return None


def _run_of(log: Any, number: int, at: int) -> dict[str, NDArray[Any]]:
    """Samples of row ``at`` of call ``number``."""
    begin, end = log[f"{number}/samples.start"][at : at + 2].tolist()
    return {name: log[f"{number}/samples.{name}"][begin:end] for name in ("angles", "moment", "stroke")}
