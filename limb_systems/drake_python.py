"""Tools for Drake systems that are written in Python: callbacks without leaks, and state ports.

If a system that is subclassed in Python is never freed, each plan leaks
megabytes. Two things keep such a system alive:

- Python visits the attributes of a subclass of a pybind11 class twice when it
  looks for reference cycles, miscounts, and keeps the cycle of a diagram and
  its builder. Subclasses with ``__slots__ = ()`` have only the attributes of
  Drake's class, which are counted once.
- A bound method that is given to Drake as a callback refers to its system
  from C++, out of sight of the garbage collector; `weak_method` does not.
"""

import weakref
from collections.abc import Callable

from pydrake.systems.framework import DiscreteStateIndex, LeafSystem


def weak_method(method: Callable) -> Callable:
    """Return a bound method as a callback that does not keep its object alive."""
    owner = weakref.ref(method.__self__)  # type: ignore[attr-defined]
    function = method.__func__  # type: ignore[attr-defined]
    # Drake calls back only while the system is alive.
    return lambda *arguments: function(owner(), *arguments)


def declare_state_output(
    system: LeafSystem, name: str, state: DiscreteStateIndex, part: slice
) -> None:
    """Declare an output port for a part of a discrete state."""
    system.DeclareVectorOutputPort(
        name,
        part.stop - part.start,
        lambda context, output: output.SetFromVector(
            context.get_discrete_state(state).value()[part]
        ),
        {system.discrete_state_ticket(state)},
    )
