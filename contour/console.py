"""What the command line shows: progress with rate and time left, tables with units.

On a terminal progress is one line that moves; elsewhere it is a plain line now and then, fit for a log.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from contour.doctor import Finding

__all__ = ["Reporter", "findings_table", "metrics_table"]

_INTERVAL = 5.0
"""Plain lines come no more often than this [s]."""

_UNITS: tuple[tuple[str, str, float, str], ...] = (
    ("_per_s", "1/s", 1.0, ".0f"),
    ("time_s", "h", 1.0 / 3600.0, ".2f"),
    ("_s", "s", 1.0, ".2f"),
    ("_m", "mm", 1e3, ".3f"),
    ("_rad", "deg", 180.0 / math.pi, ".2f"),
    ("_rel", "%", 100.0, ".3f"),
    ("_share", "%", 100.0, ".1f"),
)
"""How names end, the unit shown for them, its factor from SI, and the format."""
_SHARES = ("coverage", "touched")
"""Beginnings of names that are shares, shown in percent."""


class Reporter:
    """Shows how far a scan is; a context manager, called with what is done."""

    def __init__(self, console: Console, *, clock: Any = time.monotonic) -> None:
        self._console = console
        self._clock = clock
        self._begun = self._said = clock()
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        self._begun = self._said = self._clock()
        if self._console.is_terminal:
            columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
            self._bar = Progress(*columns, TimeRemainingColumn(), console=self._console, transient=True)
            self._task = self._bar.add_task("scan", total=1.0)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, contacts: int, share: float) -> None:
        """Say that ``contacts`` have been made, and that ``share`` (0 to 1) of the work is done."""
        now = self._clock()
        elapsed = max(now - self._begun, 1e-9)
        rate = contacts / elapsed
        if self._bar is not None and self._task is not None:
            text = f"{contacts} contacts, {rate:.0f}/s"
            self._bar.update(self._task, completed=share, description=text)
        elif now - self._said >= _INTERVAL:
            self._said = now
            left = f", {elapsed * (1.0 - share) / share:.0f} s left" if share > 0.0 else ""
            self._console.print(f"{contacts} contacts, {100.0 * share:.0f} %, {rate:.0f} contacts/s{left}")


def metrics_table(title: str, metrics: Mapping[str, Any]) -> Table:
    """The figures of a scan with units; those a scan does not know (no truth) are left out."""
    table = Table("figure", "value", "unit", title=title, title_justify="left")
    table.columns[1].justify = "right"
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            for part, count in value.items():
                _add(table, f"{name}: ".replace("_", " "), part, count)
        else:
            _add(table, "", name, value)
    return table


def _add(table: Table, group: str, name: str, value: Any) -> None:
    """A row for one figure; for notes one each."""
    if name == "notes":
        for note in value:
            table.add_row(f"{group}note", escape(note), "")
    elif value is not None:
        label, text, unit = _row(name, value)
        table.add_row(group + label, text, unit)


def _row(name: str, value: Any) -> tuple[str, str, str]:
    """Label, value and unit of one figure; the unit follows from the end of its name."""
    unit, factor, form = "", 1.0, ".3f"
    label = name
    for ending, its_unit, its_factor, its_form in _UNITS:
        if name.endswith(ending):
            unit, factor, form = its_unit, its_factor, its_form
            label = name.removesuffix("_s" if ending == "time_s" else ending)
            break
    if name.startswith(_SHARES):
        unit, factor, form = "%", 100.0, ".1f"
    if isinstance(value, bool):
        return label.replace("_", " "), "yes" if value else "no", ""
    if name == "seconds":
        return "time", format(value, ".2f"), "s"
    values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    texts = [
        str(item) if isinstance(item, str | int) and not unit else format(factor * item, form)
        for item in values
    ]
    label += " per second" if name.endswith("_per_s") else ""
    return label.replace("_", " "), " x ".join(texts), unit


def findings_table(findings: Sequence[Finding]) -> Table:
    """What the doctor found."""
    table = Table("", "found", "remedy")
    for finding in findings:
        table.add_row(
            f"{'ok' if finding.good else 'MISSING':8}{finding.what}",
            finding.found,
            "" if finding.good else finding.remedy,
        )
    return table
