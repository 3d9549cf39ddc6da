"""Stations by scenarios: simulated, emulated and on a board, and scenarios that are wrong."""

import contextlib
import dataclasses
import logging

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from hardware import (
    LimbDriver,
    LimbTwin,
    ReplayError,
    Scenario,
    Station,
    StationError,
    drive,
    emulated_port,
)
from hardware.station import _refuse_replaced_inertia
from limb_systems import Limb, LimbError, LimbParameters, PlanCheck, WireColors, simulate
from urdf import limb_sdf

SCENARIO = """
directives:
- add_model: {name: finger, file: package://scenario/finger.sdf}
- add_weld: {parent: world, child: finger::base}
- add_model: {name: thumb, file: package://soft_limb/limb_5.sdf}
- add_weld: {parent: world, child: thumb::base, X_PC: {translation: [0.0, 0.5, 0.0]}}
model_drivers:
  finger: !LimbDriver {limb: finger.yaml, seed: 3}
  thumb: !LimbDriver {limb: thumb.yaml, seed: 4}
"""
SIDES = ("left", "right")
DUTY = {"finger.duty": [0.0, 0.4], "thumb.duty": [0.3, 0.0]}


@pytest.fixture
def scenario(tmp_path):
    """A scenario of two limbs that hang from the world's z, one of them of four links."""
    for name, links in (("finger", 4), ("thumb", 5)):
        limb = LimbParameters()
        limb.segments[0].links, limb.gravity = links, [0.0, 0.0, -9.81]
        limb.save(tmp_path / f"{name}.yaml")
        (tmp_path / f"{name}.sdf").write_text(limb_sdf(limb.segments))
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    return tmp_path / "scenario.yaml"


def test_simulated_limbs_bend_as_each_alone(scenario):
    seen = drive(Station(scenario), DUTY, 2.0, sample_rate=10.0)
    for name in ("finger", "thumb"):
        alone = Limb(scenario.with_name(f"{name}.yaml"))
        alone = simulate(alone, DUTY[f"{name}.duty"], 2.0, sample_rate=10.0)
        for signal, tolerance in (("bend_angle", 2e-3), ("wire_temperature", 0.02)):
            found = seen[f"{name}.{signal}"]
            np.testing.assert_allclose(found, getattr(alone, signal), atol=tolerance)
        np.testing.assert_array_equal(seen[f"{name}.contact_force"], 0.0)
    assert np.abs(seen["finger.bend_angle"]).max() > 0.1


def test_the_wires_that_meshcat_shows_have_the_colour_of_their_heat(scenario, meshcat):
    colored = {}
    station = Station(scenario, meshcat=meshcat)
    station.ForcedPublish(station.CreateDefaultContext())  # what is shown is there from now on

    class Told:
        def SetProperty(self, path, name, value):
            colored[path] = name, value

    limb = LimbParameters()
    colors = WireColors(limb, Told(), "finger")
    context = colors.CreateDefaultContext()
    colors.get_input_port().FixValue(context, [limb.ambient_temperature, 80.0])
    colors.ForcedPublish(context)
    shown = [path for path in colored if meshcat.HasPath(path)]
    assert len(shown) == 2 * 4  # wires on the finger's four links
    (_, cold), (name, hot) = (colored[f"illustration/finger/link_2/finger/wire_{w}"] for w in SIDES)
    assert (name, hot[3]) == ("color", 1.0)
    assert hot[0] > 2 * cold[0]  # red


def test_emulated_limbs_are_those_of_their_seeds(scenario):
    seen = drive(Station(scenario, "emulated"), DUTY, 1.0)
    twin = LimbTwin(scenario.with_name("thumb.yaml"), seed=4, truth=True)
    alone = simulate(twin, DUTY["thumb.duty"], 1.0)
    np.testing.assert_allclose(seen["thumb.bend_angle"], alone.bend_angle, atol=1e-4)
    assert "thumb.contact_force" not in seen


def test_limbs_on_boards_are_driven_in_real_time_and_switched_off(scenario):
    with emulated_port(seed=4) as port:
        text = SCENARIO.replace("limb: thumb.yaml, seed: 4", f"port: '{port}'")
        scenario.write_text(
            text.replace("  finger: !LimbDriver {limb: finger.yaml, seed: 3}\n", "")
        )
        drivers = {"thumb": LimbDriver(port=port), "finger": LimbDriver()}
        with pytest.raises(StationError, match="driver of finger has no port"):
            Station(Scenario(model_drivers=drivers), "board")
        station = Station(scenario, "board")  # the port of the thumb is free again
        readings = drive(station, {"thumb.duty": [0.8, 0.0]}, 1.5)["thumb.measured_temperature"]
        assert readings[0, -1] > readings[1, -1] + 0.9
        again = Station(scenario, "board")  # the port is free again, and the wires are off
        with again:
            np.testing.assert_array_equal(again.limbs["thumb"].link.sample().duty, 0.0)


