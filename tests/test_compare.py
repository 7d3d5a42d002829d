"""Surfaces against nominal meshes: cases with known answers, and runs that cannot be compared."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from made_runs import PLACE, write_ball_run

from contour import cloud
from contour.compare import check_units, compare, compare_run, reach_of, surface_of
from contour.errors import UsageError
from contour.mesh_env import MeshEnvironment
from contour.nearest import Target, as_faces
from contour.results import SURFACE_FILE, load_run, write_surface
from contour.scene import load_scene, scene_of_record
from contour.surface import Surface


def _surface(mesh):
    """A mesh as a reconstructed surface."""
    count = len(mesh.vertices)
    return Surface(
        vertices=np.array(mesh.vertices),
        faces=np.array(mesh.faces),
        normals=np.array(mesh.vertex_normals),
        trust=np.zeros(count),
        sigma=np.zeros(count),
        method="hermite",
        watertight=bool(mesh.is_watertight),
        touched=1.0,
        notes=(),
        seconds=0.0,
    )


def _ball(radius, subdivisions=5):
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def _whole_and_half():
    """A ball of 200 mm with a ring of vertices on its equator, and the half of it above."""
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 129)
    arc = 0.1 * np.column_stack((np.cos(turn), np.sin(turn)))
    arc[[0, 64, 128]] = [0.0, -0.1], [0.1, 0.0], [0.0, 0.1]
    whole = trimesh.creation.revolve(arc, sections=256)
    half = trimesh.Trimesh(whole.vertices, whole.faces[whole.triangles_center[:, 2] > 0.0])
    assert half.bounds[0, 2] == pytest.approx(0.0, abs=1e-12)
    return whole, half


@pytest.mark.parametrize("radius", [0.101, 0.099])
def test_concentric_spheres_are_the_difference_of_radii_apart(radius):
    """Accuracy, completeness and deviation are 1 mm, plus outside; the F-score falls where 1 mm is passed."""
    made, nominal = _ball(radius), _ball(0.1)
    found = compare(_surface(made), np.array(nominal.triangles), points=np.array(made.vertices))
    off = radius - 0.1
    for one in (found.accuracy, found.completeness):
        for value in (one.mean, one.rms, one.hausdorff95, one.largest):
            assert value == pytest.approx(abs(off), rel=2e-3)
    np.testing.assert_allclose(found.deviation, off, rtol=2e-3)
    assert found.normal_median < 1e-6
    assert found.normal_p95 < np.deg2rad(0.5)
    assert found.reachable == 1.0
    assert found.notes == ()
    for shrunk, score in ((0.9, 1.0), (1.1, 0.0)):
        other = compare(
            _surface(_ball(0.1 + shrunk * off)), np.array(nominal.triangles), points=made.vertices
        )
        assert other.f_score == score


def test_directions_are_told_apart():
    """Half a sphere is accurate but not complete; a whole one against half of it is the reverse.

    From the missing half, points at elevation a below the rim are 2 R sin(a / 2) away from it: 0.55 R on
    average, R sqrt(2) at the pole, over half of the area.
    """
    whole, half = _whole_and_half()
    one = compare(_surface(half), np.array(whole.triangles), points=np.array(half.vertices))
    assert one.accuracy.largest < 1e-9
    a = np.linspace(0.0, np.pi / 2, 20001)
    mean = 0.1 * np.trapezoid(2.0 * np.sin(a / 2) * np.cos(a), a)
    assert one.completeness.mean == pytest.approx(0.5 * mean, rel=5e-3)
    assert one.completeness.largest == pytest.approx(0.1 * np.sqrt(2.0), rel=1e-2)
    other = compare(_surface(whole), np.array(half.triangles), points=np.array(half.vertices))
    assert other.completeness.largest < 1e-9
    assert other.accuracy.mean == pytest.approx(0.5 * mean, rel=5e-3)
    assert one.f_score == pytest.approx(2 * 0.5 / 1.5, abs=0.01)
    assert one.touched == pytest.approx(0.5 + 0.5 * np.sin(0.05), abs=0.01)  # 5 mm past the rim


def test_only_what_is_reachable_counts():
    """The same half sphere, with nothing below its rim reachable: complete."""
    whole, half = _whole_and_half()
    found = compare(
        _surface(half),
        np.array(whole.triangles),
        points=np.array(half.vertices),
        reachable=lambda points, normals: (points[:, 2] > 0.0) & (normals[:, 2] > 0.0),
    )
    assert found.reachable == pytest.approx(0.5, abs=0.01)
    assert found.completeness.largest < 1e-4
    assert found.f_score == 1.0
    nothing = compare(
        _surface(half),
        np.array(whole.triangles),
        points=np.array(half.vertices),
        reachable=lambda points, normals: (points[:, 2] > 1.0) & (normals[:, 2] > 0.0),
    )
    assert np.isnan(nothing.completeness.mean)
    assert "no beam" in nothing.notes[0]


def test_a_cup_is_missed_inside_by_a_surface_without_hollow(tmp_path):
    """A cup, reached by the default plan, against its hull: only its touchable inside is missing."""
    outline = [[0, 0], [0.03, 0], [0.03, 0.06], [0.025, 0.06], [0.025, 0.005], [0, 0.005]]
    cup = trimesh.creation.revolve(np.array(outline), sections=96)
    hull = trimesh.creation.cylinder(radius=0.03, height=0.06, sections=96)
    hull.apply_translation([0.0, 0.0, 0.03])
    triangles = np.array(cup.triangles)
    cup.export(tmp_path / "cup.ply")  # a scene has a file; the plan follows from the triangles
    reachable = reach_of(load_scene(tmp_path / "cup.ply", unit="m"), triangles)
    fair = compare(_surface(hull), triangles, points=np.array(hull.vertices), reachable=reachable)
    unfair = compare(_surface(hull), triangles, points=np.array(hull.vertices))
    assert 0.75 < fair.reachable < 0.95
    assert fair.completeness.mean < unfair.completeness.mean
    assert fair.completeness.largest == pytest.approx(0.005, rel=0.01)  # the wall
    assert unfair.completeness.largest == pytest.approx(0.005, rel=0.01)
    assert fair.accuracy.largest > 0.02  # the lid that is not there


def test_winding_of_the_nominal_mesh_does_not_matter():
    """Inside out as a whole, and one of two bodies: the same signs; every second face: it is said."""
    made = trimesh.util.concatenate([_ball(0.05, 4), _ball(0.05, 4).apply_translation([0.2, 0.0, 0.0])])
    right = trimesh.util.concatenate([_ball(0.049, 4), _ball(0.049, 4).apply_translation([0.2, 0.0, 0.0])])
    soup = np.array(right.triangles)
    half = len(soup) // 2
    wanted = compare(_surface(made), soup, points=np.array(made.vertices)).deviation
    np.testing.assert_allclose(wanted, 0.001, rtol=5e-3)
    one = np.concatenate((soup[:half], soup[half:, ::-1]))
    for turned in (soup[:, ::-1], one):
        found = compare(_surface(made), turned, points=np.array(made.vertices))
        np.testing.assert_allclose(found.deviation, wanted)
        assert found.normal_median < 0.01
        assert not found.notes
    mixed = soup.copy()
    mixed[::3] = mixed[::3, ::-1]
    assert "wound the other way" in compare(_surface(made), mixed, points=np.array(made.vertices)).notes[0]


def test_contacts_of_the_other_side_do_not_count():
    """A wall of 3 mm, touched on one side: the other is near to contacts but not touched."""
    wall = trimesh.creation.box(extents=(0.2, 0.2, 0.003)).subdivide_to_size(0.004)
    top = wall.vertices[:, 2] > 0.001
    points, normals = wall.vertices[top], np.tile([0.0, 0.0, 1.0], (int(top.sum()), 1))
    found = compare(_surface(wall), np.array(wall.triangles), points=points, normals=normals)
    assert found.touched == pytest.approx(0.5, abs=0.02)
    blind = compare(_surface(wall), np.array(wall.triangles), points=points)
    assert blind.touched == 1.0


def test_an_environment_is_as_good_as_its_triangles():
    """The bodies that were scanned, as they are."""
    ball = _ball(0.05, 4)
    made = _surface(_ball(0.051, 4))
    one = compare(made, MeshEnvironment(ball), points=made.vertices)
    other = compare(made, np.array(ball.triangles), points=made.vertices)
    assert one.accuracy.mean == pytest.approx(other.accuracy.mean, rel=1e-9)


def test_metrics_are_flat_and_end_in_units():
    """Numbers under names that say their unit; notes only if there are any."""
    made = _surface(_ball(0.051, 4))
    found = compare(made, np.array(_ball(0.05, 4).triangles), points=made.vertices)
    metrics = found.metrics()
    assert metrics["accuracy_hausdorff95_m"] == found.accuracy.hausdorff95
    assert metrics["completeness_max_m"] == found.completeness.largest
    assert all(isinstance(value, float) for value in metrics.values())
    assert replace(found, notes=("odd",)).metrics()["notes"] == ["odd"]


@pytest.mark.parametrize(
    "factor,read_in,right",
    [(1000.0, "m", "mm"), (1e-3, "mm", "m"), (25.4, "in", "mm"), (0.1, "mm", "cm"), (10.0, "cm", "mm")],
)
def test_a_mesh_in_another_unit_is_recognised(factor, read_in, right):
    """Sizes that differ by the ratio of two units: the right one is named."""
    ball = _ball(0.05, 4)
    target = Target(*as_faces(np.array(ball.triangles) * factor))
    with pytest.raises(
        UsageError, match=f"looks like it is in {right}, not in {read_in}; give --unit {right}"
    ):
        check_units(target, np.array(ball.vertices) * 0.95, unit=read_in)


def test_parts_of_large_objects_and_odd_sizes_are_no_matter_of_units():
    """Points on a tenth of a plate lie on it; a mesh twice as large is of another object, and it is said."""
    plate = trimesh.creation.box(extents=(1.0, 0.02, 0.02)).subdivide_to_size(0.005)
    part = plate.vertices[np.abs(plate.vertices[:, 0]) < 0.05]
    assert check_units(Target(*as_faces(np.array(plate.triangles))), part, unit="m") == ()
    ball = _ball(0.05, 4)
    notes = check_units(Target(*as_faces(2.0 * np.array(ball.triangles))), np.array(ball.vertices), unit="m")
    assert "one object" in notes[0]
    tiny = Target(*as_faces(np.array(ball.triangles) / 70.0))
    with pytest.raises(UsageError, match="not of one object"):
        check_units(tiny, np.array(ball.vertices), unit="m")


@pytest.fixture(scope="module")
def ball_run(tmp_path_factory):
    """A finished scan of a ball, its contacts made and not sensed."""
    return write_ball_run(tmp_path_factory.mktemp("runs"))


def test_a_run_is_compared_with_its_mesh_in_its_place(ball_run):
    """The mesh is placed as the scene's object; the surface is made if the folder has none."""
    run = load_run(ball_run)
    surface, found = compare_run(run, ball_run.parent / "ball.ply")
    assert found.accuracy.mean < 0.1e-3
    assert found.completeness.mean < 0.1e-3
    assert found.reachable == 1.0
    assert surface.watertight
    _, again = compare_run(run, ball_run.parent / "ball.toml")
    assert again.metrics() == found.metrics() | {"compare_s": again.seconds}
    with pytest.raises(UsageError, match="looks like it is in mm, not in m; give --unit mm"):
        compare_run(run, ball_run.parent / "ball.ply", unit="m")


