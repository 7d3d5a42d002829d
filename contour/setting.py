"""What was scanned and with what, as HTML tables: the section of a scan's report that ``run.json`` fills."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from contour.results import Run

__all__ = ["setting_html"]

MM, DEG = 1e3, 180.0 / math.pi
UNKNOWN_VALUE = "not known"

_SETTINGS: tuple[tuple[str, tuple[tuple[str, str, float, str], ...]], ...] = (
    (
        "Antenna",
        (
            ("length", "antenna.beam.length", MM, "mm"),
            ("diameter", "antenna.beam.diameter", MM, "mm"),
            ("Young's modulus", "antenna.beam.youngs_modulus", 1e-9, "GPa"),
            ("density", "antenna.beam.density", 1.0, "kg/m\N{SUPERSCRIPT THREE}"),
            ("rigid adaptor, part of the length", "antenna.beam.adaptor", MM, "mm"),
            ("yield stress", "antenna.beam.yield_stress", 1e-6, "MPa"),
            ("moment limit", "antenna.moment_limit", 1e3, "mN m"),
        ),
    ),
    (
        "Sensor",
        (
            ("noise of a moment", "antenna.sensor.moment_noise", 1e6, "\N{MICRO SIGN}N m"),
            ("drift of a moment", "antenna.sensor.moment_drift", 1e6, "\N{MICRO SIGN}N m/s"),
            ("encoder step", "antenna.sensor.encoder_step", DEG, "deg"),
            ("sample rate", "antenna.sensor.sample_rate", 1.0, "Hz"),
            ("touch is declared above", "antenna.sensor.touch_sigmas", 1.0, "sigma"),
        ),
    ),
    (
        "Machine",
        (
            ("travel", "machine.travel_speed", MM, "mm/s"),
            ("approach", "machine.approach_speed", MM, "mm/s"),
            ("retreat", "machine.retreat_speed", MM, "mm/s"),
            ("push", "machine.push_speed", DEG, "deg/s"),
            ("way back of a push", "machine.return_speed", DEG, "deg/s"),
            ("turn between pushes", "machine.turn_speed", DEG, "deg/s"),
            ("floor at z", "reach.floor", MM, "mm"),
        ),
    ),
    (
        "Plan and strategy",
        (
            ("strategy", "scan.strategy", 1.0, ""),
            ("family of contours", "plan.family", 1.0, ""),
            ("contours at most", "plan.contours", 1.0, ""),
            ("step between contacts", "plan.step", MM, "mm"),
            ("forward model of the simulator", "scan.rung", 1.0, ""),
            ("its tolerance, of the moment", "scan.tolerance", 100.0, "%"),
        ),
    ),
)
"""Tables of the setting: label, place in the scene of ``run.json``, factor from SI, unit."""
_LEFT_OPEN = {"plan.step": "a twentieth of the longest edge", "reach.floor": "none"}
"""What a setting that is null means."""


def setting_html(run: Run) -> str:
    """What was scanned and with what; all of ``run.json`` at the end."""
    record = run.record
    scene = record.get("scene") or {}
    tables = [_rows("Object", _objects(run, scene))]
    for title, settings in _SETTINGS:
        rows = [(label, _setting(scene, where, factor, unit)) for label, where, factor, unit in settings]
        if title == "Plan and strategy":
            rows.append(("seed of all chance", str(record.get("seed", UNKNOWN_VALUE))))
        if title == "Machine":
            rows.append(("axis limits (X, Y, Z, phi1, phi2)", _limits(scene)))
        tables.append(_rows(title, rows))
    versions = record.get("versions") or {}
    made = [(str(name), str(version) if version else "not installed") for name, version in versions.items()]
    tables.append(_rows("Made by", [*made, ("commit", str(record.get("commit") or UNKNOWN_VALUE))]))
    whole = escape(json.dumps(record, indent=1))
    return (
        f'<div class="columns">{"".join(tables)}</div><details class="screen">'
        f"<summary>All of run.json (SI units)</summary><pre>{whole}</pre></details>"
    )


def _objects(run: Run, scene: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What was scanned: each body, and how large what was touched is."""
    rows = [("name", str(scene.get("name", UNKNOWN_VALUE)))]
    for body in scene.get("objects") or []:
        placement = np.asarray(body.get("placement", np.eye(4)), dtype=np.float64)
        rows.append(("mesh", str(body.get("mesh"))))
        rows.append(("unit of its numbers", str(body.get("unit") or f"{run.unit} (from the file)")))
        if placement.shape == (4, 4) and not np.allclose(placement, np.eye(4)):
            at = ", ".join(f"{MM * x:.1f}" for x in placement[:3, 3])
            turn = math.acos(max(-1.0, min(1.0, 0.5 * (float(np.trace(placement[:3, :3])) - 1.0))))
            rows.append(("stood at", f"({at}) mm, turned by {DEG * turn:.1f} deg"))
        if body.get("friction_angle") is not None:
            angle = float(body["friction_angle"])
            friction = f"{DEG * angle:.1f} deg (coefficient {math.tan(angle):.2f}); no estimator knows it"
            rows.append(("friction angle", friction))
    points = run.points[run.good] if run.good.any() else run.points
    extent = " \N{MULTIPLICATION SIGN} ".join(f"{MM * x:.1f}" for x in np.ptp(points, axis=0))
    return [*rows, ("extent of what was touched", f"{extent} mm"), ("unit of point files", run.unit)]


def _setting(scene: Mapping[str, Any], where: str, factor: float, unit: str) -> str:
    value: Any = scene
    for key in where.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    if value is None:
        return _LEFT_OPEN.get(where, UNKNOWN_VALUE)
    if isinstance(value, bool | str) or not isinstance(value, int | float):
        return str(value)
    return f"{factor * value:.5g} {unit}".strip()


def _limits(scene: Mapping[str, Any]) -> str:
    reach = scene.get("reach") or {}
    ends = [reach.get(side) or [] for side in ("lower", "upper")]
    if not any(value is not None for side in ends for value in side):
        return "none"
    factors = (MM, MM, MM, DEG, DEG)
    texts = [
        " to ".join("free" if value is None else f"{factor * value:.5g}" for value in pair)
        for factor, *pair in zip(factors, *ends, strict=False)
    ]
    return ", ".join(texts) + " (mm, deg)"


def _rows(title: str, rows: Sequence[tuple[str, str]]) -> str:
    body = "".join(
        f'<tr><th scope="row">{escape(label)}</th><td>{escape(value)}</td></tr>' for label, value in rows
    )
    return f'<div class="wide"><table><caption>{escape(title)}</caption><tbody>{body}</tbody></table></div>'
