"""The command line: exit codes, one clear line for each error, nothing half-written."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console

from contour import __version__, cli, shapes
from contour.cli import DEVICE_FAULT, KNOWN_ERROR, OK, WRONG_USAGE, main
from contour.console import Reporter, findings_table, metrics_table
from contour.doctor import Finding, examine
from contour.errors import DeviceFault, NotConverged, UsageError

SMALL_SCENE = """
[[object]]
mesh = "{mesh}"
friction_angle_deg = 17
[scan]
seed = 3
[plan]
family = "silhouettes"
directions = [[0, 1, 0], [1, 0, 0]]
step_mm = 12
"""


@pytest.fixture
def small_scene(tmp_path, mesh_file):
    """A scene with two short contours round the sphere."""
    path = tmp_path / "small.toml"
    path.write_text(SMALL_SCENE.format(mesh=mesh_file("sphere")), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    """Whatever is written by default lands where it can be looked for."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")


def test_version_is_that_of_the_package(capsys):
    """--version says name and version."""
    assert main(["--version"]) == OK
    assert capsys.readouterr().out.strip() == f"contour {__version__}"


@pytest.mark.parametrize(
    "arguments,message",
    [
        (["scna"], "scan"),
        (["scan"], "source"),
        (["scan", "nothing.ply"], "nothing.ply does not exist"),
        (["scan", "nothing.ply", "--sed", "3"], "--seed"),
        (["scan", "nothing.ply", "--seed", "x"], "--seed"),
        (["scan", "nothing.ply", "--unit", "mn"], "--unit 'mn'"),
    ],
)
def test_wrong_usage_is_two_and_one_line(arguments, message, capsys, tmp_path):
    """Exit code 2, one line on stderr that names the thing, and no file."""
    assert main(arguments) == WRONG_USAGE
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert message in told.err
    assert not list((tmp_path / "here").iterdir())