@pytest.mark.parametrize(
    ("wrong", "right", "said"),
    [
        ("directives:", "directve:", r"scenario\.yaml: .*directve.* unknown"),
        ("limb_5.sdf", "limb_6.sdf", r"limb_6\.sdf"),
        ("  thumb:", "  tumb:", "model_drivers has tumb.*they add finger, thumb"),
        ("limb: thumb.yaml", "limb: finger.yaml", "'thumb' has 5 joints in the plant and 4"),
        (SCENARIO, "directives: []", "The scenario has no limb: model_drivers must have"),
        (SCENARIO, "model_drivers: {thumb: !LimbDriver {}}", "directives add no model .* none"),
        ("thumb::base,", "thumb::bas,", "no Frame named 'bas'"),
        ("seed: 3", "seed: 3, seed: 4", r"scenario\.yaml: .*'seed' is given twice"),
        ("finger: !LimbDriver", "finger: !Driver", "'Driver' did not match"),
        ("- add_model: {name: finger,", "- {}\n- add_model: {name: finger,", "directives"),
        ("model_drivers:", "plant_config: {contact_model: pont}\nmodel_drivers:", "pont"),
    ],
)
def test_a_scenario_that_is_wrong_is_refused_by_one_sentence(scenario, wrong, right, said):
    scenario.write_text(SCENARIO.replace(wrong, right))
    with pytest.raises(LimbError, match=said) as refused:
        Station(scenario)
    assert "\n" not in str(refused.value)


def test_settings_of_a_scenario_are_drakes_with_the_contact_of_robots(scenario):
    scenario.write_text(SCENARIO + "plant_config: {stiction_tolerance: 1e-3}")
    read = Scenario.load(scenario)
    assert read.model_drivers["finger"].seed == 3
    assert read.plant_config.stiction_tolerance == 1e-3
    assert read.plant_config.discrete_contact_approximation == "sap"
    assert read.plant_config.sap_near_rigid_threshold == 0.0
    assert Station(scenario).plant.time_step() == 1e-3


def test_bodies_that_no_parser_would_keep_are_refused(scenario):
    """Drake puts the inertia of a ball of water in the place of a rounded plate's."""
    plate = """<robot name="plate"><link name="plate"><inertial><mass value="0.02"/>
    <inertia ixx="2e-6" iyy="9e-6" izz="{}" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
    added = "- add_model: {name: plate, file: package://scenario/plate.urdf}\nmodel_drivers:"
    scenario.write_text(SCENARIO.replace("model_drivers:", added))
    path = scenario.with_name("plate.urdf")
    path.write_text(plate.format("1.1e-5"))
    Station(scenario)
    path.write_text(plate.format("1.100000001e-5"))
    with pytest.raises(StationError, match=r"plate\.urdf:\d+: .*1\.100000001e-05 kg.* ball"):
        Station(scenario)
    # Nor is the message lost among others.
    log = logging.getLogger("drake")
    with contextlib.ExitStack() as loading:
        loading.enter_context(_refuse_replaced_inertia())
        for message in ("a.urdf:1: warning: While parsing inertia", *["another"] * 10_000):
            log.warning(message)
        with pytest.raises(StationError, match=r"a\.urdf:1: the moments"):
            loading.close()


def test_inputs_that_do_not_fit_are_refused(scenario):
    station = Station(scenario)
    of_two = [[0.1, 0.1], [0.0, 0.0]]
    of_matrices = PiecewisePolynomial.ZeroOrderHold([0.0, 2.0], [np.zeros((2, 2))] * 2)
    late = PiecewisePolynomial.ZeroOrderHold([5.0, 9.0], of_two)
    short = PiecewisePolynomial.ZeroOrderHold([0.0, 0.5], of_two)
    for thumb, said in (
        ([0.0, 0.0, 0.0], r"thumb\.duty has 2 numbers, but its signal 3"),
        ([0.0, 1.2], "duty reaches from 0 to"),
        ([0.8, 0.8], r"thumb\.duty add up to 1\.60, but .* total_duty is 1\.5"),
        ([], r"thumb\.duty is \[\]; it must be a plan, a trajectory or a list of finite numbers"),
        (of_two, r"thumb\.duty is \[\[0\.1, 0\.1\]"),
        ([0.1, np.nan], r"thumb\.duty is \[0\.1, nan\]"),
        (PiecewisePolynomial(), r"thumb\.duty is a trajectory of 0 x 0 numbers"),
        (of_matrices, r"thumb\.duty is a trajectory of 2 x 2 numbers"),
        (late, r"thumb\.duty starts at 5 s, but a run begins at 0 s"),
        (short, r"thumb\.duty ends at 0\.5 s, before the 1 s of the run"),
    ):
        with pytest.raises(LimbError, match=said):
            drive(station, DUTY | {"thumb.duty": thumb}, 1.0)
    for inputs, said in (
        ({"thum.duty": "a"}, r"no input thum\.duty; it has finger\.duty, th"),
        ({"finger.duty": [0.0, 0.0]}, r"thumb\.duty is missing"),
    ):
        with pytest.raises(LimbError, match=said):
            drive(station, inputs, 1.0)
    assert drive(station, DUTY, 0.15)["time"] == pytest.approx([0.0, 0.05, 0.1, 0.15])
    with pytest.raises(LimbError, match="part of a diagram already"):
        drive(station, DUTY, 0.15)


def test_plans_are_driven_where_replay_takes_them(scenario, fig5_plan):
    """Another number of wires, no check, and a board with another limb are its refusals."""
    unchecked = dataclasses.replace(fig5_plan, check=PlanCheck())
    with pytest.raises(ReplayError, match="was never checked"):
        drive(Station(scenario, "emulated"), DUTY | {"thumb.duty": unchecked}, 1.0)


def test_gravity_of_another_direction_than_planned_for_is_warned_of(scenario):
    scenario.write_text(SCENARIO.replace("X_PC: {", "X_PC: {rotation: !Rpy {deg: [90, 0, 0]}, "))
    with pytest.warns(UserWarning, match="base of the limb 'thumb'.*give the description the same"):
        Station(scenario)
