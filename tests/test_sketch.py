"""Pictures by matplotlib alone: near hides far, ellipsoids have their outlines, grey where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from contour.panel import UNTOUCHED, Bar, Layer, Panel, camera_of
from contour.sketch import draw_panel, pieces_of

VIEW = np.array([0.0, -1.0, 0.0])
BAR = Bar(label="x", cmap="viridis", low=0.0, high=1.0, ticks=(0.0, 1.0))
SQUARE = np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])


def _layer(kind, points, **changes):
    nothing = {"cells": np.zeros(0), "facing": np.zeros((0, 3)), "values": np.zeros(0)}
    return Layer(
        kind=kind,
        points=np.asarray(points, dtype=np.float64),
        **{"colour": "red", "size": 0.1, **nothing, **changes},
    )


def _square(depth, colour="red", **changes):
    return _layer(
        "mesh", SQUARE + depth * VIEW, cells=np.array([[0, 1, 2], [0, 2, 3]]), colour=colour, **changes
    )


def _panel(*layers):
    return Panel(name="surface", title="", caption="", layers=layers, view=VIEW, bar=BAR)


def _middle(*layers):
    """Colour (3,) in the middle of a picture of the layers."""
    figure = Figure(figsize=(1, 1), dpi=50)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    camera = camera_of(_panel(*layers), 1.0)
    axes.set_xlim(-camera.half_height, camera.half_height)
    axes.set_ylim(-camera.half_height, camera.half_height)
    axes.axis("off")
    draw_panel(axes, _panel(*layers), camera)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[25, 27, :3] / 255.0


@pytest.mark.parametrize("turned", [False, True])
def test_near_hides_far(turned):
    """The square nearer to the camera is seen, in whatever order they come."""
    layers = [_square(1.0, "red"), _square(-1.0, "blue")]
    np.testing.assert_allclose(_middle(*(reversed(layers) if turned else layers)), to_rgb("red"), atol=0.02)


@pytest.mark.parametrize("kind", ["rods", "lines", "dots"])
def test_things_behind_a_surface_are_hidden(kind):
    """In front they are seen, behind not."""
    cells = np.zeros(0) if kind == "dots" else np.array([[0, 1]])
    thing = np.array([[-0.6, 0.0, 0.0], [0.6, 0.0, 0.0]]) if kind != "dots" else np.zeros((1, 3))
    size = 4.0 if kind == "lines" else 0.2
    before = _layer(kind, thing + 0.5 * VIEW, cells=cells, size=size)
    behind = _layer(kind, thing - 0.5 * VIEW, cells=cells, size=size)
    np.testing.assert_allclose(_middle(_square(0.0, "blue"), before), to_rgb("red"), atol=0.02)
    np.testing.assert_allclose(_middle(_square(0.0, "blue"), behind), to_rgb("blue"), atol=0.02)


def test_unknown_values_are_grey():
    """A face with a nan corner is grey; others have the colour of their mean."""
    np.testing.assert_allclose(_middle(_square(0.0, values=np.full(4, np.nan))), to_rgb(UNTOUCHED), atol=0.02)
    np.testing.assert_allclose(_middle(_square(0.0, values=np.ones(4))), (0.993, 0.906, 0.144), atol=0.02)


def test_ellipsoids_have_the_outline_of_their_shadow(rng):
    """An ellipsoid reaches as far in each direction of the picture as the norm of its axes there."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] * np.array([[3.0], [2.0], [0.5]])
    layer = _layer("ellipsoids", np.zeros((1, 3)), cells=axes[None])
    camera = camera_of(_panel(layer), 1.0)
    (piece,) = pieces_of(layer, camera, None)
    corners = piece.corners[0] - piece.corners[0].mean(axis=0)
    shadow = axes @ camera.axes[:2].T
    for turn in np.linspace(0.0, np.pi, 7):
        way = np.array([np.cos(turn), np.sin(turn)])
        # A polygon of ten corners inside an ellipse reaches at least cos(18 deg) as far.
        reach = np.linalg.norm(shadow @ way)
        assert np.cos(np.pi / 10) - 1e-9 <= np.max(corners @ way) / reach <= 1.0 + 1e-9
