"""Relatching and arms on arms: found without hints, verified, and lies about them found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from limms_scenes import loaded, scene

from climbplan.limms.check.logic import find_rule_violations
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.modules.loads import compute_loads
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.bounds import anchor_wrist, joint_distance, max_chain_span, side_wrist


@pytest.fixture(scope="module")
def relatched() -> LimmsPlan:
    return plan_limms(loaded("limms_relatch"))


@pytest.fixture(scope="module")
def doubled() -> LimmsPlan:
    return plan_limms(loaded("limms_double_arm"))


def story(plan: LimmsPlan, module: int) -> list[tuple[int, int]]:
    """Anchors of both ends of a module, in order."""
    pairs = zip(plan.motion.base_anchor[:, module], plan.motion.tip_anchor[:, module], strict=True)
    return list(dict.fromkeys((int(base), int(tip)) for base, tip in pairs))


def broken_rules(plan: LimmsPlan) -> set[int]:
    return {rule for rule, samples in find_rule_violations(plan).items() if samples.any()}


def test_one_module_latches_box_then_wall_then_lifts(relatched: LimmsPlan) -> None:
    assert verify_plan(relatched).passed
    ground, wall = (relatched.anchor_names.index(name) for name in ("ground", "wall"))
    side = story(relatched, 0)[1][1]
    assert 0 <= side < 4
    assert story(relatched, 0) == [(ground, -1), (ground, side), (-1, side), (wall, side)]
    # It lifts only once it is on the wall
    motion = relatched.motion
    assert any("nothing but the standing box holds module A" in w for w in relatched.warnings)
    moves = np.abs(motion.box_position[:, 0] - motion.box_position[0, 0]).max(axis=1) > 1e-9
    assert (motion.base_anchor[moves, 0] == wall).all()


def test_a_module_on_a_standing_box_alone_is_free_and_nothing_else(relatched: LimmsPlan) -> None:
    motion = relatched.motion
    alone = (motion.base_anchor[:, 0] < 0) & (motion.tip_anchor[:, 0] >= 0)
    assert alone.any()
    assert set(motion.mode[alone, 0]) == {1}
    assert set(motion.box_mode[alone, 0]) == {1}
    for mode, box_mode, rules in ((2, 1, {7, 12}), (1, 2, {12}), (1, 3, {5, 6})):
        modes, boxes = motion.mode.copy(), motion.box_mode.copy()
        modes[alone], boxes[alone] = mode, box_mode
        lie = replace(relatched, motion=replace(motion, mode=modes, box_mode=boxes))
        assert broken_rules(lie) == rules


def test_arms_on_arms_lift_where_one_arm_does_not_reach(doubled: LimmsPlan) -> None:
    wide = scene("limms_double_arm")
    nearest = min(
        joint_distance(anchor_wrist(wide, root), side_wrist(wide, side, wide.box_start[0]))
        for root in range(2)
        for side in range(4)
    )
    assert nearest > max_chain_span(wide, 1)
    assert verify_plan(doubled).passed
    last = doubled.motion.mode[-1]
    assert sorted(last) == [2, 2, 3, 3]
    # Who carries bears what the added arm holds
    loads = compute_loads(doubled)
    assert loads.force.max(axis=0)[last == 2] == pytest.approx(loads.force.max(axis=0)[last == 3])
    assert (loads.torque.max(axis=0) > 0).all()


def test_lies_about_chains_are_found(doubled: LimmsPlan) -> None:
    motion, count = doubled.motion, len(doubled.anchor_names)
    added = int(np.flatnonzero(motion.mode[-1] == 3)[0])
    joined = motion.tip_anchor[:, added] >= count
    carrier = int(motion.tip_anchor[-1, added] - count) // 2

    def with_tip(anchor: int) -> LimmsPlan:
        tip = motion.tip_anchor.copy()
        tip[joined, added] = anchor
        return replace(doubled, motion=replace(motion, tip_anchor=tip))

    assert broken_rules(with_tip(-1)) == {9}
    # On the carrier's latched end, on itself, on a module that holds the box
    assert broken_rules(with_tip(count + 2 * carrier + 1)) == {10}
    assert 10 in broken_rules(with_tip(count + 2 * added))
    other = int(np.flatnonzero(motion.mode[-1] == 3)[1])
    assert 11 in broken_rules(with_tip(count + 2 * other))
    # A carrier that moves takes the added arm with it
    angles = motion.joint_angles.copy()
    angles[-50:, carrier, 2] += 1e-3
    off = replace(doubled, motion=replace(motion, joint_angles=angles))
    assert "latch.position" in {check.name for check in verify_plan(off).failed}


def test_a_module_on_the_ground_lets_go_where_that_helps() -> None:
    # From its anchor the side is out of reach: it lets go and drives there
    plan = plan_limms(loaded("limms_relatch", "box.goal=[0.2, -0.1, 1.3]"))
    assert verify_plan(plan).passed
    assert 1 in plan.motion.mode[:10, 0]
    # And what starts elsewhere than the spec says is found
    points = plan.motion.joint_position.copy()
    points[0, 0, 0] += 0.01
    moved = replace(plan, motion=replace(plan.motion, joint_position=points))
    assert "file.spec_values" in {check.name for check in verify_plan(moved).failed}
