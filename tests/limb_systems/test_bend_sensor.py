"""What bend sensors show of a limb's shape, against the continuous beam."""

import numpy as np
import pytest
import scipy.linalg
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from limb_systems import (
    ChordSensor,
    LimbParameters,
    SegmentParameters,
    TipTangentSensor,
    bend_angle,
    joint_angles_from_bend_angle,
    make_manipulator,
)
from limb_systems.statics import static_equilibrium

SENSORS = (TipTangentSensor(), ChordSensor())


def apparent_bend(sensor, angles):
    """The bend that a sensor shows of the paper's segment, () or (K,), rad."""
    return sensor.apparent_bends(SegmentParameters(links=len(angles)).chain, angles)[0]


def test_sensors_agree_for_constant_curvature():
    for sensor in SENSORS:
        for links in [1, 2, 5, 10, 100]:
            limb = LimbParameters(segments=[SegmentParameters(links=links)])
            for bend in (-0.7, 0.0, 0.02, 0.7):
                angles = joint_angles_from_bend_angle(limb, [bend])
                assert apparent_bend(sensor, angles) == pytest.approx(bend, abs=1e-14)


def ratio(angles) -> float:
    """α/2 over the chord's angle."""
    tangent, chord = (apparent_bend(sensor, angles) for sensor in SENSORS)
    return float(tangent / chord)


def test_sag_of_a_cantilever_has_two_thirds_in_its_tip_tangent():
    """w = q (6 L² x² - 4 L x³ + x⁴) / (24 E I): chord q L³ / (8 E I), α/2 = q L³ / (12 E I)."""
    for links, tolerance in [(5, 0.01), (10, 0.005), (50, 0.001)]:
        limb = LimbParameters(segments=[SegmentParameters(links=links, stiffness=100.0)])
        limb.gravity = [0.0, -9.81, 0.0]  # a hundredth of a degree: the beam's theory is linear
        assert ratio(static_equilibrium(limb)[0]) == pytest.approx(2 / 3, rel=tolerance)


def test_first_mode_of_a_cantilever_has_688_thousandths():
    """cos(λ) cosh(λ) = -1 at λ = 1.8751: the mode's tip slope is 1.3765 of its deflection / L."""
    for links, tolerance in [(5, 0.013), (10, 0.003), (50, 0.001)]:
        limb = LimbParameters(segments=[SegmentParameters(links=links)])
        plant = make_manipulator(limb)
        inertia = plant.CalcMassMatrixViaInverseDynamics(plant.CreateDefaultContext())
        _, modes = scipy.linalg.eigh(np.eye(links), inertia)
        assert ratio(1e-3 * modes[:, 0]) == pytest.approx(1.3765 / 2, rel=tolerance)


def test_sensors_add_gain_and_offset_and_correction_removes_them():
    for kind in [TipTangentSensor, ChordSensor]:
        sensor, angles = kind(gain=1.1, offset=0.05), np.array([0.1, 0.08, 0.05, 0.02, 0.01])
        exact = apparent_bend(kind(), angles)
        assert apparent_bend(sensor, angles) == pytest.approx(1.1 * exact + 0.05)
        assert sensor.corrected_bends(apparent_bend(sensor, angles)[np.newaxis]) == pytest.approx(
            exact
        )


def test_many_samples_are_as_one_by_one_and_derivatives_as_differences():
    for sensor in SENSORS:
        samples = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 3))
        one_by_one = [apparent_bend(sensor, sample) for sample in samples.T]
        np.testing.assert_allclose(apparent_bend(sensor, samples), one_by_one)
        angles, step = samples[:, 0], 1e-6
        gradient = ExtractGradient(
            np.array([apparent_bend(sensor, InitializeAutoDiff(angles)[:, 0])])
        )[0]
        for joint in range(5):
            moved = angles + step * np.eye(5)[joint]
            slope = (apparent_bend(sensor, moved) - one_by_one[0]) / step
            assert gradient[joint] == pytest.approx(slope, abs=1e-5)


def test_a_chord_sensor_reads_the_bend_angle_of_the_limb():
    angles = np.random.default_rng(1).uniform(-0.5, 0.5, (5, 4))
    np.testing.assert_array_equal(
        apparent_bend(ChordSensor(), angles), bend_angle(LimbParameters(), angles)[0]
    )
