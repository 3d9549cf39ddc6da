"""The limb's YAML file: exact round trip, and ways to get a field wrong.

Each field's range is compared with the page on limbs in tests/test_docs.py.
"""

import dataclasses
import math
import re
import subprocess
import sys

import numpy as np
import pytest
import yaml

from limb_systems import (
    CalibrationRecord,
    ChordSensor,
    CoupledLaw,
    EmulatedLimb,
    HystereticLaw,
    LimbError,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    TemperatureLimits,
    ThresholdLaw,
    WireParameters,
    wires_around,
)
from limb_systems.heat_bounds import HeatBounds
from limb_systems.limb_parameters import ParameterError

WIRE = ("segments", 0, "wires", 0)


def edited(keys, value) -> str:
    """YAML text of the nominal limb with one value replaced; without tags, which are defaults."""
    data = yaml.safe_load(re.sub(r"!\w+ ", "", LimbParameters().to_yaml()))
    part = data
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    return yaml.safe_dump(data)


def everything(rng) -> LimbParameters:
    """A limb with all that a description may have, and numbers with all the digits of a double."""
    limb = LimbParameters(segments=[SegmentParameters(), SegmentParameters(wires=wires_around(3))])
    first, second = limb.segments
    for name in ("length", "mass", "width", "thickness", "stiffness", "damping"):
        setattr(first, name, float(getattr(first, name) * rng.uniform(0.8, 1.1)))
    first.name, first.stiffening, first.rest_memory = "upper", float(rng.uniform()), RestMemory()
    first.wires[0].heat_bounds = HeatBounds()
    first.wires[1].law = HystereticLaw(a1=float(-rng.uniform(0.01, 0.1)))
    second.axes, second.twists, second.centred_joints = 2, True, True
    second.stiffness_ratio, second.torsional_ratio, second.rest_angle_e3 = 0.9, 0.6, 0.1
    second.bend_sensor = ChordSensor(offset_e3=0.05, roll=float(rng.normal()))
    limb.payload, limb.supply_voltage, limb.gravity = 0.01, 7.0, rng.uniform(-10, 10, 3).tolist()
    limb.temperature_limits = TemperatureLimits(rng.uniform(80, 120), rng.uniform(40, 79))
    limb.board = EmulatedLimb(int(rng.integers(100)), LimbParameters().to_yaml(), ["hysteresis"])
    errors = rng.uniform(size=(4, 2)).tolist()
    limb.calibration = CalibrationRecord(["a1", "a2"], *errors[:2], errors[2:], ["a line"])
    return limb


def test_round_trip_is_exact(tmp_path):
    for seed in range(5):
        parameters = everything(np.random.default_rng(seed))
        parameters.save(tmp_path / "limb.yaml")
        assert LimbParameters.load(tmp_path / "limb.yaml") == parameters
    for value in (0.1 + 0.2, 1e-6 * (1 + 2**-52), math.nextafter(1e4, 0), 7e-5):
        parameters = LimbParameters(segments=[SegmentParameters(stiffness=value, damping=0.0)])
        assert LimbParameters.from_yaml(parameters.to_yaml()) == parameters


def test_a_field_that_is_left_out_has_its_default():
    text = "segments:\n- length: 0.14\n  wires:\n  - {name: right, law: {a2: 25.0}}\n"
    wire = WireParameters("right", law=LinearLaw(a2=25.0))
    expected = LimbParameters(segments=[SegmentParameters(length=0.14, wires=[wire])])
    assert LimbParameters.from_yaml(text) == expected


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("segments",), {}, ("segments", "list")),
        (("segments",), [], ("segments", "at least one")),
        (("segments", 0, "mass"), True, ("segments[0].mass is ", "number")),
        (("segments", 0, "mass"), -0.025, ("-0.025", "from 1e-06 to 100 kg")),
        (("segments", 0, "mass"), 25.0, ("segments[0].mass is 25 kg", "in grams")),
        (("segments", 0, "links"), 2.5, ("segments[0].links", "whole number")),
        (("segments", 0, "twists"), True, ("segments[0].twists", "axes to 2")),
        ((*WIRE, "name"), "", ("wires[0].name is ''",)),
        ((*WIRE, "law"), {"a1": 0.07}, ("wires[0].law.a1", "from -10 to -0.0001 1/s")),
        ((*WIRE, "heat_bounds"), {"least_heating": 50.0}, ("least_heating", "most_heating")),
        (("gravity",), [0.0, -9.81], ("gravity", "three numbers")),
        (("temperature_limits", "maximum"), 25.0, ("maximum", "ambient_temperature", "25")),
        (("temperature_limits", "warm"), 100.0, ("warm", "temperature_limits.maximum", "100")),
        (("stiffness",), 1.0, ("stiffness",)),
    ],
)
def test_values_that_no_limb_has_are_refused_by_name(refused, keys, value, words):
    with refused(ParameterError, *words):
        LimbParameters.from_yaml(edited(keys, value))


