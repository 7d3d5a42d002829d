"""What pictures of a scan show: points with normals, contours, surface, uncertainty, the antenna at a contact.

Each view becomes a panel of plain arrays (:mod:`contour.panel`).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from contour.compare import TOLERANCE
from contour.panel import UNTOUCHED, Bar, Layer, Panel
from contour.results import Run
from contour.stance import Stance, beam_directions, stance_of
from contour.surface import FAR, TOUCH, Surface

__all__ = ["build_panels", "default_contact", "title_of"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_BODY = "#d9d5cc"
_FLAGGED = "#d62728"
_BEAM = "#20242c"
_PUSH = "#1f5fbf"
_FORCE = "#d62728"
_NORMAL = "#2ca02c"
_GAP = 3.0
"""Successive contacts farther apart than this many usual steps are not joined by a line."""
_LIFT = 0.005
"""Contour lines are drawn this much off the surface, in the longest edge: chords would sink into it."""
_NICE = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Factors by which uncertainty is exaggerated."""
_SEEN_SIGMA = 0.025
"""Half length of the median ellipsoid, in the longest edge."""
_LONGEST = 0.15
"""Half length of the longest ellipsoid drawn, in the longest edge."""
_ELEVATION = float(np.deg2rad(28.0))
"""Of the usual camera above the horizon [rad]."""


def title_of(run: Run) -> str:
    """One line over all panels: object, contacts, unit."""
    flagged = int(np.count_nonzero(~run.good))
    told = f" ({flagged} flagged)" if flagged else ""
    contours = np.unique(run.contour).size
    return f"{_name(run)}: {run.contour.size} contacts{told} on {contours} contours, lengths in mm"


def default_contact(run: Run) -> int:
    """The contact at which the antenna is shown if none is asked for: a good one half-way along the beam."""
    length = float(run.record["scene"]["antenna"]["beam"]["length"])
    off = np.abs(run.contacts["s_m"] / length - 0.6) + 10.0 * ~run.good
    return int(np.argmin(off))


def build_panels(
    run: Run,
    names: tuple[str, ...],
    *,
    surface: Surface | None,
    deviation: FloatArray | None,
    contact: int | None = None,
    tolerance: float = TOLERANCE,
) -> list[Panel]:
    """The panels ``names`` (of VIEWS) of a run.

    Args:
        run: with at least one contact.
        names: which; ``surface`` needs one.
        surface: the body behind contours and antenna too; contours float in the air without.
        deviation: (v,) m of its vertices from the nominal surface, positive outside; None if it is not known.
        contact: row at which the antenna is shown; see :func:`default_contact`.
        tolerance: m, marked on the bar of deviations.
    """
    usual = _usual_view(run.points[run.good] if run.good.any() else run.points)
    makers: dict[str, Callable[[], Panel]] = {
        "points": lambda: _points(run, surface, usual),
        "contours": lambda: _contours(run, surface, usual),
        "uncertainty": lambda: _uncertainty(run, surface, usual),
        "antenna": lambda: _antenna(run, surface, default_contact(run) if contact is None else contact),
    }
    if surface is not None:
        makers["surface"] = lambda: _surface(surface, _size(run), deviation, tolerance, usual)
    return [makers[name]() for name in names]


def _name(run: Run) -> str:
    return str(run.record["scene"]["name"])


def _size(run: Run) -> float:
    """Longest edge of the box round the good contacts [m]."""
    points = run.points[run.good] if run.good.any() else run.points
    return max(float(np.ptp(points, axis=0).max()), 1e-6)


def _usual_view(points: FloatArray) -> FloatArray:
    """(3,) unit: of eight directions round the object, the one from which it looks largest."""
    best, view = -1.0, np.zeros(3)
    for turn in np.deg2rad(np.arange(-60.0, 300.0, 45.0)):
        level = np.array([np.cos(turn), np.sin(turn), 0.0])
        candidate = np.cos(_ELEVATION) * level + np.array([0.0, 0.0, np.sin(_ELEVATION)])
        right = np.array([-level[1], level[0], 0.0])
        flat = np.stack((points @ right, points @ np.cross(candidate, right)), axis=1)
        try:
            area = float(ConvexHull(flat).volume)
        except (QhullError, ValueError):  # fewer than three points, or all in line: no direction is better
            area = 0.0
        if area > 1.02 * best:  # nearly equal ones do not outdo the first
            best, view = area, candidate
    return view


