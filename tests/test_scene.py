"""Scene files: what they mean, and how they are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from contour.cloud import read_json, write_json
from contour.errors import UsageError
from contour.quantities import DIMENSIONS, Key, read_section
from contour.scene import PlanSettings, ScanSettings, load_scene, scene_of_record

BOX = np.array([[-0.05, -0.05, 0.0], [0.05, 0.05, 0.08]])


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene file beside a mesh file; its path."""
    (tmp_path / "thing.ply").write_bytes(b"ply\n")

    def write(text="", *, head='[[object]]\nmesh = "thing.ply"\n'):
        path = tmp_path / "scene.toml"
        path.write_text(head + text, encoding="utf-8")
        return path

    return write


def test_a_bare_mesh_makes_the_default_instrument(scene_file):
    """The default instrument: 210 mm of 0.8 mm steel, 100 Hz, 10 uN m, 15 mN m, 10 deg of friction."""
    scene = load_scene(scene_file().with_name("thing.ply"), unit="mm")
    beam, sensor = scene.antenna.beam, scene.antenna.sensor
    assert (beam.length, beam.diameter, beam.youngs_modulus, beam.adaptor) == (0.210, 0.8e-3, 206e9, 0.0)
    assert (sensor.moment_noise, sensor.moment_drift, sensor.sample_rate) == (10e-6, 1e-6, 100.0)
    assert sensor.encoder_step == pytest.approx(np.deg2rad(0.001))
    assert (sensor.touch_sigmas, scene.antenna.moment_limit) == (5.0, 15e-3)
    machine = scene.machine
    assert (machine.travel_speed, machine.approach_speed, machine.acceleration) == (0.050, 0.010, 0.5)
    assert np.rad2deg([machine.push_speed, machine.return_speed]) == pytest.approx([2.0, 5.0])
    assert np.rad2deg(scene.bodies[0].friction_angle) == pytest.approx(10.0)
    assert scene.bodies[0].unit == "mm"
    assert scene.name == "thing"
    assert scene.scan == ScanSettings(strategy="model", rung="auto")


def test_keys_and_values_may_carry_the_unit(scene_file):
    """The same length in three spellings is the same length."""
    scenes = [
        load_scene(scene_file(f"[antenna]\n{line}\nmoment_limit_mNm = 40\nyield_stress_MPa = 900\n"))
        for line in ("diameter_mm = 1.2", 'diameter = "1.2 mm"', 'diameter = "1200um"')
    ]
    assert [s.antenna.beam.diameter for s in scenes] == pytest.approx([1.2e-3] * 3, rel=1e-12)


def test_every_section_reaches_its_owner(scene_file):
    """One value of each kind arrives in SI where it belongs."""
    scene = load_scene(
        scene_file(
            """
            unit = "in"
            position_mm = [10, 20, 30]
            rotation_deg = [0, 0, 90]
            friction_angle_deg = 17
            [antenna]
            youngs_modulus_GPa = 70
            moment_drift = "3 uN m/s"
            [gantry]
            approach_speed_mm_s = 5
            turn_acceleration_deg_s2 = 90
            x_mm = [-300, 300]
            phi2_deg = [-60, 60]
            floor_mm = -2
            position_mm = [0, -500, 0]
            rotation_deg = [180, 0, 0]
            [scan]
            rung = "elastica"
            seed = 7
            [plan]
            family = "levels"
            axis = [0, 0, -1]
            heights_mm = [-60, -30]
            """
        )
    )
    body = scene.bodies[0]
    assert body.unit == "in"
    assert body.placement[:3, 3] == pytest.approx([0.010, 0.020, 0.030])
    assert body.placement[:3, 0] == pytest.approx([0.0, 1.0, 0.0])  # its x axis is the world's y
    assert np.rad2deg(body.friction_angle) == pytest.approx(17.0)
    assert scene.antenna.beam.youngs_modulus == 70e9
    assert scene.machine.sensor.moment_drift == pytest.approx(3e-6)
    assert scene.machine.approach_speed == pytest.approx(0.005)
    assert scene.machine.turn_acceleration == pytest.approx(np.pi / 2)
    assert scene.machine.seed == scene.scan.seed == 7
    assert scene.scan.rung == "elastica"
    assert scene.reach.lower == pytest.approx([-0.3, -np.inf, -np.inf, -np.inf, -np.pi / 3])
    assert scene.reach.floor == pytest.approx(-0.002)
    assert scene.mount.origin == pytest.approx([0.0, -0.5, 0.0])
    assert scene.mount.rotation == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-15)
    assert scene.plan.heights == pytest.approx((-0.06, -0.03))


