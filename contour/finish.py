"""What follows a scan: the surface through its contacts, and in simulation how far that is from the truth.

Neither may lose a scan. What cannot be done is told in the metrics: ``surface`` and ``comparison`` then hold
nothing but ``notes``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.cloud import Table, write_json
from contour.compare import compare, compare_run, surface_through
from contour.errors import ContourError
from contour.results import SURFACE_FILE, load_run, write_surface
from contour.scan import Finish, Job
from contour.surface import Surface, samples_of
from contour.touchable import touchable

__all__ = ["COMPARISON_FILE", "compare_to", "finishing", "surface_metrics"]

FloatArray = NDArray[np.float64]

COMPARISON_FILE = "comparison.json"


def finishing(job: Job) -> Finish:
    """What :func:`contour.scan.run` shall do after the scan of ``job``, by its scene's ``[scan] surface``.

    Given the result folder and the columns of ``contacts.csv``, it writes ``surface.ply`` and returns the
    metrics to add: ``surface`` and, of a surface that was made, ``comparison``; nothing for ``none``.
    """

    def finish(folder: Path, columns: Table) -> dict[str, Any]:
        method = job.scene.scan.surface
        if method == "none":
            return {}
        try:
            surface = surface_through(columns, method)
        except ContourError as error:
            return {"surface": {"notes": [f"no surface: {error}"]}}
        write_surface(folder / SURFACE_FILE, surface, unit=job.unit)
        return {"surface": surface_metrics(surface), "comparison": _compared(job, surface, columns)}

    return finish


def compare_to(mesh: Path, folder: Path, *, unit: str | None = None) -> dict[str, Any]:
    """Compare the surface of the finished scan in ``folder`` with the nominal ``mesh``, a file in ``unit``.

    Returns:
        What it writes into ``comparison.json``: the metrics of :class:`contour.compare.Comparison`, the
        ``mesh`` and the ``surface``'s own. A scan without a surface gets its ``surface.ply``.
    """
    run = load_run(folder)
    surface, found = compare_run(run, mesh, unit=unit)
    if not (folder / SURFACE_FILE).exists():
        write_surface(folder / SURFACE_FILE, surface, unit=run.unit)
    metrics = {"mesh": str(mesh), "surface": surface_metrics(surface), **found.metrics()}
    write_json(folder / COMPARISON_FILE, metrics)
    return metrics


def surface_metrics(surface: Surface) -> dict[str, Any]:
    """What ``metrics.json`` says of ``surface``."""
    return {
        "method": surface.method,
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "watertight": surface.watertight,
        "touched": surface.touched,
        "seconds": surface.seconds,
        "notes": list(surface.notes),
    }


def _compared(job: Job, surface: Surface, columns: Table) -> dict[str, Any]:
    """What ``metrics.json`` says of ``surface`` against the meshes that were scanned."""
    scene, contacts = job.scene, samples_of(columns)
    triangles = job.environment.triangles

    def reachable(points: FloatArray, normals: FloatArray) -> NDArray[np.bool_]:
        return touchable(points, normals, triangles, job.plan, scene.antenna, scene.mount)

    try:
        found = compare(
            surface, triangles, points=contacts.points, normals=contacts.normals, reachable=reachable
        )
    except ContourError as error:
        return {"notes": [f"not compared: {error}"]}
    return found.metrics()
