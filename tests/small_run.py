"""A small scan that is really made, once for all tests: two contours round the sphere, with its surface."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path

from contour import shapes
from contour.cloud import read_csv, write_csv
from contour.compare import surface_through
from contour.contacts import Flag
from contour.results import SURFACE_FILE, write_surface
from contour.scan import prepare, run
from contour.scene import load_scene

SCENE = """
[[object]]
mesh = "sphere.ply"
friction_angle_deg = 17
[scan]
seed = 3
[plan]
family = "silhouettes"
directions = [[0, 1, 0], [1, 0, 0]]
step_mm = 12
"""
FLAGGED, WRONG = 3, 7
"""Contacts of :func:`spoilt_run` that are flagged and silently wrong."""


@functools.cache
def _made() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="contour-small-run-"))
    shapes.write_mesh(folder / "sphere.ply", shapes.load("sphere").mesh(), "sphere")
    (folder / "small.toml").write_text(SCENE, encoding="utf-8")
    run(prepare(load_scene(folder / "small.toml")), folder / "run")
    surface = surface_through(read_csv(folder / "run" / "contacts.csv"), "auto")
    write_surface(folder / "run" / SURFACE_FILE, surface, unit="mm")
    return folder / "run"


def small_run(folder: Path) -> Path:
    """A copy of the scan in ``folder``, for tests to do with as they like."""
    return Path(shutil.copytree(_made(), folder / "small"))


def spoilt_run(folder: Path) -> Path:
    """A copy in which one contact is flagged twice and one is silently wrong by 8 mm."""
    path = small_run(folder)
    table = read_csv(path / "contacts.csv")
    table["flags"][FLAGGED] = int(Flag.SLIP_OFF | Flag.UNRESOLVED)
    table["true_s_m"][WRONG] -= 8e-3
    write_csv(path / "contacts.csv", table)
    return path
