"""Words: nothing that a run may hold goes unexplained."""

from __future__ import annotations

from small_run import small_run

from contour.compare import compare
from contour.contacts import Flag, Kind
from contour.glossary import FLAGS, KINDS, STATUSES, UNKNOWN, meaning_of
from contour.results import load_run, load_surface
from contour.sections import figure_rows
from contour.shapes import load
from contour.trace import Status


def test_every_figure_of_a_scan_has_a_meaning(tmp_path):
    """A real scan's metrics, its surface's and a comparison's are all explained."""
    run = load_run(small_run(tmp_path))
    surface, mesh = load_surface(run), load("sphere").mesh()
    found = compare(surface, mesh.vertices[mesh.faces], points=run.points).metrics()
    parts = ("method", "vertices", "faces", "watertight", "touched", "seconds", "notes")
    metrics = {**run.metrics, "surface": dict.fromkeys(parts), "comparison": found | {"notes": ["so"]}}
    keys = [key for key, *_ in figure_rows(metrics)]
    assert len(keys) > 30
    assert [key for key in keys if meaning_of(key) == UNKNOWN] == []


def test_every_flag_kind_and_ending_has_words():
    """None is forgotten when one is added."""
    assert set(FLAGS) == {flag for flag in Flag if flag}
    assert set(KINDS) == set(Kind)
    assert set(STATUSES) == set(Status)


def test_unknown_figures_are_owned_up_to():
    """What nobody explained has no invented meaning."""
    assert meaning_of("phlogiston_m") == UNKNOWN
    assert meaning_of("comparison.phlogiston_m") == UNKNOWN
