"""Geometry for VTK, which needs no OpenGL; drawing it does, and is done in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.image import imread
from picture_runs import drawable

from contour.panel import UNTOUCHED, Bar, Layer, Panel, save_panels
from contour.render import PANELS, build_layer, picture_name

BAR = Bar(label="x", cmap="viridis", low=0.0, high=1.0, ticks=(0.0, 1.0))


def _layer(kind, points, **changes):
    nothing = {"cells": np.zeros(0), "facing": np.zeros((0, 3)), "values": np.zeros(0)}
    return Layer(
        kind=kind,
        points=np.asarray(points, dtype=np.float64),
        **{"colour": "red", "size": 0.1, **nothing, **changes},
    )


def test_dots_are_balls_of_their_radius():
    """Two balls, each with its value."""
    balls = build_layer(_layer("dots", [[0, 0, 0], [5, 0, 0]], size=0.5, values=np.array([1.0, 2.0])))
    np.testing.assert_allclose(balls.bounds, (-0.5, 5.5, -0.5, 0.5, -0.5, 0.5), atol=0.03)
    near = balls.points[:, 0] < 2.0
    assert set(balls.point_data["value"][near]) == {1.0}
    assert set(balls.point_data["value"][~near]) == {2.0}


def test_ellipsoids_reach_along_their_axes():
    """Half axes 3, 2 and 1."""
    balls = build_layer(_layer("ellipsoids", [[1, 1, 1]], cells=np.diag([3.0, 2.0, 1.0])[None]))
    np.testing.assert_allclose(balls.bounds, (-2, 4, -1, 3, 0, 2), atol=0.15)


@pytest.mark.parametrize("kind", ["rods", "arrows"])
def test_rods_and_arrows_go_from_start_to_end(kind):
    """They begin and end where they should; an arrow's head is thicker than its shaft."""
    rod = build_layer(_layer(kind, [[1, 0, 0], [1, 0, 4]], cells=np.array([[0, 1]]), size=0.1))
    assert rod.bounds[4:] == pytest.approx((0.0, 4.0), abs=1e-5)
    wide = np.hypot(rod.points[:, 0] - 1.0, rod.points[:, 1]).max()
    assert wide == pytest.approx(0.1 if kind == "rods" else 0.26, rel=0.02)


def test_lines_and_meshes_keep_cells_and_values():
    """Two lines; a mesh with our normals."""
    lines = build_layer(_layer("lines", np.eye(3), cells=np.array([[0, 1], [1, 2]]), values=np.arange(3.0)))
    assert lines.n_cells == 2
    np.testing.assert_array_equal(lines.point_data["value"], np.arange(3.0))
    mesh = build_layer(_layer("mesh", np.eye(3), cells=np.array([[0, 1, 2]]), facing=np.eye(3)))
    assert mesh.n_cells == 1
    np.testing.assert_array_equal(mesh.point_normals, np.eye(3))


def test_a_child_draws_known_and_unknown_values(tmp_path):
    """Half the mesh has the colour of one, the other is grey; around it all is white."""
    if drawable():
        pytest.skip(drawable())
    corners = np.array([[-1, 0, -1], [0, 0, -1], [0, 0, 1], [-1, 0, 1]], dtype=np.float64)
    facing = np.broadcast_to((0.0, -1.0, 0.0), (4, 3)).copy()
    halves = [
        _layer(
            "mesh",
            corners + np.array([x, 0, 0]),
            cells=np.array([[0, 1, 2], [0, 2, 3]]),
            facing=facing,
            values=v,
        )
        for x, v in ((0.0, np.ones(4)), (1.0, np.full(4, np.nan)))
    ]
    panel = Panel(
        name="surface", title="", caption="", layers=tuple(halves), view=np.array([0.0, -1.0, 0.0]), bar=BAR
    )
    save_panels(tmp_path / PANELS, [panel])
    command = [sys.executable, "-m", "contour.render", str(tmp_path), "--size", "200", "100"]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    image = imread(tmp_path / picture_name(0))[:, :, :3]
    assert image.shape == (200, 400, 3)
    np.testing.assert_allclose(image[100, 150], (0.993, 0.906, 0.144), atol=0.08)
    grey = int(UNTOUCHED[1:3], 16) / 255.0
    np.testing.assert_allclose(image[100, 250], (grey, grey, grey), atol=0.08)
    assert image[100, 20].min() == 1.0
