"""Contacts as files: nothing is lost on the way, other programs can read them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour.cloud import read_csv, read_json, read_ply, table, write_csv, write_json, write_ply, write_vtp
from contour.contacts import Contacts, Flag, Kind
from contour.errors import UsageError

ISSUE_COLUMNS = [
    *("id", "contour", "x_m", "y_m", "z_m", "nx", "ny", "nz", "s_m", "sigma_s_m", "sigma_normal_rad"),
    *("pushes", "kind", "flags", "machine_time_s"),
]


def _contacts(count, rng):
    normal = rng.normal(size=(count, 3))
    return Contacts(
        which=rng.integers(0, 9, count),
        touch=rng.normal(size=(count, 2)),
        point=0.1 * rng.normal(size=(count, 3)),
        normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        distance=rng.uniform(0.02, 0.2, count),
        sigma_distance=rng.uniform(1e-5, 1e-3, count),
        outward=rng.uniform(-3, 3, count),
        sigma_normal=rng.uniform(1e-3, 1e-1, count),
        friction_angle=rng.uniform(0.0, 0.4, count),
        sigma_friction=rng.uniform(0.0, 0.1, count),
        radius_along=rng.choice([0.0, 0.02, np.inf], count),
        curvature_across=rng.normal(size=count),
        kind=rng.integers(0, len(Kind), count).astype(np.int8),
        pushes=rng.integers(1, 5, count),
        flags=rng.integers(0, 2 * max(Flag), count),
        machine_time=rng.uniform(1.0, 9.0, count),
        sequence=np.arange(count),
    )


@pytest.fixture
def columns(rng):
    """A table of 50 contacts with two true columns."""
    contacts = _contacts(50, rng)
    return table(contacts, {"true_s_m": contacts.distance + 1e-5, "true_nx": contacts.normal[:, 0]})


def test_table_begins_with_the_documented_columns(columns):
    """The documented columns come first and in order, the true ones last."""
    names = list(columns)
    assert names[: len(ISSUE_COLUMNS)] == ISSUE_COLUMNS
    assert names[-2:] == ["true_s_m", "true_nx"]


def test_csv_comes_back_bit_for_bit(columns, tmp_path):
    """Written and read again, every number, kind and combination of flags is the same."""
    write_csv(tmp_path / "contacts.csv", columns)
    again = read_csv(tmp_path / "contacts.csv")
    assert list(again) == list(columns)
    for name, column in columns.items():
        assert np.array_equal(again[name], column), name
        assert again[name].dtype.kind == column.dtype.kind, name


def test_csv_names_kinds_and_flags_and_leaves_good_ones_empty(rng, tmp_path):
    """A good side contact reads 'side' and nothing; a bad one names its flags."""
    contacts = _contacts(2, rng)
    contacts.kind[:] = Kind.SIDE, Kind.TIP
    contacts.flags[:] = 0, Flag.SLIP_OFF | Flag.LOST
    write_csv(tmp_path / "contacts.csv", table(contacts))
    rows = [line.split(",") for line in (tmp_path / "contacts.csv").read_text().splitlines()]
    kind, flags = rows[0].index("kind"), rows[0].index("flags")
    assert [(row[kind], row[flags]) for row in rows[1:]] == [("side", ""), ("tip", "slip-off|lost")]


def test_no_contacts_make_files_too(rng, tmp_path):
    """A scan that touched nothing leaves readable, empty files."""
    columns = table(_contacts(0, rng))
    write_csv(tmp_path / "c.csv", columns)
    write_ply(tmp_path / "c.ply", columns, unit="mm")
    write_vtp(tmp_path / "c.vtp", columns, unit="mm")
    assert {len(column) for column in read_csv(tmp_path / "c.csv").values()} == {0}
    assert len(read_ply(tmp_path / "c.ply")[0]["x"]) == 0


def test_ply_is_in_the_unit_its_header_names(columns, tmp_path):
    """Points and lengths are in millimetres, normals and angles as they are; scalars are called scalar_*."""
    write_ply(tmp_path / "points.ply", columns, unit="mm")
    again, unit = read_ply(tmp_path / "points.ply")
    assert unit == "mm"
    assert again["x"] == pytest.approx(1e3 * columns["x_m"], rel=1e-15)
    assert again["nz"] == pytest.approx(columns["nz"], abs=1e-7)  # single precision
    assert again["scalar_sigma_s_mm"] == pytest.approx(1e3 * columns["sigma_s_m"], rel=1e-6)
    assert again["scalar_sigma_normal_rad"] == pytest.approx(columns["sigma_normal_rad"], rel=1e-6)
    assert again["scalar_curvature_across_1_m"] == pytest.approx(columns["curvature_across_1_m"], rel=1e-6)
    assert all(name.startswith("scalar_") for name in list(again)[6:])


def test_ply_opens_elsewhere(columns, tmp_path):
    """An independent reader finds the same points."""
    write_ply(tmp_path / "points.ply", columns, unit="mm")
    cloud = trimesh.load(tmp_path / "points.ply")
    assert np.allclose(cloud.vertices, 1e3 * np.stack([columns[c] for c in ("x_m", "y_m", "z_m")], axis=1))


def test_vtp_opens_in_vtk(columns, tmp_path):
    """VTK's own reader finds points, normals, every scalar and the unit."""
    vtk_io = pytest.importorskip("vtkmodules.vtkIOXML")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    write_vtp(tmp_path / "points.vtp", columns, unit="mm")
    reader = vtk_io.vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "points.vtp"))
    reader.Update()
    data = reader.GetOutput()
    assert [data.GetCell(i).GetPointId(0) for i in range(50)] == list(range(50))
    points = vtk_to_numpy(data.GetPoints().GetData())
    assert np.array_equal(points, 1e3 * np.stack([columns[c] for c in ("x_m", "y_m", "z_m")], axis=1))
    normals = vtk_to_numpy(data.GetPointData().GetNormals())
    assert np.array_equal(normals, np.stack([columns[c] for c in ("nx", "ny", "nz")], axis=1))
    assert np.array_equal(vtk_to_numpy(data.GetPointData().GetArray("flags")), columns["flags"])
    assert data.GetFieldData().GetAbstractArray("unit").GetValue(0) == "mm"


def test_json_has_no_numbers_that_json_has_not(tmp_path):
    """Infinite and undefined numbers become null, arrays lists; what was there is replaced whole."""
    path = tmp_path / "metrics.json"
    write_json(path, {"old": 1})
    write_json(path, {"a": np.inf, "b": np.array([1.5, np.nan]), "c": np.int64(3), "d": (True, "x")})
    assert read_json(path) == {"a": None, "b": [1.5, None], "c": 3, "d": [True, "x"]}
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.json"]  # no part of a file is left


def test_wrong_input_is_refused_by_name(columns, rng, tmp_path):
    """Unknown units, columns of the wrong length and files that are not there are named."""
    with pytest.raises(UsageError, match="unit 'mn'"):
        write_ply(tmp_path / "points.ply", columns, unit="mn")
    with pytest.raises(UsageError, match="true_s_m"):
        table(_contacts(3, rng), {"true_s_m": np.zeros(2)})
    with pytest.raises(UsageError, match="does not exist"):
        read_csv(tmp_path / "contacts.csv")
    (tmp_path / "text.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(UsageError, match="not a binary"):
        read_ply(tmp_path / "text.ply")
    assert not (tmp_path / "points.ply").exists()
