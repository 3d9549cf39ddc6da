"""Numbers in files: as few digits as come back as the same double.

Fractions do not round, so that they tell what a text stands for without the code under test.
"""

import decimal
import hashlib
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from limb_systems import LimbParameters
from limb_systems.files.tables import format_rows, parse_table
from limb_systems.schema import dump_typed, load_typed

PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")

doubles = st.floats(allow_nan=False, allow_infinity=False)


def degrees_of(radians: float) -> str:
    (row,) = format_rows({"bend_angle_deg": np.array([radians])})
    return row.strip()


def in_radians(degrees: Fraction) -> float:
    try:
        return float(degrees * PI / 180)
    except OverflowError:
        return math.inf


def with_fewer_digits(text: str, value: Fraction) -> list[Fraction]:
    """The two nearest numbers around a value that have one digit fewer than a text."""
    size = decimal.Decimal(text).normalize()
    step = Fraction(10) ** (size.as_tuple().exponent + 1)
    below = math.floor(value / step)
    return [below * step, (below + 1) * step]


@settings(max_examples=300, deadline=None)
@given(doubles)
@example(5e-324)
@example(math.radians(0.4))
@example(1.7976931348623157e308)
@example(2.0**-1022)
@example(2.0**-10)  # for which a number farther away is shorter than the nearest
def test_an_angle_has_the_fewest_degrees_that_come_back(radians):
    text = degrees_of(radians)
    assert in_radians(Fraction(text)) == radians
    if len(decimal.Decimal(text).normalize().as_tuple().digits) > 1:
        for shorter in with_fewer_digits(text, Fraction(radians) * 180 / PI):
            assert in_radians(shorter) != radians


@pytest.mark.parametrize("text", ["0.4", "-20", "44.1", "1e-05", "30"])
def test_degrees_that_were_typed_are_written_as_they_were(text):
    head = b"# limb recording, format 2\ntime_s,bend_angle_deg\n0.0,%s\n" % text.encode()
    end = f"# end, 1 rows, sha256 {hashlib.sha256(head).hexdigest()}\n".encode()
    (angle,) = parse_table(head + end, "recording").columns["bend_angle_deg"]
    assert degrees_of(angle) == text


@settings(max_examples=20, deadline=None)
@given(st.floats(0.01, 100.0))
@example(0.8)
def test_a_parameter_has_the_fewest_digits_that_come_back(value):
    parameters = LimbParameters(total_duty=value)
    text = dump_typed(parameters)
    assert load_typed(LimbParameters, text).total_duty == value
    (line,) = (line for line in text.splitlines() if line.startswith("total_duty: "))
    number = line.removeprefix("total_duty: ")
    if len(decimal.Decimal(number).normalize().as_tuple().digits) > 1:
        for shorter in with_fewer_digits(number, Fraction(value)):
            assert float(shorter) != value
