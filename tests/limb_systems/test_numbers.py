"""Numbers in files read back as the same doubles, and as they were typed.

Fractions do not round, so that they tell what a text stands for without the code under test.
"""

import hashlib
import math
from fractions import Fraction

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from limb_systems.files.csv_format import format_rows, parse_table

PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")


def degrees_of(radians: float) -> str:
    return format_rows({"bend_angle_deg": np.array([radians])}).strip()


@settings(max_examples=300, deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False))
@example(5e-324)
@example(1.7976931348623157e308)
@example(2.0**-1022)
def test_degrees_are_the_radians_that_read_back(radians):
    text = degrees_of(radians)
    assert len(text.partition("e")[0].strip("-0.").replace(".", "")) <= 17
    degrees = Fraction(text)
    assert float(degrees * PI / 180) == radians
    assert math.copysign(1.0, float(text)) == math.copysign(1.0, radians)


def test_degrees_that_were_typed_are_written_as_they_were():
    for text in ("0.4", "-20", "44.1", "1e-05", "30"):
        body = b"# limb recording, format 3\ntime_s,bend_angle_deg\n0.0,%s\n" % text.encode()
        end = f"# end, 1 rows, sha256 {hashlib.sha256(body).hexdigest()}\n".encode()
        (angle,) = parse_table(body + end, "recording").columns["bend_angle_deg"]
        assert degrees_of(angle) == text
