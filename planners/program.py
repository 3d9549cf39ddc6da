"""The trajectory program, eqns (15)-(20), on Drake's DirectCollocation."""

import warnings

import numpy as np
from pydrake.planning import DirectCollocation
from pydrake.systems.analysis import BatchEvalTimeDerivatives

from limb_systems import Limb, LimbParameters, joint_angles_from_bend_angle, split_state
from planners.defects import ANGLE_SCALE, TEMPERATURE_SCALE, LimbDefects

# Weights of eqn (15), as Sec. VI gives them.
ANGLE_WEIGHT = 100.0  # Q, on θ alone
DUTY_WEIGHT = 2.0  # R
TERMINAL_FACTOR = 1000.0  # Q_N = 1000 Q


class TrajectoryProgram:
    """Eqns (15)-(20) for one limb and one reference.

    - ``prog``: the `MathematicalProgram`.
    - ``collocation``: the `DirectCollocation` that built it.
    - ``limb``: the `Limb` whose dynamics are its constraints.
    - ``states``, ``duty``: indices of x_k and u_k among the decision
      variables, (N, 2n + 2W) and (N, W).
    - ``defects``: eqn (17) in closed form, or None where it disagrees with
      the limb's `MultibodyPlant`.

    Args:
        parameters: of the limb.
        times: of the knots (N,), s, evenly spaced from 0.
        reference: φ_ref at the knots (S, N), rad.
        initial_state: x_init, a state of `Limb`.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        times: np.ndarray,
        reference: np.ndarray,
        initial_state: np.ndarray,
    ):
        self.parameters = parameters
        self.limb = limb = Limb(parameters)
        num_knots, time_step = len(times), float(times[1] - times[0])
        n, num_wires = parameters.num_joints, len(parameters.wires)
        # (17)
        self.collocation = DirectCollocation(
            limb,
            limb.CreateDefaultContext(),
            num_time_samples=num_knots,
            minimum_time_step=time_step,
            maximum_time_step=time_step,
            input_port_index=limb.GetInputPort("duty").get_index(),
        )
        self.prog = prog = self.collocation.prog()
        states = np.array([self.collocation.state(k) for k in range(num_knots)])
        duty = np.array([self.collocation.input(k) for k in range(num_knots)])
        self.time_step = time_step
        self.time_steps = _indices(
            prog, np.array([self.collocation.time_step(k) for k in range(num_knots - 1)])
        )
        self.states = _indices(prog, states)
        self.duty = _indices(prog, duty)

        # (15)
        angles_ref = joint_angles_from_bend_angle(parameters, reference)
        for k in range(num_knots):
            last = k == num_knots - 1
            angle_weight = ANGLE_WEIGHT * (TERMINAL_FACTOR if last else 1.0)
            duty_weight = 0.0 if last else DUTY_WEIGHT
            weights = np.repeat([angle_weight, duty_weight], [n, num_wires])
            target = np.r_[angles_ref[:, k], np.zeros(num_wires)]
            prog.AddQuadraticCost(
                np.diag(weights),
                -weights * target,
                0.5 * target @ (weights * target),
                np.r_[states[k, :n], duty[k]],
                is_convex=True,
            )
        # (16)
        prog.AddBoundingBoxConstraint(initial_state, initial_state, states[0])
        # (18)
        prog.AddBoundingBoxConstraint(0.0, 1.0, duty.ravel())
        # (19), (20)
        limits = parameters.temperature_limits
        wire = states[:, 2 * n : 2 * n + num_wires]
        prog.AddBoundingBoxConstraint(-np.inf, limits.maximum, wire.ravel())
        warm = wire[times > limits.warm_up_time]
        if warm.size:
            prog.AddBoundingBoxConstraint(limits.warm, np.inf, warm.ravel())

        for variable in states[:, :n].ravel():
            prog.SetVariableScaling(variable, ANGLE_SCALE)
        for variable in states[:, 2 * n :].ravel():
            prog.SetVariableScaling(variable, TEMPERATURE_SCALE)
        manipulator = limb.GetSubsystemByName("manipulator")
        defects = LimbDefects(parameters, manipulator, num_knots, time_step)
        self._acceleration_to_angle = defects.acceleration_to_angle
        if defects.largest_disagreement(manipulator) < 1e-9:
            self.defects = DefectBlock(self, defects)
        else:
            self.defects = None
            warnings.warn(
                "The limb's plant is not the planar chain of eqn (2) any more; planning with "
                "Drake's own constraints, much slower than in closed form.",
                stacklevel=2,
            )

    def variables(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """All decision variables, from states (2n + 2W, N) and duty (W, N)."""
        x = np.empty(self.prog.num_vars())
        x[self.time_steps] = self.time_step
        x[self.states], x[self.duty] = states.T, duty.T
        return x

    def signals(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """[θ, θ̇] (2n, N), T, V and D (W, N) of all decision variables."""
        angles, rates, wire, measured = split_state(self.parameters, x[self.states].T)
        return np.vstack([angles, rates]), wire, measured, x[self.duty].T

    def cost(self, x: np.ndarray) -> float:
        """Eqn (15)."""
        return float(self.prog.EvalBindings(self.prog.quadratic_costs(), x).sum())

    def largest_defect(self, x: np.ndarray) -> float:
        """Largest violation of (17), with the dynamics of the limb's diagram.

        Defects of θ̇ are scaled by K⁻¹ M(0) to the static deflections they
        stand for, in rad; those of θ by the time step, in rad; those of T and
        V by the time step and 50 °C.
        """
        h, states, duty = self.time_step, x[self.states].T, x[self.duty].T
        rates = self._time_derivatives(states, duty)
        middle_states = (states[:, :-1] + states[:, 1:]) / 2 - h / 8 * np.diff(rates)
        middle_rates = 1.5 / h * np.diff(states) - (rates[:, :-1] + rates[:, 1:]) / 4
        middle_duty = (duty[:, :-1] + duty[:, 1:]) / 2
        defects = middle_rates - self._time_derivatives(middle_states, middle_duty)
        n = self.parameters.num_joints
        scaled = (
            defects[:n] * h,
            self._acceleration_to_angle @ defects[n : 2 * n],
            defects[2 * n :] * h / TEMPERATURE_SCALE,
        )
        return max(float(np.abs(rows).max()) for rows in scaled)

    def _time_derivatives(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        return BatchEvalTimeDerivatives(
            self.limb,
            self.limb.CreateDefaultContext(),
            np.zeros((1, states.shape[1])),
            np.asfortranarray(states),
            np.asfortranarray(duty),
            self.limb.GetInputPort("duty").get_index(),
        )


class DefectBlock:
    """`LimbDefects` as a `planners.ipopt.ConstraintBlock` of a program's variables."""

    def __init__(self, program: TrajectoryProgram, defects: LimbDefects):
        self._program, self._defects = program, defects
        num_states = program.states.shape[1]
        variables = np.hstack(
            [program.states[:-1], program.states[1:], program.duty[:-1], program.duty[1:]]
        )
        first_rows = num_states * np.arange(defects.num_intervals)
        self.rows = (first_rows[:, None] + defects.rows).ravel()
        self.columns = variables[:, defects.columns].ravel()
        self.lower = self.upper = np.zeros(defects.num_intervals * num_states)

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        return self._defects.evaluate(x[self._program.states], x[self._program.duty]).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._defects.jacobian(x[self._program.states], x[self._program.duty]).ravel()


def _indices(prog, variables: np.ndarray) -> np.ndarray:
    flat = prog.FindDecisionVariableIndices(variables.ravel())
    return np.array(flat).reshape(variables.shape)
