"""Finished scans read back, and their files in other people's programs: trimesh, pyvista, MeshLab's conventions."""

from __future__ import annotations

import shutil
from dataclasses import fields

import numpy as np
import pytest
import trimesh
from made_runs import PLACE, write_ball_run

from contour import cloud
from contour.errors import UsageError
from contour.results import SURFACE_FILE, load_run, load_surface, write_surface
from contour.surface import Surface


@pytest.fixture(scope="module")
def ball_run(tmp_path_factory):
    """A finished scan of a ball."""
    return write_ball_run(tmp_path_factory.mktemp("runs"))


@pytest.fixture
def run_copy(ball_run, tmp_path):
    """One that may be spoilt."""
    return shutil.copytree(ball_run, tmp_path / "copy")


def _surface(rng, *, closed=True):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.06)
    count = len(ball.vertices)
    return Surface(
        vertices=np.array(ball.vertices) + PLACE,
        faces=np.array(ball.faces[None if closed else slice(1, None)]).reshape(-1, 3),
        normals=np.array(ball.vertex_normals),
        trust=rng.uniform(0.0, 0.01, count),
        sigma=rng.uniform(0.0, 1e-4, count),
        method="layers",
        watertight=closed,
        touched=0.875,
        notes=("a first note, with a comma", "and a second"),
        seconds=1.25,
    )


def test_a_run_is_read_as_it_was_written(ball_run):
    """Points, normals, order, flags, unit, record."""
    run = load_run(ball_run)
    assert run.unit == "mm"
    assert run.metrics == {"contacts": 642, "flagged": 1}
    assert run.record["scene"]["name"] == "ball"
    assert np.flatnonzero(~run.good).tolist() == [5]
    radius = np.linalg.norm(run.points - PLACE, axis=1)[run.good]
    np.testing.assert_allclose(radius, radius[0], rtol=1e-12)
    np.testing.assert_allclose((run.points - PLACE)[run.good], radius[0] * run.normals[run.good], atol=1e-12)
    assert (run.contour[41], run.order[41]) == (2, 1)


def test_smoothed_normals_come_first(run_copy):
    """Where the table has them they are the run's."""
    columns = cloud.read_csv(run_copy / "contacts.csv")
    columns |= {f"smooth_n{axis}": np.full(642, float(axis == "y")) for axis in "xyz"}
    cloud.write_csv(run_copy / "contacts.csv", columns)
    np.testing.assert_array_equal(load_run(run_copy).normals, np.tile([0.0, 1.0, 0.0], (642, 1)))


@pytest.mark.parametrize("unit", ["mm", "in"])
@pytest.mark.parametrize("closed", [True, False])
def test_a_surface_comes_back(run_copy, rng, unit, closed):
    """All fields, in metres again, to the precision that the file keeps; open ones stay open."""
    surface = _surface(rng, closed=closed)
    write_surface(run_copy / SURFACE_FILE, surface, unit=unit)
    again = load_surface(load_run(run_copy))
    for field in fields(Surface):
        wrote, read = getattr(surface, field.name), getattr(again, field.name)
        if field.name in {"normals", "trust", "sigma"}:  # single precision
            np.testing.assert_allclose(read, wrote, rtol=1e-6, atol=1e-7)
        elif field.name == "vertices":
            np.testing.assert_allclose(read, wrote, rtol=1e-14)
        else:
            np.testing.assert_array_equal(read, wrote)


def test_there_may_be_no_surface(ball_run):
    """None, not an error."""
    assert load_surface(load_run(ball_run)) is None


def test_trimesh_reads_the_surface(tmp_path, rng):
    """Vertices in the file's unit, faces, normals and the scalars by name."""
    surface = _surface(rng)
    write_surface(tmp_path / "surface.ply", surface, unit="mm")
    mesh = trimesh.load(tmp_path / "surface.ply", process=False)
    np.testing.assert_allclose(mesh.vertices, surface.vertices * 1e3, rtol=1e-12)
    np.testing.assert_array_equal(mesh.faces, surface.faces)
    assert mesh.is_watertight
    assert mesh.volume > 0.0  # wound outwards
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(data["scalar_trust_mm"].ravel(), surface.trust * 1e3, rtol=1e-6)
    np.testing.assert_allclose(data["scalar_sigma_mm"].ravel(), surface.sigma * 1e3, rtol=1e-6)
    np.testing.assert_allclose(
        np.column_stack([data[name].ravel() for name in ("nx", "ny", "nz")]), surface.normals, atol=1e-6
    )


