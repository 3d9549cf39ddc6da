"""Emulated limbs that bend about two axes, against planar ones, closed forms and energy."""

import dataclasses

import numpy as np
import pytest
from continuum import ContinuumSpecimen, RadialShells, fine
from pydrake.trajectories import PiecewisePolynomial

from hardware.emulation.specimen import Specimen
from hardware.emulation.twin import LimbTwin
from limb_systems import (
    ChordSensor,
    LimbError,
    LimbModel,
    LimbParameters,
    make_manipulator,
    simulate,
)
from limb_systems.simulation import make_simulator
from limb_systems.statics import static_equilibrium

from .conftest import small_limb

EFFECTS = ("rubber", "bend sensor", "places")


def changed(specimen: Specimen, wires=None, segments=None) -> Specimen:
    specimen.wires = [dataclasses.replace(wire, **wires or {}) for wire in specimen.wires]
    specimen.segments = [dataclasses.replace(s, **segments or {}) for s in specimen.segments]
    return specimen


def test_a_limb_in_space_is_made_again_and_a_planar_segment_has_nothing_of_it():
    drawn = Specimen(LimbParameters.in_space(4), 3)
    again = LimbTwin.of(LimbTwin(LimbParameters.in_space(4), seed=3).parameters).specimen
    assert (again.wires, again.segments) == (drawn.wires, drawn.segments)
    planar = LimbParameters().segments[0]
    both = Specimen(LimbParameters(segments=[planar, LimbParameters.in_space().segments[0]]), 3)
    assert both.segments[0] == Specimen(LimbParameters(), 3).segments[0]
    assert [wire.misplaced != 0.0 for wire in both.wires] == [False] * 2 + [True] * 3


def test_a_wire_bends_the_limb_to_where_it_runs():
    specimen = Specimen(LimbParameters.in_space(links=2), 3).without(*EFFECTS)
    changed(specimen, {"misplaced": np.deg2rad(6.0)}, {"stiffness_ratio": 1.0})
    bent = simulate(LimbTwin(specimen=specimen), [0.0, 0.5, 0.0], 10.0).bend_angle[:, -1]
    assert np.rad2deg(np.hypot(*bent)) > 15.0
    assert np.rad2deg(np.arctan2(bent[1], bent[0])) == pytest.approx(126.0, abs=0.6)


def test_with_wires_at_e2_only_it_is_the_planar_limb():
    limbs = small_limb(), small_limb()
    limbs[1].segments[0].axes = 2
    planar, space = (Specimen(limb, 3, ["memory"]) for limb in limbs)
    space = changed(space.without("places"), segments={"rest_offset_e3": 0.0})
    expected, found = (
        simulate(LimbTwin(specimen=limb, truth=True), [0.9, 0.1], 3.0) for limb in (planar, space)
    )
    e2, e3 = LimbModel.of(limbs[1]).layout.bend_joints
    assert np.rad2deg(np.abs(expected.joint_state[:2]).max()) > 5.0
    np.testing.assert_allclose(found.joint_state[e2], expected.joint_state[:2], atol=1e-4)
    np.testing.assert_allclose(found.joint_state[e3], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.wire_temperature, expected.wire_temperature, atol=1e-2)


def test_energy_only_falls_without_heat():
    """That of Drake, and of stiffening and relaxing springs whose forces are its gradient."""
    limb = LimbParameters.in_space(3)
    limb.gravity, limb.payload, segment = [1.0, -5.0, 8.0], 0.02, limb.segments[0]
    segment.twists = segment.centred_joints = True
    segment.rest_angle, segment.rest_angle_e3, segment.links = 0.2, -0.1, 2
    specimen = Specimen(limb, 5).without("stress")
    (rubber,) = changed(specimen, segments={"damping": 1e-6, "stiffening": 2.0}).segments
    mechanics = LimbModel.of(specimen.mechanics()).mechanics
    start = mechanics.shape @ [0.9, -0.7] + 0.1 * np.sin(np.arange(6))
    specimen.state = {"joints": start, "rubber": start}
    plant, described = make_manipulator(specimen.mechanics()), mechanics.shape @ [0.2, -0.1]
    context = plant.CreateDefaultContext()

    def energy(state):
        plant.SetPositionsAndVelocities(context, state["joints"])
        angles, k = state["joints"][:6], mechanics.stiffness
        links = np.array([(angles - described)[j] ** 2 for j in mechanics.layout.bend_joints]).sum(
            axis=0
        )
        stiffening = rubber.stiffness * rubber.stiffening / (np.pi / 4) ** 2
        lost = k @ ((specimen.rest_angles() - described) * angles)
        creep = rubber.viscous_share * k @ (angles - state["rubber"]) ** 2 / 2
        drake = plant.CalcKineticEnergy(context) + plant.CalcPotentialEnergy(context)
        return drake + stiffening * (links**2).sum() / 4 - lost + creep

    twin = LimbTwin(specimen=specimen)
    simulator = make_simulator(twin, 1e-5)
    twin.GetInputPort("duty").FixValue(simulator.get_mutable_context(), np.zeros(3))
    energies = []
    for time in np.arange(0.0, 0.3, 0.02):
        simulator.AdvanceTo(time)
        energies.append(energy(twin.specimen.state))
    assert np.diff(energies).max() < 1e-4 * np.ptp(energies)
    assert plant.CalcKineticEnergy(context) > 0.01 * np.ptp(energies)


