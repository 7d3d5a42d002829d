"""Numbers with units at the border; inside, all is SI.

A key carries its unit (``diameter_mm = 0.8``) or its value does (``diameter = "0.8 mm"``). In keys, units are
written without spaces, powers and slashes: ``mm_s``, ``uNm_s``, ``kg_m3``.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from contour.errors import UsageError

__all__ = ["ANY_LENGTH", "DIMENSIONS", "METRES_PER", "Key", "closest", "read_section"]

METRES_PER = {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 25.4e-3, "ft": 0.3048}
"""Units of length, in m."""

ANY_LENGTH = -1
"""A list of one or more numbers."""
_DEG = math.pi / 180.0
DIMENSIONS: dict[str, dict[str, float]] = {
    "length": METRES_PER,
    "angle": {"rad": 1.0, "deg": _DEG},
    "speed": {"m_s": 1.0, "mm_s": 1e-3},
    "acceleration": {"m_s2": 1.0, "mm_s2": 1e-3},
    "turn speed": {"rad_s": 1.0, "deg_s": _DEG},
    "turn acceleration": {"rad_s2": 1.0, "deg_s2": _DEG},
    "moment": {"Nm": 1.0, "mNm": 1e-3, "uNm": 1e-6},
    "moment rate": {"Nm_s": 1.0, "mNm_s": 1e-3, "uNm_s": 1e-6},
    "stress": {"Pa": 1.0, "MPa": 1e6, "GPa": 1e9},
    "density": {"kg_m3": 1.0, "g_cm3": 1e3},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
}
"""Units of each dimension and their size in SI."""

_WITH_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """What one key of a section may hold."""

    kind: str
    """A dimension of :data:`DIMENSIONS`, or ``number``, ``whole`` (an integer), ``text`` or ``vectors``
    (lists of three numbers)."""
    usual: str = ""
    """The unit that messages suggest."""
    length: int = 0
    """Numbers in a list; 0 where the value is one number, :data:`ANY_LENGTH` for one or more."""
    choices: tuple[str, ...] = ()
    """Words that a text may be; any if empty."""

    @property
    def units(self) -> dict[str, float]:
        """Units of the dimension; none for numbers and texts."""
        return DIMENSIONS.get(self.kind, {})


def closest(word: str, known: Iterable[str]) -> str:
    """What to say about a word that is unknown: the nearest known one, or all of them."""
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(names)}"


def read_section(where: str, section: Mapping[str, Any], keys: Mapping[str, Key]) -> dict[str, Any]:
    """Values of a section in SI, by the keys' names without units; keys that are absent stay absent.

    Args:
        where: file and section, for messages.
        section: as read from TOML.
        keys: what is allowed.

    Raises:
        UsageError: an unknown, doubled or unit-less key, or a value of the wrong kind.
    """
    spellings = {name: (name, None) for name in keys}
    usual = [f"{name}_{key.usual}" if key.usual else name for name, key in keys.items()]
    for name, key in keys.items():
        spellings.update({f"{name}_{unit}": (name, unit) for unit in key.units})  # type: ignore[misc]
    values: dict[str, Any] = {}
    for spelling, value in section.items():
        if spelling not in spellings:
            raise UsageError(f"{where}: key {spelling!r} is unknown: {closest(spelling, usual)}")
        name, unit = spellings[spelling]
        if name in values:
            raise UsageError(
                f"{where}: {name} is given twice, the second time as {spelling!r}: keep one of them"
            )
        values[name] = _read(f"{where}: {spelling}", value, keys[name], name, unit)
    return values


def _read(what: str, value: Any, key: Key, name: str, unit: str | None) -> Any:
    if key.kind == "text":
        if not isinstance(value, str):
            raise UsageError(f"{what} = {value!r} must be a text in quotes")
        if key.choices and value not in key.choices:
            raise UsageError(f"{what} = {value!r} is unknown: {closest(value, key.choices)}")
        return value
    if key.kind == "vectors":
        if not isinstance(value, list) or not value:
            raise UsageError(f"{what} = {value!r} must be a list of directions, as [[0, 0, -1]]")
        three = Key(kind="number", length=3)
        return tuple(_read(what, item, three, name, unit) for item in value)
    if not key.length:
        return _number(what, value, key, name, unit)
    wanted = "one or more" if key.length == ANY_LENGTH else str(key.length)
    if not isinstance(value, list) or not value or (key.length != ANY_LENGTH and len(value) != key.length):
        raise UsageError(f"{what} = {value!r} must be a list of {wanted} numbers")
    return tuple(_number(what, item, key, name, unit) for item in value)


def _number(what: str, value: Any, key: Key, name: str, unit: str | None) -> float | int:
    if isinstance(value, str) and key.units and unit is None:
        return _with_unit(what, value, key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{what} = {value!r} must be a finite number")
    if key.kind == "whole":
        if not isinstance(value, int):
            raise UsageError(f"{what} = {value!r} must be a whole number")
        return value
    if key.units and unit is None:
        raise UsageError(
            f'{what} = {value!r} has no unit: write {name}_{key.usual}, or "{value!r} {key.usual}"'
        )
    return value * key.units[unit] if unit is not None else float(value)


def _with_unit(what: str, text: str, key: Key) -> float:
    match = _WITH_UNIT.fullmatch(text)
    if match is None:
        raise UsageError(f'{what} = {text!r} must be a number and a unit, as "0.8 {key.usual}"')
    number, unit = match.groups()
    plain = unit.replace(" ", "").replace("^", "").replace("/", "_").replace("\N{MICRO SIGN}", "u")
    if plain not in key.units:
        raise UsageError(
            f"{what} = {text!r}: {unit!r} is no unit of {key.kind}: use one of {', '.join(key.units)}"
        )
    return float(number) * key.units[plain]
