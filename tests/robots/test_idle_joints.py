"""Joints that move no leg: where an arm is held that would be in the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from urdf_walkers import Walker

from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.propose_robot import detect_legs
from climbplan.robots.urdf.proposal.unused_joints import choose_locked_angles, find_unused_joints

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
    found = detect_legs(tmp_path / "boom.urdf")
    model = build_urdf_model(found.draft.load_robot(meshes=True))
    legs = {
        joint.name: (joint.lower, joint.upper)
        for own in model.robot.joints.values()
        for joint in own
    }
    idle = find_unused_joints(found.tree, set(legs), set())
    assert set(idle) == {"swing", "lift"}
    hips = np.array([model.read_leg(name).joints[0] for name in model.robot.limb_names])
    held = choose_locked_angles(model, idle, legs, hips)
    swing, lift = np.deg2rad(held["swing"]), np.deg2rad(held["lift"])
    aside = 0.7 * np.cos(lift) * np.cos(swing)  # where the end of the boom is beside the body
    assert aside < 0.25
    assert held == choose_locked_angles(model, idle, legs, hips)