def test_the_sensor_reads_in_axes_of_its_own():
    limb = LimbParameters.in_space()
    segment = limb.segments[0]
    segment.rest_angle, segment.rest_angle_e3 = 0.4, 0.3
    segment.bend_sensor = ChordSensor(offset=0.1, offset_e3=-0.2, noise=0.0, drift=0.0)
    specimen = Specimen(limb, 3).without("rubber", "stress")
    sensor = {"sensor_roll": np.arctan2(3.0, 4.0), "sensor_gain_e3": 1.1}
    changed(specimen, segments=sensor | {"sensor_curvature_e3": 0.0})
    (drawn,) = specimen.segments
    gain = drawn.sensor_gain * (1 + drawn.sensor_curvature * 0.5 / (np.pi / 4))
    seen = simulate(LimbTwin(specimen=specimen), [0.0] * 3, 1.0).bend_angle[:, -1]
    # Its first axis is along the bend of 0.5 rad.
    np.testing.assert_allclose(np.rad2deg(seen), np.rad2deg([0.5 * gain + 0.1, -0.2]), atol=0.4)


def test_a_hand_holds_both_bends():
    wanted = np.array([0.5, -0.4])
    hand = PiecewisePolynomial.FirstOrderHold([0.0, 0.6, 2.0], np.outer(wanted, [0.0, 1.0, 1.0]))
    limb = LimbParameters.in_space()
    held = LimbTwin(specimen=Specimen(limb, 3).without("bend sensor"), hand=hand)
    bent = simulate(held, [0.0] * 3, 1.6).bend_angle[:, -1]
    np.testing.assert_allclose(bent, wanted, rtol=0.15)  # it is no stiffer than a hand
    with pytest.raises(LimbError, match="The hand moves 2 bend angles, but the limb has 1"):
        LimbTwin(hand=hand)


# Of the physics "continuum"


PLAIN = dict.fromkeys(
    ("taper", "softening", "stiffening", "mullins", "creep", "friction", "rest_offset", "anchor",
     "rest_offset_e3", "sensor_roll", "sensor_play"), 0.0)  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize("limb", [LimbParameters(), LimbParameters.in_space()])
def test_the_continuum_hangs_as_its_chain_does_at_rest(limb):
    """With weight and payload across a bent limb, where twist counts; found by Newton's method."""
    limb.gravity, limb.payload, segment = [3.0, 5.0, -8.0], 0.03, limb.segments[0]
    segment.rest_angle = 0.5
    beam = PLAIN | {"stiffness": 1.0, "stiffness_ratio": 1.2, "damping_ratio": 1.0}
    specimen = changed(ContinuumSpecimen(limb, 3), {"martensite_pull": 0.0}, beam)
    simulate(LimbTwin(specimen=specimen), [0.0] * len(limb.wires), 15.0)
    chain = dataclasses.replace(fine(segment), stiffness=segment.stiffness * 8 / 5)
    limb.segments = [dataclasses.replace(chain, stiffness_ratio=1.2)]
    angles, _ = static_equilibrium(limb)
    twists = LimbModel.of(limb).mechanics.axes[:, 0] != 0
    assert not twists.any() or np.rad2deg(np.abs(angles[twists]).max()) > 3.0
    bends = LimbModel.of(limb).mechanics.recorded_bend_angle(angles)
    np.testing.assert_allclose(np.rad2deg(specimen.state["play"]), np.rad2deg(bends), atol=0.05)


@pytest.mark.whole
def test_in_the_continuum_a_wire_bends_the_limb_to_where_it_runs():
    specimen = ContinuumSpecimen(LimbParameters.in_space(4), 3)
    beam = PLAIN | {"stiffness_ratio": 1.0, "sensor_shift": 0.0}
    changed(specimen, {"misplaced": np.deg2rad(6.0)}, beam)
    twin = LimbTwin(specimen=specimen, truth=True)
    recording = simulate(twin, [0.0, 0.3, 0.0, 0.0], 20.0)
    seen = twin.specimen.state["play"]
    assert np.rad2deg(np.hypot(*seen)) > 20.0
    assert np.rad2deg(np.arctan2(seen[1], seen[0])) == pytest.approx(96.0, abs=0.2)
    shown = LimbModel.of(twin.parameters).mechanics.recorded_bend_angle(
        recording.joint_state[:10, -1]
    )
    np.testing.assert_allclose(shown, seen, atol=1e-3)


def test_heat_crosses_to_the_wires_beside_and_none_is_lost_on_the_way():
    """Four wires in a ring, of which the first is hot, without loss to the room."""
    specimen = ContinuumSpecimen(LimbParameters.in_space(4), 3)
    shells = RadialShells(changed(specimen, segments={"cooling": 0.0}))
    temperatures = np.full(shells.capacities.shape, specimen.ambient)
    temperatures[0] += 50.0
    before = (shells.capacities * temperatures).sum()
    for _ in range(2000):
        temperatures = shells.after(temperatures, np.zeros(4), 0.02)
    assert (shells.capacities * temperatures).sum() == pytest.approx(before, rel=1e-12)
    rise = temperatures.mean(axis=1) - specimen.ambient
    assert rise[1] == pytest.approx(rise[3], rel=0.1)
    assert rise[1] > 4 * rise[2] > 0.0
