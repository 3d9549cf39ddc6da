"""The trajectory program, eqns (15)-(20), in CasADi and IPOPT: the benchmark's peer.

Nothing of Drake and nothing of `planners` is in here. The limb is one segment
of equal box-shaped links that move in a plane without gravity. Variables of
knot k are z = [θ, θ̇, T - T0, V - T0, D] and, in the implicit form, θ̈.

The defects of direct collocation (cubic states, linear duty, dynamics at the
middle of each interval) are linear in all z but for the mechanics, which is
one small function F of θ, θ̇, torque and, in the implicit form, θ̈. With Y = P z
all arguments of F, at the N knots and then at the N - 1 midpoints,

    g(z) = A z + B F(P z)

with constant sparse A, B and P. F is

- implicit: the inverse dynamics K⁻¹ (M θ̈ + ... - f), which is to be zero;
- explicit: the accelerations θ̈ = M⁻¹ (f - ...), which enter the defects.

The midpoint rate in P is 3/(2h) (θ1 - θ0) - (θ̇0 + θ̇1)/4, which is the cubic's
wherever the defects of θ are zero.
"""

import dataclasses
import time
from typing import Literal

import casadi as ca
import numpy as np

ca.load_nlpsol("ipopt")  # now, so that it does not count as building

# Changes that matter, which scaling takes as one.
ANGLE_SCALE = 0.1  # rad
RATE_SCALE = 1.0  # rad/s
ACCELERATION_SCALE = 10.0  # rad/s²
TEMPERATURE_SCALE = 50.0  # °C

Form = Literal["implicit", "explicit"]

IPOPT_OPTIONS = {
    "mu_strategy": "adaptive",
    "tol": 1e-5,  # of the scaled objective, whose size is 100 at the most
    "constr_viol_tol": 1e-8,
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",  # variables, rows and objective come scaled
    "mumps_permuting_scaling": 0,
    "mumps_scaling": 0,
    "mumps_pivot_order": 2,  # approximate minimum fill
    "bound_push": 1e-3,  # the guess is good, and near its bounds
    "bound_frac": 1e-3,
    "max_iter": 3000,
    "print_level": 0,
    "sb": "yes",
}


@dataclasses.dataclass(frozen=True)
class Problem:
    """One limb, one reference and the start, as plain numbers.

    - ``links``, ``length`` m, ``mass`` kg, ``thickness`` m, ``stiffness``
      N·m/rad, ``damping`` N·m·s/rad: of the segment and its joints.
    - ``a1`` 1/s, ``a2`` °C/s, ``a3`` 1/s, ``beta`` N·m/°C: of the wires (2,).
    - ``ambient``, ``maximum``, ``warm``: T0, T_max and T_warm, °C.
    - ``warm_up_time``: k_warm, s.
    - ``angle_weight``, ``duty_weight``, ``terminal_factor``: of eqn (15).
    - ``times``: of the knots (N,), s.
    - ``angles_ref``: θ_ref (n, N), rad.
    - ``initial_state``: [θ, θ̇, T, V] (2n + 4,), rad, rad/s, °C and °C.
    - ``guess_states``: (2n + 4, N), in the same order and units.
    - ``guess_duty``: (2, N).
    """

    links: int
    length: float
    mass: float
    thickness: float
    stiffness: float
    damping: float
    a1: np.ndarray
    a2: np.ndarray
    a3: np.ndarray
    beta: np.ndarray
    ambient: float
    maximum: float
    warm: float
    warm_up_time: float
    angle_weight: float
    duty_weight: float
    terminal_factor: float
    times: np.ndarray
    angles_ref: np.ndarray
    initial_state: np.ndarray
    guess_states: np.ndarray
    guess_duty: np.ndarray