def test_plans_are_built_from_their_settings(scene_file):
    """The contours asked for bound the default plan; silhouettes make one contour for each direction."""
    default = load_scene(scene_file("[plan]\ncontours = 7\nstep_mm = 9\n")).build_plan(BOX)
    assert 0 < default.contours <= 7
    assert default.step == pytest.approx(9e-3)
    text = '[plan]\nfamily = "silhouettes"\ndirections = [[0, 1, -0.2], [0.3, 1, 0.4]]\n'
    assert load_scene(scene_file(text)).build_plan(BOX).contours == 2


def test_overrides_beat_the_file(scene_file):
    """Strategy and seed of the command line win; the unit only fills a gap."""
    path = scene_file('unit = "cm"\n[scan]\nstrategy = "model-out"\nseed = 1\n')
    scene = load_scene(path, unit="mm", strategy="model", seed=5)
    assert (scene.scan.strategy, scene.scan.seed, scene.machine.seed) == ("model", 5, 5)
    assert scene.bodies[0].unit == "cm"


@pytest.mark.parametrize(
    "text,message",
    [
        (
            "[antenna]\ndimeter_mm = 1\n",
            r"\[antenna\]: key 'dimeter_mm' is unknown: did you mean 'diameter_mm'\?",
        ),
        ("[antenna]\nlength_deg = 1\n", r"'length_deg' is unknown: did you mean 'length_mm'"),
        ("[antena]\n", r"section \[antena\] is unknown: did you mean 'antenna'"),
        ("[antenna]\nlength = 210\n", r"length = 210 has no unit: write length_mm"),
        ('[antenna]\nlength = "210 deg"\n', r"'deg' is no unit of length"),
        ('[antenna]\nlength = "long"\n', r"must be a number and a unit"),
        ('[antenna]\nlength_mm = 210\nlength = "210 mm"\n', r"length is given twice"),
        ("[antenna]\nlength_mm = nan\n", r"length_mm = nan must be a finite number"),
        ("[antenna]\nlength_mm = true\n", r"length_mm = True must be a finite number"),
        ("[antenna]\nlength_mm = -1\n", r"length"),
        ("[antenna]\nmoment_limit_mNm = 31\n", r"above the yield moment"),
        ("[antenna]\nmoment_noise_uNm = 2000\n", r"yield before contact is felt"),
        ("[gantry]\nx_mm = [3]\n", r"must be a list of 2 numbers"),
        ("[gantry]\nx_mm = [3, -3]\n", r"axis X is empty"),
        ("[gantry]\ntravel_speed_mm_s = 0\n", r"travel_speed"),
        ('[scan]\nstrategy = "modell"\n', r"'modell' is unknown: did you mean 'model'"),
        ("[scan]\nseed = 1.5\n", r"must be a whole number"),
        ("[scan]\nseed = -1\n", r"seed is -1"),
        ("[scan]\ntolerance = 2\n", r"tolerance is 2"),
        ("[plan]\ncontours = 0\n", r"at least one"),
        ("[plan]\nstep_mm = 0\n", r"step is 0 mm"),
        ('[plan]\nfamily = "levels"\n', r"'levels' needs axis"),
        ("[plan]\naxis = [0, 0, 1]\n", r"'default' has no use for axis"),
        ('[plan]\nfamily = "silhouettes"\ndirections = 3\n', r"list of directions"),
        ("friction_angle_deg = 90\n", r"friction angle is 90 deg"),
        ('unit = "mn"\n', r"'mn' is unknown"),
        ("[scan\n", r"not valid TOML"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(scene_file, text, message):
    """Each names the thing and the file, in one line."""
    path = scene_file(text)
    with pytest.raises(UsageError, match=message) as refusal:
        load_scene(path)
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    "head,message",
    [
        ("", r"is empty"),
        ("[scan]\nseed = 1\n", r"has no object"),
        ("[[object]]\n", r"has no mesh"),
        ('[[object]]\nmesh = "gone.ply"\n', r"gone.ply does not exist"),
        ("object = 3\n", r"must be a section"),
        ('[[object]]\nmesh = "thing.ply"\n[[object]]\nmash = "thing.ply"\n', r"\[\[object\]\] 2: key 'mash'"),
    ],
)
def test_objects_must_be_there(scene_file, head, message):
    """A scene without an object, or with one that is not there, is refused."""
    with pytest.raises(UsageError, match=message):
        load_scene(scene_file(head=head))


def test_missing_files_and_units_are_named(tmp_path):
    """A path that leads nowhere and a unit that does not exist are named."""
    with pytest.raises(UsageError, match=r"nothing\.ply does not exist"):
        load_scene(tmp_path / "nothing.ply")
    with pytest.raises(UsageError, match=r"--unit 'mn' is unknown"):
        load_scene(tmp_path / "nothing.ply", unit="mn")


def test_settings_made_in_python_are_checked_too():
    """The dataclasses refuse what the file reader would."""
    with pytest.raises(UsageError, match="did you mean 'model'"):
        ScanSettings(strategy="modle")
    with pytest.raises(UsageError, match="no plan family"):
        PlanSettings(family="spiral")


def test_resolved_scene_is_plain_json(scene_file, tmp_path):
    """Every number of the scene survives JSON; limits that are not there become null."""
    scene = load_scene(scene_file("[gantry]\nz_mm = [0, 400]\n"))
    write_json(tmp_path / "run.json", scene.resolved())
    again = read_json(tmp_path / "run.json")
    assert again["antenna"]["beam"]["length"] == 0.210
    assert again["reach"]["lower"] == [None, None, 0.0, None, None]
    assert json.dumps(again["scan"]) == json.dumps(scene.resolved()["scan"])


@pytest.mark.parametrize("kind", DIMENSIONS)
def test_every_unit_is_read_in_key_and_value(kind):
    """A number with a unit in the key equals the same number with the unit in the value."""
    for unit, size in DIMENSIONS[kind].items():
        key = {"thing": Key(kind=kind, usual=unit)}
        in_key = read_section("test", {f"thing_{unit}": 2.5}, key)
        in_value = read_section("test", {"thing": f"2.5 {unit}"}, key)
        assert in_key == in_value == {"thing": pytest.approx(2.5 * size)}


def test_scenes_come_back_from_their_record(scene_file, tmp_path):
    """What run.json holds is the whole scene: infinite limits, lists and numbers included."""
    full = (
        "position_mm = [1, 2, 3]\nfriction_angle_deg = 7\n[antenna]\nlength_mm = 180\nmoment_noise_uNm = 5\n"
        "moment_limit_mNm = 12\n[gantry]\nx_mm = [-100, 400]\nrotation_deg = [0, 0, 30]\napproach_speed_mm_s = 7\n"
        '[scan]\nseed = 4\nsurface = "layers"\n[plan]\n'
    )
    families = (
        'family = "levels"\naxis = [0, 0.8, -0.6]\nheights_mm = [10, 20]',
        'family = "silhouettes"\ndirections = [[0, 1, 0], [1, 0, 0]]',
    )
    for text in ("", *(full + family for family in families)):
        scene = load_scene(scene_file(text), unit="mm")
        write_json(tmp_path / "record.json", scene.resolved())
        again = scene_of_record(read_json(tmp_path / "record.json"))
        write_json(tmp_path / "again.json", again.resolved())
        assert read_json(tmp_path / "again.json") == read_json(tmp_path / "record.json")
        assert (again.antenna, again.machine, again.scan, again.plan) == (
            scene.antenna,
            scene.machine,
            scene.scan,
            scene.plan,
        )
        np.testing.assert_array_equal(again.reach.lower, scene.reach.lower)
        np.testing.assert_array_equal(again.reach.upper, scene.reach.upper)
        assert again.reach.floor == scene.reach.floor
        np.testing.assert_array_equal(again.mount.rotation, scene.mount.rotation)
        np.testing.assert_array_equal(again.bodies[0].placement, scene.bodies[0].placement)
        assert again.bodies[0].mesh == scene.bodies[0].mesh
