"""Robots with arms: where idle arms are held, and standing on hands and feet, or with walls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_humanoid import humanoid
from urdf_walkers import Walker

from climbplan.climb.proposed.proposed import ProposalTrials
from climbplan.errors import UsageError
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.self_clearance import list_clearance_pairs
from climbplan.robots.urdf.proposal.candidate_stances import find_candidate_stances
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal, prepare_robot
from climbplan.robots.urdf.proposal.propose_robot import detect_legs, propose_robot
from climbplan.robots.urdf.robot_builder import build_robot_from_urdf
from climbplan.robots.urdf.workspace import select_common_reach

# A bar across the front legs at zero, which half a turn takes up over them
BAR = """<joint name="bar" type="revolute"><parent link="base_link"/><child link="bar"/>
<origin xyz="0.26 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-3.1" upper="3.1" effort="9" velocity="5"/></joint>
<link name="bar"><inertial><origin xyz="0 0 -0.1"/><mass value="0.3"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.01"/></inertial>
<collision><origin xyz="0 0 -0.1"/><geometry><box size="0.04 0.9 0.04"/></geometry></collision>
</link>
"""


@pytest.mark.slow
def test_an_arm_in_the_way_is_held_elsewhere(tmp_path: Path) -> None:
    text = Walker(joints=3).text()
    (tmp_path / "plain.urdf").write_text(text)
    (tmp_path / "bar.urdf").write_text(text.replace("</robot>", f"{BAR}</robot>"))
    assert propose_robot(tmp_path / "plain.urdf").draft.locked == {}
    found = propose_robot(tmp_path / "bar.urdf")
    angle = np.deg2rad(found.draft.locked["bar"])
    height = 0.1 - 0.1 * np.cos(angle)  # of the bar above the first joints
    assert height > 0.04, "the bar is held off the legs' level"
    parts = found.prepared.collision_model
    assert parts is not None
    by_joint = {joint: float(np.deg2rad(value)) for joint, value in found.standing.items()}
    assert not parts.find_collisions(by_joint)


def test_limbs_end_before_motors_too_weak_for_their_toes(tmp_path: Path) -> None:
    urdf = humanoid(tmp_path / "humanoid.urdf")
    assert detect_legs(urdf).draft.locked == {}
    text = urdf.read_text()
    for side in ("left", "right"):  # a fair share of 20 kg at 0.25 m asks for 15 N m
        at = text.index(f'<joint name="{side}_arm_bend"')
        text = text[:at] + text[at:].replace('effort="150.0"', 'effort="2"', 1)
    urdf.write_text(text)
    found = detect_legs(urdf)
    toes = dict(zip(found.naming.names, found.toes, strict=True))
    for side in ("left", "right"):
        toe = toes[f"{side[0].upper()}_arm"]
        assert (toe.link, toe.offset) == (f"{side}_arm_pitch", (0.0, 0.0, -0.25))
        assert "has 2 N m" in toe.reason
        # The forearm is turned back, and so ahead of the elbow by no more than its thickness
        assert abs(found.draft.locked[f"{side}_arm_bend"]) > 90
    assert toes["L_leg"].link == "left_leg_tip"


def test_forward_is_where_left_is_left(tmp_path: Path) -> None:
    urdf = humanoid(tmp_path / "humanoid.urdf")
    assert detect_legs(urdf).draft.forward == "x"
    text = urdf.read_text()
    urdf.write_text(text.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right"))
    found = detect_legs(urdf)
    assert found.draft.forward == "-x"
    for name, toe in zip(found.naming.names, found.toes, strict=True):
        assert toe.link[0] == name[0].lower()


def test_hips_of_several_joints_in_one_place(tmp_path: Path) -> None:
    found = detect_legs(humanoid(tmp_path / "humanoid.urdf"))
    drawn = found.draft.load_robot(meshes=True)
    size = drawn.spec.workspace.model_copy(update={"reach": 1.0, "stance_radius": 0.1})
    spec = drawn.spec.model_copy(update={"workspace": size})
    robot = build_robot_from_urdf(replace(drawn, spec=spec))
    links = limb_capsules(robot, np.zeros((1, 4, 4)))
    for pairs in list_clearance_pairs(robot, links):
        for limb, capsule, other, beside in pairs:
            if other < 0:
                assert links.link[limb, capsule] >= 2
            else:
                assert max(links.link[limb, capsule], links.link[other, beside]) >= 2


def test_one_reach_is_a_necessary_one_for_all() -> None:
    assert select_common_reach(np.array([0.5, 0.55])) == 0.5
    assert select_common_reach(np.array([0.5, 0.8])) == 0.8


@pytest.fixture(scope="module", name="upright")
def _upright(tmp_path_factory: pytest.TempPathFactory) -> RobotProposal:
    found = detect_legs(humanoid(tmp_path_factory.mktemp("upright") / "humanoid.urdf"))
    own = found.draft, found.tree, found.toes, found.naming, found.shapes, found.geometry_error
    return find_candidate_stances(prepare_robot(*own)).build_proposal()


@pytest.mark.slow
def test_a_humanoid_goes_on_hands_and_feet(tmp_path: Path) -> None:
    found = propose_robot(humanoid(tmp_path / "humanoid.urdf"))
    assert (found.draft.forward, found.draft.up) == ("z", "-x")
    assert found.naming.names == ("RF", "RR", "LR", "LF")
    assert not found.posture.gap
    np.testing.assert_allclose(found.posture.toes[:, 2], found.posture.toes[0, 2])
    trials = ProposalTrials(found, tmp_path)
    assert trials.ground.plan is not None, trials.ground.why
    assert "walls:" not in trials.ground.text


@pytest.mark.slow
def test_a_humanoid_stands_with_its_hands_on_walls(upright: RobotProposal) -> None:
    arms = np.array(upright.naming.is_arm)
    assert sorted(upright.naming.names) == ["L_arm", "L_leg", "R_arm", "R_leg"]
    assert [name.endswith("arm") for name in upright.naming.names] == arms.tolist()
    toes = upright.posture.toes
    assert upright.posture.gap > 0
    np.testing.assert_allclose(np.abs(toes[arms, 0]), upright.posture.gap / 2)
    np.testing.assert_allclose(toes[~arms, 2], toes[~arms, 2][0])
    assert toes[arms, 2].min() > toes[~arms, 2].max()
    # Stiffness of arms is that of the legs, so that the body does not buckle over them
    stiffness = {name: motor.stiffness for name, motor in upright.motors.joints.items()}
    assert stiffness["left_arm_bend"] == pytest.approx(stiffness["left_leg_bend"], rel=0.02)


@pytest.mark.slow
def test_motors_that_cannot_hold_it_are_told_by_how_much(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"hands on walls the motors need [0-9.]+ times") as told:
        propose_robot(humanoid(tmp_path / "weak.urdf", effort=4.0))
    times = float(str(told.value).partition("walls the motors need ")[2].split()[0])
    assert times > 1
    strong = propose_robot(humanoid(tmp_path / "strong.urdf", effort=4.0 * 1.3 * times))
    assert strong.posture.utilisation < 1


@pytest.mark.slow
def test_it_walks_between_the_walls(upright: RobotProposal, tmp_path: Path) -> None:
    trials = ProposalTrials(upright, tmp_path)
    assert trials.ground.plan is not None, trials.ground.why
    assert "walls:" in trials.ground.text
