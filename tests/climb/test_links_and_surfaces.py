"""Links keep off every surface, by their own collision geometry as coal measures it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from a1_specs import CHIMNEY, a1_urdf, written
from coal_oracle import UrdfGeometry

from climbplan.climb.check.clearance import check_clearance
from climbplan.climb.check.motion_state import reconstruct_motion
from climbplan.climb.check.subject import build_subject
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.robots.any_robot import build_robot
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf
from climbplan.schema.robots.source import load_any_robot

SPECS = Path(__file__).parents[2] / "specs"
SHIPPED = ("hexapod", "walker", "telescope")  # soles are looked at corner by corner
TOLERATED = 5e-4  # [m]
OF_FOOT = 1.5e-3  # [m] by which feet leave the spheres that stand for them


def geometry_of(name: str, folder: Path) -> UrdfGeometry:
    if name == "a1":
        written(folder, CHIMNEY)
        return UrdfGeometry.of(build_robot(load_any_robot("a1.yaml", folder)), a1_urdf())
    robot = build_robot(load_any_robot(f"robot_{name}.yaml", SPECS))
    return UrdfGeometry.of(robot, SPECS / f"{name}.urdf")


@pytest.mark.parametrize("name", ["a1", *SHIPPED])
def test_links_hold_their_geometry_in_random_postures(name: str, tmp_path: Path) -> None:
    geometry = geometry_of(name, tmp_path)
    robot, rng = geometry.robot, np.random.default_rng(0)
    lower, upper = np.maximum(robot.joint_lower, -np.pi), np.minimum(robot.joint_upper, np.pi)
    for _ in range(100):
        angles = rng.uniform(lower, upper)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        links = limb_capsules(robot, angles)
        ours = np.minimum(links.starts @ normal, links.ends @ normal) - links.radius
        # What links keep from a plane is never more than what their geometry keeps from it
        assert (ours.min(axis=-1) <= geometry.heights(angles, normal) + 1e-6).all()


FEET = {  # package part, radius [m], toe offset [m], leg with its joints and angles [deg]
    "solo12": ("solo12", 0.0128, (0.0, 0.0001, -0.0033), ("FR_FOOT", "FR_HAA FR_HFE FR_KFE")),
    "go2": (
        "go2_description/urdf/go2",
        0.025,
        (-0.0005, 0.0, 0.0021),
        ("FR_foot", "FR_hip_joint FR_thigh_joint FR_calf_joint"),
    ),
}


def four_legs(name: str, folder: Path) -> tuple[Robot, Path]:
    """A quadruped with spherical feet, its legs as they are in its URDF."""
    part, radius, offset, (toe, joints) = FEET[name]
    urdf = find_package_urdf(f"example-robot-data:{part}")
    text = f"kind: robot\nurdf: {urdf}\nforward: x\nup: z\nfoot: {{radius: {radius}}}\n"
    text += "joint_stiffness: 100\nstructural_compliance_share: 0.1\nlegs:\n"
    rear = {"solo12": "H", "go2": "R"}[name]
    for limb in ("RF", "RR", "LR", "LF"):
        side, end = limb
        prefix = (rear if end == "R" else "F") + side
        own = [joint.replace("FR_", f"{prefix}_", 1) for joint in joints.split()]
        knee = -1 if name == "go2" or end == "F" else 1
        posture = dict(zip(own, (0, -50 * knee, 90 * knee), strict=True))
        mirrored = (offset[0], offset[1] if side == "R" else -offset[1], offset[2])
        text += f"  {limb}: {{toe: {toe.replace('FR', prefix)}, toe_offset: {list(mirrored)}, "
        text += f"posture_deg: {posture}}}\n".replace("'", "")
    (folder / "robot.yaml").write_text(text)
    return build_robot(load_any_robot("robot.yaml", folder)), urdf


@pytest.mark.parametrize("name", FEET)
def test_last_links_reach_beyond_feet_no_more_than_their_geometry(
    name: str, tmp_path: Path
) -> None:
    robot, urdf = four_legs(name, tmp_path)
    geometry = UrdfGeometry.of(robot, urdf)
    angles = robot.mechanism.posture
    toes = robot.mechanism.joint_points(angles)[:, -2:]  # knee, toe
    links = limb_capsules(robot, angles)
    rng = np.random.default_rng(1)
    last, tried = np.isfinite(links.to_toe), 0
    for _ in range(60):
        for limb, (knee, toe) in enumerate(toes):
            up = (knee - toe) / np.linalg.norm(knee - toe)
            normal = up + rng.normal(size=3) * 0.5
            normal /= np.linalg.norm(normal)
            if normal @ up < np.cos(np.deg2rad(45)):
                continue
            ends = np.stack([links.starts, links.ends])[:, limb] @ normal
            height = ends.min(axis=0) - links.radius[limb]
            ours = height[last[limb]].min()
            if ours > height.min():
                continue  # another link is lower
            tried += 1
            theirs = geometry.heights(angles, normal)[limb]
            foot = toe @ normal - robot.foot.radius
            assert ours <= theirs + OF_FOOT
            assert ours >= min(theirs, foot) - 1.5e-3
    assert tried > 60


@pytest.fixture(scope="module", name="climb")
def _climb(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    return plan_climb(load_climb(written(tmp_path_factory.mktemp("a1"), CHIMNEY)))


def test_no_part_of_a_urdf_is_inside_a_wall(climb: ClimbPlan) -> None:
    assert verify_plan(climb).passed
    subject, moving = build_subject(climb), climb.trajectory
    motion = reconstruct_motion(subject)
    angles = np.where(motion.lifted[..., None], moving.joint_command, motion.standing.angles)
    geometry = UrdfGeometry.of(climb.robot, a1_urdf())
    deepest = max(
        depth
        for k in range(0, len(angles), 5)
        for solid in subject.solids
        for depth, _, _ in geometry.depths(
            pin.SE3(rotation_world_body(moving.rpy[k]), moving.com[k]), angles[k], solid.corners
        )
    )
    assert -TOLERATED < deepest < TOLERATED  # feet touch


def test_a_link_in_the_wall_that_its_toe_stands_on_fails(climb: ClimbPlan) -> None:
    capsules = climb.robot.capsules
    assert capsules is not None
    hips = capsules.joint == 0
    thick = replace(capsules, radius=np.where(hips, 0.12, capsules.radius))
    plan = replace(climb, robot=replace(climb.robot, capsules=thick))
    check = next(c for c in check_clearance(build_subject(plan)) if c.name == "limbs.collision")
    assert not check.passed
    assert "hip_joint and " in check.worst_at
    assert check.worst_at.endswith(("left", "right"))
