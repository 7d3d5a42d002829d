"""The report: one page that holds everything, opens from a file, and draws in a real browser."""

from __future__ import annotations

import base64
import functools
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import matplotlib.image
import numpy as np
import pytest
from small_run import FLAGGED, small_run, spoilt_run

from contour.cli import OK, WRONG_USAGE, main
from contour.report import write_report
from contour.results import load_run

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL in software, so that no graphics card is needed."""


@functools.cache
def _browser():
    return next((path for path in map(shutil.which, BROWSERS) if path), None)


needs_browser = pytest.mark.skipif(
    _browser() is None, reason="no chromium to open the page with: apt install chromium"
)


def _open(page, tmp_path, *options, fragment="", gl=GL):
    """What a browser prints and says of ``page``: the document after its scripts, and the lines of the log."""
    command = [_browser(), "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", *gl]
    command += ["--enable-logging=stderr", "--hide-scrollbars", "--virtual-time-budget=8000"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", *options, page.as_uri() + fragment]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line or "Uncaught" in line]


def _state(document):
    tag = re.search(r"<html[^>]*>", document).group(0)
    return dict(re.findall(r'data-([\w-]+)="([^"]*)"', tag))


class _Sources(HTMLParser):
    """Whatever a page would load or lead to."""

    def __init__(self):
        super().__init__()
        self.found = []
        self.scripts = 0

    def handle_starttag(self, tag, attrs):
        self.found += [
            value for name, value in attrs if name in {"src", "href", "data", "action", "poster", "srcset"}
        ]
        self.scripts += tag == "script"


@pytest.fixture
def folder(tmp_path):
    """A scan with one flagged contact and one that is silently wrong."""
    return spoilt_run(tmp_path)


def test_the_page_holds_all_it_shows(folder):
    """Nothing is loaded: sources are data or places in the page, and the page forbids itself anything else."""
    (folder / "view.png").write_bytes(b"\x89PNG of some kind")
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    sources = _Sources()
    sources.feed(text)
    assert [s for s in sources.found if not s.startswith(("#", "data:image/png;base64,"))] == []
    assert base64.b64encode(b"\x89PNG of some kind").decode() in text
    assert sources.scripts == 2
    assert not re.search(r"@import|url\(|https?://|fetch\(|XMLHttpRequest|import\(", text)
    assert "default-src 'none'" in text


def test_the_page_has_figures_flags_and_setting(folder):
    """All figures of metrics.json, the flags, what was scanned, and the terms."""
    run = load_run(folder)
    text = write_report(run).read_text(encoding="utf-8")
    for name, value in run.metrics.items():
        for key in [f"{name}.{part}" for part in value] if isinstance(value, dict) else [name]:
            assert f'data-key="{key}"' in text
    for words in (
        "slip-off|unresolved: 1",
        "came back to where it began",
        "Silently wrong",
        "Coverage",
        "sphere.ply",
    ):
        assert words in text
    assert not re.search(r"\$\w", text.replace("$(", "").replace("${", ""))  # no place was left unfilled


def test_names_are_not_markup(folder):
    """A scene may be called anything; the page stays a page."""
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record["scene"]["name"] = "</script><img src=x onerror=alert(1)> & co"
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    sources = _Sources()
    sources.feed(text)
    assert sources.scripts == 2
    assert "x" not in sources.found
    assert "&lt;/script&gt;" in text


def test_deviations_need_the_mesh_and_say_so(folder):
    """Where the nominal mesh is gone the page says why there are no deviations, and has everything else."""
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    assert '"name":"deviation"' in text
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record["scene"]["objects"][0]["mesh"] = "gone.ply"
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    assert '"name":"deviation"' not in text
    assert "Deviations from the nominal surface are not known: " in text
    assert "gone.ply" in text


def test_what_was_compared_later_is_shown(folder):
    """Figures of comparison.json stand in the page."""
    compared = {"mesh": "part.stl", "surface": {"faces": 3}, "accuracy_mean_m": 0.000123}
    (folder / "comparison.json").write_text(json.dumps(compared), encoding="utf-8")
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    assert 'data-key="compared.accuracy_mean_m"' in text
    assert ">0.123<" in text
    assert 'data-key="compared.surface"' not in text


def test_missing_parts_are_said(folder):
    """No surface, no picture, no log: the page says so and stands."""
    for name in ("surface.ply", "log.jsonl"):
        (folder / name).unlink()
    text = write_report(load_run(folder)).read_text(encoding="utf-8")
    for words in ("There is no surface.ply", "There is no picture", "log.jsonl is not in the folder"):
        assert words in text


def test_the_command_writes_the_report(tmp_path, capsys):
    """``contour report RUN`` writes RUN/report.html and says so."""
    folder = small_run(tmp_path)
    assert main(["report", str(folder)]) == OK
    assert (folder / "report.html").stat().st_size > 50_000
    assert "report.html" in capsys.readouterr().out


@pytest.mark.parametrize("fault", ["absent", "half", "empty", "damaged log"])
def test_bad_runs_are_one_line(fault, tmp_path, capsys):
    """No folder, a half-written run, no contacts, a torn log: exit code 2, one line, no page."""
    folder = small_run(tmp_path)
    if fault == "absent":
        folder /= "nothing"
    elif fault == "half":
        (folder / "metrics.json").unlink()
    elif fault == "empty":
        head = (folder / "contacts.csv").read_text(encoding="ascii").splitlines()[0]
        (folder / "contacts.csv").write_text(head + "\n", encoding="ascii")
    else:
        (folder / "log.jsonl").write_text('{"event": "contour", ', encoding="utf-8")
    assert main(["report", str(folder)]) == WRONG_USAGE
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert str(folder) in told
    assert not (folder / "report.html").exists()


@needs_browser
def test_the_page_draws_in_a_browser(folder, tmp_path):
    """Opened from a file it draws contacts and surface, and the browser's log has no line about it."""
    run = load_run(folder)
    document, said = _open(write_report(run), tmp_path, "--dump-dom")
    assert said == []
    state = _state(document)
    assert state["viewer"] == "ready"
    assert int(state["viewer-contacts"]) == run.good.size
    assert int(state["viewer-faces"]) > 1000
    assert 0.1 < float(state["viewer-covered"]) < 0.9


