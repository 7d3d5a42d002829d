"""Charts: what is drawn is what the numbers say."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from contour.charts import (
    HEIGHT,
    MOST_DOTS,
    WIDTH,
    Axis,
    nice_ceiling,
    ratio_histogram,
    scatter,
    values_histogram,
)


def _svg(figure):
    return ET.fromstring(figure[figure.index("<svg") : figure.index("</svg>") + 6])  # noqa: S314 - of our own making


def _bars(figure):
    return [rect for rect in _svg(figure).iter("rect") if rect.get("class").startswith("bar")]


def _scatter(x, y, claimed, **options):
    everything = {"all": np.ones(x.size, dtype=bool)}
    words = {"title": "Dots", "x_label": "x", "y_label": "y", "signed": True}
    return scatter(x, y, everything, claimed=claimed, **(words | options))


def test_honest_sigmas_follow_the_expected_curve(rng):
    """Bars of 100,000 normal errors meet the half-normal curve to 3 %, and 95 % lie within 1.96."""
    figure = ratio_histogram(np.abs(rng.standard_normal(100_000)), title="Honest", what="s")
    heights = np.array([float(bar.get("height")) for bar in _bars(figure)[:6]])
    curve = next(line for line in _svg(figure).iter("polyline") if line.get("class") == "expected")
    places = np.array([[float(v) for v in pair.split(",")] for pair in curve.get("points").split()])
    middles = np.array([float(bar.get("x")) + 0.5 * float(bar.get("width")) for bar in _bars(figure)[:6]])
    foot = max(float(bar.get("y")) + float(bar.get("height")) for bar in _bars(figure))
    np.testing.assert_allclose(heights, foot - np.interp(middles, places[:, 0], places[:, 1]), rtol=0.03)
    share = float(re.search(r"([\d.]+) % within 1.96", figure).group(1))
    assert share == pytest.approx(95.0, abs=0.3)


def test_errors_beyond_the_frame_are_counted():
    """Five errors beyond 4 sigmas, infinite ones too, stand in the last bar."""
    figure = ratio_histogram(np.r_[np.full(20, 0.5), np.full(4, 9.0), np.inf], title="Bold", what="s")
    assert _bars(figure)[-1].find("title").text == "5 beyond 4 sigma"
    assert "5 lie beyond 4 sigmas" in figure


def test_every_bar_counts():
    """The bars' counts add up to all values."""
    for figure in (
        ratio_histogram(np.linspace(0.0, 6.0, 333), title="A", what="s"),
        values_histogram(np.linspace(0.0, 1.0, 333), title="B", label="x"),
    ):
        counts = [int(bar.find("title").text.split()[0]) for bar in _bars(figure)]
        assert sum(counts) == 333


def test_dots_stay_in_the_frame_and_outliers_are_said(rng):
    """A far outlier stands at the edge, and the description says so."""
    y = rng.standard_normal(500)
    y[7] = 1e3
    figure = _scatter(np.linspace(0.0, 1.0, 500), y, np.ones(500))
    way = next(path for path in _svg(figure).iter("path")).get("d")
    places = np.array([[float(a), float(b)] for a, b in re.findall(r"M([\d.]+) ([\d.]+)h0", way)])
    assert len(places) == 500
    assert (places >= 0.0).all()
    assert (places <= [WIDTH, HEIGHT]).all()
    assert "lie beyond the frame" in figure


def test_many_dots_are_thinned_and_that_is_said():
    """Of 9,000 points no more than MOST_DOTS are drawn."""
    x = np.linspace(0.0, 1.0, 9000)
    figure = _scatter(x, np.sin(x), np.ones(9000))
    assert figure.count("h0") == MOST_DOTS
    assert f"{MOST_DOTS} are drawn" in figure


@pytest.mark.parametrize("count", [0, 1])
def test_next_to_nothing_can_be_drawn(count):
    """No or one contact makes a chart, without warnings."""
    values = np.full(count, 0.3)
    for figure in (
        ratio_histogram(values, title="A", what="s"),
        values_histogram(values, title="B", label="x"),
        _scatter(values, values, values),
    ):
        assert _svg(figure).get("role") == "img"


def test_charts_are_described_and_escaped():
    """Title and description are those that the picture points at; names from outside end no element."""
    figure = _scatter(np.arange(3.0), np.arange(3.0), np.ones(3), title="a < b & c", x_label="<script>")
    svg = _svg(figure)
    assert svg.find("title").text == "a < b & c"
    assert svg.get("aria-labelledby").split() == [svg.find("title").get("id"), svg.find("desc").get("id")]
    assert "<script>" not in figure


def test_ticks_are_round_and_inside():
    """Ticks are multiples of 1, 2 or 5 within the axis."""
    assert Axis(label="", low=-0.31, high=0.31).ticks() == pytest.approx([-0.2, 0.0, 0.2], abs=1e-12)
    assert nice_ceiling(0.31) == 0.5
    assert nice_ceiling(float("nan")) == 1.0
