"""A small finished scan to make pictures of: three contours round the sphere, with its surface."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

from contour import shapes
from contour.cloud import Table
from contour.compare import compare
from contour.doctor import examine
from contour.finish import surface_metrics
from contour.results import SURFACE_FILE, write_surface
from contour.scan import prepare, run
from contour.scene import load_scene
from contour.surface import reconstruct, samples_of

SCENE = """
[[object]]
mesh = "ball.ply"
[scan]
seed = 3
[plan]
family = "silhouettes"
directions = [[0, 1, 0], [1, 0, 0], [0.5, 0.5, 0.7]]
step_mm = 14
"""
SPACING = 5e-3
"""Of the surface's grid [m]: coarse, so that it is drawn in no time."""
CRASH = ("-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
"""What a process that crashes as VTK does without OpenGL is given."""


@functools.cache
def _scanned() -> Path:
    """The scan, made once in a session."""
    folder = Path(tempfile.mkdtemp(prefix="contour-pictures-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    scene = folder / "ball.toml"
    shapes.write_mesh(folder / "ball.ply", shapes.load("sphere").mesh(), "ball")
    scene.write_text(SCENE, encoding="utf-8")
    job = prepare(load_scene(scene))

    def finish(results: Path, columns: Table) -> dict[str, Any]:
        seen = samples_of(columns)
        surface = reconstruct(seen.points, seen.normals, spacing=SPACING)
        write_surface(results / SURFACE_FILE, surface, unit="mm")
        found = compare(surface, job.environment, points=seen.points, normals=seen.normals)
        return {"surface": surface_metrics(surface), "comparison": found.metrics()}

    run(job, folder / "run", finish=finish)
    return folder / "run"


def copied_run(folder: Path) -> Path:
    """A copy of the scan in ``folder``, to write into."""
    return Path(shutil.copytree(_scanned(), folder / "run"))


@functools.cache
def drawable() -> str:
    """Why VTK cannot draw on this machine; empty if it can."""
    pictures = examine()[-1]
    return "" if pictures.good else f"VTK cannot draw here: {pictures.found}; {pictures.remedy}"
