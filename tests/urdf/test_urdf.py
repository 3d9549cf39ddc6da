"""Models of limbs: the checked-in files, and what is drawn.

Masses, inertia and joints of the models are tested as plants in limb_systems.
"""

import dataclasses
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

import urdf
from limb_systems import LimbParameters, SegmentParameters, WireParameters, add_limb
from urdf import limb_sdf, limb_urdf

from ..limb_systems.plant_links import link_positions

FOLDER = Path(urdf.__file__).parent


@pytest.mark.parametrize(("name", "write"), [("limb_5.urdf", limb_urdf), ("limb_5.sdf", limb_sdf)])
def test_checked_in_files_are_the_models_of_the_nominal_limb(name, write):
    text = (FOLDER / name).read_text(encoding="utf-8")
    assert text == write(LimbParameters().segments)


def test_wires_are_drawn_on_their_side_and_below_the_axis_if_they_are():
    wires = [
        WireParameters("above", e2=0.003, e3=0.005),
        WireParameters("below", e2=-0.003, e3=-0.005),
    ]
    robot = ElementTree.fromstring(limb_urdf([SegmentParameters(wires=wires)]))
    for name, place in (("above", [0.01, 0.003, 0.01]), ("below", [0.01, -0.003, -0.01])):
        visual = robot.find(f"link[@name='link_2']/visual[@name='wire_{name}']")
        drawn = visual.find("origin").get("xyz").split()
        assert [float(number) for number in drawn] == pytest.approx(place)


def test_in_space_wires_run_at_their_places_beside_the_axis_of_each_piece():
    limb = LimbParameters.in_space(wires=4, links=3)
    limb.payload, limb.segments[0].centred_joints, limb.segments[0].twists = 0.02, True, True
    limb.segments.insert(0, SegmentParameters(links=1))  # of other silicone
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_limb(plant, limb)
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    query = scene_graph.get_query_output_port()
    bent = np.random.default_rng(2).uniform(-0.4, 0.4, 10)
    for angles in (np.zeros(10), bent):
        plant.SetPositions(plant.GetMyContextFromRoot(context), angles)
        shown = query.Eval(scene_graph.GetMyContextFromRoot(context))
        ends = link_positions(limb, angles)[1:]
        pieces = ("root_2", "link_2", "link_3", "link_4")
        for body, start, end in zip(pieces, ends[:-1], ends[1:], strict=True):
            frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName(body).index())
            geometries = shown.inspector().GetGeometries(frame, Role.kIllustration)
            found = {shown.inspector().GetName(one).split("::")[-1]: one for one in geometries}
            along = (end - start) / np.linalg.norm(end - start)
            for wire in limb.segments[1].wires:
                pose = shown.GetPoseInWorld(found[f"wire_{wire.name}"])
                beside = pose.translation() - (start + end) / 2
                assert np.linalg.norm(beside) == pytest.approx(np.hypot(wire.e2, wire.e3))
                assert beside @ along == pytest.approx(0.0, abs=1e-12)
                np.testing.assert_allclose(pose.rotation().col(2), along, atol=1e-12)
                if not angles.any():
                    np.testing.assert_allclose(beside, [0.0, wire.e2, wire.e3], atol=1e-12)
    (ball,) = shown.inspector().GetGeometries(
        plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("payload").index()), Role.kIllustration
    )
    np.testing.assert_allclose(shown.GetPoseInWorld(ball).translation(), ends[-1], atol=1e-12)
    radius = shown.inspector().GetShape(ball).radius()
    assert 7850 * 4 / 3 * np.pi * radius**3 == pytest.approx(0.02, rel=0.01)  # of steel


def test_generator_needs_only_the_named_fields_of_a_segment():
    """urdf does not depend on limb_systems: any object with these fields will do."""
    names = ["links", "length", "mass", "width", "thickness", "damping", "wires"]
    names += ["joints", "joint_ratios", "centred_joints"]
    segment = SegmentParameters(links=2)
    plain = dataclasses.make_dataclass("Plain", names)(*[getattr(segment, name) for name in names])
    assert limb_urdf([plain]) == limb_urdf([segment])
