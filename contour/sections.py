"""Sections of a scan's report as HTML: figures, claims, flags, endings; text from files is escaped."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.charts import ratio_histogram, scatter, values_histogram
from contour.claims import Claims, covered
from contour.console import metrics_table
from contour.contacts import Flag, Kind, flag_names
from contour.glossary import DEFINITIONS, FLAGS, KINDS, STATUSES, meaning_of
from contour.results import Run
from contour.trace import Status

__all__ = [
    "care_html",
    "claims_html",
    "contours_html",
    "definitions_html",
    "figure_rows",
    "figures_html",
    "findings_html",
    "tiles_html",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Row = tuple[str, str, str, str]
"""Key, label, value, unit."""

MM, DEG = 1e3, 180.0 / math.pi
HONEST = (0.92, 0.99)
"""Coverage that is worth no remark."""
MANY_FLAGGED = 0.05
"""Share of flagged contacts from which on they are remarked on."""
UNKNOWN_VALUE = "not known"
LONGEST_CELL = 16
"""Values with more letters than this take the whole row of their table."""

_GROUPS: tuple[tuple[str, Callable[[str], bool]], ...] = (
    ("Contacts", lambda key: key in {"contacts", "flagged", "pushes_per_contact"}),
    (
        "Errors of unflagged contacts against the truth",
        lambda key: "_error_" in key or key.startswith("coverage") or key == "silently_wrong",
    ),
    ("Surface", lambda key: key.startswith("surface")),
    ("Surface against the nominal one", lambda key: key.startswith("comparison")),
    ("Surface against a mesh, compared after the scan", lambda key: key.startswith("compared")),
    ("Effort", lambda _: True),
)
"""Tables of figures; each figure goes into the first that takes it."""
_OWN_TABLE = ("surface", "comparison", "compared")
"""Groups of figures that stand in a table of their own."""


def figure_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Every figure of ``metrics.json`` in the words and units of the console; parts have the key ``whole.part``."""
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            for part, of_it in value.items():
                label, text, unit = _words(part, of_it)
                whole = "" if name in _OWN_TABLE else f"{name}: "
                yield f"{name}.{part}", f"{whole}{label}", text, unit
        else:
            yield name, *_words(name, value)


def _words(name: str, value: Any) -> tuple[str, str, str]:
    plain = name.replace("_", " ")
    if isinstance(value, bool):
        return plain, "yes" if value else "no", ""
    if name == "notes":
        return plain, "; ".join(map(str, value or ())) or "none", ""
    unknown = value is None or (isinstance(value, float) and not math.isfinite(value))
    table = metrics_table("", {name: 0.0 if unknown else value})
    label, text, unit = (next(iter(column.cells)) for column in table.columns)
    return str(label), UNKNOWN_VALUE if unknown else str(text), "" if unknown else str(unit)