@pytest.mark.parametrize(
    "content,message",
    [
        (b"", "is empty"),
        (b"solid nonsense", "mesh"),
        (b"# no vertex at all\n", "mesh"),
        (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no area"),
    ],
)
def test_bad_meshes_leave_nothing_behind(content, message, capsys, tmp_path):
    """An empty, foreign, undefined or flat mesh: exit code 2, one line, no result folder."""
    path = tmp_path / "bad.obj"
    path.write_bytes(content)
    assert main(["scan", str(path), "--unit", "mm", "--out", str(tmp_path / "out")]) == WRONG_USAGE
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert message in told
    assert not (tmp_path / "out").exists()


def test_undefined_vertices_are_refused(capsys, tmp_path):
    """NaN among the vertices: exit code 2 and one line."""
    mesh = shapes.load("box").mesh()
    mesh.vertices[3] = np.nan
    shapes.write_mesh(tmp_path / "bad.ply", mesh, "bad")
    assert main(["scan", str(tmp_path / "bad.ply"), "--dry-run"]) == WRONG_USAGE
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "bad.ply" in told


def test_a_mesh_without_unit_asks_for_one(capsys, tmp_path):
    """OBJ has no unit: the message says which option gives one."""
    path = tmp_path / "thing.obj"
    path.write_bytes(b"v 0 0 0\nv 99 0 0\nv 0 99 0\nv 0 0 99\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    assert main(["scan", str(path)]) == WRONG_USAGE
    assert "--unit" in capsys.readouterr().err


def test_dry_run_writes_nothing(small_scene, capsys, tmp_path):
    """The outlook is shown with units, and no folder is made."""
    out = tmp_path / "out"
    assert main(["scan", str(small_scene), "--dry-run", "--out", str(out)]) == OK
    told = capsys.readouterr().out
    assert "contours" in told
    assert "12.000" in told
    assert not out.exists()
    assert not list((tmp_path / "here").iterdir())


def test_results_are_never_overwritten(small_scene, capsys, tmp_path):
    """A folder with something in it is refused; without --out a new name is found."""
    full = tmp_path / "full"
    full.mkdir()
    (full / "precious").write_text("mine")
    assert main(["scan", str(small_scene), "--out", str(full)]) == WRONG_USAGE
    assert "is not empty" in capsys.readouterr().err
    (tmp_path / "here" / "results" / "small").mkdir(parents=True)
    assert str(cli._free_folder(None, "small")) == "results/small-2"


@pytest.mark.parametrize(
    "error,code",
    [
        (UsageError("bad"), WRONG_USAGE),
        (NotConverged("the rod", residual=1.0, iterations=3), KNOWN_ERROR),
        (DeviceFault("alarm 2"), DEVICE_FAULT),
    ],
)
def test_known_errors_have_their_codes(error, code, monkeypatch, capsys):
    """Each family of errors has its exit code and is told in one line; others keep their traceback."""

    def fail():
        raise error

    monkeypatch.setattr("contour.doctor.examine", fail)
    assert main(["doctor"]) == code
    assert capsys.readouterr().err.count("\n") == 1


def test_unforeseen_errors_keep_their_traceback(monkeypatch):
    """A bug is not dressed up as a known error."""

    def fail():
        raise ZeroDivisionError

    monkeypatch.setattr("contour.doctor.examine", fail)
    with pytest.raises(ZeroDivisionError):
        main(["doctor"])


def test_doctor_survives_a_child_that_crashes(monkeypatch):
    """Where VTK kills its process the doctor says so, and names the packages to install."""
    monkeypatch.setattr("contour.doctor._DRAW", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setattr("contour.doctor._loads", lambda library: library != "libGL.so.1")
    pictures = examine()[-1]
    assert not pictures.good
    assert "SIGSEGV" in pictures.found
    assert "apt install libgl1;" in pictures.remedy


def test_doctor_fails_when_something_is_missing(monkeypatch, capsys):
    """Exit code 1 and the remedy; nothing is said to remedy what is well."""
    findings = [
        Finding(what="good", found="1.0", good=True, remedy="nothing to do"),
        Finding(what="bad", found="not installed", good=False, remedy="pip install bad"),
    ]
    monkeypatch.setattr("contour.doctor.examine", lambda: findings)
    assert main(["doctor"]) == KNOWN_ERROR
    told = capsys.readouterr().out
    assert "pip install bad" in told
    assert "nothing to do" not in told
    assert findings_table(findings).row_count == 2


def test_progress_is_plain_lines_off_a_terminal():
    """No more than one line each five seconds, with rate and time left."""
    text, times = io.StringIO(), iter([0.0, 0.0, 1.0, 6.0, 8.0, 12.0, 20.0])
    with Reporter(Console(file=text), clock=lambda: next(times)) as report:
        for contacts, share in ((10, 0.0), (60, 0.0), (80, 0.1), (120, 0.5), (200, 1.0)):
            report(contacts, share)
    assert text.getvalue().splitlines() == [
        "60 contacts, 0 %, 10 contacts/s",
        "120 contacts, 50 %, 10 contacts/s, 12 s left",
        "200 contacts, 100 %, 10 contacts/s, 0 s left",
    ]


def test_progress_is_one_moving_line_on_a_terminal():
    """A bar with contacts and rate, gone at the end."""
    text = io.StringIO()
    with Reporter(Console(file=text, force_terminal=True, width=100)) as report:
        report(60, 0.5)
    assert "60 contacts" in text.getvalue()
    assert text.getvalue().count("\n") <= 1


def test_metrics_are_shown_with_units():
    """Angles in degrees, lengths in millimetres, shares in percent; what is unknown is left out."""
    text = io.StringIO()
    metrics = {
        "normal_error_median_rad": 0.01745329,
        "point_error_rms_m": 0.00025,
        "coverage_95": 0.951,
        "s_error_rms_rel": None,
        "rungs": {"edge": 7},
        "surface": {"watertight": True, "touched": 0.5, "seconds": 1.0, "notes": ["a [guess]", "open"]},
        "comparison": {"accuracy_mean_m": 0.0003, "reachable_share": 0.25, "f_score_1mm": 0.75},
    }
    Console(file=text, width=100).print(metrics_table("thing", metrics))
    rows = [
        [cell.strip() for cell in line.split("\N{BOX DRAWINGS LIGHT VERTICAL}")[1:4]]
        for line in text.getvalue().splitlines()
    ]
    assert ["normal error median", "1.00", "deg"] in rows
    assert ["point error rms", "0.250", "mm"] in rows
    assert ["coverage 95", "95.1", "%"] in rows
    assert ["rungs: edge", "7", ""] in rows
    assert ["surface: watertight", "yes", ""] in rows
    assert ["surface: touched", "50.0", "%"] in rows
    assert ["surface: time", "1.00", "s"] in rows
    assert [row for row in rows if row[:1] == ["surface: note"]] == [
        ["surface: note", "a [guess]", ""],
        ["surface: note", "open", ""],
    ]
    assert ["comparison: accuracy mean", "0.300", "mm"] in rows
    assert ["comparison: reachable", "25.0", "%"] in rows
    assert ["comparison: f score 1mm", "0.750", ""] in rows
    assert not any("s error" in row[0] for row in rows if row)


def test_runs_as_a_module():
    """``python -m contour.cli`` is the command."""
    done = subprocess.run(
        [sys.executable, "-m", "contour.cli", "--version"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.strip() == f"contour {__version__}"


def test_a_folder_that_cannot_be_made_is_said_before_the_scan(small_scene, capsys, tmp_path):
    """A file stands where a folder is needed."""
    (tmp_path / "file").write_text("x", encoding="utf-8")
    assert main(["scan", str(small_scene), "--out", str(tmp_path / "file" / "out")]) == WRONG_USAGE
    assert "cannot be made" in capsys.readouterr().err
