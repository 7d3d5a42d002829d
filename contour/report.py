"""The report of a scan: one HTML page that holds everything it shows and loads nothing.

``report.html`` in the result folder opens from a file, with no network: figures with what they mean, errors
against claimed sigmas, flags, the setting, pictures, and a 3-D view (contour/web; docs/decisions/0007).
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import replace
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

import contour
from contour import sections
from contour.claims import claims_of
from contour.cloud import read_json, replace_file
from contour.errors import UsageError
from contour.results import Run, load_surface
from contour.setting import setting_html
from contour.surface import Surface
from contour.web_scene import MOST_FACES, build_scene, script_of, untouched_beyond

__all__ = ["REPORT_FILE", "write_report"]

FloatArray = NDArray[np.float64]

REPORT_FILE = "report.html"
PICTURE_FILE = "view.png"
COMPARISON_FILE = "comparison.json"
LOG_FILE = "log.jsonl"
MM = 1e3

_CONTENTS = (
    ("summary", "Summary"),
    ("object", "3-D view"),
    ("figures", "Figures"),
    ("claims", "Errors and claims"),
    ("care", "Flags"),
    ("contours", "Contours"),
    ("pictures", "Pictures"),
    ("setup", "Setting"),
    ("definitions", "Terms"),
)


def write_report(run: Run, path: Path | None = None) -> Path:
    """Write the report of ``run``; the file's path, ``report.html`` in the run's folder if none is given."""
    path = run.folder / REPORT_FILE if path is None else path
    run = _with_comparison(run)
    length = _beam_length(run)
    claims = None if length is None else claims_of(run, length)
    endings = _endings(run)
    surface = load_surface(run)
    deviation, notes = _deviation(run, surface)
    if surface is None:
        notes += ("There is no surface.ply in the folder: the 3-D view shows contacts and contours only.",)
    closed = frozenset(int(e["contour"]) for e in endings or () if e.get("status") == "closed")
    scene = build_scene(run, surface, deviation=deviation, claims=claims, closed=closed)
    title = f"{_name(run)}: shape by touch"
    far = MM * untouched_beyond(run)
    page = Template(_part("report.html")).substitute(
        title=escape(title),
        lead=_lead(run),
        version=escape(contour.__version__),
        contents="".join(f'<a href="#{key}">{text}</a>' for key, text in _CONTENTS),
        tiles=sections.tiles_html(run),
        findings=sections.findings_html(run, endings, notes),
        canvas_label=escape(f"3-D view of {_name(run)} with {scene['contacts']['count']} contacts"),
        untouched=f"grey stripes: not touched, farther than {far:.1f} mm from any contact on its side",
        view_notes=_view_notes(run, surface, scene),
        figures=sections.figures_html(run.metrics),
        claims=sections.claims_html(run, claims),
        care=sections.care_html(run, claims),
        contours=sections.contours_html(endings),
        pictures=_pictures(run),
        setup=setting_html(run),
        definitions=sections.definitions_html(),
        folder=escape(run.folder.name),
        scene=script_of(scene),
        style=_part("report.css"),
        script=_part("viewer.js"),
    )
    replace_file(path, page.encode("utf-8"))
    return path


def _part(name: str) -> str:
    return (resources.files("contour") / "web" / name).read_text(encoding="utf-8")


def _name(run: Run) -> str:
    return str((run.record.get("scene") or {}).get("name") or run.folder.name)


def _lead(run: Run) -> str:
    """One sentence: what this is."""
    scene = run.record.get("scene") or {}
    beam = (scene.get("antenna") or {}).get("beam") or {}
    with_what = ""
    if "length" in beam and "diameter" in beam:
        with_what = f" with a wire {MM * beam['length']:.4g} mm long and {MM * beam['diameter']:.3g} mm thick"
    strategy = (scene.get("scan") or {}).get("strategy")
    by = f", strategy {escape(str(strategy))}" if strategy else ""
    how = "in simulation" if "true_s_m" in run.contacts else "on a machine"
    contours = np.unique(run.contour).size
    return f"{run.good.size:,} contacts on {contours} contours, made{with_what} {how}{by}."


def _with_comparison(run: Run) -> Run:
    """The run with what was compared later (``contour compare``), as the figure ``compared``."""
    path = run.folder / COMPARISON_FILE
    if not path.is_file():
        return run
    compared = {key: value for key, value in read_json(path).items() if key != "surface"}
    return replace(run, metrics={**run.metrics, "compared": compared})


def _beam_length(run: Run) -> float | None:
    value: Any = run.record.get("scene")
    for key in ("antenna", "beam", "length"):
        value = value.get(key) if isinstance(value, Mapping) else None
    return float(value) if value is not None else None


def _endings(run: Run) -> list[dict[str, Any]] | None:
    """The log's events of contours that ended; None where there is no log."""
    path = run.folder / LOG_FILE
    if not path.is_file():
        return None
    try:
        events = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except ValueError as error:
        raise UsageError(f"{path} is damaged ({error}): restore it, or remove it to do without") from error
    return [event for event in events if event.get("event") == "contour"]


def _deviation(run: Run, surface: Surface | None) -> tuple[FloatArray | None, tuple[str, ...]]:
    """Signed distances of the surface's vertices from the scene's meshes [m]; why not, where they are not known."""
    if surface is None:
        return None, ()
    from contour.compare import compare
    from contour.mesh_io import as_triangles, load_scene
    from contour.scene import scene_of_record

    try:
        bodies = scene_of_record(run.record["scene"], run.folder).bodies
    except (KeyError, TypeError, IndexError):
        return None, ("run.json names no mesh: deviations from a nominal surface are not known.",)
    try:
        parts = [as_triangles(load_scene(b.mesh, unit=b.unit, transform=b.placement)) for b in bodies]
        triangles = np.concatenate([part.vertices[part.faces] for part in parts])
        points, normals = run.points[run.good], run.normals[run.good]
        return compare(surface, triangles, points=points, normals=normals).deviation, ()
    except UsageError as error:
        return None, (f"Deviations from the nominal surface are not known: {error}.",)


def _view_notes(run: Run, surface: Surface | None, scene: dict[str, Any]) -> str:
    notes = []
    left_out = run.good.size - scene["contacts"]["count"]
    if left_out:
        notes.append(f"{left_out} contacts have no place and are not shown.")
    if surface is not None and len(surface.faces) > MOST_FACES:
        notes.append(
            f"The surface has {len(surface.faces):,} triangles; it is shown with {MOST_FACES:,}, its colours are those "
            "of the whole."
        )
    return " ".join(notes)


def _pictures(run: Run) -> str:
    path = run.folder / PICTURE_FILE
    if not path.is_file():
        return '<p class="absent">There is no picture in the folder; <code>contour view</code> makes one.</p>'
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    about = escape(f"Views of {_name(run)}: contacts, contours and surface")
    return f'<div class="pictures"><img src="data:image/png;base64,{content}" alt="{about}"></div>'
