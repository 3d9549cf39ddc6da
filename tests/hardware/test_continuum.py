"""The emulated limb of physics "continuum": relays, heat that diffuses, a chain that ages."""

import dataclasses

import numpy as np
import pytest
from continuum import (
    ADDED,
    JOINTS,
    SHELLS,
    Chain,
    ContinuumLimb,
    ContinuumSpecimen,
    Preisach,
    RadialShells,
)
from scipy.linalg import eigh
from scipy.optimize import fsolve

from hardware import LimbTwin
from hardware.emulation.twin import specimen_class
from limb_systems import ChordSensor, LimbParameters, SegmentParameters, simulate
from limb_systems.limb import make_manipulator
from soft_limb.runs.jobs import run_each

EXACT = {  # a beam whose stiffness is even, and a sensor without errors
    **dict.fromkeys(("taper", "creep", "mullins", "softening", "stiffening", "friction"), 0.0),
    **dict.fromkeys(("anchor", "sensor_offset", "sensor_play", "sensor_warming"), 0.0),
    **dict.fromkeys(("sensor_shift", "sensor_noise", "sensor_walk", "missing"), 0.0),
    **{"sensor_gain": 1.0, "stiffness": 1.0, "rest_offset": 0.0},
}


def specimen_with(seed=3, description=None, **beam) -> ContinuumSpecimen:
    specimen = ContinuumSpecimen(description or LimbParameters(), seed)
    specimen.segments = [dataclasses.replace(specimen.segments[0], **beam)]
    return specimen


# Wires


def course_of(preisach, relays, temperatures):
    """Shares and relays after each turning point of a course, in steps of 0.1 °C."""
    shares, now = [], temperatures[0]
    for turn in temperatures[1:]:
        for temperature in np.linspace(now, turn, 1 + round(10 * abs(turn - now))):
            relays = preisach.after(relays, np.full((2, 1), temperature))
        now = turn
        shares.append(relays.mean(axis=1))
    return np.array(shares), relays


def test_minor_loops_return_to_where_they_began_and_are_wiped_out():
    """Madelung's rules: the end of a loop is its beginning, and then the path is the old one."""
    preisach = Preisach.of(ContinuumSpecimen(LimbParameters(), 0).wires)
    cold = np.zeros(preisach.up.shape, bool)
    shares, relays = course_of(preisach, cold, [20, 75, 50, 65, 50])
    np.testing.assert_array_equal(shares[3], shares[1])  # back at 50 °C, where it turned
    assert (shares[2] > shares[1] + 0.02).all()  # the loop is not nothing
    looped, _ = course_of(preisach, relays, [50, 75])
    np.testing.assert_array_equal(looped[0], shares[0])
    straight, _ = course_of(preisach, cold, [20, 75])
    np.testing.assert_array_equal(looped[0], straight[0])


# Heat


def test_steady_heat_falls_by_the_logarithm_of_the_radius():
    """Closed form of a cylinder's wall, between the contact and the surface."""
    specimen = specimen_with(seed=2, crossing=0.0)
    shells, (beam,) = RadialShells(specimen), specimen.segments
    power = np.array([10.0, 5.0])

    def change(temperatures):
        before = temperatures.reshape(2, -1)
        return ((shells.after(before, power, 1.0) - before) * shells.capacities).ravel()

    steady = fsolve(change, np.full(2 * (1 + SHELLS), 60.0), xtol=1e-12).reshape(2, -1)
    np.testing.assert_allclose(shells.loss(steady[:, -1]), power, rtol=1e-6)
    for wire, temperatures, heat in zip(specimen.wires, steady, power, strict=True):
        outside = np.sqrt(0.02 * 0.01 / 2 / np.pi)
        volumes = (outside / wire.radius) ** ((np.arange(SHELLS) + 0.5) / SHELLS)
        wall = heat * np.log(volumes) / (2 * np.pi * beam.conductivity)
        contact = heat * wire.contact_time / (wire.heat_capacity * np.pi * wire.radius**2)
        np.testing.assert_allclose(temperatures[0] - temperatures[1:], contact + wall, rtol=1e-6)


# Beam


def test_inertia_and_stiffness_are_those_of_drake_s_chain():
    """Frequencies, of the same links as a MultibodyPlant."""
    chain = Chain(specimen_with(**EXACT | {"damping_ratio": 0.0}))
    free, _ = chain.propagator(1e-4)
    rates = np.abs(np.angle(np.linalg.eigvals(free[: 2 * JOINTS, : 2 * JOINTS]))) / 1e-4
    links = LimbParameters(segments=[SegmentParameters(links=JOINTS)])
    plant = make_manipulator(links)
    inertia = plant.CalcMassMatrix(plant.CreateDefaultContext())
    exact = np.sqrt(eigh(np.diag(chain.stiffness), inertia, eigvals_only=True))
    # What is added to the linear part makes it stiffer by that.
    np.testing.assert_allclose(np.sort(rates)[::2], exact * np.sqrt(1 + ADDED), rtol=0.01)


def test_any_chain_shows_the_bend_of_this_one():
    for sensor in (None, ChordSensor()):
        segment = SegmentParameters(**({"bend_sensor": sensor} if sensor else {}))
        specimen = specimen_with(description=LimbParameters(segments=[segment]))
        twin = LimbTwin(specimen=specimen, truth=True)
        limb = twin.GetSubsystemByName("shape_memory_wires")
        assert isinstance(limb, ContinuumLimb)
        recording = simulate(twin, [0.0, 0.4], 14.0)
        shown = segment.bend_sensor.exact_bends(segment.chain, recording.joint_state[:5, -1])[0]
        (beam,), state = specimen.segments, specimen.state
        beam_chain = SegmentParameters(links=JOINTS).chain
        true = segment.bend_sensor.exact_bends(beam_chain, state["beam"][:JOINTS])[0]
        assert abs(true) > 0.3
        assert shown == pytest.approx(true, abs=1e-4)
        assert state["play"][0] == pytest.approx(true, abs=beam.sensor_play / 2 + 1e-6)


# The limb as a whole


def test_processes_know_the_physics_that_the_host_has_loaded():
    kinds = list(run_each(specimen_class, ["continuum"] * 2, 2))
    assert kinds == [ContinuumSpecimen] * 2
