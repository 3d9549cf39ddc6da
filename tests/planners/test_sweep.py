"""A short version of benchmarks/sweep.py: random problems all come out."""

import importlib.util
from pathlib import Path

import pytest

SWEEP = Path(__file__).parents[2] / "benchmarks" / "sweep.py"
spec = importlib.util.spec_from_file_location("sweep", SWEEP)
sweep = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sweep)


@pytest.mark.whole
def test_random_problems_are_solved():
    for seed in (1000, 1006):
        result = sweep.solve(seed)
        assert "failure" not in result, result
        assert result["defect"] < 1e-6
        assert result["difference"] < 5.0
