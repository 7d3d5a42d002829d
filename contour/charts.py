"""Charts as inline SVG: readable in light and dark, on paper and by screen readers; colours come from the page.

The page gives the classes their colours (contour/web/report.css). Every chart has a title and a description.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from contour.evaluate import WITHIN

__all__ = ["MOST_DOTS", "Axis", "nice_ceiling", "ratio_histogram", "scatter", "values_histogram"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

WIDTH, HEIGHT = 480, 300
LEFT, RIGHT, TOP, BOTTOM = 56, 14, 18, 46
"""Margins around the frame [px]."""
MOST_DOTS = 4000
"""Dots of a scatter; of more points as many are drawn, spread evenly over the table."""
MOST_SIGMAS = 4.0
"""Right end of ratios; what lies beyond is counted in a bar of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One axis of a chart."""

    label: str
    low: float
    high: float

    def ticks(self) -> list[float]:
        """Round numbers, four to eight of them, within the axis."""
        step = _round((self.high - self.low) / 5.0, (1.0, 2.0, 5.0, 10.0))
        first = math.ceil(self.low / step - 1e-9)
        return [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]


def nice_ceiling(value: float) -> float:
    """The smallest of 1, 2, 3, 5, 10 times a power of ten that is not below ``value``.

    >>> [nice_ceiling(v) for v in (0.0021, 0.21, 3.2, 80.0)]
    [0.003, 0.3, 5.0, 100.0]
    """
    if not (math.isfinite(value) and value > 0.0):
        return 1.0
    return _round(value, (1.0, 2.0, 3.0, 5.0, 10.0))


def _round(value: float, factors: Sequence[float]) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    factor = next(f for f in factors if f * power >= value * (1.0 - 1e-9))
    return float(f"{factor * power:.12g}")


def ratio_histogram(ratio: FloatArray, *, title: str, what: str) -> str:
    """Errors over claimed sigmas (n,) as a histogram, with what honest sigmas would give drawn over it.

    Args:
        ratio: at least 0.
        title: of the chart.
        what: of which the errors are, for labels.
    """
    bins = 16
    edges = np.linspace(0.0, MOST_SIGMAS, bins + 1)
    inside, _ = np.histogram(ratio, edges)
    beyond = int(np.count_nonzero(ratio > MOST_SIGMAS))
    width = float(edges[1])
    expected = ratio.size * width * math.sqrt(2.0 / math.pi)
    x = Axis(label=f"|error of {what}| / claimed sigma", low=0.0, high=MOST_SIGMAS + 2.0 * width)
    y = Axis(label="contacts", low=0.0, high=1.08 * max(float(inside.max(initial=1)), expected, beyond))
    frame = _Frame(x, y)
    parts = [
        frame.bar(edges[k], edges[k + 1], float(n), "bar", f"{n} contacts") for k, n in enumerate(inside)
    ]
    right = MOST_SIGMAS + 1.6 * width
    parts.append(frame.bar(right - width, right, float(beyond), "bar beyond", f"{beyond} beyond 4 sigma"))
    along = np.linspace(0.0, MOST_SIGMAS, 81)
    parts.append(frame.line(along, expected * np.exp(-0.5 * along**2), "expected"))
    parts.append(frame.line(np.array([WITHIN, WITHIN]), np.array([0.0, y.high]), "limit"))
    share = float(np.mean(ratio <= WITHIN)) if ratio.size else math.nan
    parts.append(frame.note(WITHIN + 0.06, 0.955 * y.high, f"{100.0 * share:.1f} % within 1.96 sigma"))
    parts.append(frame.note(right - 0.5 * width, beyond, str(beyond), "middle"))
    labels = {k: f"{k:g}" for k in range(int(MOST_SIGMAS))} | {right - 0.5 * width: f"> {MOST_SIGMAS:g}"}
    said = (
        f"Histogram of {ratio.size} contacts. {100.0 * share:.1f} % of the errors lie within 1.96 claimed sigmas, "
        f"where 95 % are expected; {beyond} lie beyond {MOST_SIGMAS:g} sigmas."
    )
    keys = (("bar", "contacts"), ("line", "expected of honest sigmas"))
    return frame.svg(title, said, parts, x_labels=labels, keys=keys)


def values_histogram(values: FloatArray, *, title: str, label: str) -> str:
    """Values (n,), at least 0, as a histogram up to their 99th percentile; the rest in the last bar."""
    top = nice_ceiling(float(np.quantile(values, 0.99))) if values.size else 1.0
    edges = np.linspace(0.0, top, 21)
    inside, _ = np.histogram(np.minimum(values, top), edges)
    frame = _Frame(
        Axis(label=label, low=0.0, high=top),
        Axis(label="contacts", low=0.0, high=1.08 * float(inside.max(initial=1))),
    )
    parts = [
        frame.bar(edges[k], edges[k + 1], float(n), "bar", f"{n} contacts") for k, n in enumerate(inside)
    ]
    beyond = int(np.count_nonzero(values > top))
    middle = float(np.median(values)) if values.size else math.nan
    parts.append(frame.line(np.array([middle, middle]), np.array([0.0, frame.y.high]), "limit"))
    parts.append(frame.note(middle, 0.955 * frame.y.high, f" median {middle:.3g}"))
    said = f"Histogram of {values.size} contacts, median {middle:.3g}; {beyond} beyond {top:g} stand in the last bar."
    return frame.svg(title, said, parts)


def scatter(
    x: FloatArray,
    y: FloatArray,
    groups: Mapping[str, BoolArray],
    *,
    title: str,
    x_label: str,
    y_label: str,
    claimed: FloatArray,
    signed: bool,
) -> str:
    """Dots (n,) in colours by group, and the band in which 95 % of them should lie by the claimed sigmas.

    Args:
        x: abscissae.
        y: errors.
        groups: name and mask (n,) of each colour, in the order of the page's colours.
        title: of the chart.
        x_label: with unit.
        y_label: with unit.
        claimed: (n,) sigma of each, in the unit of y.
        signed: whether errors have a sign; if not, the axis starts at 0.
    """
    good = np.isfinite(x) & np.isfinite(y)
    spread = np.abs(y[good])
    top = nice_ceiling(1.15 * float(np.quantile(spread, 0.995))) if good.any() else 1.0
    low, high = (float(x[good].min()), float(x[good].max())) if good.any() else (0.0, 1.0)
    pad = 0.03 * max(high - low, 1e-9 * max(abs(high), 1.0))
    frame = _Frame(
        Axis(label=x_label, low=low - pad, high=high + pad),
        Axis(label=y_label, low=-top if signed else 0.0, high=top),
    )
    parts = [frame.band(*_band(x[good], claimed[good]), signed=signed)]
    outside = int(np.count_nonzero(spread > top))
    chosen = np.zeros(x.size, dtype=bool)
    chosen[np.linspace(0, x.size - 1, min(x.size, MOST_DOTS)).astype(np.int64)] = True
    for number, (name, mask) in enumerate(groups.items()):
        rows = good & mask & chosen
        if rows.any():
            parts.append(frame.dots(x[rows], np.clip(y[rows], frame.y.low, top), f"dots g{number}", name))
    keys = [(f"g{number}", name) for number, (name, mask) in enumerate(groups.items()) if (good & mask).any()]
    said = f"{int(good.sum())} contacts; the band holds 95 % of them if the sigmas are honest."
    if outside:
        said += f" {outside} lie beyond the frame and stand at its edge."
    if chosen.sum() < x.size:
        said += f" {int(chosen.sum())} are drawn, evenly chosen."
    return frame.svg(title, said, parts, keys=[*keys, ("band", "claimed 95 %")])


def _band(x: FloatArray, claimed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Abscissae and heights of the band: 1.96 times the middle sigma of up to 24 equally full stretches."""
    order = np.argsort(x)
    parts = [part for part in np.array_split(order, max(1, min(24, x.size // 12))) if part.size]
    middles = np.array([np.median(x[part]) for part in parts])
    heights = np.array([WITHIN * np.median(claimed[part]) for part in parts])
    first, last = (x.min(), x.max()) if x.size else (0.0, 1.0)
    if not parts:
        return np.array([first, last]), np.zeros(2)
    return np.r_[first, middles, last], np.r_[heights[0], heights, heights[-1]]


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Places data in the frame of a chart."""

    x: Axis
    y: Axis

    def _px(self, x: FloatArray | float) -> FloatArray:
        share = (np.asarray(x, dtype=np.float64) - self.x.low) / (self.x.high - self.x.low)
        return np.asarray(LEFT + share * (WIDTH - LEFT - RIGHT))

    def _py(self, y: FloatArray | float) -> FloatArray:
        share = (np.asarray(y, dtype=np.float64) - self.y.low) / (self.y.high - self.y.low)
        return np.asarray(HEIGHT - BOTTOM - share * (HEIGHT - BOTTOM - TOP))

    def bar(self, left: float, right: float, height: float, style: str, said: str) -> str:
        x0, x1, y0, y1 = self._px(left), self._px(right), self._py(0.0), self._py(height)
        return (
            f'<rect class="{style}" x="{x0 + 0.5:.1f}" y="{y1:.1f}" width="{max(x1 - x0 - 1.0, 0.5):.1f}" '
            f'height="{y0 - y1:.1f}"><title>{escape(said)}</title></rect>'
        )

    def line(self, x: FloatArray, y: FloatArray, style: str) -> str:
        return f'<polyline class="{style}" points="{self._points(x, y)}"/>'

    def band(self, x: FloatArray, height: FloatArray, *, signed: bool) -> str:
        upper = np.minimum(height, self.y.high)
        lower = np.maximum(-height, self.y.low) if signed else np.zeros_like(height)
        outline = self._points(np.r_[x, x[::-1]], np.r_[upper, lower[::-1]])
        return f'<polygon class="band" points="{outline}"/>'

    def dots(self, x: FloatArray, y: FloatArray, style: str, said: str) -> str:
        way = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(self._px(x), self._py(y), strict=True))
        return f'<path class="{style}" d="{way}"><title>{escape(said)}</title></path>'

    def note(self, x: float, y: float, text: str, anchor: str = "start") -> str:
        at = f'x="{self._px(x):.1f}" y="{self._py(y) - 4.0:.1f}"'
        return f'<text class="note" {at} text-anchor="{anchor}">{escape(text)}</text>'

    def _points(self, x: FloatArray, y: FloatArray) -> str:
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(self._px(x), self._py(y), strict=True))

    def svg(
        self,
        title: str,
        said: str,
        parts: Sequence[str],
        *,
        x_labels: Mapping[float, str] | None = None,
        keys: Sequence[tuple[str, str]] = (),
    ) -> str:
        """The chart: axes, ``parts`` over them, title and description, and a key of (class, name)."""
        name = "chart-" + re.sub(r"[^a-z0-9]+", "-", title.lower())
        right, bottom, middle = WIDTH - RIGHT, HEIGHT - BOTTOM, 0.5 * (TOP + HEIGHT - BOTTOM)
        drawn = []
        for value, text in (x_labels or {t: f"{t:.6g}" for t in self.x.ticks()}).items():
            at = float(self._px(value))
            drawn.append(f'<line class="tick" x1="{at:.1f}" x2="{at:.1f}" y1="{bottom}" y2="{bottom + 4}"/>')
            drawn.append(f'<text x="{at:.1f}" y="{bottom + 17}" text-anchor="middle">{escape(text)}</text>')
        for value in self.y.ticks():
            at = float(self._py(value))
            drawn.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{at:.1f}" y2="{at:.1f}"/>')
            drawn.append(f'<text x="{LEFT - 7}" y="{at + 4:.1f}" text-anchor="end">{value:.6g}</text>')
        axis = f'<line class="axis" x1="{LEFT}" x2="{right}" y1="{bottom}" y2="{bottom}"/>'
        names = (
            f'<text class="name" x="{0.5 * (LEFT + right)}" y="{HEIGHT - 8}" text-anchor="middle">'
            f"{escape(self.x.label)}</text>"
            f'<text class="name" transform="translate(13 {middle}) rotate(-90)" text-anchor="middle">'
            f"{escape(self.y.label)}</text>"
        )
        key = "".join(f'<span><i class="{style}"></i>{escape(word)}</span>' for style, word in keys)
        return (
            f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
            f'aria-labelledby="{name}-title {name}-said">'
            f'<title id="{name}-title">{escape(title)}</title>'
            f'<desc id="{name}-said">{escape(said)}</desc>'
            f"{''.join(drawn)}{''.join(parts)}{axis}{names}</svg>"
            f'<figcaption><strong>{escape(title)}</strong><span class="key">{key}</span>'
            f"<span>{escape(said)}</span></figcaption></figure>"
        )
