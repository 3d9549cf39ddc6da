"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from controllers.reduced_model import ReducedModel

__all__ = ["ReducedModel"]
