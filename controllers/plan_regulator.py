"""Time-varying linear-quadratic regulation about a plan, with Drake's regulator."""

import numpy as np
from pydrake.systems.controllers import (
    FiniteHorizonLinearQuadraticRegulator,
    FiniteHorizonLinearQuadraticRegulatorOptions,
)
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from controllers.estimator import Estimate
from controllers.gains import mean_gains
from controllers.plan_controller import PlanController, SampledPlan, share
from controllers.reduced_model import PERIOD, ReducedModel
from limb_systems import LimbParameters, Trajectory
from limb_systems.model.ownership import weak_method

# Deviations that cost alike; (15) has no weight on temperature, but feedback runs out of heat.
BEND = np.deg2rad(0.5)  # rad
DUTY = 0.2
TEMPERATURE = 10.0  # °C


@TemplateSystem.define("TangentModel_")
def TangentModel_(T):
    """`TangentModel` for the scalar type T: float or AutoDiffXd."""

    class Impl(LeafSystem_[T]):
        """A limb's deviations from a plan, by the derivatives of `ReducedModel` along it.

        - input 0 ``duty``: δD (W)
        - state, discrete, at 20 Hz: [δx (N), p (S), δφ (S)]: of the wires' states, the bend
          from outside, rad, and of the bend a period before, rad
        """

        __slots__ = ()  # see limb_systems.model.ownership

        def _construct(self, A: np.ndarray, B: np.ndarray, C: np.ndarray, converter=None):
            """
            Args:
                A, B: of δx⁺ = A δx + B δD, for each period (K, N, N), (K, N, W).
                C: of δφ = C δx + p (K, S, N).
            """
            LeafSystem_[T].__init__(self, converter=converter)
            self._matrices = A, B, C
            self.DeclareVectorInputPort("duty", B.shape[2])
            self.DeclareDiscreteState(A.shape[1] + 2 * C.shape[1])
            self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other._matrices, converter=converter)

        def _update(self, context, state):
            A, B, C = self._matrices
            time = context.get_time()
            k = min(round((time if T is float else time.value()) / PERIOD), len(A) - 1)
            x, p, _ = np.split(
                context.get_discrete_state_vector().CopyToVector(),
                np.cumsum([A.shape[1], C.shape[1]]),
            )
            duty = self.get_input_port().Eval(context)
            state.set_value(np.concatenate([A[k] @ x + B[k] @ duty, p, C[k] @ x + p]))

    return Impl


TangentModel = TangentModel_[None]


class PlanRegulator(PlanController):
    """The linear-quadratic regulator about a plan on `ReducedModel`, time-varying.

    The least of, summed over the periods to the end of the plan,

        (δφ / 0.5°)² + Σ (δT / 10 °C)² + Σ (δD / 0.2)²

    for deviations from the plan that the `Estimator` sees, and a bend p from outside that
    stays: D = D* - K(t) [x - x*, p]. What a wire cannot do of it the others of its segment
    do, as far as they can. No duty is beyond what `TemperatureLimiter` allows.

    Ports and state are those of `PlanController`.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, trajectory: Trajectory, *, parameters: LimbParameters | None = None):
        """
        Args:
            trajectory: the plan.
            parameters: of the limb, from which gains and estimates follow; the plan's if None.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan = SampledPlan(trajectory, parameters)
        super().__init__(parameters, self._plan.duty[0])
        self._gains = mean_gains(self._estimator.model)
        self._regulator = regulator_gains(self._estimator.model, self._plan)
        # How other parameters than the plan's bend otherwise under the plan's duty.
        first = trajectory.bend_angle[:, :1].T
        planned = np.vstack([first, self._plan.bend_angle[:-1]])
        self._unlike_plan = self._estimator.model.bend_angle(self._plan.heat) - planned
        self.set_name("plan_regulator")

    def _duty(self, time: float, estimate: Estimate, caps: np.ndarray, state) -> np.ndarray:
        k, N = self._plan.index(time), estimate.heat.size - len(caps)
        offset = estimate.offset + self._unlike_plan[k]
        deviation = np.append((estimate.heat - self._plan.heat[k])[:N], offset)
        wanted = self._plan.duty[k] - self._regulator[k] @ deviation
        possible = np.clip(wanted, 0.0, caps)
        return share(self._gains @ (wanted - possible), possible, self._gains, caps)

    def linearized(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The plan's heat (H,) and duty (W,) at a time, s, and K (W, M) of the regulator there.

        D = D* - K (all that is estimated, less the plan's), while no bound is active.
        """
        k, model = self._plan.index(time), self._estimator.model
        heat, S = self._plan.heat[k], model.num_segments
        K = np.zeros((model.num_wires, self._estimator.sensing(heat)[1].shape[1]))
        K[:, : model.size - model.num_wires] = self._regulator[k][:, :-S]
        K[:, -S:] = self._regulator[k][:, -S:]
        return heat, self._plan.duty[k], K


def regulator_gains(model: ReducedModel, plan: SampledPlan) -> np.ndarray:
    """K (periods, W, N + S) of `PlanRegulator`."""
    W, S, N = model.num_wires, model.num_segments, model.size - model.num_wires
    _, A, B = model.linearized_step(plan.heat, plan.duty)
    _, C = model.bend_slopes(plan.heat)
    tangent = TangentModel(A[:, :N, :N], B[:, :N], C[..., :N])
    context = tangent.CreateDefaultContext()
    tangent.get_input_port().FixValue(context, np.zeros(W))
    weights = np.zeros(N + 2 * S)
    weights[:W], weights[N + S :] = TEMPERATURE**-2, BEND**-2
    regulator = FiniteHorizonLinearQuadraticRegulator(
        tangent,
        context,
        0.0,
        PERIOD * len(A),
        np.diag(weights),
        DUTY**-2 * np.eye(W),
        FiniteHorizonLinearQuadraticRegulatorOptions(),
    )
    gains = [regulator.K.value(time)[:, : N + S] for time in regulator.K.get_times()]
    return np.array(gains[: len(A)])