def _layer(
    kind: str,
    points: FloatArray,
    *,
    cells: NDArray[Any] | None = None,
    facing: FloatArray | None = None,
    values: FloatArray | None = None,
    colour: str = _BODY,
    size: float = 0.0,
    label: str = "",
    framed: bool = True,
) -> Layer:
    return Layer(
        kind=kind,
        points=np.asarray(points, dtype=np.float64),
        cells=np.zeros(0) if cells is None else cells,
        facing=np.zeros((0, 3)) if facing is None else facing,
        values=np.zeros(0) if values is None else np.asarray(values, dtype=np.float64),
        colour=colour,
        size=size,
        label=label,
        framed=framed,
    )


def _body(surface: Surface | None) -> list[Layer]:
    """The surface as a pale background; nothing without one."""
    if surface is None:
        return []
    return [_layer("mesh", surface.vertices, cells=surface.faces, facing=surface.normals, colour=_BODY)]


def _flagged(run: Run) -> list[Layer]:
    bad = ~run.good & np.isfinite(run.points).all(axis=1)
    if not bad.any():
        return []
    label, size = f"{int(np.count_nonzero(bad))} flagged", _size(run)
    if run.good.any():
        low, high = run.points[run.good].min(axis=0), run.points[run.good].max(axis=0)
        out = np.any((run.points[bad] < low - 0.1 * size) | (run.points[bad] > high + 0.1 * size), axis=1)
        label += f",\n{int(np.count_nonzero(out))} of them far off" if out.any() else ""
    framed = not run.good.any()
    return [_layer("dots", run.points[bad], colour=_FLAGGED, size=0.008 * size, label=label, framed=framed)]


def _points(run: Run, surface: Surface | None, view: FloatArray) -> Panel:
    good, size = run.good, _size(run)
    points, normals = run.points[good], run.normals[good]
    count = len(points)
    ends = np.concatenate((points, points + 0.05 * size * normals))
    pairs = np.stack((np.arange(count), np.arange(count) + count), axis=1)
    layers = [
        *_body(surface),
        _layer("dots", points, facing=normals, colour=_PUSH, size=0.004 * size, label="contact"),
        _layer(
            "lines",
            ends,
            cells=pairs,
            facing=np.concatenate((normals, normals)),
            colour="#5a86c9",
            size=1.0,
            label="outward normal",
        ),
        *_flagged(run),
    ]
    caption = f"normals drawn {0.05 * size * 1e3:.2g} mm long"
    title = "Contacts with their normals"
    return Panel(name="points", title=title, caption=caption, layers=tuple(layers), view=view, bar=None)


def _contours(run: Run, surface: Surface | None, view: FloatArray) -> Panel:
    pairs, place = _strings(run)
    layers = [*_body(surface)]
    used, cells = np.unique(pairs, return_inverse=True)
    if used.size:
        layers.append(
            _layer(
                "lines",
                run.points[used] + _LIFT * _size(run) * run.normals[used],
                cells=cells.reshape(-1, 2),
                facing=run.normals[used],
                values=place[used],
                size=2.2,
                label="contour",
            )
        )
    else:
        layers.append(
            _layer("dots", run.points[run.good], colour=_PUSH, size=0.004 * _size(run), label="contact")
        )
    layers += _flagged(run)
    bar = Bar(
        label="place along each contour: first contact to last [%]",
        cmap="viridis",
        low=0.0,
        high=100.0,
        ticks=(0.0, 25.0, 50.0, 75.0, 100.0),
    )
    caption = "gaps: no line where neighbours are far apart or flagged"
    title = "Contours, coloured by the order in which they were followed"
    return Panel(name="contours", title=title, caption=caption, layers=tuple(layers), view=view, bar=bar)


def _strings(run: Run) -> tuple[IntArray, FloatArray]:
    """Rows of neighbours along contours (c, 2), and each contact's place along its contour [%]."""
    closed = _closed(run)
    place = np.zeros(run.contour.size)
    pairs: list[tuple[int, int]] = []
    for contour in np.unique(run.contour).tolist():
        rows = np.flatnonzero(run.contour == contour)
        rows = rows[np.argsort(run.order[rows], kind="stable")]
        place[rows] = 100.0 * np.arange(rows.size) / max(rows.size - 1, 1)
        pairs += pairwise(rows.tolist())
        if contour in closed and rows.size > 2:
            pairs.append((int(rows[-1]), int(rows[0])))
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    both = both[run.good[both].all(axis=1)]
    apart = np.linalg.norm(run.points[both[:, 0]] - run.points[both[:, 1]], axis=1)
    return both[apart <= _GAP * (np.median(apart) if apart.size else 0.0)], place


