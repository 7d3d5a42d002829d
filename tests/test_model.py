"""The strategy ``model`` on contacts that stay where they are."""

from __future__ import annotations

import numpy as np
import pytest
from push_bench import Bench, true_contacts

from contour.antenna import Sensor
from contour.contacts import Flag
from contour.errors import InstrumentError
from contour.frames import Mount, wrap_angle
from contour.model import ModelSettings, ModelStrategy
from contour.virtual import VirtualAntenna


def sensed(bench: Bench, settings: ModelSettings | None = None, **changes):
    """Contacts of ``bench`` by the model."""
    n = bench.truth.distance.size
    return bench.localise(ModelStrategy(n, bench.antenna, Mount.identity(), settings), **changes)


def nothing(_contact, _eps, path, _rows):
    """The answer of thin air."""
    return np.zeros_like(path), np.full_like(path, np.pi)


def round_bodies(n: int, rng: np.random.Generator):
    """Round bodies of several frictions, the radii well above the depth of a push."""
    return true_contacts(
        n,
        distance=rng.uniform(0.06, 0.18, n),
        outward=rng.uniform(-np.pi, np.pi, n),
        radius_along=rng.uniform(0.0, 0.05, n),
        radius_across=rng.uniform(0.03, 0.08, n),
        friction=np.tan(np.deg2rad(rng.choice([10.0, 17.0, 25.0], n))),
    )


@pytest.mark.parametrize("exact", [False, True])
def test_first_contacts_are_right_and_say_how_sure_they_are(rng, exact):
    """60 first contacts, the normal unknown to 20 deg: s within 0.5 % rms, nothing silently wrong, few flags."""
    bench = Bench(round_bodies(60, rng), sensor=Sensor(), expected_off=np.deg2rad(12.0), exact=exact)
    contacts = sensed(bench)
    off = contacts.distance / bench.truth.distance - 1.0
    turn = np.abs(wrap_angle(contacts.outward - bench.truth.outward))
    good = contacts.good
    assert good.mean() > 0.9
    assert np.sqrt(np.mean(off[good] ** 2)) < 5e-3
    assert np.median(turn[good]) < np.deg2rad(0.6)
    wrong = (np.abs(off * bench.truth.distance) > np.maximum(4 * contacts.sigma_distance, 2.1e-3)) | (
        turn > np.maximum(4 * contacts.sigma_normal, np.deg2rad(5.0))
    )
    assert not np.any(wrong & good)
    assert contacts.pushes.mean() <= 2.5


def test_the_return_stroke_is_worth_pushes(rng):
    """Without the way back the same contacts take more pushes or end less sure of their normals."""
    truth = round_bodies(40, rng)
    with_back = sensed(Bench(truth, sensor=Sensor(), expected_off=0.1))
    without = sensed(Bench(truth, sensor=Sensor(), expected_off=0.1), ModelSettings(both_strokes=False))
    assert without.pushes.sum() > with_back.pushes.sum()


def test_pushes_stay_under_the_moment_limit():
    """At 25 mm a push of 3 deg would bend the wire for good: the planned angle keeps to the limit."""
    bench = Bench(true_contacts(4, distance=0.025, radius_across=0.05), sensor=Sensor())
    strategy = ModelStrategy(4, bench.antenna, Mount.identity())
    strategy.start(bench.touch())
    ask = strategy.ask()
    moment = bench.antenna.stiffness3 * ask.angle / 0.025
    assert np.all(moment < bench.antenna.moment_limit)


def test_a_touch_that_nothing_answers_is_lost():
    """Pushes into thin air end in a flag, after no more than the pushes allowed."""
    bench = Bench(true_contacts(3), sensor=Sensor())
    bench._virtual = VirtualAntenna(bench.antenna, bench.machine, bench.mount, nothing)
    contacts = sensed(bench)
    assert np.all(contacts.flags & Flag.LOST)
    assert np.all(contacts.pushes <= ModelSettings().most_pushes)


def test_a_dropped_contact_stays_as_it_was():
    """A body that is gone when the beam comes back leaves what the first push told."""
    bench = Bench(true_contacts(2, radius_across=0.05), sensor=Sensor(), expected_off=0.2)
    contacts = sensed(bench, drop_after=1)
    assert np.all(contacts.pushes == 1)


def test_asking_before_starting_is_refused():
    """Nothing is known before start()."""
    with pytest.raises(InstrumentError, match="start"):
        ModelStrategy(1, Bench(true_contacts(1)).antenna, Mount.identity()).ask()
