"""Robots that no grid of bracing postures is made for: drawn toes, arms held out of the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_humanoid import humanoid
from urdf_walkers import Walker

from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.building import robot_of_urdf
from climbplan.robots.urdf.pinocchio_model import urdf_model
from climbplan.robots.urdf.proposal.braces import farthest
from climbplan.robots.urdf.proposal.drawn_braces import drawn_braces
from climbplan.robots.urdf.proposal.idle import idle_joints, rest_of
from climbplan.robots.urdf.proposal.naming import mirrored
from climbplan.robots.urdf.proposal.postures import Legs
from climbplan.robots.urdf.proposal.proposing import legs_of

# An arm over the back that lies across both sides at zero, through the front legs
BOOM = """<joint name="swing" type="revolute"><parent link="base_link"/><child link="swing"/>
<origin xyz="0.26 0 0.0"/><axis xyz="0 0 1"/>
<limit lower="-1.6" upper="1.6" effort="9" velocity="5"/></joint>
<link name="swing"><inertial><mass value="0.1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.01"/></inertial></link>
<joint name="lift" type="revolute"><parent link="swing"/><child link="boom"/>
<origin xyz="0 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1.5" effort="9" velocity="5"/></joint>
<link name="boom"><inertial><origin xyz="0 0.25 0"/><mass value="0.3"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.01"/></inertial>
<collision><origin xyz="0 0.35 0"/><geometry><box size="0.04 0.7 0.04"/></geometry></collision>
</link>
"""


def test_an_idle_arm_is_held_where_it_does_not_stand_out(tmp_path: Path) -> None:
    text = Walker(joints=3).text().replace("</robot>", f"{BOOM}</robot>")
    (tmp_path / "boom.urdf").write_text(text)
    found = legs_of(tmp_path / "boom.urdf")
    model = urdf_model(found.draft.robot(meshes=True))
    legs = {
        joint.name: (joint.lower, joint.upper)
        for own in model.robot.joints.values()
        for joint in own
    }
    idle = idle_joints(found.tree, set(legs), set())
    assert set(idle) == {"swing", "lift"}
    hips = np.array([model.leg(name).joints[0] for name in model.robot.limb_names])
    held = rest_of(model, idle, legs, hips)
    swing, lift = np.deg2rad(held["swing"]), np.deg2rad(held["lift"])
    aside = 0.7 * np.cos(lift) * np.cos(swing)  # where the end of the boom is beside the body
    assert aside < 0.25
    assert held == rest_of(model, idle, legs, hips)


@pytest.mark.slow
def test_drawn_toes_brace_a_humanoid(tmp_path: Path) -> None:
    drawn = legs_of(humanoid(tmp_path / "humanoid.urdf")).draft.robot(meshes=True)
    size = drawn.spec.workspace.model_copy(update={"reach": 1.0, "stance_radius": 0.1})
    spec = drawn.spec.model_copy(update={"workspace": size})
    robot = robot_of_urdf(replace(drawn, spec=spec))
    chain, low, high = robot.mechanism, robot.joint_lower, robot.joint_upper
    assert isinstance(chain, SerialChain)
    box = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    mirror = mirrored(chain.joint_zero[:, 0])
    torque = np.full(low.shape, 150.0)  # of the file; a draft has none yet
    legs = Legs(chain, low, high, torque, farthest(chain, low, high), robot.weight, mirror, box)
    braced = drawn_braces(legs, 0.02)
    assert braced.tried
    held, lack = braced.holding(legs, 1.2)
    assert held, lack
    for one in held[:20]:
        np.testing.assert_allclose(np.abs(one.toes[:, 0]), one.gap / 2)
        reached = chain.joint_points(one.angles[None])[0, :, -1]
        np.testing.assert_allclose(reached, one.toes, atol=1e-5)
        assert (one.angles >= low - 1e-9).all()
        assert (one.angles <= high + 1e-9).all()
        assert one.use < 1
