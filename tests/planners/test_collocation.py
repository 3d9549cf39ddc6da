"""Collocation in closed form against Drake's own constraints and dynamics."""

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.planning import DirectCollocationConstraint
from scipy.linalg import block_diag
from wire_laws import LIMBS, limb_with, random_state

from limb_systems import (
    HystereticLaw,
    Limb,
    LimbModel,
    LimbParameters,
    SegmentParameters,
)
from planners.recurrence import LinearRecurrence
from planners.transcription.collocation import MotionDefects, fixed_time_heat_blocks, heat_block

TIME_STEP = 5e-4  # s, short enough for the fixed point that closes the θ rows below


def limbs() -> dict[str, LimbParameters]:
    """Chains of all kinds with the paper's law, and with laws of one to three states."""
    soft_tip = SegmentParameters(links=1, length=0.05, mass=0.02, thickness=0.02, stiffness=0.05)
    soft_tip.wire("left").law.beta, soft_tip.wire("right").law.a3 = 2e-4, -2.5
    return {
        "one link": LimbParameters(segments=[SegmentParameters(links=1)]),
        "two segments": LimbParameters(segments=[SegmentParameters(links=3), soft_tip]),
        "gravity": LimbParameters(segments=[SegmentParameters(links=2)], gravity=[-4.0, -9.0, 1.0]),
        **{name: LIMBS[name]() for name in ("mixed", "remembering")},
    }


class Trajectories:
    """(17) of K knots as functions of states (K, ..), duty (K, W) and time steps."""

    def __init__(self, parameters, num_knots=2, time_step=TIME_STEP):
        wires = LimbModel.of(parameters).wires
        num_states = 2 * parameters.num_joints + len(wires.heat_scales)
        sizes = num_knots * num_states, num_knots * wires.num_wires, num_knots - 1
        ends = np.cumsum(sizes)
        states, duty, steps = np.split(np.arange(ends[-1]), ends[:-1])
        states, duty = states.reshape(num_knots, -1), duty.reshape(num_knots, -1)
        motion = MotionDefects(
            LimbModel.of(parameters),
            states,
            duty,
            steps,
            time_step,
            free_duration=True,
        )
        heat = heat_block(
            LimbModel.of(parameters), states[:, 2 * parameters.num_joints :], duty, steps
        )
        self.blocks, self.num_variables = [motion, heat], ends[-1]

    def evaluate(self, *signals):
        return np.concatenate([block.evaluate(flat(*signals)) for block in self.blocks])

    def jacobian(self, *signals):
        results = []
        for block in self.blocks:
            results.append(np.zeros((len(block.lower), self.num_variables)))
            results[-1][block.rows, block.columns] = block.jacobian(flat(*signals))
        return np.vstack(results)

    def hessian(self, multipliers, *signals):
        result = np.zeros((self.num_variables, self.num_variables))
        split = np.split(multipliers, [len(self.blocks[0].lower)])
        for block, weights in zip(self.blocks, split, strict=True):
            values = block.hessian(flat(*signals), weights)
            rows, columns = block.hessian_rows, block.hessian_columns
            low, high = np.minimum(rows, columns), np.maximum(rows, columns)
            np.add.at(result, (high, low), values)
        return result + np.tril(result, -1).T


def flat(*signals):
    return np.concatenate([np.ravel(signal) for signal in signals])


def test_defects_and_their_jacobian_agree_with_drakes_autodiff():
    """θ rows are exact at once; rows of θ̇ where those of θ vanish, as in `MotionDefects`."""
    generator = np.random.default_rng(1)
    for parameters in limbs().values():
        states, duty = random_state(parameters, generator, 2)
        system, n, size = Limb(parameters), parameters.num_joints, states.shape[1]
        port = system.GetInputPort("duty").get_index()
        constraint = DirectCollocationConstraint(
            system, system.CreateDefaultContext(), input_port_index=port
        )
        weight = np.linalg.inv(LimbModel.of(parameters).dynamics.acceleration_to_angle)
        heat_weight = np.diag(LimbModel.of(parameters).wires.heat_scales / TIME_STEP)
        unscale = block_diag(TIME_STEP / 8 * weight, weight, heat_weight)
        defects, step = Trajectories(parameters), np.array([TIME_STEP])

        def variables(states=states, duty=duty):
            return np.r_[TIME_STEP, states.ravel(), duty.ravel()]

        ours = unscale @ defects.evaluate(states, duty, step)
        theirs, exact = constraint.Eval(variables()), np.r_[:n, 2 * n : size]
        np.testing.assert_allclose(ours[exact], theirs[exact], rtol=1e-9, atol=1e-7)
        for _ in range(60):  # closes the θ rows
            states[1, :n] -= constraint.Eval(variables())[:n] * TIME_STEP / 1.5
        ours, theirs = (
            unscale @ defects.evaluate(states, duty, step),
            constraint.Eval(variables()),
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-5)
        assert np.abs(theirs).max() > 1.0  # it is no feasible point

        heat_defects = theirs[2 * n :]
        theirs = ExtractGradient(constraint.Eval(InitializeAutoDiff(variables())[:, 0]))
        theirs = np.roll(theirs, -1, axis=1)  # the time step is Drake's first and our last variable
        ours = unscale @ defects.jacobian(states, duty, step)
        ours[2 * n :, -1] -= heat_defects / TIME_STEP  # rows of heat are times the time step
        scale = np.abs(theirs).max(axis=0) + 1.0
        ours, theirs = ours / scale, theirs / scale
        np.testing.assert_allclose(ours[exact], theirs[exact], rtol=1e-8, atol=1e-8)
        # Rows of θ̇ differ by multiples of those of θ.
        difference = ours[n : 2 * n] - theirs[n : 2 * n]
        multiples = np.linalg.lstsq(theirs[:n].T, difference.T, rcond=None)[0]
        np.testing.assert_allclose(multiples.T @ theirs[:n], difference, atol=1e-7)


