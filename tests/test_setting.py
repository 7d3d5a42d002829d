"""The setting: what run.json says, in the units of people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_run import small_run

from contour.results import load_run
from contour.setting import setting_html


def test_setting_names_object_antenna_and_seed(tmp_path):
    """Mesh, friction, beam, noise, plan and seed with units."""
    text = setting_html(load_run(small_run(tmp_path)))
    for label, value in (
        ("friction angle", "17.0 deg (coefficient 0.31); no estimator knows it"),
        ("length", "210 mm"),
        ("diameter", "0.8 mm"),
        ("Young&#x27;s modulus", "206 GPa"),
        ("noise of a moment", "10 \N{MICRO SIGN}N m"),
        ("family of contours", "silhouettes"),
        ("step between contacts", "12 mm"),
        ("seed of all chance", "3"),
        ("axis limits (X, Y, Z, phi1, phi2)", "none"),
    ):
        assert f'<th scope="row">{label}</th><td>{value}</td>' in text


def test_placed_objects_and_limits_are_said(tmp_path):
    """Where the body stood, and where the base may go."""
    run = load_run(small_run(tmp_path))
    scene = run.record["scene"]
    placement = np.eye(4)
    placement[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    placement[:3, 3] = [0.01, 0.02, -0.03]
    scene["objects"][0]["placement"] = placement.tolist()
    scene["reach"]["upper"] = [None, None, 0.4, None, np.pi / 2]
    text = setting_html(run)
    assert "(10.0, 20.0, -30.0) mm, turned by 90.0 deg" in text
    assert "free to free, free to free, free to 400, free to free, free to 90 (mm, deg)" in text


def test_a_bare_record_is_no_trouble(tmp_path):
    """Where run.json says nothing, the report says that it is not known."""
    run = replace(load_run(small_run(tmp_path)), record={})
    text = setting_html(run)
    assert '<th scope="row">length</th><td>not known</td>' in text
    assert '<th scope="row">commit</th><td>not known</td>' in text


def test_texts_of_the_record_are_escaped(tmp_path):
    """A name is a name, not markup."""
    run = load_run(small_run(tmp_path))
    run.record["scene"]["name"] = "<b>mug</b>"
    assert "<b>" not in setting_html(run)
