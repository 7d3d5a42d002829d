"""A scan as the 3-D view of the report reads it (contour/web/viewer.js): plain JSON with packed arrays.

Lengths are in mm about the middle of the scan. Arrays are base64 of little-endian numbers, whole numbers times a
scale where that is fine enough: positions of the surface to a 65,000th of its size.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from contour.charts import nice_ceiling
from contour.claims import Claims
from contour.compare import TOLERANCE
from contour.contacts import Flag, Kind, flag_names
from contour.results import Run
from contour.surface import FAR, Surface

__all__ = ["MOST_FACES", "build_scene", "script_of", "untouched_beyond"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_FACES = 100_000
"""Triangles of the surface on a page; larger ones are made coarser, which is said."""
GAP = 4.0
"""Neighbours farther apart than this many usual steps are not joined by a line."""
MM = 1e3
DEG = 180.0 / np.pi
PLUS_MINUS = "\N{PLUS-MINUS SIGN}"
_KINDS = [kind.name.lower() for kind in Kind]
_READOUT: tuple[dict[str, Any], ...] = (
    {"label": "contour", "column": "contour", "unit": "", "digits": 0},
    {"label": "place on it", "column": "order", "unit": "", "digits": 0},
    {"label": "kind", "column": "kind", "words": _KINDS},
    {"label": "s", "column": "s_m", "factor": MM, "unit": "mm", "digits": 2},
    {"label": "sigma of s", "column": "sigma_s_m", "factor": MM, "unit": "mm", "digits": 3},
    {"label": "sigma of normal", "column": "sigma_normal_rad", "factor": DEG, "unit": "deg", "digits": 2},
    {"label": "pushes", "column": "pushes", "unit": "", "digits": 0},
)
_READOUT_OF_ERRORS: tuple[dict[str, Any], ...] = (
    {"label": "error of s", "column": "error_s", "factor": MM, "unit": "mm", "digits": 3},
    {"label": "error of point", "column": "error_point", "factor": MM, "unit": "mm", "digits": 3},
    {"label": "error of normal", "column": "error_normal", "factor": DEG, "unit": "deg", "digits": 2},
)
"""What is said of a contact that is clicked: label, column, factor from SI, unit, digits."""
_TYPES = {"i1": "<i1", "u1": "<u1", "i2": "<i2", "u2": "<u2", "u4": "<u4", "f4": "<f4"}


def build_scene(
    run: Run,
    surface: Surface | None,
    *,
    deviation: FloatArray | None,
    claims: Claims | None,
    closed: frozenset[int],
) -> dict[str, Any]:
    """What the 3-D view shows, as JSON.

    Args:
        run: the scan.
        surface: its surface, if it has one.
        deviation: (v,) m, signed distance of the surface's vertices from the nominal surface, positive outside.
        claims: errors of the contacts, in simulation.
        closed: numbers of the contours that came back to where they began.
    """
    shown = np.flatnonzero(np.isfinite(run.points).all(axis=1) & np.isfinite(run.normals).all(axis=1))
    points = run.points[shown]
    extent = points[run.good[shown]] if run.good[shown].any() else points  # flagged ones may lie anywhere
    if surface is not None:
        extent = np.concatenate([extent, surface.vertices])
    low, high = extent.min(axis=0), extent.max(axis=0)
    middle = 0.5 * (low + high)
    return {
        "radius": MM * max(float(np.linalg.norm(extent - middle, axis=1).max()), 1e-6),
        "reach": MM * float(np.linalg.norm(points - middle, axis=1).max()),
        "half": (0.5 * MM * (high - low)).tolist(),
        "contacts": _contacts(run, shown, middle, claims),
        "segments": _packed(_segments(run, shown, closed), "u4"),
        "surface": None if surface is None else _surface(run, surface, middle, deviation),
    }


def untouched_beyond(run: Run) -> float:
    """Distance from any contact on the same side beyond which the surface counts as not touched [m]."""
    points = run.points[run.good]
    return FAR * float(np.ptp(points, axis=0).max()) if len(points) else 0.0


def script_of(scene: dict[str, Any]) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(scene, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _contacts(run: Run, shown: IntArray, middle: FloatArray, claims: Claims | None) -> dict[str, Any]:
    table = run.contacts
    length = np.bincount(run.contour, minlength=1)
    columns = {
        "id": _packed(table["id"][shown], "u4"),
        "position": _packed(MM * (run.points[shown] - middle), "f4"),
        "normal": _packed(127.0 * run.normals[shown], "i1"),
        "flags": _packed(table["flags"][shown], "u2"),
        "kind": _packed(table["kind"][shown], "u1"),
        "contour": _packed(run.contour[shown], "u4"),
        "order": _packed(run.order[shown], "u4"),
        "along": _packed((run.order / np.maximum(length[run.contour] - 1, 1))[shown], "f4"),
        "pushes": _packed(table["pushes"][shown], "u2"),
    }
    for name in ("s_m", "sigma_s_m", "sigma_normal_rad"):
        columns[name] = _packed(table[name][shown], "f4")
    if claims is not None:
        columns |= {
            "wrong": _packed(claims.wrong[shown], "u1"),
            "error_s": _packed(claims.distance[shown], "f4"),
            "error_normal": _packed(claims.normal[shown], "f4"),
            "error_point": _packed(claims.point[shown], "f4"),
            "ratio": _packed(np.minimum(claims.distance_ratio[shown], 1e6), "f4"),
        }
    return {
        "count": int(shown.size),
        "columns": columns,
        "shades": _shades(run, known=claims is not None),
        "readout": [*_READOUT, *(_READOUT_OF_ERRORS if claims is not None else ())],
        "flags": [{"bit": int(flag), "word": flag_names(int(flag))} for flag in Flag if flag],
    }


def _shades(run: Run, *, known: bool) -> list[dict[str, Any]]:
    """What contacts and lines may be coloured by; errors where they are ``known``."""
    good = run.good
    sigma = MM * run.contacts["sigma_s_m"][good] if good.any() else np.ones(1)
    top = nice_ceiling(float(np.quantile(sigma, 0.98)))
    rows: list[tuple[str, str, str, str, dict[str, Any]]] = [
        (
            "contour",
            "contour",
            "number of the contour",
            "contour",
            {"range": max(float(run.contour.max()), 1.0)},
        ),
        (
            "along",
            "place along the contour",
            "place along the contour (0 first, 1 last)",
            "along",
            {"range": 1.0},
        ),
        ("kind", "kind of contact", "kind of contact", "kind", {"words": _KINDS}),
        (
            "sigma",
            "claimed sigma of s",
            "claimed sigma of s [mm]",
            "sigma_s_m",
            {"factor": MM, "range": top, "open": True},
        ),
    ]
    if known:
        label = "|error of s| / claimed sigma"
        rows.append(("ratio", "error of s over its sigma", label, "ratio", {"range": 4.0, "open": True}))
    return [
        {"name": name, "word": word, "label": label, "column": column, **rest}
        for name, word, label, column, rest in rows
    ]


def _segments(run: Run, shown: IntArray, closed: frozenset[int]) -> IntArray:
    """Pairs (k, 2) of rows of ``shown``: unflagged neighbours along the contours, none across wide gaps."""
    points = run.points[shown]
    good, contour, order = run.good[shown], run.contour[shown], run.order[shown]
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for number in np.unique(contour).tolist():
        rows = np.flatnonzero((contour == number) & good)
        rows = rows[np.argsort(order[rows], kind="stable")]
        links = np.stack([rows, np.roll(rows, -1)], axis=1)
        links = links if number in closed and rows.size > 2 else links[:-1]
        step = np.linalg.norm(points[links[:, 1]] - points[links[:, 0]], axis=1)
        pairs.append(links[step <= GAP * np.median(step)] if step.size else links)
    return np.concatenate(pairs)


def _surface(run: Run, surface: Surface, middle: FloatArray, deviation: FloatArray | None) -> dict[str, Any]:
    vertices, faces, nearest = _coarser(surface)
    far = untouched_beyond(run)
    touched = surface.trust <= far
    fields = []
    if deviation is not None:
        top = nice_ceiling(MM * _quantile(np.abs(deviation[touched]), 0.95))
        label = "deviation from nominal [mm]: + outside, \N{MINUS SIGN} inside"
        field = _field("deviation", "signed deviation", label, "diverging", MM * deviation[nearest], top)
        share = 100.0 * _share_within(surface, np.abs(deviation) <= TOLERANCE, touched)
        said = f"marks: {PLUS_MINUS}{MM * TOLERANCE:g} mm, held by {share:.0f} % of what was touched"
        fields.append(field | {"marks": MM * TOLERANCE, "said": said})
    top = nice_ceiling(MM * _quantile(surface.sigma[touched], 0.95))
    label = "sigma of the surface's place [mm]"
    fields.append(_field("sigma", "sigma", label, "sequential", MM * surface.sigma[nearest], top))
    label = "distance to the nearest contact on the same side [mm]"
    fields.append(
        _field(
            "trust",
            "distance to contacts",
            label,
            "sequential",
            MM * surface.trust[nearest],
            nice_ceiling(MM * far),
        )
    )
    return {
        "position": _packed(MM * (vertices - middle), "i2"),
        "normal": _packed(127.0 * surface.normals[nearest], "i1"),
        "index": _packed(faces, "u2" if len(vertices) <= 65_536 else "u4"),
        "touched": _packed(touched[nearest], "u1"),
        "fields": fields,
    }


def _share_within(surface: Surface, good: NDArray[np.bool_], touched: NDArray[np.bool_]) -> float:
    """Share of the touched area whose vertices are ``good``."""
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = area * touched[surface.faces].all(axis=1)
    return float(np.sum(weight * good[surface.faces].mean(axis=1)) / max(float(weight.sum()), 1e-30))


def _coarser(surface: Surface) -> tuple[FloatArray, IntArray, IntArray]:
    """Vertices (k, 3) and faces of the surface with MOST_FACES at most, and the vertex each one is nearest to."""
    if len(surface.faces) <= MOST_FACES:
        return surface.vertices, surface.faces, np.arange(len(surface.vertices))
    import pyvista

    corners: NDArray[Any] = surface.faces
    whole = pyvista.PolyData.from_regular_faces(surface.vertices, corners)
    less = whole.decimate(1.0 - MOST_FACES / len(surface.faces), volume_preservation=True)
    vertices = np.asarray(less.points, dtype=np.float64)
    nearest = np.asarray(KDTree(surface.vertices).query(vertices)[1], dtype=np.int64)
    return vertices, np.asarray(less.regular_faces, dtype=np.int64), nearest


def _field(name: str, word: str, label: str, colours: str, values: FloatArray, top: float) -> dict[str, Any]:
    """One quantity of the surface; beyond ten times its range nothing is told apart."""
    clipped = np.clip(np.nan_to_num(values, nan=0.0), -10.0 * top, 10.0 * top)
    packed = _packed(clipped, "i2")
    return {"name": name, "word": word, "label": label, "map": colours, "range": top, "values": packed}


def _quantile(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if values.size else 1.0


def _packed(values: NDArray[Any], kind: str) -> dict[str, Any]:
    """An array as base64; ``i2`` as shares of the largest, with the scale to undo it; whole numbers rounded."""
    if kind == "i2":
        scale = max(float(np.abs(values).max(initial=0.0)), 1e-12) / 32_767.0
        whole = np.rint(values / scale).astype(_TYPES[kind])
        return {"type": kind, "scale": scale, "data": base64.b64encode(whole.tobytes()).decode("ascii")}
    numbers = values if kind == "f4" else np.rint(values.astype(np.float64))
    return {"type": kind, "data": base64.b64encode(numbers.astype(_TYPES[kind]).tobytes()).decode("ascii")}
