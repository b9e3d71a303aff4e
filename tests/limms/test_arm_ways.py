"""Ways that arms can follow: poses as programs ask for them, and detours round what they cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from limms_scenes import scene as scene_of_spec

from climbplan.limms.arms.branch_choices import (
    SINGULAR_MARGINS,
    HeldTask,
    compute_clearance,
    is_off_singular,
    rank_branches,
)
from climbplan.limms.arms.grid_path import MAX_JOINT_STEP, find_grid_path
from climbplan.limms.arms.symbols import build_arm_function, compute_margin_bounds
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.modules.limbs import build_arm, compute_anchor_pose, compute_limb_angles
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.corridor import decompose_free_space, find_corridor
from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.scene.phases import SupportModule
from climbplan.limms.schema.loading import load_limms

# One arm a box: the straight ways off these shelves pass poses where branches meet
SHELVES = """\
kind: limms
terrain:
  regions:
    - {name: room, lower: [-1.4, -0.6, 0], upper: [1.4, 0.6, 2.2]}
  obstacles:
    - {name: left shelf, lower: [-0.7, -0.6, 0], upper: [-0.3, -0.15, 0.3]}
    - {name: right shelf, lower: [0.3, -0.6, 0], upper: [0.7, -0.15, 0.3]}
  anchors:
    - {name: left, position: [-0.4, 0.6, 0.7], normal: [0, -1, 0]}
    - {name: right, position: [0.4, 0.6, 0.7], normal: [0, -1, 0]}
boxes:
  - {size: [0.2, 0.2, 0.2], mass: 0.4, start: [-0.5, -0.3, 0.4], goal: [0.5, -0.3, 0.4]}
  - {size: [0.2, 0.2, 0.2], mass: 0.4, start: [0.5, -0.3, 0.4], goal: [-0.5, -0.3, 0.4]}
modules:
  - {name: A, position: [-1.1, 0.2, 0]}
  - {name: B, position: [1.1, 0.2, 0]}
"""


@pytest.fixture(scope="module")
def shelves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ways") / "shelves.yaml"
    path.write_text(SHELVES, encoding="utf-8")
    return path


def limb_on(scene: ModuleScene, root: int = 0, side: int = 2) -> SupportModule:
    return build_arm(0, side, compute_anchor_pose(scene, root, 1), 0)


def test_poses_are_judged_as_programs_do(shelves: Path) -> None:
    scene = build_scene(load_limms(shelves))
    rng = np.random.default_rng(1)
    boxes = np.array([-0.4, 0.0, 0.5]) + rng.uniform(-0.35, 0.35, (200, 3))
    low, high = compute_margin_bounds(SINGULAR_MARGINS)
    compared = 0
    for branch in ((1, 1, 1), (-1, 1, -1), (1, -1, 1)):
        limb = branch_limb(scene, branch)
        feet = np.tile(limb.fixed_position, (len(boxes), 1))
        angles, missing = compute_limb_angles(scene, limb, boxes, feet, branch)
        function = build_arm_function(scene, limb)
        for k in np.flatnonzero(missing <= 0):
            margins = np.array(function(boxes[k], np.zeros(3), angles[k])[2]).ravel()
            near = np.abs(margins - np.where(np.isfinite(low), low, high)).min() < 1e-4
            if not near:
                inside = bool(((margins >= low) & (margins <= high)).all())
                assert bool(is_off_singular(scene.module, angles[k])) is inside
                compared += 1
    assert compared > 100


def branch_limb(scene: ModuleScene, branch: tuple[int, int, int]) -> SupportModule:
    return build_arm(0, 2, compute_anchor_pose(scene, 0, 1), 0, branch)


def test_a_way_is_found_that_joints_can_follow(shelves: Path) -> None:
    scene = build_scene(load_limms(shelves))
    start, goal = scene.box_start[0], np.array([-0.5, 0.12, 0.1])
    way = find_corridor(decompose_free_space(scene), start, goal)
    assert way is not None
    task = HeldTask(start, goal, way, False, 0.0)
    path = np.linspace(start, goal, 9)
    limb = limb_on(scene)
    feet = np.tile(limb.fixed_position, (len(path), 1))
    found = 0
    for choice in rank_branches(scene, limb, path, feet):
        pieces = find_grid_path(scene, [choice.limb], task)
        if not pieces:
            continue
        found += 1
        assert (pieces[0][0][0] == start).all()
        assert (pieces[-1][0][-1] == goal).all()
        nodes = np.vstack([piece for piece, _ in pieces])
        for piece, block in pieces:
            assert (piece >= block[0] - 1e-9).all()
            assert (piece <= block[1] + 1e-9).all()
        held = np.tile(limb.fixed_position, (len(nodes), 1))
        angles, missing = compute_limb_angles(scene, choice.limb, nodes, held, choice.limb.branch)
        assert (missing <= 0).all()
        turned = np.abs((np.diff(angles, axis=0) + np.pi) % (2 * np.pi) - np.pi)
        assert turned.max() <= MAX_JOINT_STEP
        gap = compute_clearance(scene, [choice.limb], nodes, held[:, None], angles[:, None])
        assert gap[1:-1].min() >= -1e-6
    assert found


def test_no_way_where_the_arm_does_not_reach(shelves: Path) -> None:
    scene = build_scene(load_limms(shelves))
    far = np.array([1.0, 0.3, 0.1])
    way = find_corridor(decompose_free_space(scene), scene.box_start[0], far)
    assert way is not None
    assert not find_grid_path(
        scene, [limb_on(scene)], HeldTask(scene.box_start[0], far, way, False, 0.0)
    )


def test_other_bends_come_before_other_rolls() -> None:
    scene = scene_of_spec("limms_throw")
    box = scene.box_start[:1]
    limb = build_arm(0, 1, compute_anchor_pose(scene, 0, 1), 0)
    choices = rank_branches(scene, limb, box, limb.fixed_position[None])
    assert len(choices) > 1
    assert [c.rank for c in choices] == sorted(c.rank for c in choices)
    bends = {c.limb.branch[0] * c.limb.branch[1] for c in choices if c.rank == 0}
    assert len(bends) == sum(c.rank == 0 for c in choices)


@pytest.mark.slow
def test_single_arms_swap_boxes_on_awkward_shelves(shelves: Path) -> None:
    plan = plan_limms(load_limms(shelves))
    assert verify_plan(plan).passed
    assert "aside" in plan.sequence
