"""A short version of benchmarks/random_plans.py: random problems all come out."""

import importlib.util
from pathlib import Path

import pytest

pytestmark = pytest.mark.whole

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "random_plans.py"
spec = importlib.util.spec_from_file_location("random_plans", SCRIPT)
random_plans = importlib.util.module_from_spec(spec)
spec.loader.exec_module(random_plans)


def test_random_problems_are_solved():
    for seed in (1000, 1006):
        result = random_plans.solve(seed)
        assert "failure" not in result, result
        assert result["defect"] < 1e-6
        assert result["difference"] < 5.0
