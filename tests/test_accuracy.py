"""How right contacts are: regions and truth of known shapes, and the figures of the strategies."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from push_bench import Bench, true_contacts

from contour import shapes
from contour.antenna import Antenna, Sensor
from contour.contacts import Kind
from contour.evaluate import errors_of
from contour.frames import Mount, plane_angle, wrap_angle
from contour.model import ModelStrategy
from contour.plan import default_plan
from contour.regions import REGIONS, TIP, analytic_truth
from contour.shapes import Region

PROGRAM = Path(__file__).resolve().parents[1] / "benchmarks" / "accuracy.py"


@pytest.fixture(scope="module")
def accuracy():
    """The program that makes the table."""
    spec = importlib.util.spec_from_file_location("accuracy", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    sys.modules["accuracy"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["accuracy"]


def frames(beam, up):
    """Rotations sensor to world (n, 3, 3) of beams (n, 3), their x_s axes square to ``up`` (3,)."""
    y = beam / np.linalg.norm(beam, axis=1, keepdims=True)
    x = np.cross(y, up)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack((x, y, np.cross(x, y)), axis=2)


# ------------------------------------------------------------------------------------------- regions and truth


def test_a_side_contact_on_a_rod_has_the_normal_square_to_rod_and_beam(rng):
    """Facets touch beside the place where the smooth side is touched; the truth is there, not on the facet."""
    n = 50
    beam = rng.normal(size=(n, 3))
    rotation = frames(beam, np.array([0.3, 0.2, 1.0]))
    axis = np.array([0.0, 0.0, 1.0])
    square = np.cross(axis, rotation[:, :, 1])
    square /= np.linalg.norm(square, axis=1, keepdims=True)
    turn = np.deg2rad(rng.uniform(-2.0, 2.0, n))  # as far as facets are apart
    aside = np.cross(axis, square)
    radial = np.cos(turn)[:, None] * square + np.sin(turn)[:, None] * aside
    point = 12e-3 * radial + np.array([0.0, 0.0, 0.08])
    mesh = true_contacts(n, point=point, normal=radial, outward=plane_angle(radial, rotation))
    truth = analytic_truth(mesh, rotation, shapes.load("rod12"), np.zeros((n, 3)))
    lean = np.abs(np.sum(rotation[:, :, 1] * axis, axis=1))
    steep = lean < 0.9
    assert steep.sum() > 30
    # The shift is the first order of an arc: turns of 2 deg leave turn^2/2 = 0.04 deg over cos(lean) > 0.4.
    off = wrap_angle(truth.outward - plane_angle(square, rotation))
    assert np.abs(off[steep]).max() < np.deg2rad(0.1)
    assert np.abs(wrap_angle(mesh.outward - plane_angle(square, rotation))[steep]).max() > np.deg2rad(0.5)
    assert (truth.region == Region.ARC).all()


def test_the_truth_follows_the_copy_of_the_shape():
    """A copy of the shape elsewhere in the world has the same normals."""
    place = np.array([[2.0, -1.0, 0.5]])
    way = np.array([[0.6, 0.0, 0.8]])
    rotation = frames(np.array([[0.8, 0.0, -0.6]]), np.array([0.0, 1.0, 0.0]))
    mesh = true_contacts(1, point=59.9e-3 * way + place, normal=way)
    truth = analytic_truth(mesh, rotation, shapes.load("sphere"), place)
    np.testing.assert_allclose(truth.normal, way, atol=1e-12)
    np.testing.assert_allclose(truth.point, 60e-3 * way + place, atol=1e-12)


def test_on_an_edge_the_normal_of_beam_and_edge_is_the_truth():
    """The closest point of a box has no normal at its edge: it is square to beam and edge, if that was the edge."""
    corner = np.abs(shapes.load("box").mesh().vertices).max(axis=0)
    point = np.tile([corner[0], corner[1], 0.01], (3, 1))
    turn = 0.3 + np.deg2rad([0.0, 2.0, 20.0])  # the mesh's; the last one is that of another edge
    normal = np.stack([np.cos(turn), np.sin(turn), np.zeros(3)], axis=1)
    rotation = frames(np.tile([-np.sin(0.3), np.cos(0.3), 0.2], (3, 1)), np.array([0.0, 0.0, 1.0]))
    mesh = true_contacts(3, kind=Kind.EDGE, point=point, normal=normal, outward=plane_angle(normal, rotation))
    truth = analytic_truth(mesh, rotation, shapes.load("box"), np.zeros((3, 3)))
    assert (truth.region == Region.EDGE).all()
    exact = [np.cos(0.3), np.sin(0.3), 0.0]
    np.testing.assert_allclose(truth.normal[:2], [exact, exact], atol=1e-12)
    np.testing.assert_allclose(wrap_angle(truth.outward[:2]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(truth.normal[2], normal[2])
    assert truth.outward[2] == pytest.approx(mesh.outward[2])


@pytest.mark.parametrize(
    "name,centre,axis,size",
    [
        ("rod12", (0.0, 0.0, 0.160), (0.0, 0.0, 1.0), 0.012),
        ("gear", (0.0, 0.0, 0.028), (0.0, 0.0, 1.0), 0.014),
        ("bracket", (0.020, 0.070, 0.010), (0.0, 0.0, 1.0), 0.008),
        ("bracket", (0.060, 0.010, 0.070), (0.0, 1.0, 0.0), 0.012),
    ],
)
def test_on_a_rim_the_normal_is_that_of_the_circle(name, centre, axis, size, rng):
    """Whatever side of a polygon the mesh has there: the circle's tangent is known."""
    n = 40
    first = np.array([1.0, 0.0, 0.0])
    second = np.cross(axis, first)
    turn = rng.uniform(0.0, 2.0 * np.pi, (n, 1))
    point = centre + size * (np.cos(turn) * first + np.sin(turn) * second)
    beam = rng.normal(size=(n, 3))
    rotation = frames(beam, np.array([0.3, 0.2, 1.0]))
    normals = []
    for off in (0.0, np.deg2rad(1.5)):  # the circle, and a side of a polygon
        tangent = -np.sin(turn + off) * first + np.cos(turn + off) * second
        square = np.cross(rotation[:, :, 1], tangent)
        normals.append(square / np.linalg.norm(square, axis=1, keepdims=True))
    mesh = true_contacts(
        n, kind=Kind.EDGE, point=point, normal=normals[1], outward=plane_angle(normals[1], rotation)
    )
    truth = analytic_truth(mesh, rotation, shapes.load(name), np.zeros((n, 3)))
    assert (truth.region == Region.EDGE).all()
    steep = np.sum(normals[0] * normals[1], axis=1) > np.cos(np.deg2rad(4.0))
    assert steep.sum() > 20
    np.testing.assert_allclose(truth.normal[steep], normals[0][steep], atol=1e-9)
    np.testing.assert_allclose(
        wrap_angle(truth.outward - plane_angle(normals[0], rotation))[steep], 0.0, atol=1e-9
    )


