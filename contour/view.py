"""Pictures of a scan, for people: a window, or a PNG.

VTK draws them in a process of its own with a time limit, since it crashes where OpenGL is absent. If that fails
matplotlib draws them here, and what is returned says which it was, why, and what to install.
"""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contour import mesh_io
from contour.compare import TOLERANCE, compare
from contour.errors import ContourError, UsageError
from contour.page import view_size, write_page
from contour.panel import VIEWS, Panel, save_panels
from contour.panels import build_panels, title_of
from contour.quantities import closest
from contour.render import PANELS, picture_name
from contour.results import Run, load_surface
from contour.scene import scene_of_record
from contour.surface import Surface

__all__ = ["ALL", "PATIENCE", "PICTURE", "Picture", "picture", "window", "window_possible"]

FloatArray = NDArray[np.float64]

PICTURE = "view.png"
"""In the result folder, where no other name is asked for."""
ALL = "all"
PATIENCE = 180.0
"""VTK is given up after this time [s]; software rendering of four views takes a few."""
_CHILD = ("-m", "contour.render")
"""Arguments of the interpreter that draws by VTK."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What was made."""

    path: Path | None
    """The PNG; None of a window."""
    drawn_by: str
    """VTK or matplotlib."""
    views: tuple[str, ...]
    """What it shows, of ``contour.panel.VIEWS``."""
    notes: tuple[str, ...]
    """What could not be shown or done, and what to do about it, a line each."""


def picture(
    run: Run,
    path: Path | None = None,
    *,
    what: str = ALL,
    contact: int | None = None,
    tolerance: float = TOLERANCE,
    deviation: FloatArray | None = None,
    patience: float = PATIENCE,
) -> Picture:
    """Write a PNG of a run, 1600 x 1200 pixels; by VTK if it can, else by matplotlib.

    Args:
        run: a finished scan.
        path: of the PNG; ``view.png`` in the run's folder if not given.
        what: one of VIEWS, or ``all`` for four of them on a page.
        contact: at which the antenna is shown; a typical one if not given.
        tolerance: marked on the bar of deviations [m].
        deviation: (v,) m, of the vertices of the run's surface, where it is known already; computed if not
            given, from the meshes that the run's record names.
        patience: time given to VTK [s].

    Raises:
        UsageError: a view, contact or path that there is not.
    """
    target = run.folder / PICTURE if path is None else path
    if target.suffix.lower() != ".png":
        raise UsageError(f"--out {target} is no PNG: give a name that ends in .png")
    if not target.parent.is_dir():
        raise UsageError(f"--out {target}: the folder {target.parent} does not exist: make it first")
    panels, notes = _prepared(run, what, contact, tolerance, deviation)
    title = title_of(run)
    with tempfile.TemporaryDirectory(prefix="contour-view-") as name:
        folder = Path(name)
        save_panels(folder / PANELS, panels)
        wide, high = view_size(len(panels))
        trouble = _draw(folder, ("--size", str(wide), str(high)), patience)
        views = [folder / picture_name(number) for number in range(len(panels))]
        if not trouble and not all(view.is_file() for view in views):
            trouble = "it ended without a picture"
        if trouble:
            notes = (*notes, f"drawn by matplotlib, since VTK failed: {trouble}; {_remedy()}")
        drawn_by = "matplotlib" if trouble else "VTK"
        foot = f"drawn by {drawn_by}, parallel projection"
        write_page(target, panels, title=title, foot=foot, views=None if trouble else views)
    return Picture(path=target, drawn_by=drawn_by, views=tuple(p.name for p in panels), notes=notes)


def window(
    run: Run, *, what: str = ALL, contact: int | None = None, tolerance: float = TOLERANCE
) -> Picture | str:
    """Show a run in a window, and come back when it is closed; why not, if no window could be opened."""
    panels, notes = _prepared(run, what, contact, tolerance, None)
    with tempfile.TemporaryDirectory(prefix="contour-view-") as name:
        save_panels(Path(name) / PANELS, panels)
        trouble = _draw(Path(name), ("--window", title_of(run)), None)
    if trouble:
        return trouble
    return Picture(path=None, drawn_by="VTK", views=tuple(p.name for p in panels), notes=notes)


def window_possible() -> bool:
    """Whether there is a display: on Linux one must be named in the environment."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def _prepared(
    run: Run, what: str, contact: int | None, tolerance: float, deviation: FloatArray | None
) -> tuple[list[Panel], tuple[str, ...]]:
    """The panels asked for, and what they do not show."""
    if what != ALL and what not in VIEWS:
        raise UsageError(f"--what {what!r} is unknown: {closest(what, (*VIEWS, ALL))}")
    count = run.contour.size
    if contact is not None and not 0 <= contact < count:
        raise UsageError(f"--contact {contact} is not there: the run has contacts 0 to {count - 1}")
    if contact is not None and not np.isfinite(run.points[contact]).all():
        raise UsageError(f"--contact {contact} has no place: it was felt nowhere; choose another one")
    if not tolerance > 0.0:
        raise UsageError(f"tolerance is {1e3 * tolerance:g} mm: it must be above zero")
    surface = load_surface(run)
    notes: tuple[str, ...] = ()
    if surface is None:
        if what == "surface":
            raise UsageError(
                f"{run.folder} has no surface.ply: compare it with a mesh (contour compare), which makes one"
            )
        notes = ("no surface.ply in the folder: points with normals are shown instead of the surface",)
    elif deviation is None and what in {ALL, "surface"}:
        deviation, reason = _deviation(run, surface)
        notes = (reason,) if reason else ()
    names: Sequence[str] = (what,)
    if what == ALL:
        names = ("contours", "points" if surface is None else "surface", "uncertainty", "antenna")
    panels = build_panels(
        run, tuple(names), surface=surface, deviation=deviation, contact=contact, tolerance=tolerance
    )
    return panels, notes


def _deviation(run: Run, surface: Surface) -> tuple[FloatArray | None, str]:
    """Deviation (v,) m of the surface from the meshes that the run's record names; why not, if not."""
    if np.count_nonzero(run.good) < 2:
        return None, "no deviation shown: fewer than two contacts have no flag"
    try:
        parts = [
            mesh_io.as_triangles(mesh_io.load_scene(body.mesh, unit=body.unit, transform=body.placement))
            for body in scene_of_record(run.record["scene"], run.folder).bodies
        ]
        triangles = np.concatenate([part.vertices[part.faces] for part in parts])
        found = compare(surface, triangles, points=run.points[run.good], normals=run.normals[run.good])
    except ContourError as error:
        return None, f"no deviation shown: {error}"
    return found.deviation, ""


def _draw(folder: Path, options: tuple[str, ...], patience: float | None) -> str:
    """Let a child draw the panels in ``folder``; empty if all went well, else what went wrong."""
    command = [sys.executable, *_CHILD, str(folder), *options]
    try:
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, errors="replace", timeout=patience
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {patience:g} s"
    except OSError as error:
        return f"no process could be started ({error})"
    if done.returncode < 0:
        return f"its process crashed ({signal.Signals(-done.returncode).name})"
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    return ""


@functools.cache
def _remedy() -> str:
    """What the doctor says about pictures; asked once, since a look takes seconds."""
    from contour.doctor import examine

    found = next(finding for finding in examine() if finding.what.startswith("pictures"))
    return "'contour doctor' finds no fault with VTK: try again" if found.good else found.remedy
