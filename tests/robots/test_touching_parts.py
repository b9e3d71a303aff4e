"""Parts of a robot that touch, by coal on the URDF's own shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker

from climbplan.robots.capsules import straight_capsules
from climbplan.robots.self_clearance import compute_body_clearance
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.draft import Draft
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.robots.urdf.proposal.self_collision import (
    SelfCollisionModel,
    build_self_collision_model,
)

JOINTS = ("yaw", "lift", "knee")


def parts_in(folder: Path) -> SelfCollisionModel:
    """Of a quadruped with legs of three joints."""
    path = Walker(joints=3, sprawl_deg=(0.0, 0.0)).write(folder / "walker.urdf")
    legs = {name: {"toe": f"{name}_toe"} for name in ("L1", "R1", "L2", "R2")}
    model = build_urdf_model(Draft(path, "base_link", legs, {}, {}).load_robot(meshes=True))
    bounds = {f"{leg}_{joint}": (-1.0, 1.0) for leg in legs for joint in JOINTS}
    return build_self_collision_model(model, bounds)


def test_legs_that_cross_touch(tmp_path: Path) -> None:
    parts = parts_in(tmp_path)
    assert parts.find_collisions({}) == []
    # Front and rear leg of the left side turned towards each other until their shanks meet
    turned = {"L1_yaw": 1.0, "L2_yaw": -1.0}
    pairs = parts.find_collisions(turned) + parts.find_collisions(
        {k: -v for k, v in turned.items()}
    )
    assert pairs
    assert all({one[:2], other[:2]} == {"L1", "L2"} for one, other in pairs)


def test_neighbours_are_left_out(tmp_path: Path) -> None:
    parts = parts_in(tmp_path)
    model = parts.urdf_model.model
    items = parts.geometry.geometryObjects
    for pair in parts.geometry.collisionPairs:
        a, b = items[pair.first].parentJoint, items[pair.second].parentJoint
        assert a != b
        assert model.parents[a] != b
        assert model.parents[b] != a


def test_clearance_of_links_and_body_is_that_of_the_nearest_face() -> None:
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])
    # One limb of two links: along the side of the box, and away from it
    points = np.array([[[[0.15, 0.0, 0.0], [0.15, 0.1, 0.0], [0.35, 0.1, 0.0]]]])
    links = straight_capsules(points, 0.02)
    pairs = np.array([[0, 0, -1, 0], [0, 1, -1, 0]])
    np.testing.assert_allclose(compute_body_clearance(links, pairs, [corners]), [[0.03, 0.03]])
    inside = straight_capsules(points - np.array([0.1, 0.0, 0.0]), 0.02)
    assert compute_body_clearance(inside, pairs, [corners])[0, 0] == pytest.approx(-0.07)
    # The nearest of two parts counts
    ahead = corners + np.array([0.3, 0.0, 0.0])
    nearer = compute_body_clearance(links, pairs, [corners, ahead])
    np.testing.assert_allclose(nearer, [[0.03, -0.07]])


@pytest.mark.slow
def test_proposed_postures_touch_nothing(tmp_path: Path) -> None:
    path = Walker(joints=3).write(tmp_path / "walker.urdf")
    found = propose_robot(path)
    parts = build_self_collision_model(
        build_urdf_model(found.draft.load_robot(meshes=True)),
        dict.fromkeys(found.standing, (-1.0, 1.0)),
    )
    assert parts.find_collisions({j: float(np.deg2rad(a)) for j, a in found.standing.items()}) == []
    names = [joint for own in found.robot.limbs.joint_names for joint in own]
    for brace in found.braces:
        assert (
            parts.find_collisions(dict(zip(names, brace.angles.ravel().tolist(), strict=True)))
            == []
        )
