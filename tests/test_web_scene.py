"""The scene of the 3-D view: packed arrays say what the run says."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from small_run import FLAGGED, WRONG, small_run, spoilt_run

from contour import web_scene
from contour.claims import claims_of
from contour.results import load_run, load_surface
from contour.web_scene import build_scene, script_of, untouched_beyond

CLOSED = frozenset({0, 1})


def _unpacked(packed):
    values = np.frombuffer(base64.b64decode(packed["data"]), dtype="<" + packed["type"]).astype(float)
    return values * packed.get("scale", 1.0)


@pytest.fixture
def run(tmp_path):
    """A scan with one flagged contact and one that is silently wrong."""
    return load_run(spoilt_run(tmp_path))


def _scene(run, **options):
    usual = {"deviation": None, "claims": claims_of(run, 0.21), "closed": CLOSED}
    return build_scene(run, load_surface(run), **(usual | options))


def test_contacts_keep_their_places(run):
    """Differences between contacts are those of the run, in mm, to single precision."""
    scene = _scene(run)
    position = _unpacked(scene["contacts"]["columns"]["position"]).reshape(-1, 3)
    apart = position - position[0]
    np.testing.assert_allclose(apart, 1e3 * (run.points - run.points[0]), atol=1e-4)
    normal = _unpacked(scene["contacts"]["columns"]["normal"]).reshape(-1, 3) / 127.0
    np.testing.assert_allclose(normal, run.normals, atol=0.5 / 127.0)


def test_surface_is_fine_enough(run):
    """Vertices are kept to 0.005 mm, faces as they are, and contacts lie on it in the same frame."""
    scene, surface = _scene(run), load_surface(run)
    vertices = _unpacked(scene["surface"]["position"]).reshape(-1, 3)
    middle = vertices[0] - 1e3 * surface.vertices[0]
    np.testing.assert_allclose(vertices - middle, 1e3 * surface.vertices, atol=0.01)
    assert _unpacked(scene["surface"]["index"]).astype(int).reshape(-1, 3).tolist() == surface.faces.tolist()
    position = _unpacked(scene["contacts"]["columns"]["position"]).reshape(-1, 3)
    np.testing.assert_allclose(position - middle, 1e3 * run.points, atol=0.01)


def test_deviation_keeps_sign_and_size(run):
    """Plus stays plus, in mm, and the share within the tolerance is that of the area."""
    surface = load_surface(run)
    deviation = np.where(surface.vertices[:, 2] > 0.0, 1e-4, -5e-4)
    field = _scene(run, deviation=deviation)["surface"]["fields"][0]
    np.testing.assert_allclose(_unpacked(field["values"]), 1e3 * deviation, atol=1e-3)
    assert (field["name"], field["map"], field["marks"]) == ("deviation", "diverging", 0.3)
    assert "held by" in field["said"]
    assert not any(f["name"] == "deviation" for f in _scene(run)["surface"]["fields"])


def test_marks_of_trust_reach_the_page(run):
    """Which contacts are flagged and silently wrong, and which vertices are untouched."""
    scene, surface = _scene(run), load_surface(run)
    columns = scene["contacts"]["columns"]
    assert np.flatnonzero(_unpacked(columns["flags"])).tolist() == [FLAGGED]
    assert np.flatnonzero(_unpacked(columns["wrong"])).tolist() == [WRONG]
    touched = _unpacked(scene["surface"]["touched"]).astype(bool)
    assert touched.tolist() == (surface.trust <= untouched_beyond(run)).tolist()
    assert not touched.all()  # two contours leave most of a ball untouched


def test_lines_join_unflagged_neighbours(run):
    """Lines run along contours, close where the contour did, and leave out what is flagged."""
    pairs = _unpacked(_scene(run)["segments"]).astype(int).reshape(-1, 2)
    assert FLAGGED not in pairs
    assert (run.contour[pairs[:, 0]] == run.contour[pairs[:, 1]]).all()
    ends = [p for p in pairs.tolist() if abs(run.order[p[0]] - run.order[p[1]]) > 2]
    assert len(ends) == 2  # one for each closed contour
    opened = _unpacked(_scene(run, closed=frozenset())["segments"]).astype(int).reshape(-1, 2)
    assert len(opened) == len(pairs) - 2


def test_no_line_across_a_gap(run):
    """A contour with a wide gap is not joined across it."""
    rows = np.flatnonzero(run.contour == 0)
    moved = rows[np.argsort(run.order[rows])][len(rows) // 2]
    run.contacts["x_m"][moved] += 0.5
    pairs = _unpacked(_scene(run)["segments"]).astype(int)
    assert moved not in pairs


def test_large_surfaces_are_made_coarser(run, monkeypatch):
    """No more triangles than a page holds, near the surface, with the colours of the nearest vertices."""
    surface = load_surface(run)
    most = len(surface.faces) // 4
    monkeypatch.setattr(web_scene, "MOST_FACES", most)
    height = surface.vertices[:, 2].copy()
    packed = _scene(run, deviation=height)["surface"]
    assert len(_unpacked(packed["index"])) / 3 <= most
    vertices = _unpacked(packed["position"]).reshape(-1, 3)
    deviation = _unpacked(packed["fields"][0]["values"])
    offset = np.median(vertices[:, 2] - deviation)
    assert np.abs(vertices[:, 2] - deviation - offset).max() < 3.0  # [mm], an edge of the finer surface


def test_runs_without_surface_or_truth_have_scenes(run):
    """Contacts alone are shown; there is nothing about errors."""
    scene = build_scene(run, None, deviation=None, claims=None, closed=frozenset())
    assert scene["surface"] is None
    assert "wrong" not in scene["contacts"]["columns"]
    assert all("error" not in item["label"] for item in scene["contacts"]["readout"])


def test_contacts_without_a_place_are_left_out(run):
    """What has no finite place cannot be shown; the rest can."""
    run.contacts["x_m"][FLAGGED] = np.nan
    scene = _scene(run)
    assert scene["contacts"]["count"] == len(run.good) - 1
    assert FLAGGED not in _unpacked(scene["contacts"]["columns"]["id"])


def test_json_cannot_end_its_script():
    """No tag can be written inside; the text stays what it was."""
    text = script_of({"name": "</script><script>alert(1)"})
    assert "<" not in text
    assert json.loads(text) == {"name": "</script><script>alert(1)"}


def test_pages_stay_small(tmp_path):
    """60,000 triangles and 3,000 contacts take less than 2 MB: by the bytes each of them takes here."""
    run = load_run(small_run(tmp_path))
    surface = load_surface(run)
    scene = _scene(run, deviation=np.zeros(len(surface.vertices)))
    each_face = len(script_of(scene["surface"])) / len(surface.faces)
    each_contact = len(script_of(scene["contacts"])) / len(run.good)
    assert 60_000 * each_face + 3_000 * each_contact < 2e6
