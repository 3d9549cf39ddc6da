"""References: shape, samples and files."""

import numpy as np
import pytest

from limb_systems import (
    LimbError,
    LimbParameters,
    Recording,
    SegmentParameters,
    joint_angles_from_bend_angle,
    tip_position,
    wires_around,
)
from planners import references


def degrees(reference, time):
    return np.rad2deg(reference.value(time)[0, 0])


def test_fig5_has_two_steps_and_a_decaying_sine():
    reference = references.step_and_decaying_sine()
    assert (reference.start_time(), reference.end_time()) == (0.0, 60.0)
    for time, expected in ((0.0, 0.0), (21.9, 0.0), (22.1, 25.0), (29.9, 25.0), (30.1, -20.0)):
        assert degrees(reference, time) == pytest.approx(expected)
    crossings = [38.0, 42.0, 46.0, 50.0, 54.0, 58.0]
    assert np.allclose([degrees(reference, t) for t in crossings], 0.0, atol=1e-9)
    peaks = np.abs([degrees(reference, t) for t in (40.0, 44.0, 48.0, 52.0, 56.0)])
    assert np.allclose(peaks[1:] / peaks[:-1], np.exp(-0.4), rtol=1e-6)


@pytest.fixture
def recording() -> Recording:
    """A sine of 23° over 10 s, 20 samples a second."""
    time = np.arange(201) / 20
    return Recording(
        time=time,
        duty=np.zeros((2, 201)),
        measured_temperature=np.full((2, 201), 25.0),
        bend_angle=0.4 * np.sin(time)[np.newaxis],
        parameters=LimbParameters(),
        source="made up",
        sample_rate=20.0,
    )


def test_a_recording_becomes_its_bend_angle_and_short_gaps_are_bridged(recording):
    reference = references.from_recording(recording)
    bend_angle = recording.bend_angle
    np.testing.assert_allclose(reference.vector_values(recording.time), bend_angle, atol=1e-12)
    recording.bend_angle = bend_angle.copy()
    recording.bend_angle[:, 100:119] = np.nan
    with pytest.warns(
        UserWarning, match="19 of .* samples of the recording are missing, up to 1 s"
    ):
        reference = references.from_recording(recording)
    bridged = reference.vector_values(recording.time)
    expected = np.linspace(*bend_angle[0, [99, 119]], 21)
    np.testing.assert_allclose(bridged[0, 99:120], expected, atol=1e-12)
    recording.bend_angle[:, 119] = np.nan
    with pytest.raises(LimbError, match=r"up to 1\.05 s in a row; the motion in the gap is"):
        references.from_recording(recording)


def test_smoothing_takes_noise_away_and_leaves_the_motion(recording):
    clean = recording.bend_angle
    recording.bend_angle = clean + np.random.default_rng(0).normal(0, 0.02, clean.shape)
    reference = references.from_recording(recording, smoothing_time=1.0)
    assert np.std(reference.vector_values(recording.time) - clean) < 0.4 * 0.02
    with pytest.raises(LimbError, match="it must be from 0 to the recording's 10 s"):
        references.from_recording(recording, smoothing_time=60.0)


def test_csv_is_in_degrees_and_starts_at_its_first_sample(tmp_path):
    path = tmp_path / "reference.csv"
    path.write_text("# s, deg\n5,0\n7,-30\n")
    with pytest.warns(UserWarning, match="starts at 5 s, which is shifted to 0 s"):
        reference = references.load(path)
    assert reference.end_time() == 2.0
    assert degrees(reference, 1.0) == pytest.approx(-15.0)


def test_csv_that_is_no_reference_is_refused(tmp_path):
    for text, message in [
        ("0,0\n1,nan\n", r"Row 2 of the reference is 1, nan \(s, °\)"),
        ("0,0\n", "two samples or more"),
        ("0,0\n2,1\n1,2\n", "from 2 s to 1 s; time must increase"),
        ("time,angle\n0,0\n", "number of times: 1, of angles: 1"),
        ("0,O\n1,2\n", "line 1 has 'O', which is not a number"),
        ("0,0\n1,2,3\n", "line 2 has 3 numbers, but those above have 2"),
        ("0\n1\n", "line 1 has one number; there must be a time and an angle"),
        ("0;1.000,5\n", "line 1 has '1.000,5'"),
        ("# limb trajectory, format 1\n", "is a plan already, for soft-limb replay"),
        ("format: 2\nsegments:\n- links: 5\n", "describes a limb, and is given with -l"),
        (f"t{',a' * 10**6}\n", "line 1 has 1000001 columns; .* Is a table transposed"),
        ("", "number of times: 0, of angles: 0|Cannot read"),
    ]:
        path = tmp_path / "reference.csv"
        path.write_text(text)
        with pytest.raises(LimbError, match=message) as caught:
            references.load(path)
        assert "reference.csv" in str(caught.value)


def test_csv_files_of_spreadsheets_are_read(tmp_path):
    for text in [
        "time (s),angle (deg)\n0,0\n1.5,10\n",
        "\ufefftime;angle\ns;deg\n0;0\n1,5;10,0\n",
        "time\tangle\n0\t0\n1,5\t10\n",
        '"time","angle"\r\n"0","0"\r\n"1.5","10"\r\n',
        "\n\n0, 0\n\n1.5, 10  # up\n\n",
    ]:
        path = tmp_path / "reference.csv"
        path.write_bytes(text.encode())
        reference = references.load(path)
        assert reference.end_time() == 1.5
        assert degrees(reference, 0.75) == pytest.approx(5.0)


def test_bends_of_a_tip_path_are_those_of_arcs_of_a_circle():
    """The tip of an arc of length L that turns by 2φ is L (1 - cos 2φ) / 2φ beside the axis."""
    segment = SegmentParameters(links=40, axes=2, centred_joints=True, wires=wires_around(3))
    angle = np.linspace(0.0, 6.0, 20)
    path = 0.02 * np.array([np.cos(angle), np.sin(angle)])
    reference = references.from_tip_path(LimbParameters(segments=[segment]), angle, path)
    bends = reference.vector_values(angle)
    chord = np.hypot(*bends)
    np.testing.assert_allclose(0.1 * (1 - np.cos(2 * chord)) / (2 * chord), 0.02, rtol=1e-3)
    np.testing.assert_allclose(np.unwrap(np.arctan2(*bends[::-1])), angle, atol=1e-3)
    lifted = references.from_tip_path(LimbParameters(), [0.0, 1.0], [[0.0, 0.03]]).value(1.0)
    tip = tip_position(LimbParameters(), joint_angles_from_bend_angle(LimbParameters(), lifted))
    assert tip[1, 0] == pytest.approx(0.03)
    with pytest.raises(LimbError, match=r"does not reach 0\.0 mm and 110\.0 mm .* at 1 s"):
        references.from_tip_path(LimbParameters.in_space(), [0.0, 1.0], [[0.0, 0.0], [0.0, 0.11]])


def test_circle_and_eight_begin_after_the_wait():
    circle, eight = references.circle(0.3, 40.0), references.eight(0.3, 0.1, 40.0, wait=0.0)
    for reference, time, expected in (
        (circle, 20.0, [0.0, 0.0]),
        (circle, 25.0, [0.3, 0.0]),
        (circle, 35.0, [0.0, 0.3]),
        (eight, 5.0, [0.0, 0.0]),
        (eight, 10.0, [0.3 * np.sqrt(0.5), 0.1]),
    ):
        np.testing.assert_allclose(reference.value(time)[:, 0], expected, atol=1e-9)
    assert (circle.end_time(), eight.end_time()) == (65.0, 45.0)
