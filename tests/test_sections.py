"""Sections of the report: every figure, every flag, every ending, and nothing made up."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from small_run import FLAGGED, WRONG, small_run, spoilt_run

from contour.claims import claims_of
from contour.results import load_run
from contour.sections import (
    care_html,
    claims_html,
    contours_html,
    figure_rows,
    figures_html,
    findings_html,
    tiles_html,
)


@pytest.fixture
def run(tmp_path):
    """A scan with one flagged contact and one that is silently wrong."""
    return load_run(spoilt_run(tmp_path))


def test_all_figures_stand_in_the_tables(run):
    """Each figure of metrics.json once, parts too, in the units of the console."""
    metrics = {
        **run.metrics,
        "surface": {"watertight": True, "touched": 0.5, "notes": ["one", "two"]},
        "comparison": {"accuracy_mean_m": 0.00021, "completeness_mean_m": float("nan")},
        "unheard_of_m": 0.002,
    }
    text = figures_html(metrics)
    keys = re.findall(r'data-key="([^"]+)"', text)
    flat = [
        f"{name}.{part}" if part else name
        for name, value in metrics.items()
        for part in (value if isinstance(value, dict) else [""])
    ]
    assert sorted(keys) == sorted(flat)
    rows = {key: (value, unit) for key, _, value, unit in figure_rows(metrics)}
    assert rows["comparison.accuracy_mean_m"] == ("0.210", "mm")
    assert rows["comparison.completeness_mean_m"] == ("not known", "")
    assert rows["surface.watertight"] == ("yes", "")
    assert rows["surface.notes"] == ("one; two", "")
    assert rows["unheard_of_m"] == ("2.000", "mm")
    assert '<td class="n">2.000</td><td>mm</td>' in text


def test_unknown_figures_are_called_so():
    """A figure that the scan could not know is listed as not known."""
    assert list(figure_rows({"coverage_95": None})) == [("coverage_95", "coverage 95", "not known", "")]


def test_flags_are_listed_with_reasons_and_links(run):
    """Each flag with its count and reason, each flagged contact with a way into the 3-D view."""
    text = care_html(run, claims_of(run, 0.21))
    assert '<th scope="row">slip-off</th><td class="n">1</td>' in text
    assert '<th scope="row">lost</th><td class="n">0</td>' in text
    assert "A push slid off the body" in text
    assert f'<a href="#contact-{FLAGGED}">' in text
    assert f'<a href="#contact-{WRONG}">' in text
    assert "+8." in text  # what it is off by [mm]


def test_findings_say_what_is_wrong(run):
    """Silently wrong, dishonest sigmas, open contours and notes are told; a clean run has none of it."""
    bad = {**run.metrics, "silently_wrong": 2, "coverage_95": 0.80, "surface": {"notes": ["half a guess"]}}
    endings = [{"status": "lost", "contour": 4}, {"status": "closed", "contour": 5}]
    text = findings_html(replace(run, metrics=bad), endings, ["<note>"])
    for words in (
        "2 contacts are silently wrong",
        "too small: they claim too much (80.0 %",
        "80.0 %",
        "1 contour did not",
        "Surface: half a guess",
        "&lt;note&gt;",
    ):
        assert words in text
    careful = findings_html(replace(run, metrics={"coverage_95": 0.999}), None, [])
    assert "larger than they need be (99.9 %" in careful
    clean = {"coverage_95": 0.95, "coverage_95_normal": 0.96, "silently_wrong": 0, "unconverged": 0}
    fine = findings_html(replace(run, metrics=clean), [endings[1]], [])
    assert "Nothing out of the ordinary" in fine


def test_tiles_count_contacts(run):
    """The large figures are those of the run."""
    text = tiles_html(run)
    assert f"<b>{run.good.size} " in text
    assert "contacts on 2 contours" in text
    wrong = tiles_html(replace(run, metrics={**run.metrics, "silently_wrong": 3}))
    assert 'class="tile bad"><b>3 ' in wrong


def test_claims_show_charts_in_simulation_and_sigmas_without(run):
    """Three histograms and three scatters with the truth; what is claimed without it."""
    known = claims_html(run, claims_of(run, 0.21))
    assert known.count("<svg") == 6
    assert known.count("within 1.96 sigma<") == 3
    unknown = claims_html(run, None)
    assert "The truth is not known" in unknown
    assert unknown.count("<svg") == 2


def test_kinds_add_up(run):
    """The table by kind has all contacts, flagged and silently wrong ones."""
    text = claims_html(run, claims_of(run, 0.21))
    rows = re.findall(r'<tr><th scope="row">\w+</th>(.*?)</tr>', text[text.index("By kind") :])
    cells = np.array(
        [[int(v) for v in np.array(re.findall(r'class="n">([^<]*)', row))[[0, 1, -1]]] for row in rows]
    )
    assert cells.sum(axis=0).tolist() == [run.good.size, 1, 1]


def test_a_run_of_flagged_contacts_is_shown(run):
    """Nothing to judge by, and no warning."""
    run.contacts["flags"][:] = 1
    assert "Every contact is flagged" in claims_html(run, claims_of(run, 0.21))
    assert "100.0 %" in findings_html(run, [], [])


def test_contours_that_ended_alike_stand_together(tmp_path):
    """Counts of contours and contacts by ending; reasons are escaped; no log is said."""
    path = small_run(tmp_path)
    events = [json.loads(line) for line in (path / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    endings = [event for event in events if event["event"] == "contour"]
    endings.append(
        {"status": "lost", "contour": 9, "contacts": 0, "approaches": 4, "ended": "<nothing> there"}
    )
    text = contours_html(endings)
    contacts = sum(e["contacts"] for e in endings)
    assert f'<th scope="row">closed</th><td class="n">2</td><td class="n">{contacts}</td>' in text
    assert "&lt;nothing&gt; there" in text
    assert "log.jsonl is not in the folder" in contours_html(None)
