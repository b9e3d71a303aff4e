"""Robots with arms: where idle arms are held, and standing on hands and feet, or with walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_humanoid import humanoid
from urdf_walkers import Walker

from climbplan.climb.proposed import Trials
from climbplan.errors import UsageError
from climbplan.robots.urdf.proposal.proposing import legs_of, propose
from climbplan.robots.urdf.proposal.settled import Proposal, settled
from climbplan.robots.urdf.workspace import common_reach

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
    assert propose(tmp_path / "plain.urdf").draft.locked == {}
    found = propose(tmp_path / "bar.urdf")
    angle = np.deg2rad(found.draft.locked["bar"])
    height = 0.1 - 0.1 * np.cos(angle)  # of the bar above the first joints
    assert height > 0.04, "the bar is held off the legs' level"
    parts = found.settled.parts
    assert parts is not None
    standing = {joint: float(np.deg2rad(value)) for joint, value in found.standing.items()}
    assert not parts.touching(standing)


def test_one_reach_is_a_necessary_one_for_all() -> None:
    assert common_reach(np.array([0.5, 0.55])) == 0.5
    assert common_reach(np.array([0.5, 0.8])) == 0.8


@pytest.fixture(scope="module", name="upright")
def _upright(tmp_path_factory: pytest.TempPathFactory) -> Proposal:
    found = legs_of(humanoid(tmp_path_factory.mktemp("upright") / "humanoid.urdf"))
    own = found.draft, found.tree, list(found.toes), found.named, found.shapes, found.unread
    return settled(*own).proposal()


@pytest.mark.slow
def test_a_humanoid_goes_on_hands_and_feet(tmp_path: Path) -> None:
    found = propose(humanoid(tmp_path / "humanoid.urdf"))
    assert (found.draft.forward, found.draft.up) == ("z", "-x")
    assert found.named.names == ("RF", "RR", "LR", "LF")
    assert not found.posture.gap
    np.testing.assert_allclose(found.posture.toes[:, 2], found.posture.toes[0, 2])
    trials = Trials(found, tmp_path)
    assert trials.ground.plan is not None, trials.ground.why
    assert "walls:" not in trials.ground.text


@pytest.mark.slow
def test_a_humanoid_stands_with_its_hands_on_walls(upright: Proposal) -> None:
    arms = np.array(upright.named.arms)
    assert sorted(upright.named.names) == ["L_arm", "L_leg", "R_arm", "R_leg"]
    assert [name.endswith("arm") for name in upright.named.names] == arms.tolist()
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
        propose(humanoid(tmp_path / "weak.urdf", effort=4.0))
    times = float(str(told.value).partition("walls the motors need ")[2].split()[0])
    assert times > 1
    strong = propose(humanoid(tmp_path / "strong.urdf", effort=4.0 * 1.3 * times))
    assert strong.posture.use < 1


@pytest.mark.slow
def test_it_walks_between_the_walls(upright: Proposal, tmp_path: Path) -> None:
    trials = Trials(upright, tmp_path)
    assert trials.ground.plan is not None, trials.ground.why
    assert "walls:" in trials.ground.text
