"""Toes lie on the surface of the collision geometry that their legs end in, as coal has it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from urdf_walkers import QUADRUPED

from benchmarks.zoo.robots import ROBOTS, Zoo
from climbplan.errors import SpecError, UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.urdf.capsule_fit import fit_capsule
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.proposal.propose_robot import detect_legs
from climbplan.robots.urdf.proposal.toe_placement import place_toes_on_surface
from climbplan.robots.urdf.proposal.toes import Toe
from climbplan.robots.urdf.shapes import read_collision_shapes
from climbplan.robots.urdf.toe_surface import compute_depth, compute_exit_distance, evaluate_support
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

pytest.importorskip("pinocchio")
coal = pytest.importorskip("coal")

SPECS = Path(__file__).parents[2] / "specs"
CLOSE = 1e-3  # [m]
FEW = ("Solo12", "Go2", "A1", "hexapod")  # the others take up to six seconds each
SHIPPED = ("robot_walker", "robot_telescope", "robot_hexapod", "robot_biped")


def off_surface(model: UrdfModel, leg_name: str, radius: float) -> tuple[float, float]:
    """Distance from the surface, and depth [m], of a leg's outermost point, by coal.

    The distance is to the nearest piece of the last body, or to its hull; the depth is in the link
    of the toe and what is fixed to it, meshes as their convex hulls.
    """
    pin, robot = model.library, model.robot
    leg = model.read_leg(leg_name)
    geometry = pin.buildGeomFromUrdf(
        model.model,
        str(robot.tree.path),
        pin.GeometryType.COLLISION,
        package_dirs=[str(p) for p in Path(robot.tree.path).parents][:6],
    )
    data = model.model.createData()
    pin.forwardKinematics(model.model, data, model.build_configuration({}))
    outward = leg.toe - leg.joints[-1]
    # Feet that are points may be in the last joint itself
    point = leg.toe + radius * outward / np.linalg.norm(outward) if radius else leg.toe
    root = point @ model.root_to_base_rotation + model.base_origin
    at = coal.Transform3s(np.eye(3), root)
    frame = model.model.getFrameId(robot.spec.legs[leg_name].toe, pin.FrameType.BODY)
    toe_joint = model.model.frames[frame].parentJoint
    distances, depths = [np.inf], [0.0]
    for item in geometry.geometryObjects:
        if not follows(model, int(item.parentJoint), leg.names[-1]):
            continue
        place = data.oMi[item.parentJoint] * item.placement
        there = coal.Transform3s(place.rotation, place.translation)
        distances.append(abs(gap(item.geometry, there, at)))
        if item.parentJoint == toe_joint:
            solid = item.geometry
            if isinstance(solid, coal.BVHModelBase):
                solid.buildConvexHull(False, "Qt")
                solid = solid.convex
            inside = -gap(solid, there, at)
            depths.append(inside)
            distances.append(abs(inside))  # soles are hollow underneath: what stands is their hull
    return min(distances), max(depths)


def gap(shape: Any, there: Any, at: Any) -> float:
    """Distance between a shape and a point, negative inside of a solid [m]."""
    result = coal.DistanceResult()
    request = coal.DistanceRequest()
    return float(coal.distance(coal.Sphere(1e-6), at, shape, there, request, result))


def follows(model: UrdfModel, joint: int, last: str) -> bool:
    """Whether a joint is the last of a leg, or one beyond it that is held."""
    while joint > 1 and str(model.model.names[joint]) != last:
        joint = int(model.model.parents[joint])
    return joint > 1


@pytest.mark.parametrize(
    "zoo",
    [
        pytest.param(zoo, id=zoo.name, marks=() if zoo.name in FEW else pytest.mark.slow)
        for zoo in ROBOTS
    ],
)
def test_toes_of_new_robots_are_on_their_surfaces(zoo: Zoo) -> None:
    with ExitStack() as stack:
        try:
            found = detect_legs(zoo.urdf(stack))
        except UsageError as error:
            pytest.skip(str(error))
        if all(not shape.joint for shape in found.shapes):
            pytest.skip("its limbs are without collision geometry")
        model = found.draft.build_model()
        for name, toe in zip(found.naming.names, found.toes, strict=True):
            # A hand taken to be out of the way; a link without geometry, which the proposal tells
            if toe.is_truncated or toe.reason.startswith("ASSUMED"):
                continue
            away, depth = off_surface(model, name, found.draft.foot)
            assert away <= CLOSE, (name, toe)
            assert depth <= CLOSE, (name, toe)


def test_feet_of_meshes_are_spheres_where_their_ends_are_round() -> None:
    radii = {"Solo12": (0.012, 0.015), "Go2": (0.022, 0.026)}
    for zoo in ROBOTS:
        if zoo.name in radii:
            with ExitStack() as stack:
                low, high = radii[zoo.name]
                assert low <= detect_legs(zoo.urdf(stack)).draft.foot <= high


@pytest.mark.parametrize("name", SHIPPED)
def test_toes_of_shipped_robots_are_on_their_surfaces(name: str) -> None:
    robot = load_any_robot(str(SPECS / f"{name}.yaml"))
    assert isinstance(robot, UrdfRobot)
    model = build_urdf_model(robot)
    for leg in robot.limb_names:
        away, depth = off_surface(model, leg, robot.spec.foot_radius)
        assert max(away, depth) <= CLOSE


def robot_file(folder: Path, foot: str = "", offset: str = "", ball: float = 0.014) -> Path:
    """A walker whose legs end in balls about their toes."""
    ball_text = (
        f'<link name="{{}}_toe"><collision><geometry><sphere radius="{ball}"/></geometry>'
        "</collision></link>"
    )
    text = QUADRUPED.text()
    for name in QUADRUPED.names():
        text = text.replace(f'<link name="{name}_toe"/>', ball_text.format(name))
    (folder / "walker.urdf").write_text(text)
    legs = "\n".join(
        f"  {n}: {{toe: {n}_toe{offset}, posture_deg: {{{n}_lift: 30, {n}_knee: 20}}}}"
        for n in QUADRUPED.names()
    )
    path = folder / "robot.yaml"
    path.write_text(f"kind: robot\nurdf: walker.urdf\n{foot}legs:\n{legs}\n")
    return path


def test_a_toe_inside_its_own_shape_is_an_error_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as told:
        build_robot(load_any_robot(str(robot_file(tmp_path))))
    first = told.value.mistakes[0]
    assert len(told.value.mistakes) == 4
    assert (first.key, first.line) == ("legs.L1.toe", 4)
    assert "14.0 mm inside the collision geometry" in first.message
    assert "'L1_toe', walker.urdf line" in first.message
    assert "expected it within 1 mm of its surface" in first.message
    assert "`toe_offset: [0, 0, -0.014]`" in first.message


@pytest.mark.parametrize(
    ("foot", "offset"), [("foot: {radius: 0.0135}\n", ""), ("", ", toe_offset: [0, 0, -0.0135]")]
)
def test_a_toe_within_a_millimetre_of_its_surface_is_none(
    tmp_path: Path, foot: str, offset: str
) -> None:
    assert build_robot(load_any_robot(str(robot_file(tmp_path, foot, offset)))).limb_count == 4


def test_stored_robots_are_as_they_were(tmp_path: Path) -> None:
    """Plans of robots whose toes lie inside of their shapes are verified as they were planned."""
    robot = load_any_robot(str(robot_file(tmp_path)))
    assert isinstance(robot, UrdfRobot)
    assert build_robot(replace(robot, is_stored=True)).limb_count == 4


def test_depth_support_and_exit_of_round_shapes_are_exact(tmp_path: Path) -> None:
    robot = load_any_robot(str(robot_file(tmp_path)))
    assert isinstance(robot, UrdfRobot)
    shapes = [s for s in read_collision_shapes(build_urdf_model(robot)) if s.joint == "L1_ankle"]
    cylinder = next(s for s in shapes if s.is_cylinder)
    sphere = next(s for s in shapes if len(s.points) == 1)
    axis = cylinder.axis
    assert axis is not None
    along = axis[1] / np.linalg.norm(axis[1])
    across = np.cross(along, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(along, [1.0, 0.0, 0.0]))
    assert compute_depth([cylinder], axis[0] + 0.015 * across) == pytest.approx(0.005)
    assert compute_exit_distance([cylinder], axis[0], across) == pytest.approx(0.02)
    assert compute_exit_distance([cylinder], axis[0], along) == pytest.approx(0.05)
    leaning = (along + across) / np.sqrt(2)
    reach = evaluate_support(cylinder, leaning[None])[0] - axis[0] @ leaning
    assert reach == pytest.approx(0.07 / np.sqrt(2))
    assert compute_depth([sphere], sphere.points[0] + 0.02 * across) == pytest.approx(-0.006)
    ends, radius = fit_capsule(sphere)
    assert compute_exit_distance([sphere], ends[0], along) == pytest.approx(radius)


def test_a_toe_short_of_its_end_goes_to_the_end(tmp_path: Path) -> None:
    """A flat end is no sphere: the toe goes on along its leg to where that leaves the shape."""
    robot = load_any_robot(
        str(robot_file(tmp_path, offset=", toe_offset: [0, 0, 0.03]", ball=1e-4))
    )
    assert isinstance(robot, UrdfRobot)
    model = build_urdf_model(robot)
    names = QUADRUPED.names()
    toes = [Toe(f"{name}_toe", (0.0, 0.0, 0.03), "as given") for name in names]
    moved, radius = place_toes_on_surface(model, names, toes, read_collision_shapes(model))
    assert radius == 0.0
    assert all(np.allclose(toe.offset, [0, 0, 0], atol=2e-4) for toe in moved)
