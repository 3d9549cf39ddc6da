"""References: shape, samples and files."""

import numpy as np
import pytest

from limb_systems import Limb, LimbError, simulate
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


def test_recording_becomes_its_bend_angle_from_time_zero():
    recording = simulate(Limb(), [0.0, 0.3], 2.0)
    reference = references.from_recording(recording)
    np.testing.assert_allclose(
        reference.vector_values(recording.time), recording.bend_angle, atol=1e-12
    )


def test_csv_is_in_degrees_and_starts_at_its_first_sample(tmp_path):
    path = tmp_path / "reference.csv"
    path.write_text("# s, deg\n5,0\n7,-30\n")
    reference = references.load(path)
    assert reference.end_time() == 2.0
    assert degrees(reference, 1.0) == pytest.approx(-15.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0\n1,nan\n", "not finite at its sample 1"),
        ("0,0\n", "two samples or more"),
        ("0,0\n2,1\n1,2\n", "from 2 s to 1 s; time must increase"),
        ("time,angle\n0,0\n", "Cannot read the reference"),
        ("", "two samples or more|Cannot read"),
    ],
)
def test_csv_that_is_no_reference_is_refused(tmp_path, text, message):
    path = tmp_path / "reference.csv"
    path.write_text(text)
    with pytest.raises(LimbError, match=message) as caught:
        references.load(path)
    assert "reference.csv" in str(caught.value)
