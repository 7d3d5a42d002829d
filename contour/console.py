"""What the command line shows: progress with rate and time left, tables with units.

On a terminal progress is one line that moves; elsewhere it is a plain line now and then, fit for a log.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from contour.doctor import Finding

__all__ = ["Reporter", "findings_table", "metrics_table"]

_INTERVAL = 5.0
"""Plain lines come no more often than this [s]."""

_LABELS: dict[str, tuple[str, float, str]] = {
    "contacts": ("", 1.0, ".0f"),
    "flagged": ("", 1.0, ".0f"),
    "pushes_per_contact": ("", 1.0, ".2f"),
    "s_error_rms_rel": ("%", 100.0, ".3f"),
    "point_error_rms_m": ("mm", 1e3, ".3f"),
    "point_error_p99_m": ("mm", 1e3, ".3f"),
    "normal_error_median_rad": ("deg", 57.29577951308232, ".2f"),
    "normal_error_p95_rad": ("deg", 57.29577951308232, ".2f"),
    "coverage_95": ("%", 100.0, ".1f"),
    "silently_wrong": ("", 1.0, ".0f"),
    "rays_cast": ("", 1.0, ".0f"),
    "scan_s": ("s", 1.0, ".2f"),
    "contacts_per_s": ("1/s", 1.0, ".0f"),
    "machine_time_s": ("h", 1.0 / 3600.0, ".2f"),
}
"""Unit shown, factor from SI and format of each metric."""


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
            left = elapsed * (1.0 - share) / share if share > 0.0 else float("inf")
            self._console.print(
                f"{contacts} contacts, {100.0 * share:.0f} %, {rate:.0f} contacts/s, {left:.0f} s left"
            )


def metrics_table(title: str, metrics: Mapping[str, Any]) -> Table:
    """The figures of a scan with units; those a scan does not know (no truth) are left out."""
    table = Table("figure", "value", "unit", title=title, title_justify="left")
    table.columns[1].justify = "right"
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            for part, count in value.items():
                table.add_row(f"{_words(name)}: {part}", f"{count}", "")
        elif value is not None and name in _LABELS:
            unit, factor, form = _LABELS[name]
            table.add_row(_words(name), format(factor * value, form), unit)
    return table


def _words(name: str) -> str:
    """A metric's name without the unit it has in the file."""
    for suffix in ("_rel", "_m", "_rad", "_s"):
        name = name.removesuffix(suffix)
    return name.replace("_", " ")


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
