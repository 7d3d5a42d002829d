"""Pages: their size, what stands on them, and that nothing runs off the edge."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread, imsave

from contour.page import SIZE, view_size, write_page
from contour.panel import Bar, Layer, Panel

BAR = Bar(label="deviation [mm]", cmap="RdYlBu_r", low=-1.0, high=1.0, ticks=(-1.0, 0.0, 1.0))


def _panel(label="a label"):
    dots = Layer(
        kind="dots",
        points=0.1 * np.eye(3),
        cells=np.zeros(0),
        facing=np.zeros((0, 3)),
        values=np.zeros(3),
        colour="red",
        size=0.01,
        label=label,
    )
    caption = "many words that go on and on " * 6
    return Panel(
        name="points",
        title="A title",
        caption=caption,
        layers=(dots,),
        view=np.array([0.6, -0.64, 0.48]),
        bar=BAR,
    )


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_pages_have_their_size_and_a_clean_margin(count, tmp_path):
    """1600 x 1200 pixels, something in every view, and nothing but white along the edges."""
    write_page(tmp_path / "page.png", [_panel()] * count, title="a page", foot="below", views=None)
    image = imread(tmp_path / "page.png")[:, :, :3]
    assert image.shape == (SIZE[1], SIZE[0], 3)
    for edge in (image[:4], image[-4:], image[:, :4], image[:, -4:]):
        assert edge.min() == 1.0
    wide, high = view_size(count)
    assert count * wide * high > 0.35 * SIZE[0] * SIZE[1]
    yellow = np.all(np.abs(image - (1.0, 1.0, 0.75)) < 0.02, axis=2)  # the colour of zero
    assert np.count_nonzero(yellow) > 100 * count


def test_views_that_were_drawn_elsewhere_are_put_in(tmp_path):
    """A green picture fills its view and nothing else."""
    wide, high = view_size(1)
    imsave(tmp_path / "view.png", np.broadcast_to(np.array([0.0, 1.0, 0.0]), (high, wide, 3)))
    write_page(tmp_path / "page.png", [_panel()], title="", foot="", views=[tmp_path / "view.png"])
    image = imread(tmp_path / "page.png")[:, :, :3]
    green = np.count_nonzero(np.all(image == (0.0, 1.0, 0.0), axis=2))
    assert 0.97 * wide * high < green <= wide * high


def test_a_page_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    """The disk is full after half of it: the picture of before is still whole."""
    path = tmp_path / "page.png"
    path.write_bytes(b"old")

    def half(_figure, target, **_options):
        target.write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", half)
    with pytest.raises(OSError, match="no space left"):
        write_page(path, [_panel()], title="", foot="", views=None)
    assert path.read_bytes() == b"old"
