"""The colours of curves, equal in pictures, pages and the 3D view."""

import itertools

LEFT_RIGHT_COLORS = ("#1f9bb4", "#e07b1f")  # cyan and orange, as in the paper
# For further wires: colours that differ from the colours of reference, plan and rollout, too.
_FURTHER_COLORS = ("#2f9e6e", "#7b61c9", "#8a5a2b", "#b09a1a", "#d83a4e", "#4caf1f")
# Visible on white and on black.
REFERENCE_COLOR = "#999999"
PLAN_COLOR = "#4270ec"
ROLLOUT_COLOR = "#c2268f"
NEUTRAL_COLOR = "#808080"


def wire_colors(number: int) -> list[str]:
    """Return a colour for each wire of a segment; the first two are left's and right's."""
    return list(itertools.islice(itertools.cycle(LEFT_RIGHT_COLORS + _FURTHER_COLORS), number))
