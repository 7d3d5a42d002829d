"""Strategies by name: from pushes to contacts, n at once, all of the same shape (ask and tell).

model              ours: both strokes, a joint estimate, as few pushes as the tolerance allows
model-out          the same without the return stroke, to show what it buys
bisection          Kaneko1998, (15)-(19), as printed
bisection-limited  the same with limited steps
one-push           Solomon2008, with an assumed friction angle
"""

from __future__ import annotations

from collections.abc import Callable

from contour.antenna import Antenna
from contour.bisection import BisectionSettings, BisectionStrategy
from contour.errors import UsageError
from contour.frames import Mount
from contour.model import ModelSettings, ModelStrategy
from contour.one_push import OnePushSettings, OnePushStrategy
from contour.sensing import Action, Ask, Strategy, Touch

__all__ = [
    "STRATEGIES",
    "Action",
    "Ask",
    "BisectionSettings",
    "BisectionStrategy",
    "ModelSettings",
    "ModelStrategy",
    "OnePushSettings",
    "OnePushStrategy",
    "Strategy",
    "Touch",
    "make_strategy",
]

_MAKERS: dict[str, Callable[[int, Antenna, Mount], Strategy]] = {
    "model": ModelStrategy,
    "model-out": lambda n, antenna, mount: ModelStrategy(
        n, antenna, mount, ModelSettings(both_strokes=False)
    ),
    "bisection": BisectionStrategy,
    "bisection-limited": lambda n, antenna, mount: BisectionStrategy(
        n, antenna, mount, BisectionSettings(largest_step=0.7, name="bisection-limited")
    ),
    "one-push": OnePushStrategy,
}

STRATEGIES = tuple(_MAKERS)
"""Names that :func:`make_strategy` knows."""


def make_strategy(name: str, antennas: int, antenna: Antenna, mount: Mount) -> Strategy:
    """The strategy called ``name`` for ``antennas`` contours."""
    if name not in _MAKERS:
        raise UsageError(f"strategy {name!r} is not known: use one of {', '.join(STRATEGIES)}")
    return _MAKERS[name](antennas, antenna, mount)
