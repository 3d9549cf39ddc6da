"""A crawler on three feet against the log that benchmarks/public_crawler.py names."""

import runpy
from pathlib import Path

import numpy as np
import pytest

CRAWLER = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "public_crawler.py"))


def test_centre_of_mass_is_where_the_log_of_another_program_has_it():
    times, (x, _) = CRAWLER["simulate_crawler"]()
    for time, logged in ((0.625, -2.477e-3), (0.98, -4.728e-3)):
        assert np.interp(time, times, x) == pytest.approx(logged, abs=0.02e-3)
