"""What panels show: lines between neighbours only, deviations centred at zero, grey where nothing touched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from picture_runs import copied_run

from contour.contacts import Flag
from contour.panel import VIEWS
from contour.panels import build_panels, default_contact, title_of
from contour.results import load_run, load_surface
from contour.stance import stance_of
from contour.surface import FAR


@pytest.fixture
def run(tmp_path):
    """A small scan with a surface."""
    return load_run(copied_run(tmp_path))


def _one(run, name, **options):
    options = {"surface": load_surface(run), "deviation": None, **options}
    return build_panels(run, (name,), **options)[0]


def _of(panel, kind):
    return [layer for layer in panel.layers if layer.kind == kind]


def _with_flag(run, row, *, aside=0.5):
    columns = {**run.contacts, "flags": run.contacts["flags"].copy(), "x_m": run.contacts["x_m"].copy()}
    columns["flags"][row] = int(Flag.UNRESOLVED)
    columns["x_m"][row] += aside
    return replace(run, contacts=columns)


def test_every_view_has_its_panel(run):
    """Each has a title, and none needs a surface but that of the surface."""
    assert [_one(run, name).name for name in VIEWS] == list(VIEWS)
    assert all(_one(run, name, surface=None).layers for name in VIEWS if name != "surface")
    assert title_of(run).startswith("ball: 87 contacts on 3 contours")


def test_contour_lines_join_neighbours_only(run):
    """A closed contour has as many lines as contacts; a flagged one takes both of its lines away."""
    (lines,) = _of(_one(run, "contours"), "lines")
    assert len(lines.cells) == run.contour.size
    steps = np.linalg.norm(np.diff(lines.points[lines.cells], axis=1)[:, 0], axis=1)
    assert steps.max() < 25e-3  # the step is 14 mm
    assert lines.values.min() == 0.0
    assert lines.values.max() == 100.0
    (fewer,) = _of(_one(_with_flag(run, 10, aside=0.0), "contours"), "lines")
    assert len(fewer.cells) == run.contour.size - 2


def test_contour_lines_do_not_cross_gaps(run):
    """A good contact 0.2 m away from its neighbours is not joined to them."""
    away = replace(run, contacts={**run.contacts, "x_m": run.contacts["x_m"].copy()})
    away.contacts["x_m"][10] += 0.2
    (lines,) = _of(_one(away, "contours"), "lines")
    assert len(lines.cells) == run.contour.size - 2


def test_the_order_along_a_contour_is_what_is_coloured(run):
    """Values grow with the sequence from 0 to 100 % of each contour."""
    (lines,) = _of(_one(run, "contours"), "lines")
    for contour in range(3):
        rows = np.flatnonzero(run.contour == contour)
        place = lines.values[rows[np.argsort(run.order[rows])]]
        np.testing.assert_allclose(place, np.linspace(0.0, 100.0, rows.size))


def test_flagged_contacts_are_shown_but_not_framed(run):
    """Half a metre off: in the legend, far off said, and no matter to the camera."""
    flagged = [layer for layer in _one(_with_flag(run, 10), "contours").layers if "flagged" in layer.label]
    assert flagged[0].label == "1 flagged,\n1 of them far off"
    assert not flagged[0].framed
    assert not [layer for layer in _one(run, "contours").layers if "flagged" in layer.label]


def test_deviations_are_centred_signed_and_grey_where_untouched(run):
    """The bar is symmetric and names sign, unit and tolerance; values are in mm where touched, nan elsewhere."""
    surface = load_surface(run)
    deviation = np.linspace(-0.4e-3, 0.9e-3, len(surface.vertices))
    panel = _one(run, "surface", deviation=deviation, tolerance=0.2e-3)
    assert panel.bar.low == -panel.bar.high
    assert {-0.2, 0.0, 0.2} <= {round(tick, 9) for tick in panel.bar.ticks}
    for word in ("deviation [mm]", "+ = outside", "\N{PLUS-MINUS SIGN}0.2"):
        assert word in panel.bar.label
    far = FAR * np.ptp(run.points, axis=0).max()
    (mesh,) = _of(panel, "mesh")
    np.testing.assert_array_equal(np.isnan(mesh.values), surface.trust > far)
    touched = surface.trust <= far
    np.testing.assert_allclose(mesh.values[touched], 1e3 * deviation[touched])
    assert any(f"within {1e3 * far:.2g} mm" in layer.label for layer in panel.layers)


def test_without_nominal_mesh_the_distance_to_contacts_is_shown(run):
    """Another bar and title, and it is said."""
    panel = _one(run, "surface")
    assert panel.bar.label == "distance to the nearest contact [mm]"
    assert "no nominal mesh" in panel.caption


def test_ellipsoids_lie_along_the_beam_by_the_stated_factor(run):
    """Half the length is factor times sigma of s; colours are sigmas of the normal in degrees."""
    panel = _one(run, "uncertainty")
    (balls,) = _of(panel, "ellipsoids")
    factor = int(balls.label.split("drawn ")[1].split()[0])
    assert factor > 1
    length = np.linalg.norm(balls.cells[:, 0], axis=1)
    np.testing.assert_allclose(length, factor * run.contacts["sigma_s_m"], rtol=1e-9)
    stance = stance_of(run, 5)
    along = (stance.tip - stance.base) / np.linalg.norm(stance.tip - stance.base)
    np.testing.assert_allclose(balls.cells[5, 0] / length[5], along, atol=1e-9)
    np.testing.assert_allclose(balls.values, np.rad2deg(run.contacts["sigma_smooth_normal_rad"]))


def test_the_antenna_is_drawn_from_base_to_tip(run):
    """Rod and arrows are where the stance says, and the caption has s with its sigma."""
    stance = stance_of(run, 40)
    panel = _one(run, "antenna", contact=40)
    (beam,) = _of(panel, "rods")
    np.testing.assert_allclose(beam.points, [stance.base, stance.tip])
    arrows = {layer.label: np.diff(layer.points, axis=0)[0] for layer in _of(panel, "arrows")}
    for label, way in (("push", stance.push), ("force on the beam", stance.force), ("normal", stance.normal)):
        assert arrows[label] @ way == pytest.approx(np.linalg.norm(arrows[label]) * np.linalg.norm(way))
    assert (
        f"s = {1e3 * stance.distance:.2f} \N{PLUS-MINUS SIGN} {1e3 * stance.sigma_distance:.2f} mm"
        in panel.caption
    )
    assert "contact 40 " in panel.title


def test_the_usual_contact_is_good_and_midway(run):
    """About 0.6 of the beam's length from the base, and never a flagged one."""
    usual = default_contact(run)
    assert 0.5 * 0.21 < run.contacts["s_m"][usual] < 0.7 * 0.21
    assert default_contact(_with_flag(run, usual)) != usual