def test_flagged_contacts_touch_nothing_and_the_floor_limits_the_reach(ball_run, tmp_path):
    """Contacts above the middle flagged: half is touched; a floor at the middle: a base stays above it."""
    folder = shutil.copytree(ball_run, tmp_path / "run")
    write_surface(folder / SURFACE_FILE, surface_of(load_run(ball_run)), unit="mm")
    columns = cloud.read_csv(folder / "contacts.csv")
    columns["flags"][columns["z_m"] > PLACE[2]] = columns["flags"][5]
    cloud.write_csv(folder / "contacts.csv", columns)
    run = load_run(folder)
    _, found = compare_run(run, ball_run.parent / "ball.ply")
    assert found.reachable == 1.0
    assert found.touched == pytest.approx(0.5, abs=0.06)
    scene = run.record["scene"]
    limited = replace(run, record={"scene": {**scene, "reach": {**scene["reach"], "floor": float(PLACE[2])}}})
    _, found = compare_run(limited, ball_run.parent / "ball.ply")
    assert 0.4 < found.reachable < 0.8


def test_a_plan_that_suits_nothing_is_said(ball_run):
    """A scene whose axes leave no room: all of the mesh counts, with a note."""
    run = load_run(ball_run)
    record = dict(run.record["scene"])
    record["reach"] = {**record["reach"], "lower": [5.0, None, None, None, None]}
    _, found = compare_run(replace(run, record={"scene": record}), ball_run.parent / "ball.ply")
    assert found.reachable == 1.0
    assert "no plan suits it" in found.notes[0]


