"""Limbs beside one another and the body: planner and checker against coal, and no false pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio
import pytest
from urdf_walkers import QUADRUPED

from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import build_capsules
from climbplan.climb.check.anew.kinematics import build_limbs, compute_body_axes
from climbplan.climb.check.convex import build_hull
from climbplan.climb.check.self_collision import measure_part_clearances, measure_segment_distances
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.clearance.limb_pairs import compute_self_shortfall
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_text
from climbplan.robots.any_robot import build_robot
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.self_clearance import compute_segment_distances, list_clearance_pairs
from climbplan.robots.urdf.canonical_urdf import write_canonical_urdf
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.schema.examples import read_example
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.verification.check import LIMITS

POSTURES = 1000
SECTION = """kind: robot
urdf: walker.urdf
legs:
  L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
  R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
  L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
  R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
"""


def drawn(robot: Robot, count: int = POSTURES) -> Array:
    """Random angles (P, N, J), a little beyond the joint bounds, where limbs meet more often."""
    share = np.random.default_rng(5).uniform(-0.2, 1.2, (count, robot.limb_count, 1))
    each = np.random.default_rng(6).random((count, robot.limb_count, robot.joint_count))
    share = np.clip(0.5 * share + each - 0.25, -0.2, 1.2)
    return np.asarray(robot.joint_lower + share * (robot.joint_upper - robot.joint_lower))


def residuals(robot: Robot, angles: Array) -> Array:
    """(P,) residual of the check in every posture."""
    count = len(angles)
    com = np.random.default_rng(1).random((count, 3))
    axes = compute_body_axes(np.random.default_rng(2).uniform(-1, 1, (count, 3)))
    parts = [build_hull("body", part) for part in robot.body_parts or (robot.body_hull,)]
    worst = []
    for k in range(count):  # one at a time: of several poses the nearest alone is exact
        pose = com[k : k + 1], axes[k : k + 1]
        points = build_limbs(robot, *pose, angles[k : k + 1]).points
        links = tuple(build_capsules(robot, *pose, angles[k : k + 1], points))
        worst.append(-measure_part_clearances(robot, parts, links, *pose).clearance.min())
    return np.array(worst)


def coal_room(links: Capsules, p: int, one: tuple[int, int], other: tuple[int, int]) -> float:
    """Distance of two capsules by coal, below zero where they touch."""

    def placed(limb: int, number: int) -> tuple[Any, Any]:
        start, end = links.starts[p, limb, number], links.ends[p, limb, number]
        along = end - start
        length = float(np.linalg.norm(along))
        turn = np.eye(3)
        if length > 1e-12:
            turn = pinocchio.Quaternion.FromTwoVectors(np.array([0, 0, 1.0]), along).matrix()
        shape = coal.Capsule(float(links.radius[limb, number]), length)
        return shape, coal.Transform3s(turn, (start + end) / 2)

    result = coal.DistanceResult()
    return float(coal.distance(*placed(*one), *placed(*other), coal.DistanceRequest(), result))


def test_segments_are_as_far_apart_as_coal_says() -> None:
    rng = np.random.default_rng(0)
    one, other = rng.uniform(-1, 1, (2, 400, 2, 3))
    other[:50] = one[:50] + rng.uniform(-1, 1, (50, 1, 3))  # parallel
    other[50:80, 1] = other[50:80, 0]  # points
    links = Capsules(
        np.stack([one[:, 0], other[:, 0]], axis=1)[:, None],
        np.stack([one[:, 1], other[:, 1]], axis=1)[:, None],
        np.full((1, 2), 1e-3),
        np.zeros((1, 2), np.int64),
        np.full((1, 2), np.inf),
    )
    truth = np.array([coal_room(links, p, (0, 0), (0, 1)) + 2e-3 for p in range(400)])
    planner = compute_segment_distances(one[:, 0], one[:, 1], other[:, 0], other[:, 1])
    checker = measure_segment_distances(one, other, np.inf)
    np.testing.assert_allclose(planner, truth, atol=1e-6)
    np.testing.assert_allclose(checker, truth, atol=1e-6)
    assert (measure_segment_distances(one, other, 0.2) <= planner + 1e-12).all()  # never too large


def silvia(folder: Path) -> Robot:
    return build_robot(load_any_robot("silvia"))


def walker(folder: Path) -> Robot:
    (folder / "walker.urdf").write_text(QUADRUPED.text())
    (folder / "robot.yaml").write_text(SECTION)
    return build_robot(load_any_robot("robot.yaml", folder))


@pytest.mark.parametrize("made", [silvia, walker])
def test_no_posture_passes_that_coal_refuses(tmp_path: Path, made: Any) -> None:
    robot = made(tmp_path)
    angles = drawn(robot)
    links = limb_capsules(robot, angles)
    _, pairs = list_clearance_pairs(robot, links)
    near = residuals(robot, angles)
    refused = near > LIMITS["limbs.self_collision"].value
    met = np.zeros(POSTURES, bool)
    room = (
        compute_segment_distances(
            *(
                points[:, row[0], row[1]]
                for row in (pairs[:, :2].T, pairs[:, 2:].T)
                for points in (links.starts, links.ends)
            )
        )
        - links.radius[pairs[:, 0], pairs[:, 1]]
        - links.radius[pairs[:, 2], pairs[:, 3]]
    )
    for p, q in zip(*np.nonzero(room < 0.02), strict=True):  # coal is asked where it may matter
        truth = coal_room(links, p, tuple(pairs[q, :2]), tuple(pairs[q, 2:]))
        if truth > 0:
            assert room[p, q] == pytest.approx(truth, abs=1e-6)
        met[p] |= truth < -1e-6
    assert 10 < met.sum() < POSTURES
    assert refused[met].all()
    # Planner and checker agree on every posture, the body among what is looked at
    single = [
        compute_self_shortfall(robot, limb_capsules(robot, angles[p : p + 1])).missing
        for p in range(200)
    ]
    single, near = np.array(single), near[:200]
    measured = np.abs(near) < 2e-3
    assert measured.any()
    np.testing.assert_allclose(single[measured], near[measured], atol=1e-6)
    np.testing.assert_array_equal(single > 1e-6, near > 1e-6)


def test_geometry_of_a_urdf_never_touches_where_the_check_passes(tmp_path: Path) -> None:
    robot = walker(tmp_path)
    source = load_any_robot("robot.yaml", tmp_path)
    assert isinstance(source, UrdfRobot)
    found = build_urdf_model(source)
    geometry = pinocchio.buildGeomFromUrdfString(
        found.model, write_canonical_urdf(source), pinocchio.GeometryType.COLLISION
    )
    items = geometry.geometryObjects
    owner = [
        next((n for n in robot.limb_names if found.model.names[i.parentJoint].startswith(n)), "")
        for i in items
    ]
    first = {found.model.getJointId(f"{name}_yaw") for name in robot.limb_names}
    for a in range(len(items)):
        for b in range(a + 1, len(items)):
            joined = "" in (owner[a], owner[b]) and first & {
                items[a].parentJoint, items[b].parentJoint
            }  # fmt: skip
            if owner[a] != owner[b] and not joined:
                geometry.addCollisionPair(pinocchio.CollisionPair(a, b))
    assert not len(robot.touching)
    data, shapes = found.model.createData(), geometry.createData()
    names = robot.limbs.joint_names
    angles = drawn(robot)
    touched = 0
    for posture, near in zip(angles, residuals(robot, angles), strict=True):
        named = {
            name: float(angle)
            for row, values in zip(names, posture, strict=True)
            for name, angle in zip(row, values, strict=True)
            if name
        }
        pinocchio.computeCollisions(
            found.model, data, geometry, shapes, found.build_configuration(named), True
        )
        if any(result.isCollision() for result in shapes.collisionResults):
            touched += 1
            assert near > LIMITS["limbs.self_collision"].value
    assert touched > 20


def test_a_plan_whose_limbs_meet_is_refused() -> None:
    usual = ["task.rounds=6", "solver.method=micp"]
    loaded = load_text(read_example("climb_steps"), "climb_steps", usual)
    plan = plan_climb(loaded)
    names = ("limbs.self_collision", "trajectory.self_collision")
    checks = {check.name: check for check in verify_plan(plan).checks}
    assert all(checks[name].passed for name in names)
    assert "clear" in checks[names[0]].margin
    thick = replace(plan.robot, limb_radius=0.2)
    failed = {c.name: c for c in verify_plan(replace(plan, robot=thick)).failed}
    assert set(names) <= set(failed)
    assert "too close" in failed[names[0]].margin