def _closed(run: Run) -> set[int]:
    """Contours that came back to their beginning, as the log says."""
    log = run.folder / "log.jsonl"
    if not log.is_file():
        return set()
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines() if '"contour"' in line]
    return {
        event["contour"] for event in lines if event["event"] == "contour" and event["status"] == "closed"
    }


def _surface(
    surface: Surface, size: float, deviation: FloatArray | None, tolerance: float, view: FloatArray
) -> Panel:
    far = FAR * size
    touched = surface.trust <= far
    share = f"{len(surface.faces)} triangles by method {surface.method!r}"
    grey = f"not touched: no contact\nwithin {far * 1e3:.2g} mm"
    if deviation is None:
        values, bar = 1e3 * surface.trust, _trust_bar(far)
        title, caption = (
            "Surface, coloured by the distance to the nearest contact",
            f"{share}; no nominal mesh known",
        )
    else:
        values = 1e3 * deviation
        bar = _deviation_bar(values[touched], 1e3 * tolerance)
        title = "Surface, coloured by its deviation from the nominal mesh"
        within = 100.0 * np.mean(np.abs(deviation[touched]) <= tolerance) if touched.any() else 0.0
        caption = f"{share}; {within:.1f} % of the touched vertices within tolerance"
    mesh = _layer(
        "mesh",
        surface.vertices,
        cells=surface.faces,
        facing=surface.normals,
        values=np.where(touched, values, np.nan),
    )
    key = _layer("dots", surface.vertices[:1], colour=UNTOUCHED, size=0.0, label=grey)
    return Panel(name="surface", title=title, caption=caption, layers=(mesh, key), view=view, bar=bar)


def _trust_bar(far: float) -> Bar:
    most = 1e3 * far
    label = "distance to the nearest contact [mm]"
    return Bar(label=label, cmap="viridis_r", low=0.0, high=most, ticks=(0.0, 0.5 * most, most))


def _deviation_bar(deviation_mm: FloatArray, tolerance_mm: float) -> Bar:
    """Centred at zero, a whole number of tolerances wide, at least two and at most five."""
    usual = float(np.quantile(np.abs(deviation_mm), 0.98)) if deviation_mm.size else 0.0
    most = float(np.clip(np.ceil(usual / tolerance_mm), 2.0, 5.0)) * tolerance_mm
    label = f"deviation [mm], + = outside nominal, tolerance \N{PLUS-MINUS SIGN}{tolerance_mm:g}"
    ticks = (-most, -tolerance_mm, 0.0, tolerance_mm, most)
    return Bar(label=label, cmap="RdYlBu_r", low=-most, high=most, ticks=ticks)


def _uncertainty(run: Run, surface: Surface | None, view: FloatArray) -> Panel:
    size, beam = _size(run), beam_directions(run)
    shown = run.good & np.isfinite(beam).all(axis=1)
    sigma = run.contacts["sigma_s_m"][shown]
    column = "sigma_smooth_normal_rad" if "sigma_smooth_normal_rad" in run.contacts else "sigma_normal_rad"
    turn = np.rad2deg(run.contacts[column][shown])
    usual = float(np.median(sigma)) if sigma.size else 1.0
    factor = next((f for f in reversed(_NICE) if f * usual <= _SEEN_SIGMA * size), _NICE[0])
    along = factor * sigma
    cut = int(np.count_nonzero(along > _LONGEST * size))
    thin = max(factor * TOUCH, 0.003 * size)
    normal = run.normals[shown]
    across = np.cross(beam[shown], normal)
    length = np.minimum(along, _LONGEST * size)[:, None]
    axes = np.stack((length * beam[shown], thin * normal, thin * across), axis=1)
    most = float(np.quantile(turn, 0.98)) if turn.size else 1.0
    high = float(np.ceil(2.0 * most) / 2.0) or 0.5
    bar = Bar(
        label="sigma of the normal [deg]",
        cmap="plasma",
        low=0.0,
        high=high,
        ticks=(0.0, 0.5 * high, high),
    )
    layer = _layer(
        "ellipsoids",
        run.points[shown],
        cells=axes,
        facing=normal,
        values=turn,
        label=f"1 sigma of s, along the beam,\ndrawn {factor} times as long",
    )
    caption = f"median sigma of s {1e3 * usual:.2g} mm; thickness only so that they can be seen"
    caption += f"; {cut} longer than drawn" if cut else ""
    title = "Uncertainty of each contact"
    layers = (*_body(surface), *((layer,) if shown.any() else _flagged(run)))
    return Panel(name="uncertainty", title=title, caption=caption, layers=layers, view=view, bar=bar)