def test_a_line_contact_belongs_to_the_face_it_lies_on():
    """Its sensed end lies on an edge, the beam on the face."""
    high = np.abs(shapes.load("box").mesh().vertices).max(axis=0)
    rotation = frames(np.array([[0.0, 1.0, 0.0]]), np.array([0.0, 0.0, 1.0]))
    point = np.array([[high[0], -high[1], 0.01]])
    mesh = true_contacts(1, kind=Kind.LINE, point=point, normal=np.array([[1.0, 0.0, 0.0]]))
    truth = analytic_truth(mesh, rotation, shapes.load("box"), np.zeros((1, 3)))
    assert truth.region[0] == Region.FACE
    np.testing.assert_array_equal(truth.point, point)


def test_a_tip_is_a_region_of_its_own():
    """Wherever on the shape it is."""
    rotation = frames(np.array([[-0.6, 0.8, 0.0]]), np.array([0.0, 0.0, 1.0]))
    mesh = true_contacts(1, kind=Kind.TIP, point=[[60e-3, 0.0, 0.0]], normal=[[1.0, 0.0, 0.0]])
    truth = analytic_truth(mesh, rotation, shapes.load("sphere"), np.zeros((1, 3)))
    assert truth.region[0] == TIP
    assert REGIONS[TIP] == "tip"
    # The tip touches where it touches: the whole normal, its part along the beam too.
    np.testing.assert_allclose(truth.normal, [[1.0, 0.0, 0.0]], atol=1e-12)