def test_hessian_is_the_difference_quotient_of_the_jacobian():
    """The whole one, and then that by heat and duty alone."""
    generator = np.random.default_rng(7)
    for parameters in limbs().values():
        wires, n = LimbModel.of(parameters).wires, parameters.num_joints
        signals = *random_state(parameters, generator, 3), generator.uniform(0.04, 0.06, 2)
        defects = Trajectories(parameters, 3, 0.05)
        multipliers = generator.normal(size=sum(len(block.lower) for block in defects.blocks))
        scales = np.tile(np.r_[np.full(n, 0.1), np.ones(n), wires.heat_scales], 3)
        scales = np.r_[scales, np.ones(signals[1].size), np.full(2, 0.05)]

        def gradient(point):
            parts = np.split(point, np.cumsum([signal.size for signal in signals])[:-1])
            shaped = [a.reshape(b.shape) for a, b in zip(parts, signals, strict=True)]
            return multipliers @ defects.jacobian(*shaped)

        point, quotient = flat(*signals), []
        for step in np.diag(2e-6 * scales):
            change = gradient(point + step) - gradient(point - step)
            quotient.append(scales * change / 4e-6)
        quotient, most = np.array(quotient), np.abs(quotient).max()
        hessian = scales[:, None] * defects.hessian(multipliers, *signals) * scales
        np.testing.assert_allclose(hessian, quotient, atol=1e-6 * most)
        knots = np.arange(signals[0].size).reshape(3, -1)
        others = knots[:, : 2 * n].ravel()
        quotient[others], quotient[:, others] = 0.0, 0.0
        defects.blocks[0] = defects.blocks[0].with_curvature_of_heat()
        hessian = scales[:, None] * defects.hessian(multipliers, *signals) * scales
        by_heat = hessian[:-2, :-2]  # not by the time steps
        np.testing.assert_allclose(by_heat, quotient[:-2, :-2], atol=1e-6 * most)


def test_blocks_of_equal_wires_have_the_rows_of_the_block_of_all_wires():
    """And its curvature, which hysteretic wires have."""
    generator = np.random.default_rng(3)
    hysteretic = limb_with(HystereticLaw(), HystereticLaw())
    for parameters in (*limbs().values(), hysteretic):
        model = LimbModel.of(parameters)
        states, levels = random_state(parameters, generator, 3)
        heat, duty, steps = states[:, 2 * parameters.num_joints :], levels, np.full(2, TIME_STEP)
        x = flat(heat, duty, steps)
        places = np.split(np.arange(x.size), np.cumsum([heat.size, duty.size]))
        heat_at, duty_at = places[0].reshape(heat.shape), places[1].reshape(duty.shape)
        whole = heat_block(model, heat_at, duty_at, places[2])
        direction = generator.normal(size=x.size)
        direction[places[2]] = 0.0  # at fixed time steps

        def values_and_changes(block, x=x, direction=direction):
            changes = np.zeros(len(block.lower))
            np.add.at(changes, block.rows, block.jacobian(x) * direction[block.columns])
            return np.array([block.evaluate(x), changes])

        def curvature(block, x=x, direction=direction):
            """Return the second derivative along the direction, of all rows together."""
            rows, columns = block.hessian_rows, block.hessian_columns
            twice = np.where(rows == columns, 1.0, 2.0)
            values = block.hessian(x, np.ones(len(block.lower)))
            return (twice * values * direction[rows] * direction[columns]).sum()

        for size in (heat.shape[1], model.wires.num_states):  # with readings, and without
            expected = values_and_changes(whole).reshape(2, 2, -1)[..., :size].reshape(2, -1)
            blocks = fixed_time_heat_blocks(model, heat_at[:, :size], duty_at, places[2])
            actual = np.hstack([values_and_changes(block) for block in blocks])
            np.testing.assert_allclose(np.sort(actual), np.sort(expected), rtol=1e-9, atol=1e-9)
        blocks = fixed_time_heat_blocks(model, heat_at, duty_at, places[2])
        actual = sum(curvature(block) for block in blocks)
        np.testing.assert_allclose(actual, curvature(whole), rtol=1e-9, atol=1e-12)


def test_recurrence_in_chunks_is_the_recurrence_knot_by_knot():
    generator = np.random.default_rng(4)
    for num_steps in (0, 1, 2, 7, 30):
        factors = generator.normal(size=(num_steps, 3, 3))
        gains = generator.normal(size=(num_steps, 3))
        expected = [np.zeros(3)]
        for factor, gain in zip(factors, gains, strict=True):
            expected.append(factor @ expected[-1] + gain)
        np.testing.assert_allclose(LinearRecurrence(factors).solve(gains), expected, rtol=1e-10)