def _antenna(run: Run, surface: Surface | None, row: int) -> Panel:
    size, stance = _size(run), stance_of(run, row)
    background = _body(surface)
    if surface is None:
        background = [
            _layer(
                "dots",
                run.points[run.good],
                facing=run.normals[run.good],
                colour="#b5b0a4",
                size=0.004 * size,
            )
        ]
    where = _layer("dots", run.points[row : row + 1], colour="#ffb000", size=0.018 * size, label="contact")
    if stance is None:
        caption = f"contact {row}: neither readings nor normals tell where the beam was"
        layers, view = [*background, where], _usual_view(run.points)
    else:
        layers = [*background, where, *_rods(stance, size)]
        cloud = run.points[run.good] if surface is None else surface.vertices
        caption, view = _told(stance), _side_view(stance, cloud, size)
    title = f"The antenna at contact {row} (contour {int(run.contour[row])})"
    return Panel(name="antenna", title=title, caption=caption, layers=tuple(layers), view=view, bar=None)


def _rods(stance: Stance, size: float) -> list[Layer]:
    """Beam, base, and arrows of normal, push and force."""
    span, thick = 0.3 * size, 0.009 * size
    direction = (stance.tip - stance.base) / np.linalg.norm(stance.tip - stance.base)
    layers = [
        _rod("rods", stance.base, stance.tip, _BEAM, thick, "beam, base (ball) to tip"),
        _layer("dots", stance.base[None], colour=_BEAM, size=0.03 * size),
    ]
    on_beam = stance.point + (thick + 0.01 * size) * stance.normal
    aside = 0.09 * size * direction
    layers.append(
        _rod("arrows", on_beam, on_beam + 0.8 * span * stance.normal, _NORMAL, 0.7 * thick, "normal")
    )
    if stance.push is not None:
        head = on_beam - aside
        layers.append(_rod("arrows", head - span * stance.push, head, _PUSH, thick, "push"))
    if stance.force is not None:
        way = stance.force / np.linalg.norm(stance.force)
        layers.append(
            _rod("arrows", on_beam + aside, on_beam + aside + span * way, _FORCE, thick, "force on the beam")
        )
    return layers


def _rod(kind: str, start: FloatArray, end: FloatArray, colour: str, size: float, label: str) -> Layer:
    cells = np.array([[0, 1]], dtype=np.int64)
    return _layer(kind, np.stack((start, end)), cells=cells, colour=colour, size=size, label=label)


def _told(stance: Stance) -> str:
    """The contact in words."""
    text = (
        f"{stance.kind}{', ' + stance.flags if stance.flags else ''}; "
        f"s = {1e3 * stance.distance:.2f} \N{PLUS-MINUS SIGN} {1e3 * stance.sigma_distance:.2f} mm"
    )
    if stance.force is not None and stance.angle is not None:
        force = float(np.linalg.norm(stance.force))
        turn = np.rad2deg(np.arccos(np.clip(stance.force @ stance.normal / force, -1.0, 1.0)))
        text += f"; turned by {np.rad2deg(stance.angle):.1f} deg it felt {1e3 * force:.3g} mN"
        text += f", {turn:.0f} deg off the normal"
    elif stance.push is None:
        text += f"; {stance.source}"
    return text + "; thickness not to scale"


def _side_view(stance: Stance, cloud: FloatArray, size: float) -> FloatArray:
    """(3,) unit: from where the contact is seen, the beam is long and its arrows are apart."""
    direction = (stance.tip - stance.base) / np.linalg.norm(stance.tip - stance.base)
    best, view = -np.inf, np.array([0.6, -0.65, 0.47])
    # Seen from the camera nothing may stand before the contact, the beam and the feet of the arrows.
    offset = cloud - stance.point - 0.06 * size * stance.normal
    for elevation in np.deg2rad((10.0, 25.0, 40.0, 55.0)):
        for turn in np.deg2rad(np.arange(0.0, 360.0, 15.0)):
            c = np.array(
                [np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)]
            )
            depth = offset @ c
            beside = np.linalg.norm(offset - depth[:, None] * c, axis=1)
            hidden = np.any((depth > 0.0) & (beside < 0.03 * size))
            facing = float(stance.normal @ c)
            level = abs(
                -np.sin(turn) * direction[0] + np.cos(turn) * direction[1]
            )  # views are wide, not high
            score = 0.6 * level - abs(float(direction @ c)) - abs(facing - 0.4) - 2.0 * hidden
            if score > best:
                best, view = score, c
    return view