def test_vtk_reads_the_surface(tmp_path, rng):
    """The same through pyvista, whose reader takes geometry and normals."""
    pyvista = pytest.importorskip("pyvista")
    surface = _surface(rng)
    write_surface(tmp_path / "surface.ply", surface, unit="mm")
    mesh = pyvista.read(tmp_path / "surface.ply")
    np.testing.assert_allclose(mesh.points, surface.vertices * 1e3, rtol=1e-6)
    np.testing.assert_array_equal(mesh.regular_faces, surface.faces)
    np.testing.assert_allclose(mesh.point_data["Normals"], surface.normals, atol=1e-6)


@pytest.mark.parametrize("name", ["points.ply", "surface.ply"])
def test_headers_keep_to_the_conventions(run_copy, rng, name):
    """What MeshLab and CloudCompare look for: x y z nx ny nz, then scalar_ fields, all float or double."""
    write_surface(run_copy / SURFACE_FILE, _surface(rng), unit="mm")
    lines = (run_copy / name).read_bytes().partition(b"end_header\n")[0].decode("utf-8").splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "comment unit mm"]
    start = next(i for i, line in enumerate(lines) if line.startswith("element vertex")) + 1
    properties = [
        line.split() for line in lines[start:] if line.startswith("property") and "list" not in line
    ]
    assert [words[2] for words in properties[:6]] == ["x", "y", "z", "nx", "ny", "nz"]
    assert all(words[2].startswith("scalar_") for words in properties[6:])
    assert len(properties) > 7
    assert {words[1] for words in properties} <= {"float", "double"}
    faces = [line for line in lines if "vertex_indices" in line]
    assert faces == (["property list uchar int vertex_indices"] if name == "surface.ply" else [])


def test_other_programs_read_the_points(ball_run):
    """points.ply in trimesh, points.vtp in pyvista: places, normals, scalars and the unit."""
    pyvista = pytest.importorskip("pyvista")
    run = load_run(ball_run)
    points = trimesh.load(ball_run / "points.ply", process=False)
    np.testing.assert_allclose(points.vertices, run.points * 1e3, rtol=1e-12)
    raw = points.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(raw["scalar_sigma_s_mm"].ravel(), 0.1, rtol=1e-6)
    np.testing.assert_allclose(
        np.column_stack([raw[name].ravel() for name in ("nx", "ny", "nz")]), run.normals, atol=1e-6
    )
    vtp = pyvista.read(ball_run / "points.vtp")
    np.testing.assert_allclose(vtp.points, run.points * 1e3, rtol=1e-12)
    np.testing.assert_allclose(vtp.point_data["normals"], run.normals, rtol=1e-12)
    np.testing.assert_array_equal(vtp.point_data["flags"], run.contacts["flags"])
    assert str(vtp.field_data["unit"][0]) == "mm"


def test_what_is_no_finished_scan_is_refused(run_copy, tmp_path):
    """No folder, an empty one, half a scan, no contacts, damaged files: what it is, in one line."""
    with pytest.raises(UsageError, match="is no folder"):
        load_run(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="holds no scan"):
        load_run(tmp_path / "empty")
    metrics = (run_copy / "metrics.json").read_bytes()
    (run_copy / "metrics.json").unlink()
    with pytest.raises(UsageError, match="was not finished"):
        load_run(run_copy)
    (run_copy / "metrics.json").write_bytes(metrics[:20])
    with pytest.raises(UsageError, match=r"metrics.json is damaged"):
        load_run(run_copy)
    (run_copy / "metrics.json").write_bytes(metrics)
    table = (run_copy / "contacts.csv").read_bytes()
    rows = table.splitlines(keepends=True)
    (run_copy / "contacts.csv").write_bytes(b"".join(rows[:300]) + rows[300][:30])
    with pytest.raises(UsageError, match=r"contacts.csv is damaged"):
        load_run(run_copy)
    (run_copy / "contacts.csv").write_bytes(b"".join(rows[:301]))
    with pytest.raises(UsageError, match=r"has 300 contacts, points\.ply 642"):
        load_run(run_copy)
    (run_copy / "contacts.csv").write_bytes(table.partition(b"\n")[0] + b"\n")
    with pytest.raises(UsageError, match="without contacts"):
        load_run(run_copy)


def test_a_foreign_surface_is_refused(run_copy):
    """A surface.ply that somebody else wrote has no trust."""
    trimesh.creation.box().export(run_copy / SURFACE_FILE)
    with pytest.raises(UsageError, match="no surface with trust"):
        load_surface(load_run(run_copy))


@pytest.mark.parametrize("kept", [400, 0.5, 0.99])
def test_a_surface_cut_short_is_refused(run_copy, rng, kept):
    """A full disk may leave half of it: one line, and what to do."""
    path = run_copy / SURFACE_FILE
    write_surface(path, _surface(rng), unit="mm")
    content = path.read_bytes()
    path.write_bytes(content[: kept if kept > 1 else int(kept * len(content))])
    with pytest.raises(UsageError, match=r"surface\.ply is (cut short|not a binary)"):
        load_surface(load_run(run_copy))