# ------------------------------------------------------------------------------------------ figures of strategies


def drawn(n, rng):
    """n contacts of all sorts, and how far the expected normals are off [rad]."""
    friction = np.tan(np.deg2rad(rng.choice([3.0, 10.0, 17.0, 25.0], n)))
    truth = true_contacts(
        n,
        distance=rng.uniform(0.03, 0.2, n),
        friction=friction,
        radius_along=rng.uniform(0.0, 0.06, n),
        radius_across=rng.uniform(0.015, 0.08, n),
    )
    return truth, np.deg2rad(rng.uniform(-25.0, 25.0, n))


@pytest.mark.parametrize("exact", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_first_contacts_of_the_model_are_localised(rng, exact):
    """First contacts, nothing known but the approach, on round bodies, default noise: s and its interval."""
    n = 400
    truth, off = drawn(n, rng)
    bench = Bench(truth, sensor=Sensor(), expected_off=off, exact=exact)
    found = bench.localise(
        ModelStrategy(n, bench.antenna, bench.mount), expected_sigma=np.full(n, np.deg2rad(25.0))
    )
    errors = errors_of(found, truth, bench.antenna.beam.length)
    good = found.good
    assert np.sqrt(np.mean(errors.distance_relative[good] ** 2)) < 2.5e-3
    assert np.quantile(np.abs(errors.distance_relative[good]), 0.99) < 8e-3
    assert errors.distance_covered[good].mean() > 0.92
    assert found.pushes.mean() < 2.3


def test_the_table_counts_every_contact_once(accuracy):
    """Rows of regions add up to the row of all; the pushes are those of all contacts."""
    outcome = accuracy.measure("cylinder", "one-push", contours=8, step=40e-3, rung="reduced")
    rows = accuracy.rows_of("cylinder", "one-push", outcome)
    assert len(rows) > 2
    assert rows[0]["contacts"] == len(outcome.contacts) == sum(row["contacts"] for row in rows[1:])
    assert {row["region"] for row in rows[1:]} <= set(REGIONS)
    assert rows[0]["pushes"] == outcome.contacts.pushes.mean() == 1.0
    assert outcome.first.sum() == np.unique(outcome.contacts.which).size
    text = accuracy.markdown(rows)
    assert text.count("\n") == 2 + len(rows)
    # Each copy of the shape has its own friction, and contacts of all four are there.
    np.testing.assert_allclose(
        np.unique(np.round(np.arctan(outcome.truth.friction), 9)), np.round(accuracy.FRICTION_ANGLES, 9)
    )


def test_joined_plans_keep_their_planes_apart(accuracy):
    """Contours of one plane wait for each other: those of different bodies must not share one."""
    box = np.array([[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]])
    parts = [default_plan(box + place, Antenna(), Mount.identity(), contours=6) for place in (0.0, 1.0)]
    plan = accuracy.joined(parts)
    assert plan.contours == len(plan.label) == sum(part.contours for part in parts)
    assert np.unique(plan.plane).size == sum(np.unique(part.plane).size for part in parts)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_contours_of_the_model_meet_the_figures_on_round_bodies(accuracy, name):
    """s of contacts along contours, sides only, friction angles 3 to 25 deg that the estimator does not know."""
    outcome = accuracy.measure(name, "model", contours=16, step=15e-3)
    side = outcome.take(outcome.region == Region.ARC)
    row = accuracy.row_of(side)
    assert row["s rms %"] < 0.25
    assert row["s p99 %"] < 0.8
    assert row["pushes"] < 1.5
    assert row["s cover"] > 0.92