def test_runs_without_a_surface_or_a_scene_are_refused(ball_run, tmp_path):
    """Contacts on one plane, and a record that does not say what was scanned: one line, nothing written."""
    flat = tmp_path / "flat"
    shutil.copytree(ball_run, flat)
    columns = cloud.read_csv(flat / "contacts.csv")
    columns["z_m"] = 0.0 * columns["z_m"]
    cloud.write_csv(flat / "contacts.csv", columns)
    before = {path.name: path.read_bytes() for path in flat.iterdir()}
    with pytest.raises(UsageError, match="plane"):
        surface_of(load_run(flat))
    with pytest.raises(UsageError, match="plane"):
        compare_run(load_run(flat), ball_run.parent / "ball.ply")
    cloud.write_json(flat / "run.json", {"seed": 0})
    with pytest.raises(UsageError, match="does not say what was scanned"):
        compare_run(load_run(flat), ball_run.parent / "ball.ply")
    before["run.json"] = (flat / "run.json").read_bytes()
    assert {path.name: path.read_bytes() for path in flat.iterdir()} == before


def test_a_mesh_that_moved_with_its_run_is_found(ball_run, tmp_path):
    """Where the recorded path leads nowhere, the mesh of that name in the run's folder is meant."""
    folder = shutil.copytree(ball_run, tmp_path / "run")
    shutil.copy(ball_run.parent / "ball.ply", folder / "ball.ply")
    record = cloud.read_json(folder / "run.json")
    record["scene"]["objects"][0]["mesh"] = "gone/ball.ply"
    cloud.write_json(folder / "run.json", record)
    assert scene_of_record(load_run(folder).record["scene"], folder).bodies[0].mesh == folder / "ball.ply"
    (folder / "ball.ply").unlink()
    assert str(scene_of_record(load_run(folder).record["scene"], folder).bodies[0].mesh) == "gone/ball.ply"


def test_another_object_is_asked_about(ball_run, tmp_path):
    """A ball of the right size in the wrong place is compared, and the doubt is said."""
    moved = trimesh.load_mesh(ball_run.parent / "ball.ply")
    moved.apply_translation([300.0, 0.0, 0.0])
    moved.export(tmp_path / "moved.ply")
    _, found = compare_run(load_run(ball_run), tmp_path / "moved.ply", unit="mm")
    assert any("are they of one object" in note for note in found.notes)
    _, found = compare_run(load_run(ball_run), ball_run.parent / "ball.ply")
    assert not any("are they of one object" in note for note in found.notes)
