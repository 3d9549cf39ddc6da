"""The limb's YAML file: exact round trip, and every way to get a field wrong.

The fields are found by walking over the dataclasses, so that a new field is
tested without a change here. What physics allows is listed by hand.
"""

import dataclasses
import math
import re
import types
import typing

import numpy as np
import pytest
import yaml

from limb_systems import (
    CalibrationRecord,
    ChordSensor,
    EmulatedLimb,
    HystereticLaw,
    LimbError,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    TemperatureLimits,
    WireParameters,
    wires_around,
)
from limb_systems.model.heat_bounds import HeatBounds
from limb_systems.model.parameters import ParameterError


@dataclasses.dataclass
class Leaf:
    """A number in the document: where, of which type, unit and range."""

    keys: tuple
    type: type
    unit: str
    low: float
    high: float

    @property
    def path(self) -> str:
        return path_of(self.keys)


def path_of(keys) -> str:
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return text.removeprefix(".")


def walk(schema, keys=()):
    """Leaves below a dataclass, and the keys of every field and every dataclass."""
    leaves, fields, groups = [], [], [keys]
    for field in dataclasses.fields(schema):
        here, inner = (*keys, field.name), field.type
        if field.name in ("format", "calibration"):  # have tests of their own
            continue
        fields.append(here)
        is_list = typing.get_origin(inner) is list
        if is_list:
            inner, here = typing.get_args(inner)[0], (*here, 0)
        if isinstance(inner, types.UnionType):
            inner = typing.get_args(inner)[0]  # the default
        if dataclasses.is_dataclass(inner):
            below = walk(inner, here)
            leaves, fields, groups = leaves + below[0], fields + below[1], groups + below[2]
        elif inner not in (str, bool):
            places = [(*here[:-1], index) for index in range(3)] if is_list else [here]
            unit, (low, high) = field.metadata["unit"], field.metadata["range"]
            leaves += [Leaf(place, inner, unit, low, high) for place in places]
    return leaves, fields, groups


LEAVES, FIELDS, GROUPS = walk(LimbParameters)
GRAVITY = [leaf for leaf in LEAVES if leaf.keys[0] == "gravity"]
OPTIONAL = ("heat_bounds", "rest_memory")


def nominal() -> LimbParameters:
    """The nominal limb, with all that a description may have."""
    parameters = LimbParameters()
    parameters.wires[0].heat_bounds = HeatBounds()
    parameters.segments[0].stiffening = 0.3
    parameters.segments[0].rest_memory = RestMemory()
    parameters.payload, parameters.supply_voltage = 0.01, 7.0
    segment = parameters.segments[0]
    segment.axes, segment.twists, segment.centred_joints = 2, True, True
    segment.stiffness_ratio, segment.torsional_ratio, segment.rest_angle_e3 = 0.9, 0.6, 0.1
    segment.name = "upper"
    segment.bend_sensor.offset_e3, segment.bend_sensor.roll = 0.05, 0.1
    return parameters


def document() -> dict:
    """The nominal limb's; without tags, which leaves the defaults of the unions."""
    return yaml.safe_load(re.sub(r"!\w+ ", "", nominal().to_yaml()))


def edited(keys, value) -> str:
    """YAML text of the nominal limb with one value replaced."""
    data = document()
    parent(data, keys)[keys[-1]] = value
    return yaml.safe_dump(data)


def parent(data, keys):
    for key in keys[:-1]:
        data = data[key]
    return data


def value_at(parameters: LimbParameters, keys):
    for key in keys:
        parameters = parameters[key] if isinstance(key, int) else getattr(parameters, key)
    return parameters


def with_value(keys, value, limb: LimbParameters | None = None) -> LimbParameters:
    """A limb as an object, the nominal one if None, with one value replaced."""
    parameters = limb or nominal()
    owner = value_at(parameters, keys[:-1])
    if isinstance(keys[-1], int):
        owner[keys[-1]] = value
    else:
        setattr(owner, keys[-1], value)
    return parameters


def field_in_object(leaf: Leaf) -> str:
    """How `validate` calls a leaf; it does not count the entries of gravity."""
    return "gravity" if leaf in GRAVITY else leaf.path


def test_the_walk_finds_the_fields_of_all_levels():
    paths = {leaf.path for leaf in LEAVES}
    assert {"segments[0].wires[0].law.beta", "gravity[2]"} <= paths
    assert [path_of(keys) for keys in GROUPS] == [
        "",
        "segments[0]",
        "segments[0].rest_memory",
        "segments[0].wires[0]",
        "segments[0].wires[0].law",
        "segments[0].wires[0].heat_bounds",
        "segments[0].bend_sensor",
        "temperature_limits",
        "board",
    ]


# Round trip


def random_limb(rng) -> LimbParameters:
    """The nominal limb with other values in most fields, with all the digits of a double."""
    parameters = nominal()
    for leaf in LEAVES:
        if leaf.type is not int:
            value = value_at(parameters, leaf.keys) * rng.uniform(0.9, 1.1)
            with_value(leaf.keys, float(value), parameters)
    second = SegmentParameters(bend_sensor=ChordSensor(), wires=wires_around(3), axes=2)
    second.wires[1].law = HystereticLaw(a1=float(-rng.uniform(0.01, 0.1)))
    parameters.segments.append(second)
    parameters.board = EmulatedLimb(int(rng.integers(100)), second.wires[0].name, ["hysteresis"])
    errors = rng.uniform(size=(4, 2)).tolist()
    parameters.calibration = CalibrationRecord(["a1", "a2"], *errors[:2], errors[2:], ["a line"])
    return parameters


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_round_trip_is_exact(tmp_path):
    for seed in range(5):
        parameters = random_limb(np.random.default_rng(seed))
        parameters.save(tmp_path / "limb.yaml")
        assert LimbParameters.load(tmp_path / "limb.yaml") == parameters
    for value in (0.1 + 0.2, 1e-6 * (1 + 2**-52), math.nextafter(1e4, 0), 7e-5):
        parameters = LimbParameters(segments=[SegmentParameters(stiffness=value, damping=0.0)])
        assert LimbParameters.from_yaml(parameters.to_yaml()) == parameters


