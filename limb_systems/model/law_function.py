"""Functions and dynamics that are not linear as Drake systems, for laws other than the paper's.

Drake's SymbolicVectorSystem would run in C++, but it must have a state to be
part of a continuous diagram, and that state can only start at zero.
"""

import sys
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem_
from pydrake.systems.primitives import Integrator
from pydrake.systems.scalar_conversion import TemplateSystem

from limb_systems.model.ownership import weak_method


@TemplateSystem.define("LawFunction_", scope=sys.modules[__name__])  # to find it out takes 50 ms
def LawFunction_(T):
    """`LawFunction` for the scalar type T: float, AutoDiffXd or Expression."""

    class Impl(LeafSystem_[T]):
        """Evaluates a function of its inputs.

        - inputs: vectors of the sizes that are given, in this order
        - output 0 ``value``: what the function returns for them
        """

        __slots__ = ()  # see limb_systems.model.ownership

        def _construct(
            self,
            function: Callable[..., np.ndarray],
            input_sizes: Sequence[int],
            output_size: int,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            self._arguments = function, input_sizes, output_size
            ports = [
                self.DeclareVectorInputPort(f"u{index}", size)
                for index, size in enumerate(input_sizes)
            ]
            self.DeclareVectorOutputPort(
                "value",
                output_size,
                weak_method(self._calc),
                {self.input_port_ticket(port.get_index()) for port in ports},
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other._arguments, converter=converter)

        def _calc(self, context, output):
            function, input_sizes, _ = self._arguments
            inputs = [self.get_input_port(i).Eval(context) for i in range(len(input_sizes))]
            with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
                output.SetFromVector(function(*inputs))

    return Impl


LawFunction = LawFunction_[None]


class LawDynamics(Diagram):
    """ẋ = f(x, u), with the state as its output.

    - state, continuous: x
    - input 0 ``u``: u
    - output 0 ``x``: x
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        rates: Callable[[np.ndarray, np.ndarray], np.ndarray],
        num_inputs: int,
        initial: np.ndarray,
    ):
        """
        Args:
            rates: f, for arrays of any of Drake's scalar types.
            num_inputs: size of u.
            initial: x of the default state.
        """
        super().__init__()
        builder, size = DiagramBuilder(), len(initial)
        function = builder.AddSystem(LawFunction(rates, [size, num_inputs], size))
        integrator = builder.AddSystem(Integrator(np.asarray(initial, float)))
        builder.Connect(function.get_output_port(), integrator.get_input_port())
        builder.Connect(integrator.get_output_port(), function.get_input_port(0))
        builder.ExportInput(function.get_input_port(1), "u")
        builder.ExportOutput(integrator.get_output_port(), "x")
        builder.BuildInto(self)
