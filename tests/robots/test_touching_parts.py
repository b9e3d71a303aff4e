"""Parts of a robot that touch, by coal on the URDF's own shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker

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