def test_a_wire_without_a_lever_or_a_name_of_its_own_is_refused(refused):
    limb = LimbParameters()
    limb.segments[0].wires[1].name = "left"
    with refused(ParameterError, "segments[0].wires[1].name is 'left'", "another wire"):
        limb.validate()
    for e3 in (0.0, 0.004):
        limb.segments[0].wires[1] = WireParameters("middle", 0.0, e3)
        with refused(ParameterError, "segments[0].wires[1]", "cannot bend the limb sideways"):
            limb.validate()
    limb.segments[0].wires = []
    with refused(ParameterError, "segments[0].wires", "at least one"):
        limb.validate()


def test_heat_bounds_are_around_a_law_that_is_described():
    """But not around one that was fitted to a bend."""
    parameters = LimbParameters()
    parameters.wires[1].law = LinearLaw(-0.05, 30.0, -2.0)
    left, right = parameters.heat_bounds
    assert dataclasses.astuple(left) == pytest.approx((0.042, 0.0952, 17.0, 23.0, 0.5))
    assert dataclasses.astuple(right) == pytest.approx((0.03, 0.068, 25.5, 34.5, 1.0))
    parameters.calibration = CalibrationRecord([], [], [], [])
    assert parameters.heat_bounds == [left, left]
    parameters.wires[1].heat_bounds = right
    assert parameters.heat_bounds == [left, right]
    parameters.calibration = None
    parameters.wires[0].law = LinearLaw(-5.0, 500.0, -2.0)
    with pytest.raises(LimbError, match="slowest_cooling would be 3 1/s by its law, but a board"):
        _ = parameters.heat_bounds


def test_heat_bounds_of_a_law_with_silicone_include_cold_and_warm_silicone():
    parameters = LimbParameters()
    parameters.wires[0].law = HystereticLaw(-0.1, 22.0, -2.0, 0.006, 0.012)
    left, _ = parameters.heat_bounds
    lasting = 0.1 * 0.012 / 0.018
    expected = (0.6 * lasting, 1.36 * 0.1, 0.85 * 22.0, 1.15 * 22.0, 0.5 * 2.0)
    assert dataclasses.astuple(left) == pytest.approx(expected)


def test_file_that_is_no_limb_is_refused_by_name(refused, tmp_path):
    path = tmp_path / "limb.yaml"
    for content in (
        b"# a comment\n",
        bytes(range(256)),
        b"segments: [",
        b"segments: *nothing",
        b"!!python/object/apply:os.getcwd []",
        b"just text",
        b"- 1\n- 2\n",
        b"time_s,duty_left\n0.0,0.5\n",
        b"[" * 5000,
        *[LimbParameters().to_yaml()[:size].encode() for size in (0, 10, 420, 540)],
    ):
        path.write_bytes(content)
        with refused(ParameterError, path):
            LimbParameters.load(path)


def test_a_missing_sign_or_a_wrong_unit_is_pointed_out():
    limb = LimbParameters()
    assert limb.plausibility_warnings() == []
    segment = limb.segments[0]
    segment.mass *= 1000.0
    (heavy,) = limb.plausibility_warnings()
    assert "times the water" in heavy
    segment.mass /= 1000.0
    for sign, side in ((1.0, ">"), (-1.0, "<")):
        for wire in segment.wires:
            wire.e2 = sign * abs(wire.e2)
        (one_sided,) = limb.plausibility_warnings()
        assert f"run on the same side (e2 {side} 0)" in one_sided
    space = LimbParameters.in_space(wires=3)
    space.segments[0].wires[0].e2 *= -1.0
    (gap,) = space.plausibility_warnings()
    assert "none can bend it towards 0° from +E2" in gap


def test_a_file_with_any_built_in_law_loads_without_further_imports(tmp_path):
    parameters = LimbParameters()
    parameters.segments[0].wires[0].law = CoupledLaw()
    parameters.segments[0].wires[1].law = ThresholdLaw()
    parameters.save(tmp_path / "limb.yaml")
    program = (
        "import sys; from limb_systems import LimbParameters; LimbParameters.load(sys.argv[1])"
    )
    subprocess.run([sys.executable, "-c", program, tmp_path / "limb.yaml"], check=True)


def test_a_field_that_a_later_version_adds_leaves_emulated_boards_their_numbers():
    @dataclasses.dataclass
    class _LaterLimb(EmulatedLimb):
        room: str = ""

    for limb in (EmulatedLimb(3, extra=["bond"]), EmulatedLimb(3, physics="rod")):
        later = _LaterLimb(**vars(limb))
        assert later.serial_number == limb.serial_number
        assert dataclasses.replace(later, room="cellar").serial_number != limb.serial_number
    assert EmulatedLimb(3, physics="rod").identity == "(3, '', [], [], ('physics', 'rod'))"
    assert EmulatedLimb(3, physics="rod").identity != EmulatedLimb(3, limb="rod").identity
    assert EmulatedLimb(3, extra=["bond"]).identity == "(3, '', [], ['bond'])"