def run(problem: dict, time_limit: float, **options) -> dict:
    """Build a `Solver` with these options and solve twice.

    Args:
        problem: the fields of `Problem`.
        time_limit: s, for each solution.

    Returns:
        ``build``, ``solve``, ``again`` (the second solution by the same solver) and
        ``evaluation`` (the part of ``solve`` in functions and derivatives), s;
        ``status``, ``success``, ``iterations``; ``states`` (2n + 4, N) and ``duty`` (2, N).
    """
    problem = Problem(**problem)
    started = time.process_time()
    solver = Solver(problem, **options, time_limit=time_limit)
    build = time.process_time() - started
    result = {"build": build, **solver.solve(problem)}
    if result["success"]:
        result["again"] = solver.solve(problem)["solve"]
    return result


def link_masses(problem: Problem) -> np.ndarray:
    """Return C (n, n), kg·m², of the mass matrix C_ij cos(φi - φj) in link angles φ.

    The centre of link i is at Σ_j G_ij e(φj), with e a unit vector.
    """
    n = problem.links
    link = problem.length / n
    mass = problem.mass / n
    G = link * (np.tri(n, k=-1) + np.eye(n) / 2)
    return mass * (G.T @ G + (link**2 + problem.thickness**2) / 12 * np.eye(n))


def inverse_dynamics(problem: Problem, angles: ca.SX, rates: ca.SX, accelerations: ca.SX) -> ca.SX:
    """Return the joint torques (n, 1), N·m, of θ, θ̇ and θ̈, each (n, 1): eqn (1)."""
    C = link_masses(problem)
    n = problem.links
    phi, phi_dot, phi_ddot = (ca.cumsum(x) for x in (angles, rates, accelerations))
    on_links = [
        sum(
            C[i, j]
            * (ca.cos(phi[i] - phi[j]) * phi_ddot[j] + ca.sin(phi[i] - phi[j]) * phi_dot[j] ** 2)
            for j in range(n)
        )
        for i in range(n)
    ]
    on_joints = ca.mtimes(ca.DM(np.tri(n).T), ca.vertcat(*on_links))
    return on_joints + problem.stiffness * angles + problem.damping * rates


class PointFunctions:
    """F of the module's docstring at one point, with as many derivatives as asked for.

    - ``value``: y (ny, 1) to F (n, 1).
    - ``jacobian``: y to the nonzeros of ∂F/∂y, in the order of
      ``jacobian_sparsity`` (n, ny).
    - ``hessian``: y and multipliers (n, 1) to the nonzeros of ∂²(μᵀF)/∂y², in
      the order of ``hessian_sparsity`` (ny, ny).

    y is [θ, θ̇, torque] and, in the implicit form, θ̈.

    Args:
        order: 1 with the Jacobian, 2 with the Hessian as well.
    """

    def __init__(self, problem: Problem, form: Form, order: int):
        n = problem.links
        y = ca.SX.sym("y", 2 * n + 1)
        a = ca.SX.sym("a", n)
        multipliers = ca.SX.sym("mu", n)
        residual = inverse_dynamics(problem, y[:n], y[n : 2 * n], a) - y[2 * n]
        if form == "implicit":
            y = ca.vertcat(y, a)
            value = residual / problem.stiffness
        else:
            factors = ca.ldl(ca.jacobian(residual, a), False)
            value = ca.ldl_solve(-ca.substitute(residual, a, ca.SX.zeros(n)), *factors)
        functions = [_nonzeros("value", [y], value)]
        if form == "implicit":
            jacobian = ca.jacobian(value, y)
        else:  # the residual R(y, a) stays zero: a_y = -R_a⁻¹ R_y
            by_y = ca.substitute(ca.jacobian(residual, y), a, value)
            jacobian = -ca.ldl_solve(ca.densify(by_y), *factors)
        self.jacobian_sparsity = jacobian.sparsity()
        functions.append(_nonzeros("jacobian", [y], jacobian))
        if order > 1:
            if form == "implicit":
                hessian = ca.hessian(ca.dot(multipliers, value), y)[0]
            else:  # the Hessian of μᵀa equals that one of -wᵀR along (y, a(y)), R_aᵀ w = μ
                w = ca.SX.sym("w", n)
                curvature = ca.substitute(
                    ca.hessian(ca.dot(w, residual), ca.vertcat(y, a))[0],
                    ca.vertcat(a, w),
                    ca.vertcat(value, ca.ldl_solve(multipliers, *factors)),
                )
                along = ca.vertcat(ca.SX.eye(y.numel()), jacobian)
                hessian = -ca.mtimes(along.T, ca.mtimes(curvature, along))
            self.hessian_sparsity = hessian.sparsity()
            functions.append(_nonzeros("hessian", [y, multipliers], hessian))
        for function in functions:
            setattr(self, function.name(), function)


