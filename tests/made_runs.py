"""Finished scans without a scan: result folders whose contacts are made from a shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from contour import cloud, shapes
from contour.contacts import Contacts, Flag
from contour.scene import load_scene

PLACE = np.array([50e-3, 20e-3, 10e-3])
"""Where the ball of :func:`write_ball_run` lies [m]."""
SCENE = '[[object]]\nmesh = "ball.ply"\nunit = "mm"\nposition_mm = [50, 20, 10]\n'


def write_ball_run(folder: Path) -> Path:
    """A folder ``run`` beside ``ball.ply`` and ``ball.toml``: 642 exact contacts all round, one of them flagged
    and 50 mm off.
    """
    mesh = shapes.load("sphere").mesh()
    shapes.write_mesh(folder / "ball.ply", mesh, "ball")
    (folder / "ball.toml").write_text(SCENE, encoding="utf-8")
    normal = np.array(trimesh.creation.icosphere(subdivisions=3).vertices)
    count = len(normal)
    columns = {
        name: np.zeros(count, dtype=column.dtype) for name, column in cloud.table(Contacts.none()).items()
    }
    point = 0.5 * float(np.ptp(mesh.vertices[:, 0])) * normal + PLACE
    columns |= {f"{axis}_m": point[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"n{axis}": normal[:, i] for i, axis in enumerate("xyz")}
    columns |= {"id": np.arange(count), "contour": np.arange(count) // 20, "sequence": np.arange(count) % 20}
    columns |= {"sigma_s_m": np.full(count, 1e-4), "sigma_normal_rad": np.full(count, 5e-3)}
    columns["flags"][5] = int(next(flag for flag in Flag if flag))
    columns["x_m"][5] += 0.05
    run = folder / "run"
    run.mkdir()
    cloud.write_json(run / "run.json", {"seed": 0, "scene": load_scene(folder / "ball.toml").resolved()})
    cloud.write_csv(run / "contacts.csv", columns)
    cloud.write_ply(run / "points.ply", columns, unit="mm")
    cloud.write_vtp(run / "points.vtp", columns, unit="mm")
    cloud.write_json(run / "metrics.json", {"contacts": count, "flagged": 1})
    return run