def figures_html(metrics: Mapping[str, Any]) -> str:
    """Tables of all figures with units and what each one means."""
    groups: dict[str, list[Row]] = {title: [] for title, _ in _GROUPS}
    for row in figure_rows(metrics):
        groups[next(title for title, takes in _GROUPS if takes(row[0]))].append(row)
    parts = []
    for title, rows in groups.items():
        if not rows:
            continue
        body = "".join(_figure(*row) for row in rows)
        head = '<th>figure</th><th class="n">value</th><th>unit</th><th>what it says</th>'
        parts.append(
            f'<div class="wide"><table class="figures"><caption>{escape(title)}</caption>'
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return "".join(parts)


def _figure(key: str, label: str, value: str, unit: str) -> str:
    """A row of the table; long texts take all of it."""
    cells = f'<td class="n">{escape(value)}</td><td>{escape(unit)}</td><td class="m">{escape(meaning_of(key))}</td>'
    if len(value) > LONGEST_CELL:
        cells = f'<td colspan="3">{escape(value)}</td>'
    return f'<tr data-key="{escape(key)}"><th scope="row">{escape(label)}</th>{cells}</tr>'


def tiles_html(run: Run) -> str:
    """The figures that matter most, large."""
    metrics = run.metrics
    comparison = metrics.get("comparison") or metrics.get("compared") or {}
    flagged = int(np.count_nonzero(~run.good))
    share = 100.0 * flagged / len(run.good)
    wrong = metrics.get("silently_wrong")
    smooth = metrics.get("smooth_normal_error_median_rad")
    normal = smooth if smooth is not None else metrics.get("normal_error_median_rad")
    items: list[tuple[float | None, str, str, str, bool]] = [
        (len(run.good), "d", "", f"contacts on {np.unique(run.contour).size} contours", False),
        (flagged, "d", f"{share:.1f} %", "of them flagged: not to be trusted", False),
        (
            _scaled(metrics.get("point_error_rms_m"), MM),
            ".2f",
            "mm",
            "error of a point, root mean square",
            False,
        ),
        (_scaled(normal, DEG), ".2f", "deg", "error of a normal, median", False),
        (_scaled(metrics.get("coverage_95"), 100.0), ".1f", "%", "of true s within the 95 % claimed", False),
        (wrong, "d", "", "silently wrong", bool(wrong)),
        (_scaled(comparison.get("accuracy_mean_m"), MM), ".2f", "mm", "surface to nominal, mean", False),
        (
            _scaled(comparison.get("completeness_mean_m"), MM),
            ".2f",
            "mm",
            "reachable nominal to surface, mean",
            False,
        ),
    ]
    return "".join(
        f'<div class="tile{" bad" if bad else ""}"><b>{value:{form}} <small>{unit}</small></b><span>{text}</span></div>'
        for value, form, unit, text, bad in items
        if value is not None
    )


def _scaled(value: Any, factor: float) -> float | None:
    known = isinstance(value, int | float) and math.isfinite(value)
    return factor * float(value) if known else None


def findings_html(run: Run, endings: Sequence[Mapping[str, Any]] | None, notes: Sequence[str]) -> str:
    """What whoever reads the report should know before trusting it, a line each."""
    metrics, said = run.metrics, []
    if metrics.get("silently_wrong"):
        said.append(
            f"{metrics['silently_wrong']} contacts are silently wrong: unflagged, and far off "
            '(<a href="#care">which</a>).'
        )
    for key, what in (("coverage_95", "s"), ("coverage_95_normal", "the sensed normal")):
        share = metrics.get(key)
        if isinstance(share, float) and not HONEST[0] <= share <= HONEST[1]:
            verdict = "too small: they claim too much" if share < HONEST[0] else "larger than they need be"
            said.append(f"Sigmas of {what} are {verdict} ({100.0 * share:.1f} % within the 95 % interval).")
    flagged = float(np.mean(~run.good))
    if flagged > MANY_FLAGGED:
        said.append(f'{100.0 * flagged:.1f} % of the contacts are flagged (<a href="#care">why</a>).')
    lost = [e for e in endings or () if e.get("status") not in {"closed", "duplicate"}]
    if lost:
        one = len(lost) == 1
        said.append(
            f"{len(lost)} contour{'' if one else 's'} did not come back to where {'it' if one else 'they'} began "
            '(<a href="#contours">how they ended</a>).'
        )
    if metrics.get("unconverged"):
        said.append(f"{metrics['unconverged']} pushes were simulated less exactly than was asked for.")
    for part in ("surface", "comparison", "compared"):
        of_it = metrics.get(part)
        if isinstance(of_it, Mapping):
            texts = of_it.get("notes") or []
            said += [
                f"{part.capitalize()}: {escape(str(t))}."
                for t in ([texts] if isinstance(texts, str) else texts)
            ]
    if metrics.get("coverage_95") is None and "true_s_m" not in run.contacts:
        said.append(
            "The truth is not known: sigmas are what the contacts claim, and nothing here checks them."
        )
    said += [escape(note) for note in notes]
    if not said:
        return '<ul class="findings fine"><li>Nothing out of the ordinary.</li></ul>'
    return (
        '<ul class="findings" aria-label="Worth knowing">'
        + "".join(f"<li>{text}</li>" for text in said)
        + "</ul>"
    )


def claims_html(run: Run, claims: Claims | None) -> str:
    """Charts of errors over sigmas and against s, and a table by kind; of sigmas alone where no truth is known."""
    good, table = run.good, run.contacts
    if not good.any():
        return '<p class="absent">Every contact is flagged: there is nothing to judge sigmas by.</p>'
    if claims is None:
        charts = [
            values_histogram(
                MM * table["sigma_s_m"][good], title="Claimed sigma of s", label="sigma of s [mm]"
            ),
            values_histogram(
                DEG * table["sigma_normal_rad"][good],
                title="Claimed sigma of normals",
                label="sigma of the normal [deg]",
            ),
        ]
        return (
            "<p>The truth is not known in this run, so that errors cannot be shown; this is what the unflagged "
            f'contacts claim.</p><div class="charts">{"".join(charts)}</div>'
        )
    groups = {kind.name.lower(): (table["kind"] == kind)[good] for kind in Kind}
    s = MM * table["s_m"][good]
    charts = [
        ratio_histogram(claims.distance_ratio[good], title="Errors of s over their sigmas", what="s"),
        ratio_histogram(
            claims.normal_ratio[good], title="Errors of sensed normals over their sigmas", what="normal"
        ),
    ]
    smooth = claims.smooth_normal_ratio
    if smooth is not None:
        title = "Errors of smoothed normals over their sigmas"
        charts.append(ratio_histogram(smooth[good], title=title, what="smoothed normal"))
    charts.append(
        scatter(
            s,
            MM * claims.distance[good],
            groups,
            title="Errors of s against s",
            x_label="s as sensed [mm]",
            y_label="sensed minus true s [mm]",
            claimed=MM * claims.sigma_distance[good],
            signed=True,
        )
    )
    turns = [("sensed", claims.normal, claims.sigma_normal)]
    if claims.smooth_normal is not None and claims.sigma_smooth_normal is not None:
        turns.append(("smoothed", claims.smooth_normal, claims.sigma_smooth_normal))
    for which, turn, sigma in turns:
        chart = scatter(
            s,
            DEG * turn[good],
            groups,
            title=f"Errors of {which} normals against s",
            x_label="s as sensed [mm]",
            y_label="error of the normal [deg]",
            claimed=DEG * sigma[good],
            signed=False,
        )
        charts.append(chart)
    return (
        "<p>Unflagged contacts only. Bars show how many contacts have an error of so many claimed sigmas. The line is "
        "what honest sigmas would give (the half-normal curve). Bars above it on the right mean sigmas that are too "
        "small, bars crowded at zero such as are too large. Tips crowd there: their s is the length of the beam. In "
        "the lower charts 95 % of the dots should lie in the band.</p>"
        f'<div class="charts">{"".join(charts)}</div>{_kinds(run, claims)}'
    )


def _kinds(run: Run, claims: Claims) -> str:
    """Table of contacts and errors by kind."""
    rows = []
    for kind in Kind:
        of_kind = np.asarray(run.contacts["kind"] == kind)
        good = of_kind & run.good
        if not of_kind.any():
            continue
        cells = [f"{int(of_kind.sum())}", f"{int((of_kind & ~run.good).sum())}"]
        if good.any():
            cells += [
                f"{MM * float(np.sqrt(np.mean(claims.distance[good] ** 2))):.3f}",
                f"{DEG * float(np.median(claims.normal[good])):.2f}",
                f"{100.0 * covered(claims.distance_ratio[good]):.1f}",
                f"{100.0 * covered(claims.normal_ratio[good]):.1f}",
                f"{int(claims.wrong[of_kind].sum())}",
            ]
        else:
            cells += ["&ndash;"] * 4 + ["0"]
        numbers = "".join(f'<td class="n">{cell}</td>' for cell in cells)
        rows.append(
            f'<tr><th scope="row">{kind.name.lower()}</th>{numbers}<td class="m">{KINDS[kind]}</td></tr>'
        )
    head = (
        "contacts",
        "flagged",
        "s rms [mm]",
        "normal median [deg]",
        "coverage s [%]",
        "normal [%]",
        "silently wrong",
    )
    heads = "".join(f'<th class="n">{text}</th>' for text in head)
    return (
        '<div class="wide"><table><caption>By kind of contact</caption>'
        f"<thead><tr><th>kind</th>{heads}<th></th></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def care_html(run: Run, claims: Claims | None) -> str:
    """Flags with their reasons and contacts, and what is silently wrong; each contact leads into the 3-D view."""
    flags, ids = run.contacts["flags"], run.contacts["id"]
    rows = "".join(
        f'<tr><th scope="row">{flag_names(int(flag))}</th><td class="n">{int(np.count_nonzero(flags & int(flag)))}</td>'
        f'<td class="m">{FLAGS[flag]}</td></tr>'
        for flag in Flag
        if flag
    )
    bad = int(np.count_nonzero(flags))
    intro = (
        f"<p>{bad} of {flags.size} contacts are flagged; a contact may have more than one flag. Flagged contacts take "
        "no part in errors, lines or surface, and are ringed in the 3-D view. A number leads to its contact there.</p>"
        '<table><thead><tr><th>flag</th><th class="n">contacts</th><th>reason</th></tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )
    kinds = np.unique(flags[flags != 0]).tolist()
    parts = [intro, *(_links(flag_names(value), ids[flags == value]) for value in kinds)]
    if claims is not None:
        parts.append("<h3>Silently wrong</h3>")
        count = int(claims.wrong.sum())
        parts.append(
            f"<p>{count} unflagged contacts are far off all the same (see <a href='#definitions'>Terms</a>).</p>"
            if count
            else "<p>None: no unflagged contact is far off.</p>"
        )
        if count:
            parts.append(_worst(run, claims))
    return "".join(parts)


def _links(title: str, ids: NDArray[np.int64]) -> str:
    links = "".join(f'<a href="#contact-{number}">{number}</a>' for number in ids.tolist())
    opened = " open" if ids.size <= 60 else ""
    return f'<details{opened}><summary>{escape(title)}: {ids.size}</summary><div class="ids">{links}</div></details>'


def _worst(run: Run, claims: Claims) -> str:
    """Table of the silently wrong contacts, the worst point first."""
    rows = np.flatnonzero(claims.wrong)
    rows = rows[np.argsort(-claims.point[rows])]
    kinds, ids = run.contacts["kind"], run.contacts["id"]
    body = "".join(
        f'<tr><td><a href="#contact-{ids[r]}">{ids[r]}</a></td><td class="n">{run.contour[r]}</td>'
        f'<td>{Kind(int(kinds[r])).name.lower()}</td><td class="n">{MM * run.contacts["s_m"][r]:.2f}</td>'
        f'<td class="n">{MM * claims.distance[r]:+.3f}</td><td class="n">{MM * claims.sigma_distance[r]:.3f}</td>'
        f'<td class="n">{DEG * claims.normal[r]:.2f}</td><td class="n">{DEG * claims.sigma_normal[r]:.2f}</td>'
        f'<td class="n">{MM * claims.point[r]:.3f}</td></tr>'
        for r in rows.tolist()
    )
    head = (
        "s [mm]",
        "error of s [mm]",
        "sigma [mm]",
        "error of normal [deg]",
        "sigma [deg]",
        "error of point [mm]",
    )
    heads = "".join(f'<th class="n">{text}</th>' for text in head)
    return (
        f'<details open><summary>{rows.size}, the worst point first</summary><div class="wide"><table><thead><tr>'
        f'<th>contact</th><th class="n">contour</th><th>kind</th>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div></details>"
    )


def contours_html(endings: Sequence[Mapping[str, Any]] | None) -> str:
    """How the contours ended, those that ended alike together; None where there is no log."""
    if endings is None:
        return '<p class="absent">log.jsonl is not in the folder: how the contours ended is not known.</p>'
    alike: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for ending in endings:
        alike.setdefault((str(ending.get("status")), str(ending.get("ended"))), []).append(ending)
    words = {status.name.lower(): text for status, text in STATUSES.items()}
    rows = []
    for (status, reason), group in sorted(alike.items(), key=lambda item: -len(item[1])):
        numbers = ", ".join(str(e.get("contour")) for e in group)
        whole = status == Status.CLOSED.name.lower() and len(group) > SOME
        contacts, approaches = (
            sum(int(e.get(key) or 0) for e in group) for key in ("contacts", "approaches")
        )
        said = words.get(status, "") + ("" if reason in {status, "", "None"} else f": {reason}")
        rows.append(
            f'<tr><th scope="row">{escape(status)}</th><td class="n">{len(group)}</td><td class="n">{contacts}</td>'
            f'<td class="n">{approaches}</td><td>{escape(said)}</td>'
            f'<td class="m">{"" if whole else escape(numbers)}</td></tr>'
        )
    head = (
        '<th>ended as</th><th class="n">contours</th><th class="n">contacts</th><th class="n">approaches</th>'
        "<th>the contour</th><th>numbers</th>"
    )
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    )


SOME = 12
"""Closed contours are not listed by number if there are more."""


def definitions_html() -> str:
    """Terms and what they mean."""
    return "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in DEFINITIONS)
