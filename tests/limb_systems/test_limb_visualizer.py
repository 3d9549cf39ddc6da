"""What a live view shows."""

import gc
import sys
import weakref
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from limb_systems import (
    Limb,
    LimbParameters,
    LimbVisualizer,
    joint_angles_from_bend_angle,
    wire_color,
)

sys.path.insert(0, str(Path(__file__).parent))

from meshcat_page import LIMB, check_bodies, live_poses, make_plan, properties, srgb


def test_wire_color_runs_from_greyish_blue_at_ambient_to_orange_at_the_maximum():
    parameters = LimbParameters(ambient_temperature=10.0)
    parameters.temperature_limits.maximum = 90.0
    cold, hot = wire_color(parameters, [10.0, 90.0])
    assert cold[2] > cold[1] > cold[0]
    assert np.ptp(cold) < 0.4
    assert hot[0] > 0.95
    assert hot[0] > hot[1] + 0.3 > hot[2] + 0.6
    np.testing.assert_array_equal(wire_color(parameters, [-40.0, 400.0]), [cold, hot])
    between = wire_color(parameters, np.linspace(10.0, 90.0, 101).reshape(1, 101))
    assert between.shape == (1, 101, 3)
    assert between.min() >= 0
    assert between.max() <= 1
    # Heat can be told from any colour: red less blue only ever grows.
    assert (np.diff(between[0, :, 0] - between[0, :, 2]) > 0).all()


def test_live_view_follows_the_limb_in_a_simulation(two_segments, meshcat):
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb(two_segments))
    visualizer = builder.AddSystem(LimbVisualizer(two_segments, meshcat))
    duty = builder.AddSystem(ConstantVectorSource([0.0, 0.5, 1.0, 0.0]))
    builder.Connect(duty.get_output_port(), limb.GetInputPort("duty"))
    for name in ("joint_state", "wire_temperature"):
        assert visualizer.GetInputPort(name).size() == limb.GetOutputPort(name).size()
        builder.Connect(limb.GetOutputPort(name), visualizer.GetInputPort(name))
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(
        SimulatorConfig(integration_scheme="radau3", accuracy=1e-3, use_error_control=True),
        simulator,
    )
    limb_context = limb.GetMyContextFromRoot(simulator.get_context())
    shown = []
    for time in (0.5, 2.0):
        simulator.AdvanceTo(time)
        page = meshcat.StaticHtml()
        heat = limb.GetOutputPort("wire_temperature").Eval(limb_context)
        joint_angles = limb.GetOutputPort("joint_state").Eval(limb_context)[:5]
        scene = properties(page)
        for path, temperature in (
            ("link_2/limb/wire_left", heat[0]),
            ("link_1/limb/wire_right", heat[1]),
            ("link_5/limb/wire_left", heat[2]),
            ("link_3/limb/wire_right", heat[3]),
        ):
            *color, opacity = scene[f"{LIMB}/{path}", "color"]
            assert opacity == 1.0
            expected = wire_color(two_segments, temperature)
            np.testing.assert_allclose(srgb(np.array(color)), expected, atol=1e-9)
        check_bodies(live_poses(page), two_segments, joint_angles)
        shown.append(heat)
    assert (shown[1] - shown[0])[[1, 2]].min() > 5.0


def test_live_view_shows_ghosts_at_the_context_s_time(two_segments, meshcat):
    plan = make_plan(two_segments)
    visualizer = LimbVisualizer(two_segments, meshcat, plan)
    context = visualizer.CreateDefaultContext()
    visualizer.GetInputPort("joint_state").FixValue(context, np.zeros(10))
    visualizer.GetInputPort("wire_temperature").FixValue(context, np.full(4, 25.0))
    for time, knot in ((0.0, 0), (2.5, 5), (4.0, 8), (30.0, 8)):
        context.SetTime(time)
        visualizer.ForcedPublish(context)
        page = meshcat.StaticHtml()
        pose_of, wanted = live_poses(page), plan.reference[:, knot]
        check_bodies(pose_of, two_segments, plan.joint_angles[:, knot], "plan")
        wanted = joint_angles_from_bend_angle(two_segments, wanted)
        check_bodies(pose_of, two_segments, wanted, "reference")


def test_a_live_view_is_freed_and_its_meshcat_with_it():
    meshcat = Meshcat(MeshcatParams(host="localhost", port=0))
    builder = DiagramBuilder()
    visualizer = builder.AddSystem(
        LimbVisualizer(LimbParameters(), meshcat, make_plan(LimbParameters()))
    )
    builder.ExportInput(visualizer.GetInputPort("joint_state"))
    diagram = builder.Build()
    diagram.CreateDefaultContext()
    references = [weakref.ref(thing) for thing in (visualizer, meshcat)]
    del builder, diagram, visualizer, meshcat
    gc.collect()
    assert [reference() for reference in references] == [None] * len(references)