# Documents without the right fields


def test_a_field_that_is_left_out_has_its_default(refused):
    for keys in FIELDS:
        data = document()
        del parent(data, keys)[keys[-1]]
        if keys[-1] == "axes":
            del data["segments"][0]["twists"]  # which needs two of them
        if keys[-1] == "name" and "wires" in keys:
            with refused(ParameterError, "wires[0].name is ''"):
                LimbParameters.from_yaml(yaml.safe_dump(data))
            continue
        loaded = LimbParameters.from_yaml(yaml.safe_dump(data))
        owner = value_at(loaded, keys[:-1])
        assert getattr(owner, keys[-1]) == getattr(type(owner)(), keys[-1]), keys
        assert set(document()) - {"payload", "supply_voltage"} <= set(
            yaml.safe_load(re.sub(r"!\w+ ", "", loaded.to_yaml()))
        )


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


def test_values_of_another_kind_are_refused(refused):
    for keys in GROUPS[1:]:  # groups of fields
        for value in (1.0, []) if keys[-1] in OPTIONAL else (None, 1.0, "text"):
            with refused(ParameterError, path_of(keys), "must "):
                LimbParameters.from_yaml(edited(keys, value))
        with refused(ParameterError, path_of(keys)):
            with_value(keys, 1.0 if keys[-1] in OPTIONAL else None).validate()
    for name in ("segments", "gravity"):
        for value in (None, "text", {}, True):
            with refused(ParameterError, name, "list"):
                LimbParameters.from_yaml(edited((name,), value))
    for leaf in LEAVES:
        with refused(ParameterError, field_in_object(leaf)):
            with_value(leaf.keys, True).validate()
    for value in ("text", [1.0], {"a": 1.0}, None, True, ""):
        with refused(ParameterError, "segments[0].mass is ", "number"):
            LimbParameters.from_yaml(edited(("segments", 0, "mass"), value))
    for value in (2.5, "5.5", 1e-3):
        with refused(ParameterError, "segments[0].links", "whole number"):
            LimbParameters.from_yaml(edited(("segments", 0, "links"), value))


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


def test_heat_bounds_around_a_law_with_silicone_are_those_of_cold_and_of_warm_silicone():
    parameters = LimbParameters()
    parameters.wires[0].law = HystereticLaw(-0.1, 22.0, -2.0, 0.006, 0.012)
    left, _ = parameters.heat_bounds
    lasting = 0.1 * 0.012 / 0.018
    expected = (0.6 * lasting, 1.36 * 0.1, 0.85 * 22.0, 1.15 * 22.0, 0.5 * 2.0)
    assert dataclasses.astuple(left) == pytest.approx(expected)


# Values out of range


def range_text(leaf: Leaf) -> str:
    return f"from {leaf.low:g} to {leaf.high:g} {leaf.unit}".rstrip()


NEGATIVE = {"a1", "a3"}
NOT_NEGATIVE = {"payload", "supply_voltage", "damping", "warm_up_time", "noise", "drift"}
NOT_NEGATIVE |= {"stiffening", "shift", "rate"}
ANY_SIGN = {"ambient_temperature", "gravity", "maximum", "warm", "e2", "e3", "offset"}
ANY_SIGN |= {"rest_angle", "rest_angle_e3", "offset_e3", "roll", "measured_maximum"}


def name_of(leaf: Leaf) -> str:
    return [key for key in leaf.keys if isinstance(key, str)][-1]


def test_values_of_the_wrong_sign_are_refused_and_zero_where_physics_needs_a_value(refused):
    for leaf in LEAVES:
        if name_of(leaf) in ANY_SIGN:
            continue
        value = value_at(nominal(), leaf.keys)
        assert (value < 0) == (name_of(leaf) in NEGATIVE)
        with refused(ParameterError, leaf.path, -value, range_text(leaf)):
            LimbParameters.from_yaml(edited(leaf.keys, -value))
        if name_of(leaf) not in NOT_NEGATIVE:  # nor any sign
            with refused(ParameterError, leaf.path, range_text(leaf)):
                with_value(leaf.keys, 0).validate()


def test_temperature_limits_out_of_order_are_refused(refused):
    for maximum in (24.0, 25.0):
        parameters = LimbParameters(temperature_limits=TemperatureLimits(maximum, 20.0, 20.0))
        with refused(ParameterError, "temperature_limits.maximum", "ambient_temperature", "25"):
            parameters.validate()
    with refused(ParameterError, "temperature_limits.warm", "temperature_limits.maximum", "100"):
        LimbParameters.from_yaml(edited(("temperature_limits", "warm"), 100.0))


# Files


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
    for missing in (tmp_path / "none.yaml", tmp_path):
        with refused(ParameterError, missing):
            LimbParameters.load(missing)


# What follows from the parameters


def test_every_field_is_documented():
    for schema in (LimbParameters, SegmentParameters, WireParameters, TemperatureLimits):
        for field in dataclasses.fields(schema):
            assert f"``{field.name}``" in schema.__doc__
