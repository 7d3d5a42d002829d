"""Panels: cameras that show everything, and files that give back what was put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contour.panel import Bar, Layer, Panel, camera_of, framed_points, load_panels, save_panels


def _layer(kind, points, **changes):
    nothing = {"cells": np.zeros(0), "facing": np.zeros((0, 3)), "values": np.zeros(0)}
    plain = {"colour": "red", "size": 1.0, **nothing, **changes}
    return Layer(kind=kind, points=np.asarray(points, dtype=np.float64), **plain)


def _panel(*layers, view=(0.6, -0.64, 0.48), bar=None):
    view = np.array(view) / np.linalg.norm(view)
    return Panel(name="points", title="t", caption="c", layers=layers, view=view, bar=bar)


@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
def test_camera_shows_every_point(rng, aspect):
    """All points lie in the picture, and in one direction they nearly fill it."""
    points = rng.normal(size=(200, 3)) * (0.3, 0.1, 0.2) + (5.0, -3.0, 1.0)
    camera = camera_of(_panel(_layer("dots", points)), aspect)
    at = camera.project(points)
    share = np.abs(at[:, :2]).max(axis=0) / (aspect * camera.half_height, camera.half_height)
    assert np.all(share <= 1.0)
    assert 0.85 < share.max() < 0.97


def test_camera_has_z_up_and_right_handed_axes():
    """The world's z points up in the picture, and right x up is towards the camera."""
    camera = camera_of(_panel(_layer("dots", np.eye(3))), 1.0)
    assert camera.axes[0, 2] == pytest.approx(0.0, abs=1e-12)
    assert camera.axes[1, 2] > 0.5
    np.testing.assert_allclose(np.cross(camera.axes[0], camera.axes[1]), camera.axes[2], atol=1e-12)
    near, far = camera.project(np.array([camera.axes[2], -camera.axes[2]]))
    assert near[2] > far[2]


def test_what_is_not_framed_does_not_shrink_the_picture():
    """A flagged contact far off leaves the camera where it was."""
    near = _layer("dots", np.eye(3))
    far = _layer("dots", [[50.0, 0.0, 0.0]], framed=False)
    assert camera_of(_panel(near, far), 1.0).half_height == camera_of(_panel(near), 1.0).half_height
    framed = replace(far, framed=True)
    assert camera_of(_panel(near, framed), 1.0).half_height > 5.0


def test_ends_of_ellipsoids_are_framed():
    """The longest half axis counts, not only the centre."""
    balls = _layer("ellipsoids", [[0.0, 0.0, 0.0]], cells=np.diag([3.0, 1.0, 1.0])[None])
    assert np.ptp(framed_points(_panel(balls))[:, 0]) == pytest.approx(6.0)


def test_panels_survive_their_file(tmp_path, rng):
    """Arrays, texts, bars and their absence come back as they were."""
    bar = Bar(label="deviation [mm]", cmap="RdYlBu_r", low=-1.0, high=1.0, ticks=(-1.0, 0.0, 1.0))
    mesh = _layer(
        "mesh",
        rng.normal(size=(4, 3)),
        cells=np.array([[0, 1, 2], [0, 2, 3]]),
        values=np.array([0.1, np.nan, -0.2, 0.3]),
        label="\N{PLUS-MINUS SIGN}",
        framed=False,
    )
    panels = [_panel(mesh, _layer("dots", np.eye(3)), bar=bar), _panel(mesh)]
    save_panels(tmp_path / "panels.npz", panels)
    again = load_panels(tmp_path / "panels.npz")
    assert [panel.bar for panel in again] == [bar, None]
    for one, other in zip(panels, again, strict=True):
        assert (one.name, one.title, one.caption) == (other.name, other.title, other.caption)
        np.testing.assert_array_equal(one.view, other.view)
        for a, b in zip(one.layers, other.layers, strict=True):
            assert (a.kind, a.colour, a.size, a.label, a.framed) == (
                b.kind,
                b.colour,
                b.size,
                b.label,
                b.framed,
            )
            for name in ("points", "cells", "facing", "values"):
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
