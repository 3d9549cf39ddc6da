"""Output ports that systems have in common."""

from pydrake.systems.framework import DiscreteStateIndex, LeafSystem


def declare_part(system: LeafSystem, name: str, state: DiscreteStateIndex, part: slice) -> None:
    """Declares an output port that shows a part of a discrete state."""
    system.DeclareVectorOutputPort(
        name,
        part.stop - part.start,
        lambda context, output: output.SetFromVector(
            context.get_discrete_state(state).value()[part]
        ),
        {system.discrete_state_ticket(state)},
    )
