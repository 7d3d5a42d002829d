"""Panels drawn by matplotlib alone, which needs no OpenGL: everything is flat pieces, painted from far to near."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.panel import UNTOUCHED, Bar, Camera, Layer, Panel

__all__ = ["Pieces", "draw_panel", "pieces_of"]

FloatArray = NDArray[np.float64]

_ROUND = 10
"""Corners of a dot."""
_BITS = 32
"""Pieces of a rod, so that each is painted at its own depth."""
_LIFT = 0.012
"""Lines and dots on a surface are painted this share of the picture's height nearer than they are."""
_DARKEST = 0.45
"""Brightness of what is seen edge-on."""


class Pieces(NamedTuple):
    """Polygons or strokes in the picture's plane."""

    corners: FloatArray
    """(k, c, 2) m; a stroke has two."""
    depth: FloatArray
    """(k,) m towards the camera."""
    colours: FloatArray
    """(k, 4) RGBA."""
    width: float
    """Of their edges [points]."""


def pieces_of(layer: Layer, camera: Camera, bar: Bar | None) -> list[Pieces]:
    """A layer, cut up and coloured."""
    if not len(layer.points) or (layer.kind == "dots" and layer.size <= 0.0):
        return []
    at = camera.project(layer.points)
    lift = _LIFT * 2.0 * camera.half_height
    colours = _colours(layer, bar)
    if layer.kind == "mesh":
        corners = at[layer.cells]
        edge = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        tall = np.abs(edge[:, 2]) / np.maximum(np.linalg.norm(edge, axis=1), 1e-30)
        shade = _DARKEST + (1.0 - _DARKEST) * tall
        # The value of a face is that of its corners; where one of them has none, neither has the face.
        values = layer.values[layer.cells].mean(axis=1) if layer.values.size else layer.values
        own = _rgba(values, bar) if values.size else np.repeat(colours[:1], len(corners), axis=0)
        own[:, :3] *= shade[:, None]
        return [Pieces(corners[:, :, :2], corners[:, :, 2].mean(axis=1), own, 0.4)]
    if layer.kind == "lines":
        ends = at[layer.cells]
        return [
            Pieces(ends[:, :, :2], ends[:, :, 2].mean(axis=1) + lift, colours[layer.cells[:, 0]], layer.size)
        ]
    if layer.kind in {"dots", "ellipsoids"}:
        turn = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
        circle = np.stack((np.cos(turn), np.sin(turn)))
        flat = np.repeat(layer.size * np.eye(2)[None], len(at), axis=0)
        if layer.kind == "ellipsoids":
            # An ellipsoid with half axes a_i looks like the ellipse with the matrix sum a_i a_i^T of their shadows.
            shadow = layer.cells @ camera.axes[:2].T
            values, vectors = np.linalg.eigh(np.einsum("kij,kil->kjl", shadow, shadow))
            flat = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        corners = at[:, None, :2] + np.einsum("kij,jc->kci", flat, circle)
        return [Pieces(corners, at[:, 2] + lift, colours, 0.0)]
    ends = at[layer.cells]
    return [piece for start, end in ends for piece in _rod(layer, start, end, colours[0])]


def _rod(layer: Layer, start: FloatArray, end: FloatArray, colour: FloatArray) -> list[Pieces]:
    """A rod or an arrow as a row of quadrangles, and the arrow's head."""
    way = end - start
    length = float(np.linalg.norm(way[:2]))
    if length < 1e-12:
        return []
    aside = layer.size * np.array([-way[1], way[0]]) / length
    head = min(8.0 * layer.size / float(np.linalg.norm(way)), 0.6) if layer.kind == "arrows" else 0.0
    share = np.linspace(0.0, 1.0 - head, _BITS + 1)
    spots = start + share[:, None] * way
    left, right = spots[:, :2] + aside, spots[:, :2] - aside
    quads = np.stack((left[:-1], left[1:], right[1:], right[:-1]), axis=1)
    depth = 0.5 * (spots[1:, 2] + spots[:-1, 2]) + layer.size
    pieces = [Pieces(quads, depth, np.repeat(colour[None], _BITS, axis=0), 0.4)]
    if head:
        neck = spots[-1]
        tip = np.stack((neck[:2] + 2.6 * aside, end[:2], neck[:2] - 2.6 * aside))
        pieces.append(Pieces(tip[None], np.array([0.5 * (neck[2] + end[2])]), colour[None], 0.4))
    return pieces


def _colours(layer: Layer, bar: Bar | None) -> FloatArray:
    """(k, 4) RGBA of the layer's points."""
    from matplotlib.colors import to_rgba

    if layer.values.size and bar is not None:
        return _rgba(layer.values, bar)
    return np.repeat(np.array([to_rgba(layer.colour)]), len(layer.points), axis=0)


def _rgba(values: FloatArray, bar: Bar | None) -> FloatArray:
    from matplotlib import colormaps
    from matplotlib.colors import to_rgba

    assert bar is not None
    share = (values - bar.low) / (bar.high - bar.low)
    colours = np.array(colormaps[bar.cmap](np.clip(np.nan_to_num(share), 0.0, 1.0)))
    colours[np.isnan(values)] = to_rgba(UNTOUCHED)
    return colours


def draw_panel(axes: Any, panel: Panel, camera: Camera) -> None:
    """Paint the panel into matplotlib ``axes``, whose data are m in the plane of ``camera``."""
    from matplotlib.collections import PolyCollection

    pieces = [piece for layer in panel.layers for piece in pieces_of(layer, camera, panel.bar)]
    if not pieces:
        return
    order = np.argsort(np.concatenate([piece.depth for piece in pieces]), kind="stable")
    corners = [outline for piece in pieces for outline in piece.corners]
    colours = np.concatenate([piece.colours for piece in pieces])[order]
    widths = np.concatenate([np.full(len(piece.depth), piece.width) for piece in pieces])[order]
    axes.add_collection(
        PolyCollection(
            [corners[i] for i in order],
            facecolors=colours,
            edgecolors=colours,
            linewidths=widths,
            antialiased=True,
        )
    )
