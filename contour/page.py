"""Panels side by side on one page, with title, colour bars, legends, axes and captions: a PNG by matplotlib.

The views themselves are pictures that VTK made, or painted by :mod:`contour.sketch`; the words are the same.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.panel import Camera, Panel, camera_of, framed_points
from contour.sketch import draw_panel

__all__ = ["SIZE", "view_size", "write_page"]

FloatArray = NDArray[np.float64]

SIZE = (1600, 1200)
"""Of the page [pixels]."""
_DPI = 100
_TOP, _BOTTOM, _SIDE = 64, 34, 16
"""Room for the page's title and foot, and beside panels [pixels]."""
_HEAD, _STRIP, _FOOT = 34, 70, 38
"""Room in a panel for its title above the view, for bar and legend below, and for the caption [pixels]."""
_GAP = 22
"""Between panels [pixels]."""
_LETTER = 8.0
"""Width of a caption's letters, at most [pixels]."""
_INK, _PALE = "#1c1f24", "#5b6069"


def _grid(count: int) -> tuple[int, int]:
    """Rows and columns for ``count`` panels."""
    across = 1 if count == 1 else 2
    return -(-count // across), across


def view_size(count: int) -> tuple[int, int]:
    """Width and height of the view of each of ``count`` panels [pixels]."""
    down, across = _grid(count)
    wide = (SIZE[0] - 2 * _SIDE - (across - 1) * _GAP) / across
    high = (SIZE[1] - _TOP - _BOTTOM - (down - 1) * _GAP) / down - _HEAD - _STRIP - _FOOT
    return int(wide), int(high)


def write_page(
    path: Path, panels: Sequence[Panel], *, title: str, foot: str, views: Sequence[Path] | None
) -> None:
    """Write the page as PNG.

    Args:
        path: of the PNG.
        panels: one to four.
        title: of the page.
        foot: small, below.
        views: pictures of the panels, of the aspect of :func:`view_size`; painted here if None.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(_SIDE / SIZE[0], 1.0 - 20 / SIZE[1], title, size=17, weight="bold", color=_INK, va="top")
    figure.text(_SIDE / SIZE[0], 10 / SIZE[1], foot, size=9.5, color=_PALE, va="bottom")
    wide, high = view_size(len(panels))
    _, across = _grid(len(panels))
    for number, panel in enumerate(panels):
        left = _SIDE + (number % across) * (wide + _GAP)
        top = _TOP + (number // across) * (_HEAD + high + _STRIP + _FOOT + _GAP)
        camera = camera_of(panel, wide / high)
        box = (left, top + _HEAD, wide, high)
        axes = _view(figure, box, camera)
        if views is None:
            draw_panel(axes, panel, camera)
        else:
            from matplotlib.image import imread

            w, h = camera.half_height * wide / high, camera.half_height
            axes.imshow(
                imread(views[number]), extent=(-w, w, -h, h), interpolation="antialiased", aspect="auto"
            )
        _triad(axes, panel, camera, wide / high)
        figure.text(*_place(left, top + 8), panel.title, size=13.5, weight="bold", color=_INK, va="top")
        below = top + _HEAD + high
        figure.text(
            *_place(left, below + _STRIP + 6),
            textwrap.fill(panel.caption, int(wide / _LETTER)),
            size=10.5,
            color=_PALE,
            va="top",
        )
        _explain(figure, panel, left, below, wide)
    partial = path.with_name(path.name + ".part")
    figure.savefig(partial, format="png")
    partial.replace(path)


def _place(x: float, y: float) -> tuple[float, float]:
    """Page coordinates of a spot in pixels from the upper left."""
    return x / SIZE[0], 1.0 - y / SIZE[1]


def _box(left: float, top: float, wide: float, high: float) -> tuple[float, float, float, float]:
    return left / SIZE[0], 1.0 - (top + high) / SIZE[1], wide / SIZE[0], high / SIZE[1]


def _view(figure: Any, box: tuple[float, float, float, float], camera: Camera) -> Any:
    """Axes for a view: m in the plane of its camera."""
    axes = figure.add_axes(_box(*box))
    across = camera.half_height * box[2] / box[3]
    axes.set_xlim(-across, across)
    axes.set_ylim(-camera.half_height, camera.half_height)
    axes.set_autoscale_on(False)
    axes.set_xticks([])
    axes.set_yticks([])
    for edge in axes.spines.values():
        edge.set_color("#d5d8dd")
    return axes


def _triad(axes: Any, panel: Panel, camera: Camera, aspect: float) -> None:
    """The world's axes, of a stated length, in the corner where least is drawn."""
    high = camera.half_height
    length = _round_length(0.25 * high)
    seen = framed_points(panel)
    at = camera.project(seen[:: max(len(seen) // 20000, 1)])[:, :2]
    corners = [
        np.array([x * (high * aspect - 0.36 * high), y * 0.6 * high]) for x in (-1, 1) for y in (-1, 1)
    ]
    crowd = [np.count_nonzero(np.max(np.abs(at - corner), axis=1) < 0.36 * high) for corner in corners]
    centre = corners[int(np.argmin(crowd))]
    for axis, (name, colour) in enumerate(zip("xyz", ("#b03030", "#2f8f2f", "#3050b0"), strict=True)):
        way = camera.axes[:2, axis] * length
        axes.plot(
            *np.stack((centre, centre + way), axis=1), color=colour, linewidth=2.2, solid_capstyle="round"
        )
        size = float(np.linalg.norm(way))
        label = centre + way + 0.07 * high * (way / size if size > 0.15 * length else np.array([0.7, -0.7]))
        axes.text(*label, name, size=11, color=colour, ha="center", va="center", weight="bold")
    low = min(float(camera.axes[1].min()), 0.0) * length - 0.17 * high
    text = f"axes {1e3 * length:g} mm"
    axes.text(centre[0], centre[1] + low, text, size=10, color=_INK, ha="center", va="center")


def _round_length(about: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``about``."""
    power = 10.0 ** math.floor(math.log10(about))
    return power * max(f for f in (1.0, 2.0, 5.0) if f * power <= about * (1.0 + 1e-9))


def _explain(figure: Any, panel: Panel, left: float, top: float, wide: float) -> None:
    """Colour bar and legend below a view, side by side."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D

    room = wide
    if panel.bar is not None:
        bar = panel.bar
        cax = figure.add_axes(_box(left + 12, top + 10, 0.5 * wide, 13))
        scale = ScalarMappable(Normalize(bar.low, bar.high), bar.cmap)
        extend = "both" if bar.low < 0.0 else "neither"
        drawn = figure.colorbar(
            scale, cax=cax, orientation="horizontal", ticks=list(bar.ticks), extend=extend
        )
        drawn.ax.tick_params(labelsize=10.5, color=_INK, labelcolor=_INK, pad=2)
        drawn.ax.set_xticklabels(
            [f"{tick:+.3g}" if bar.low < 0.0 and tick else f"{tick:.3g}" for tick in bar.ticks]
        )
        drawn.set_label(bar.label, size=11, color=_INK, labelpad=2)
        room = 0.45 * wide
    keys = []
    for layer in panel.layers:
        if layer.label:
            line = layer.kind in {"lines", "rods", "arrows"}
            colour = "#777777" if layer.values.size else layer.colour
            shown = {"linewidth": 2.5} if line else {"marker": "o", "linestyle": "none", "markersize": 8}
            keys.append(Line2D([], [], color=colour, label=layer.label, **shown))
    if keys:
        figure.legend(
            handles=keys,
            loc="upper right" if panel.bar is not None else "upper left",
            bbox_to_anchor=_box(left + wide - room, top + 2, room, 60),
            ncols=1 if panel.bar is not None else 3,
            fontsize=10.5,
            frameon=False,
            labelcolor=_INK,
            borderaxespad=0.0,
        )