@needs_browser
def test_the_picture_is_not_blank(folder, tmp_path):
    """A screenshot has the object in the middle of the 3-D view, in many colours."""
    shot = tmp_path / "shot.png"
    _, said = _open(
        write_report(load_run(folder)), tmp_path, f"--screenshot={shot}", "--window-size=1280,1300"
    )
    assert said == []
    pixels = np.rint(255.0 * matplotlib.image.imread(shot)[..., :3]).astype(int)
    middle = pixels[650:1000, 250:650].reshape(-1, 3)
    assert len(np.unique(middle // 8, axis=0)) > 60
    edge = pixels[650:1000, 85:95].reshape(-1, 3)
    assert len(np.unique(edge // 8, axis=0)) < 12  # background only


@needs_browser
def test_links_lead_to_contacts(folder, tmp_path):
    """The page opened at a contact shows its numbers."""
    page = write_report(load_run(folder))
    document, said = _open(page, tmp_path, "--dump-dom", fragment=f"#contact-{FLAGGED}")
    assert said == []
    chosen = re.search(r'<dl id="chosen"[^>]*>(.*?)</dl>', document, re.DOTALL)
    assert "hidden" not in chosen.group(0).split(">")[0]
    assert f"<dt>contact</dt><dd>{FLAGGED}</dd>" in chosen.group(1)
    assert "<dt>flags</dt><dd>slip-off, unresolved</dd>" in chosen.group(1)


@needs_browser
def test_without_webgl_the_page_says_so(folder, tmp_path):
    """Where 3-D is switched off a line says so, and nothing fails."""
    page = write_report(load_run(folder))
    document, said = _open(page, tmp_path, "--dump-dom", "--disable-3d-apis", gl=())
    assert said == []
    assert _state(document)["viewer"].startswith("failed: this browser offers no WebGL")
    assert "The 3-D view cannot be shown" in document


@needs_browser
def test_a_broken_page_is_noticed(folder, tmp_path):
    """The checks above can fail: a damaged scene is an error in the log, and the page says that it failed."""
    page = write_report(load_run(folder))
    text = page.read_text(encoding="utf-8").replace('"segments":{', '"fragments":{')
    page.write_text(text, encoding="utf-8")
    document, said = _open(page, tmp_path, "--dump-dom")
    assert any("Uncaught" in line for line in said)
    assert _state(document)["viewer"].startswith("failed: ")