def _nonzeros(name: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
    return ca.Function(name, inputs, [ca.vertcat(*output.nonzeros())], {"cse": True})


class Solver:
    """The program built once, to be solved for any reference, initial state and guess.

    Args:
        problem: fixes the limb and the times of the knots.
        form: see the module's docstring.
        hessian: "exact", of the Lagrangian, or "gauss-newton", of the cost alone.
        time_limit: s, for one solution.
    """

    def __init__(
        self,
        problem: Problem,
        form: Form = "implicit",
        hessian: Literal["exact", "gauss-newton"] = "exact",
        time_limit: float = 120.0,
    ):
        self._form = form
        n = problem.links
        num_points = 2 * len(problem.times) - 1
        sizes = [n, n, 2, 2, 2, n if form == "implicit" else 0]
        scales = [ANGLE_SCALE, RATE_SCALE, TEMPERATURE_SCALE, TEMPERATURE_SCALE, 1.0]
        self._scale = np.repeat([*scales, ACCELERATION_SCALE], sizes)[:, None]
        point = PointFunctions(problem, form, 2 if hessian == "exact" else 1)

        guess = self._guess(problem)
        target = self._target(problem)
        weights = self._weights(problem)
        self._cost_scale = min(1.0, 100.0 / (0.5 * np.sum(weights * (guess - target) ** 2)))
        Q = ca.diag(ca.sparsify(ca.DM(self._cost_scale * weights.ravel("F"))))
        A, B, P = collocation(problem, form, self._scale[:, 0])

        x = ca.MX.sym("x", guess.size)
        target = ca.MX.sym("target", guess.size)
        cost_gradient = ca.densify(ca.mtimes(Q, x - target))
        cost = ca.dot(x - target, cost_gradient) / 2
        arguments = ca.reshape(ca.mtimes(P, x), -1, num_points)
        values = ca.vec(point.value.map(num_points)(arguments))
        constraints = ca.mtimes(A, x) + ca.mtimes(B, values)

        options = {"ipopt": {**IPOPT_OPTIONS, "max_wall_time": time_limit}, "print_time": False}
        options |= {"no_nlp_grad": True, "calc_lam_p": False}
        cost_factor = ca.MX.sym("lam_f")
        multipliers = ca.MX.sym("lam_g", constraints.numel())
        lagrangian_hessian = cost_factor * ca.MX(Q)
        by_arguments = ca.MX(
            ca.diagcat(*[point.jacobian_sparsity] * num_points),
            ca.vec(point.jacobian.map(num_points)(arguments)),
        )
        jacobian = A + ca.mtimes(B, ca.mtimes(by_arguments, P))
        if hessian == "exact":
            on_points = ca.reshape(ca.mtimes(B.T, multipliers), n, num_points)
            curvature = ca.MX(
                ca.diagcat(*[point.hessian_sparsity] * num_points),
                ca.vec(point.hessian.map(num_points)(arguments, on_points)),
            )
            lagrangian_hessian += ca.mtimes(P.T, ca.mtimes(curvature, P))
        options["jac_g"] = ca.Function(
            "jac_g", [x, target], [constraints, jacobian], ["x", "p"], ["g", "jac_g_x"]
        )
        options["grad_f"] = ca.Function(
            "grad_f", [x, target], [cost, cost_gradient], ["x", "p"], ["f", "grad_f_x"]
        )
        options["hess_lag"] = ca.Function(
            "hess_lag",
            [x, target, cost_factor, multipliers],
            [ca.triu(lagrangian_hessian)],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        )
        program = {"x": x, "p": target, "f": cost, "g": constraints}
        self._solver = ca.nlpsol("solver", "ipopt", program, options)

    def solve(self, problem: Problem) -> dict:
        """Solve from the problem's guess; return results as `run` does."""
        started = time.process_time()
        lower, upper = self._bounds(problem)
        result = self._solver(
            x0=self._guess(problem).ravel("F"),
            p=self._target(problem).ravel("F"),
            lbx=lower.ravel("F"),
            ubx=upper.ravel("F"),
            lbg=0.0,
            ubg=0.0,
        )
        stats = self._solver.stats()
        z = np.clip(np.array(result["x"]).reshape(lower.shape, order="F"), lower, upper)
        z = z * self._scale
        n = problem.links
        evaluation = [value for name, value in stats.items() if name.startswith("t_wall_nlp_")]
        return {
            "states": z[: 2 * n + 4] + _ambient_state(problem),
            "duty": z[2 * n + 4 : 2 * n + 6],
            "success": stats["success"],
            "status": stats["return_status"],
            "iterations": stats["iter_count"],
            "solve": time.process_time() - started,
            "evaluation": sum(evaluation),
        }

    def _guess(self, problem: Problem) -> np.ndarray:
        """Return scaled z of the guess (nz, N)."""
        excess = problem.guess_states - _ambient_state(problem)
        z = np.vstack([excess, problem.guess_duty])
        if self._form == "implicit":
            rates = problem.guess_states[problem.links : 2 * problem.links]
            z = np.vstack([z, np.gradient(rates, problem.times, axis=1)])
        return z / self._scale

    def _target(self, problem: Problem) -> np.ndarray:
        """Return scaled z that would cost nothing (nz, N)."""
        z = np.zeros((len(self._scale), len(problem.times)))
        z[: problem.links] = problem.angles_ref
        return z / self._scale

    def _weights(self, problem: Problem) -> np.ndarray:
        """Return weights of the squares of scaled z (nz, N), eqn (15)."""
        n = problem.links
        weights = np.zeros((len(self._scale), len(problem.times)))
        weights[:n] = problem.angle_weight
        weights[:n, -1] *= problem.terminal_factor
        weights[2 * n + 4 : 2 * n + 6, :-1] = problem.duty_weight
        return weights * self._scale**2

    def _bounds(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds on scaled z (nz, N), eqns (16) and (18)-(20)."""
        n = problem.links
        lower = np.full((len(self._scale), len(problem.times)), -np.inf)
        upper = -lower
        wire = slice(2 * n, 2 * n + 2)
        duty = slice(2 * n + 4, 2 * n + 6)
        upper[wire] = problem.maximum - problem.ambient
        lower[wire, problem.times > problem.warm_up_time] = problem.warm - problem.ambient
        lower[duty] = 0.0
        upper[duty] = 1.0
        start = problem.initial_state - _ambient_state(problem)[:, 0]
        lower[: 2 * n + 4, 0] = upper[: 2 * n + 4, 0] = start
        return lower / self._scale, upper / self._scale


def collocation(problem: Problem, form: Form, scale: np.ndarray) -> tuple[ca.DM, ca.DM, ca.DM]:
    """Return A, B and P of the module's docstring, sparse, for z in units of `scale` (nz,).

    Rows of g are scaled to the size of the states: rows of temperature and,
    in the implicit form, of angle by the time step and the size of a change;
    accelerations by K⁻¹ M(0), to the static deflections that they stand for.
    """
    n = problem.links
    num_knots = len(problem.times)
    num_variables = len(scale)
    h = problem.times[1] - problem.times[0]
    pick = np.split(np.diag(scale), np.cumsum([n, n, 2, 2, 2]))
    theta, rate, wire, measured, duty, acceleration = pick
    a1 = np.diag(problem.a1)
    a2 = np.diag(problem.a2)
    a3 = np.diag(problem.a3)
    wire_rate = a1 @ wire + a2 @ duty
    measured_rate = a3 @ (measured - wire)
    torque = np.array([[-problem.beta[0], problem.beta[1]]])

    # An interval's quantities as matrices that are multiplied by [z0, z1].
    def middle(x, x_rate):
        return np.hstack([x / 2 + h / 8 * x_rate, x / 2 - h / 8 * x_rate])

    def middle_rate(x, x_rate):
        return np.hstack([-1.5 / h * x - x_rate / 4, 1.5 / h * x - x_rate / 4])

    no_duty_rate = np.zeros_like(duty)
    mid_wire = middle(wire, wire_rate)
    mid_measured = middle(measured, measured_rate)
    wire_rows = middle_rate(wire, wire_rate) - a1 @ mid_wire - a2 @ middle(duty, no_duty_rate)
    measured_rows = middle_rate(measured, measured_rate) - a3 @ (mid_measured - mid_wire)
    heat_rows = h / TEMPERATURE_SCALE * np.vstack([wire_rows, measured_rows])
    angle_rows = middle_rate(theta, rate) - np.hstack([rate, rate]) / 2
    at_knot = [theta, rate, torque @ wire]
    at_middle = [middle(theta, rate), middle_rate(theta, rate), torque @ mid_wire]

    left = ca.DM.eye(num_knots)[:-1, :]
    right = ca.DM.eye(num_knots)[1:, :]

    def for_intervals(matrix):
        halves = ca.DM(matrix[:, :num_variables]), ca.DM(matrix[:, num_variables:])
        return ca.kron(left, ca.sparsify(halves[0])) + ca.kron(right, ca.sparsify(halves[1]))

    if form == "implicit":
        angle_rows -= h / 8 * np.hstack([acceleration, -acceleration])
        linear = for_intervals(np.vstack([h / ANGLE_SCALE * angle_rows, heat_rows]))
        at_knot.append(acceleration)
        at_middle.append(middle_rate(rate, acceleration))
        num_values = n * (2 * num_knots - 1)
        A = ca.vertcat(ca.DM(num_values, linear.columns()), linear)
        B = ca.vertcat(ca.DM.eye(num_values), ca.DM(linear.rows(), num_values)) / ANGLE_SCALE
    else:
        links_to_joints = np.tri(n)
        straight = links_to_joints.T @ link_masses(problem) @ links_to_joints
        to_angle = straight / problem.stiffness
        rate_rows = middle_rate(rate, np.zeros_like(rate))
        A = for_intervals(
            np.vstack([8 / h * to_angle @ angle_rows, to_angle @ rate_rows, heat_rows])
        )
        no_heat = np.zeros((4, n))
        of_first = np.vstack([-to_angle, -to_angle / 4, no_heat])
        of_second = np.vstack([to_angle, -to_angle / 4, no_heat])
        of_middle = np.vstack([np.zeros((n, n)), -to_angle, no_heat])
        of_first, of_second, of_middle = map(
            ca.sparsify, map(ca.DM, (of_first, of_second, of_middle))
        )
        B = ca.horzcat(
            ca.kron(left, of_first) + ca.kron(right, of_second),
            ca.kron(ca.DM.eye(num_knots - 1), of_middle),
        )
    P = ca.vertcat(
        ca.kron(ca.DM.eye(num_knots), ca.sparsify(ca.DM(np.vstack(at_knot)))),
        for_intervals(np.vstack(at_middle)),
    )
    return A, B, P


def _ambient_state(problem: Problem) -> np.ndarray:
    """Return [θ, θ̇, T, V] at rest, straight and cold (2n + 4, 1)."""
    return np.repeat([0.0, problem.ambient], [2 * problem.links, 4])[:, None]
