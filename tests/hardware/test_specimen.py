"""The physics of the emulated limb, against closed forms."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from hardware.emulation.emulated_rubber import GRIP_STIFFNESS_RATIO, EmulatedRubber, Hand
from hardware.emulation.emulated_wires import ShapeMemoryWires
from hardware.emulation.specimen import EXTRA_EFFECTS, Specimen
from hardware.emulation.twin import LimbTwin
from limb_systems import (
    ChordSensor,
    LimbParameters,
    RestMemory,
    simulate,
    tip_position,
)

from .conftest import small_limb


def specimen_with(**physics) -> Specimen:
    """A nominal limb of the seed 3 whose wires have some physics replaced, without latent heat."""
    specimen = Specimen(LimbParameters(), 3)
    plain = {"latent_heat": 0.0, "stress_shift": 0.0}
    specimen.wires = [dataclasses.replace(wire, **plain | physics) for wire in specimen.wires]
    return specimen


def run_wires(specimen, duty, duration, joint_state=(0.0,) * 10):
    """Time, and T, S, ξ of both wires over time, for the joints held still."""
    builder = DiagramBuilder()
    wires = builder.AddSystem(ShapeMemoryWires(specimen))
    source = builder.AddSystem(TrajectorySource(duty))
    still = builder.AddSystem(ConstantVectorSource(joint_state))
    builder.Connect(source.get_output_port(), wires.GetInputPort("duty"))
    builder.Connect(still.get_output_port(), wires.GetInputPort("joint_state"))
    state = LogVectorOutput(wires.GetOutputPort("state"), builder, 0.1)
    force = LogVectorOutput(wires.GetOutputPort("generalized_force"), builder, 0.1)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    log = state.FindLog(simulator.get_context())
    return (
        log.sample_times(),
        log.data().reshape(4, 2, -1)[:3],
        force.FindLog(simulator.get_context()).data(),
    )


def steps(times, duties):
    return PiecewisePolynomial.ZeroOrderHold([*times, 1e6], np.array([*duties, duties[-1]]).T)


def test_cooling_is_the_sum_of_two_exponentials():
    specimen = specimen_with(fast_time=5.0, slow_time=30.0, silicone_share=0.3)
    time, (wire, silicone, _), _ = run_wires(specimen, steps([0, 450], [[0.3, 0.3], [0, 0]]), 540)
    hot = wire[:, time == 450.0] - specimen.ambient
    assert silicone[:, time == 450.0] - specimen.ambient == pytest.approx(0.3 * hot, rel=1e-3)
    cooling = time >= 450.0
    since = time[cooling] - 450.0
    basis = np.column_stack([np.exp(-since / 5.0), np.exp(-since / 30.0)])
    excess = (wire[0, cooling] - specimen.ambient)[:, np.newaxis]
    shares, residual, *_ = np.linalg.lstsq(basis, excess, rcond=None)
    assert np.sqrt(residual / len(since)) < 0.005 * excess[0]
    assert (shares > 0.1 * excess[0]).all()


def test_steady_heat_is_that_of_the_heating_rate():
    """c (T - S) = h D and S - T_room = share (T - T_room): T by hand."""
    specimen = specimen_with(fast_time=5.0, slow_time=30.0, silicone_share=0.3, heating=60.0)
    _, (wire, _, _), _ = run_wires(specimen, steps([0], [[51 / 255, 0]]), 400)
    # c + (d + e) = 1/5 + 1/30 and c (d + e) (1 - 0.3) = 1/150.
    silicone = np.roots([1.0, -(1 / 5 + 1 / 30), 1 / 150 / 0.7]).min()
    c = 1 / 5 + 1 / 30 - silicone
    assert wire[0, -1] - specimen.ambient == pytest.approx(60.0 * 0.2 / c / 0.7, rel=2e-3)
    assert wire[1, -1] == pytest.approx(specimen.ambient)


def logistic(temperature, middle, width):
    return 1 / (1 + np.exp((temperature - middle) / width))


def test_heating_and_cooling_follow_their_logistic_curves():
    specimen = specimen_with(austenite=60.0, martensite=50.0, austenite_width=9, martensite_width=6)
    time, (wire, _, martensite), _ = run_wires(
        specimen, steps([0, 300], [[0.1, 0.0], [0.0, 0.0]]), 900
    )
    up, down = time <= 300.0, time > 300.5
    heated = wire[0, up], martensite[0, up]
    start = logistic(specimen.ambient, 60.0, 9)
    assert heated[1] == pytest.approx(logistic(heated[0], 60.0, 9) / start, abs=3e-3)
    # Cooling begins at the fraction that was left: 1 - ξ shrinks by the ratio of its curve.
    temperature, left = wire[0, time == 300.0], martensite[0, time == 300.0]
    shrinking = (1 - logistic(wire[0, down], 50.0, 6)) / (1 - logistic(temperature, 50.0, 6))
    assert martensite[0, down] == pytest.approx(1 - (1 - left) * shrinking, abs=3e-3)
    assert heated[1].min() < 0.2
    assert martensite[0, down].max() > 0.95


def test_torque_of_a_hot_wire_held_straight_is_its_full_torque():
    specimen = specimen_with(torque=0.03, expansion=-5e-4)
    _, (wire, _, martensite), force = run_wires(specimen, steps([0], [[0.0, 0.3]]), 100)
    fraction = martensite[1, -1]
    modulus = 1 - fraction * (1 - specimen.wires[1].modulus_ratio)
    stress = modulus * (1 - fraction) - 5e-4 * (wire[1, -1] - specimen.ambient)
    assert stress > 0.8
    assert force[:, -1] == pytest.approx(np.full(5, 0.03 * stress))
    assert force[:, 0] == pytest.approx(np.zeros(5), abs=1e-12)


def test_bending_towards_a_hot_wire_relieves_it_and_stretches_the_other():
    specimen = specimen_with(torque=0.03, strain_relief=0.15, modulus_ratio=0.4)
    duty = steps([0], [[0.0, 0.3]])
    bent = np.concatenate([np.full(5, 2 * 0.6 / 6), np.zeros(5)])  # φ = 0.6 rad, eqn (11)
    *_, straight = run_wires(specimen, duty, 100)
    *_, relieved = run_wires(specimen, duty, 100, bent)
    # The hot wire loses 0.15 * 0.6 of its stress (G = 1), the cold one pulls back with 0.4 of it.
    assert straight[0, -1] - relieved[0, -1] == pytest.approx(0.03 * 0.09 * 1.4, rel=0.05)


def test_full_stress_shifts_the_transformation():
    free, shifted = specimen_with(), specimen_with(stress_shift=10.0)
    duty = steps([0], [[0.1, 0.0]])
    _, (wire, _, fraction), _ = run_wires(free, duty, 150)
    _, (also, _, later), _ = run_wires(shifted, duty, 150)
    half = wire[0][np.argmax(fraction[0] < 0.5)]
    half_later = also[0][np.argmax(later[0] < 0.5)]
    middle = 1 - 0.5 * (1 - free.wires[0].modulus_ratio)  # G at ξ = 1/2, of which half is stress
    assert half_later - half == pytest.approx(10.0 * middle * 0.5, rel=0.1)


def test_latent_heat_is_taken_up_and_given_back():
    plain, latent = specimen_with(), specimen_with(latent_heat=15.0)
    duty = steps([0], [[0.15, 0.0]])
    _, (wire, _, fraction), _ = run_wires(plain, duty, 20)
    _, (cooler, _, _), _ = run_wires(latent, duty, 20)
    transformed = 1 - fraction[0, -1]
    assert transformed > 0.2
    assert 0.4 * 15 * transformed < wire[0, -1] - cooler[0, -1] < 15 * transformed


def test_rubber_stiffens_and_relaxes_as_stated():
    specimen = Specimen(LimbParameters(), 0)
    (physics,) = specimen.segments
    rest, at_45 = 2 * physics.rest_offset / 6, 2 * np.deg2rad(45.0) / 6
    rubber = EmulatedRubber(specimen)
    context = rubber.CreateDefaultContext()
    bent = np.concatenate([np.full(5, at_45), np.zeros(5)])
    rubber.get_input_port().FixValue(context, bent)
    force = rubber.get_output_port().Eval(context)[:5]
    k = physics.stiffness
    at_once = k * (rest - physics.stiffening * at_45 - physics.viscous_share * (at_45 - rest))
    assert force == pytest.approx(np.full(5, at_once))
    simulator = Simulator(rubber, context)
    simulator.AdvanceTo(physics.relaxation_time)
    left = np.exp(-1) * physics.viscous_share * (at_45 - rest)
    assert rubber.get_output_port().Eval(context)[:5] == pytest.approx(
        np.full(5, k * (rest - physics.stiffening * at_45 - left)), rel=1e-3
    )


def test_hand_does_virtual_work_across_the_chord():
    parameters = LimbParameters()
    sensor = parameters.segments[0].bend_sensor = ChordSensor()
    hand = Hand(parameters, PiecewisePolynomial.FirstOrderHold([0.0, 2.0], [[0.5, 0.5]]))
    context = hand.CreateDefaultContext()
    angles = np.array([0.05, 0.02, 0.1, -0.03, 0.08])
    hand.get_input_port().FixValue(context, np.concatenate([angles, np.zeros(5)]))
    torque = hand.get_output_port().Eval(context)
    stiffness = GRIP_STIFFNESS_RATIO * parameters.segments[0].stiffness / 3
    tip = tip_position(parameters, angles)
    error = 0.5 - sensor.exact_bends(parameters.segments[0].chain, angles)[0]
    across = np.array([-tip[1], tip[0]]) / np.linalg.norm(tip)
    for joint in range(5):
        step = 1e-6 * np.eye(5)[joint]
        moved = (tip_position(parameters, angles + step) - tip) / 1e-6
        assert torque[joint] == pytest.approx(stiffness * error / 0.1 * across @ moved, rel=1e-4)
    context.SetTime(2.0)
    assert (hand.get_output_port().Eval(context) == 0).all()


def test_the_angle_at_rest_is_the_described_one_with_what_was_drawn():
    """Once, and rubber stiffens from the described angle on."""
    description = LimbParameters()
    segment = description.segments[0]
    segment.rest_angle, segment.stiffening, segment.rest_memory = 0.3, 0.2, RestMemory()
    specimen = Specimen(description, 3).without("stress", "bend sensor")
    drawn = specimen.segments[0].rest_offset
    assert drawn == Specimen(LimbParameters(), 3).segments[0].rest_offset
    for limb, rest in ((specimen.without("rubber"), 0.3), (specimen, 0.3 + drawn)):
        cold = simulate(LimbTwin(specimen=limb), [0.0, 0.0], 2.0)
        assert cold.bend_angle == pytest.approx(np.full((1, 41), rest), abs=np.deg2rad(0.051))


def test_a_limb_remembers_or_is_badly_bonded_on_request_only():
    limbs = [Specimen(LimbParameters(), seed, EXTRA_EFFECTS) for seed in range(20)]
    for specimen in limbs:
        plain = Specimen(LimbParameters(), specimen.seed)
        assert plain.segments[0].memory_angle == plain.segments[0].memory_share == 0.0
        assert [wire.bond_time for wire in plain.wires] == [0.0, 0.0]
        taken_out = specimen.without(*EXTRA_EFFECTS)
        assert (taken_out.wires, taken_out.segments) == (plain.wires, plain.segments)
    assert 0 < sum(wire.bond_time > 0 for limb in limbs for wire in limb.wires) < 10


def test_a_badly_bonded_thermocouple_lags():
    specimen = Specimen(LimbParameters(), 7, ("bond",))  # its left one
    laws = [wire.law.a3 for wire in specimen.mechanics().wires]
    assert laws[0] == pytest.approx(-1 / specimen.wires[0].bond_time)
    assert laws[1] == specimen.wires[1].lag_rate
    slow, usual = (
        simulate(LimbTwin(specimen=limb), [0.3, 0.0], 5.0).measured_temperature[0]
        for limb in (specimen, specimen.without("bond"))
    )
    assert usual[-1] - usual[0] > 10.0
    assert slow[-1] - slow[0] < 0.6 * (usual[-1] - usual[0])


def test_the_angle_at_rest_remembers_the_wire_that_was_hot_last():
    """Exactly: ρ = ±Δ + (ρ_0 ∓ Δ) exp(-λ x) for a share x that transformed."""
    specimen = Specimen(small_limb(), 3, ("memory",)).without("bend sensor")
    (segment,) = specimen.segments
    cold = []
    for limb in (specimen, specimen.without("memory")):
        twin = LimbTwin(specimen=limb)
        simulate(twin, [0.0, 0.25], 30.0)
        cold.append(simulate(twin.after_rest(60.0), [0.0, 0.0], 2.0).bend_angle.mean())
    after_right = specimen.state["rest"][0]
    assert cold[0] - cold[1] == pytest.approx(after_right, abs=np.deg2rad(0.25))
    simulate(LimbTwin(specimen=specimen), [0.25, 0.0], 30.0)
    after_left, left, _ = specimen.state["rest"]
    assert left < 0.3
    target, share = -segment.memory_angle, segment.memory_share * (1 - left)
    assert after_left == pytest.approx(target + (after_right - target) * np.exp(-share), rel=0.02)
    assert after_left < 0 < after_right < segment.memory_angle


def rested(**changes) -> Specimen:
    """A limb of linear rubber and slack wires, with an exact bend sensor, used and then changed."""
    specimen = Specimen(LimbParameters(), 3).without("bend sensor", "rubber", "stress")
    simulate(LimbTwin(specimen=specimen), [0.0, 0.0], 0.5)
    return specimen.disturbed(**changes)


def test_a_payload_bends_the_cold_limb_by_its_angle_without_a_swing():
    plain, loaded = (
        simulate(LimbTwin(specimen=rested(payload=payload)), [0.0, 0.0], 2.0).bend_angle
        for payload in (0.0, np.deg2rad(5.0))
    )
    assert np.rad2deg(loaded - plain) == pytest.approx(5.0, abs=0.11)  # steps of the sensor


def test_a_stiffer_limb_bends_less_by_the_same_torque():
    """Without what is not linear, by the factor of k; the payload is a torque, too."""
    specimen = Specimen(LimbParameters(), 3).without("rubber", "stress")
    bends = []
    for stiffness in (1.0, 1.25):
        limb = specimen.disturbed(stiffness=stiffness, payload=0.1)
        parameters, (segment,) = limb.mechanics(), limb.segments
        assert parameters.segments[0].stiffness == segment.stiffness
        bends.append(limb.rest_angles().sum())
        rubber = EmulatedRubber(limb)
        context = rubber.CreateDefaultContext()
        rubber.get_input_port().FixValue(context, np.zeros(10))
        torque = rubber.get_output_port().Eval(context)[:5]
        assert torque == pytest.approx(specimen.segments[0].stiffness * np.full(5, 2 * 0.1 / 6))
    assert bends[0] / bends[1] == pytest.approx(1.25)
