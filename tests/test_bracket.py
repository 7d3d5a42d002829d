"""The fallback search for the first equilibrium."""

from __future__ import annotations

import numpy as np

from contour.bracket import first_root


def search(value, start, *, fits=lambda b: np.ones(b.shape, dtype=bool), longest=0.05):
    """Roots of ``value`` past ``start`` and whether there are any; every evaluation is counted."""
    calls = [0]

    def evaluate(b):
        calls[0] += 1
        return value(b), fits(b)

    start = np.asarray(start, dtype=float)
    root, found = first_root(evaluate, start, np.full(start.shape, 0.05), np.full(start.shape, longest))
    return root, found, calls[0]


def test_the_first_of_several_roots_is_found_to_a_doubles_precision():
    """sin(40 b) has roots every pi/40; brackets no longer than the least distance of two do not pass over one."""
    offset = np.linspace(0.001, 0.07, 50)
    root, found, calls = search(lambda b: np.sin(40.0 * (b - offset)), np.zeros(50))
    assert found.all()
    # The value at 0 is negative or positive; the root lies past it, on the side its sign points to.
    assert np.max(np.abs(np.sin(40.0 * (root - offset)))) < 1e-11
    assert np.all(np.abs(root) <= np.pi / 40.0)
    assert calls < 80


def test_steep_and_flat_residuals_are_narrowed_alike():
    """Friction's law is nearly a step where the slip is small, and nearly flat far out."""
    root, found, calls = search(lambda b: np.tanh(1e6 * (b - 0.0123)) + 1e-3 * (b - 0.0123), np.zeros(3))
    assert found.all()
    assert np.max(np.abs(root - 0.0123)) < 1e-10
    assert calls < 110


def test_where_the_body_ends_first_there_is_none():
    """Rows whose root lies past the end of the body come back as they began; the others are not troubled."""
    end = np.array([0.5, 0.1])
    root, found, _ = search(lambda b: b - 0.3, np.array([0.0, 0.0]), fits=lambda b: b < end)
    assert found.tolist() == [True, False]
    assert abs(root[0] - 0.3) < 1e-12
    assert root[1] == 0.0


def test_a_start_that_is_a_root_is_kept():
    """Nothing moves where nothing pulls."""
    root, found, _ = search(lambda b: b * 2.0, np.array([0.0]))
    assert found.all()
    assert root[0] == 0.0


def test_a_residual_without_a_root_ends():
    """The search gives up."""
    _, found, calls = search(lambda b: 1.0 + b * b, np.array([0.0]), longest=1e-3)
    assert not found.any()
    assert calls < 400
