"""Limbs and robots in MuJoCo, against the equations of motion, Drake, and MuJoCo's own figures."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from pydrake.trajectories import PiecewisePolynomial

import urdf
from limb_systems import (
    HystereticLaw,
    Limb,
    LimbModel,
    LimbParameters,
    RestMemory,
    SegmentParameters,
    TwoMassLaw,
    simulate,
)
from soft_limb.command import main
from urdf import limb_mjcf, robot_mjcf
from walking import RobotParameters

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
KINDS = ["nominal", "bent at rest, loaded", "two segments", "in space", "two thermal masses"]


def limb_of(kind: str) -> LimbParameters:
    limb = LimbParameters.in_space(3) if kind == "in space" else LimbParameters()
    segment = limb.segments[0]
    if kind == "bent at rest, loaded":
        limb.gravity, limb.payload, segment.rest_angle = [0.0, -9.81, 0.0], 0.01, 0.2
    if kind == "two segments":
        limb.gravity, segment.links = [3.0, -9.0, 0.0], 2
        tip = SegmentParameters(links=3, length=0.06, mass=0.010, stiffness=0.08, stiffening=1.0)
        tip.centred_joints, tip.rest_angle = True, -0.1
        limb.segments.append(tip)
    if kind == "in space":
        limb.gravity, segment.twists, segment.stiffening = [-9.81, 0.0, 2.0], True, 0.5
        segment.rest_angle, segment.rest_angle_e3, segment.stiffness_ratio = 0.1, -0.2, 1.3
    if kind == "two thermal masses":
        for wire, a1 in zip(segment.wires, (-0.08, -0.11), strict=True):
            wire.law = TwoMassLaw(a1=a1)
    return limb


class Loaded:
    """A limb's MJCF in MuJoCo, and where its joints, temperatures and readings are."""

    def __init__(self, limb: LimbParameters, **options):
        self.model = mujoco.MjModel.from_xml_string(limb_mjcf(limb, **options))
        self.data = mujoco.MjData(self.model)
        names = [f"joint_{number}" for number in range(1, limb.num_joints + 1)]
        self.joints = [self.model.joint(name).qposadr[0] for name in names]
        names = [f"thermocouple_{wire}" for wire in limb.wire_names]
        self.readings = [self.model.joint(name).qposadr[0] for name in names]
        self.per_wire = self.model.nu // len(limb.wires)
        law = limb.wires[0].law
        self.warmth = self.model.actuator_gainprm[:, 0] / law.beta

    def temperature(self, act: np.ndarray) -> np.ndarray:
        """T - T0 (..., W) of activations (..., nu)."""
        return (act * self.warmth).reshape(*act.shape[:-1], -1, self.per_wire).sum(axis=-1)

    def rollout(self, duty: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (K, nq), velocities (K, nv) and activations (K, na) after steps of a duty."""
        state = np.zeros(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, state, STATE)
        states, _ = rollout.rollout(
            self.model, self.data, state, np.repeat(duty, self.per_wire, axis=1)
        )
        sizes = np.cumsum([1, self.model.nq, self.model.nv, self.model.na])
        return np.split(states[0], sizes, axis=1)[1:4]


@pytest.mark.parametrize("kind", KINDS)
def test_accelerations_and_rates_satisfy_the_equation_of_motion(kind):
    limb = limb_of(kind)
    loaded, wires, n = Loaded(limb), LimbModel.of(limb).wires, limb.num_joints
    model, data, W = loaded.model, loaded.data, wires.num_wires
    rng = np.random.default_rng(3)
    for _ in range(5):
        angles, rates = rng.uniform(-0.4, 0.4, n), rng.uniform(-3, 3, n)
        readings = rng.uniform(20, 100, W)
        data.act[:] = rng.uniform(0, 0.3, model.na)
        data.qpos[loaded.joints], data.qvel[loaded.joints] = angles, rates
        data.qpos[loaded.readings] = readings
        mujoco.mj_forward(model, data)
        T = limb.ambient_temperature + loaded.temperature(data.act)
        heat = wires.cold_states.copy()
        heat[:W] = T
        point = np.concatenate([angles, rates, heat])
        expected = LimbModel.of(limb).dynamics.accelerations(point)
        np.testing.assert_allclose(data.qacc[loaded.joints], expected, rtol=1e-8, atol=1e-6)
        # Without inertia the reading moves as its spring and its damper say.
        lag = model.joint("thermocouple_" + limb.wire_names[0]).damping[0]
        force = data.qfrc_actuator[loaded.readings] + data.qfrc_passive[loaded.readings]
        rates = (force / lag)[0]
        assert rates == pytest.approx(wires.reading_rates(readings, heat)[0], rel=1e-9)


@pytest.mark.parametrize("kind", ["nominal", "in space", "two thermal masses"])
def test_temperatures_under_random_duty_equal_the_integrated_wire_states(kind):
    limb = limb_of(kind)
    loaded, wires = Loaded(limb, timestep=0.01), LimbModel.of(limb).wires
    levels = np.random.default_rng(1).uniform(0, 0.8, (10, wires.num_wires))
    positions, _, act = loaded.rollout(np.repeat(levels, 200, axis=0))
    states = [wires.cold_states]
    for level in levels:
        times = np.linspace(0.0, 2.0, 41)
        states += [*wires.integrate_states(states[-1], np.tile(level, (41, 1)), times, 0.01)[1:]]
    expected = np.array(states)[1:, : wires.num_wires]
    T = limb.ambient_temperature + loaded.temperature(act[4::5])
    assert np.abs(T - expected).max() < 1e-3
    assert np.ptp(expected) > 50.0
    # V' = a3 (V - T), by small steps along the exact T.
    T = limb.ambient_temperature + loaded.temperature(act)
    V = np.full(wires.num_wires, limb.ambient_temperature)
    a3, step = np.array([wire.law.a3 for wire in limb.wires]), 0.01
    for before, after, read in zip(T[:-1], T[1:], positions[1:, loaded.readings], strict=True):
        V = 0.5 * (before + after) + np.exp(a3 * step) * (V - 0.5 * (before + after))
        assert np.abs(read - V).max() < 0.15
    assert np.abs(read - V).max() < 0.02


def test_bend_under_random_duty_is_drakes():
    limb = LimbParameters(gravity=[0.0, -9.81, 0.0])
    levels = np.random.default_rng(1).uniform(0, 0.8, (2, 4))
    duty = PiecewisePolynomial.ZeroOrderHold(2.0 * np.arange(4), levels)
    held = LimbModel.of(limb).statics.angles(LimbModel.of(limb).wires.cold_states[None])[0]
    cold = LimbModel.of(limb).wires.cold_states
    initial = np.concatenate([held, 0 * held, cold, cold])
    recording = simulate(Limb(limb), duty, 6.0, accuracy=1e-5, initial_state=initial)
    loaded = Loaded(limb, timestep=0.001)
    loaded.data.qpos[loaded.joints] = held
    positions, _, act = loaded.rollout(np.repeat(levels.T[:3], 2000, axis=0))
    at_samples = slice(49, None, 50)
    angles = positions[at_samples, loaded.joints]
    bend = np.rad2deg(
        LimbModel.of(limb).mechanics.bend_angle(angles.T) - recording.bend_angle[:, 1:]
    )
    assert np.abs(bend).max() < 0.01
    V = positions[at_samples, loaded.readings].T - recording.measured_temperature[:, 1:]
    assert np.abs(V).max() < 0.02
    T = 25.0 + loaded.temperature(act[at_samples]).T - recording.wire_temperature[:, 1:]
    assert np.abs(T).max() < 1e-3


def test_the_checked_in_file_is_the_mjcf_of_the_nominal_limb():
    path = Path(urdf.__file__).with_name("limb_5.xml")
    assert path.read_text(encoding="utf-8") == limb_mjcf(LimbParameters())


def test_laws_that_mjcf_cannot_express_are_refused_with_a_remedy():
    limb = LimbParameters()
    limb.segments[0].wires[1].law = HystereticLaw()
    with pytest.raises(ValueError, match=r"The wire right has the law HystereticLaw.*--callback"):
        limb_mjcf(limb)
    limb = LimbParameters()
    limb.segments[0].rest_memory = RestMemory()
    with pytest.raises(ValueError, match="rest_memory"):
        limb_mjcf(limb)


@pytest.mark.parametrize("robot", [RobotParameters(), RobotParameters.in_space(4)])
def test_a_robot_stands_on_feet_of_their_stiffness_and_creep(robot):
    model = mujoco.MjModel.from_xml_string(robot_mjcf(robot))
    data = mujoco.MjData(model)
    for limb in robot.limbs:
        foot = model.geom(f"{limb.name}_foot")
        mobility = model.body(foot.bodyid[0]).invweight0[0]
        damping = robot.contact_stiffness * 0.02 / 2  # the ground and the foot relax in 10 ms each
        expected = [robot.contact_stiffness, damping]
        np.testing.assert_allclose(-foot.solref / mobility / 0.1, expected, rtol=1e-6)
        assert damping * model.opt.impratio == pytest.approx(2500.0)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    normal = data.sensordata.reshape(-1, 3)[:, 2]
    weight = mujoco.mj_getTotalmass(model) * 9.81
    assert np.abs(normal).sum() == pytest.approx(weight, rel=1e-3)
    assert (normal > 0).all()
    depth = -data.contact.dist
    assert depth == pytest.approx(normal / robot.contact_stiffness, rel=0.02)


@pytest.mark.whole
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_hysteretic_wires_heat_and_pull_by_c_code(tmp_path, capsys):
    limb = LimbParameters()
    for wire in limb.segments[0].wires:
        wire.law = HystereticLaw()
    limb.save(tmp_path / "limb.yaml")
    files = [tmp_path / name for name in ("limb.yaml", "limb.xml", "limb.c")]
    yaml, xml, code = map(str, files)
    assert main(["export", yaml, "-o", xml]) == 1
    assert "--callback" in capsys.readouterr().err
    assert main(["export", yaml, "-o", xml, "--callback", code]) == 0
    library = str(tmp_path / "limb.so")
    include = f"-I{mujoco.HEADERS_DIR}/.."
    subprocess.run(
        ["cc", "-O1", "-shared", "-fPIC", include, f"-I{mujoco.HEADERS_DIR}", code, "-o", library],
        check=True,
    )
    callbacks = ctypes.CDLL(library)
    model = mujoco.MjModel.from_xml_path(xml)
    data, wires = mujoco.MjData(model), LimbModel.of(limb).wires
    duty = np.array([0.1, 0.5])
    mujoco.set_mjcb_act_dyn(callbacks.wire_rates)
    mujoco.set_mjcb_act_bias(callbacks.wire_torque)
    try:
        data.ctrl[:] = duty
        for _ in range(2000):
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_act_dyn(None)
        mujoco.set_mjcb_act_bias(None)
    states = wires.integrate_states(
        wires.cold_states, np.tile(duty, (2, 1)), np.array([0.0, 4.0]), 0.01
    )
    expected = (states[-1] - wires.cold_states).reshape(-1, 2).T
    np.testing.assert_allclose(data.act.reshape(2, -1)[:, :-1], expected, rtol=5e-3, atol=5e-3)
    held = wires.forces(states[-1], np.zeros(limb.num_joints))
    np.testing.assert_allclose(data.qfrc_actuator, held, rtol=1e-2)
    assert np.abs(held).max() > 1e-3
