"""Boxes that turn: geometry, plans, lies about their yaw, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from limms_scenes import changed, loaded
from limms_scenes import scene as scene_of_spec

from climbplan.errors import SpecError
from climbplan.limms.arms.branch_choices import HeldTask
from climbplan.limms.arms.collision_cuts import refine_trajectory
from climbplan.limms.arms.guess import build_guess
from climbplan.limms.check.loads import compute_loads
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.modules.contact import gap_to_blocks, gap_to_boxes
from climbplan.limms.modules.distances import upright_gap
from climbplan.limms.modules.limbs import build_arm, compute_anchor_pose
from climbplan.limms.motion.cubics import evaluate_box_path
from climbplan.limms.plan.file import read_limms_plan, write_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.corridor import (
    decompose_free_space,
    decompose_relaxed_free_space,
    find_corridor,
    list_standing_yaws,
)
from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.scene.phases import compute_load_sharing
from climbplan.limms.scene.placement import (
    inertia_about_vertical,
    rotate_to_world,
    rotation_about_vertical,
    swept_half_extents,
)
from climbplan.limms.schema.loading import load_limms
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.task_planning.infeasibility import prove_infeasible

QUARTER = np.pi / 2


def failing(plan: LimmsPlan) -> set[str]:
    return {check.name for check in verify_plan(plan).failed}


def tampered(plan: LimmsPlan, **arrays: Any) -> LimmsPlan:
    return replace(plan, motion=replace(plan.motion, **arrays))


# --- geometry


def test_extents_hold_all_that_a_box_sweeps() -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        half, first = rng.uniform(0.05, 0.3, 3), rng.uniform(-4, 4)
        last = first + rng.uniform(0, 3)
        yaw = np.linspace(first, last, 2001)
        c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
        swept = [(half[0] * c + half[1] * s).max(), (half[0] * s + half[1] * c).max(), half[2]]
        np.testing.assert_allclose(swept_half_extents(half, first, last), swept, atol=1e-6)


def test_gaps_of_turned_boxes_are_those_of_the_scene_turned_back() -> None:
    rng = np.random.default_rng(1)
    segments = rng.uniform(-1, 1, (20, 4, 2, 3))
    centre, half = rng.uniform(-0.5, 0.5, (20, 2, 3)), rng.uniform(0.1, 0.3, (2, 3))
    yaw = rng.uniform(-3, 3, (20, 2))
    found = gap_to_boxes(segments, centre, yaw, half, 0.03)
    for k in range(20):
        for b in range(2):
            own = rotate_to_world(-yaw[k, b], segments[k] - centre[k, b])
            there = gap_to_blocks(own, -half[b : b + 1], half[b : b + 1], 0.03)
            np.testing.assert_allclose(found[k, :, b], there[:, 0], atol=1e-9)


def test_upright_gap_says_whether_boxes_touch() -> None:
    half, other = np.array([0.2, 0.1, 0.1]), np.array([0.1, 0.1, 0.1])
    still = np.zeros(3)

    def gap(x: float, yaw: float, its_yaw: float = 0.0) -> float:
        place = np.array([x, 0.0, 0.0])
        return float(upright_gap(still, np.array(yaw), half, place, np.array(its_yaw), other))

    assert gap(0.35, 0.0) == pytest.approx(0.05)
    assert gap(0.35, QUARTER) == pytest.approx(0.15)
    assert gap(0.29, 0.0) == pytest.approx(-0.01)
    # An edge towards a corner: the corner reaches 0.1 sqrt(2)
    assert gap(0.35, 0.0, np.pi / 4) == pytest.approx(0.15 - 0.1 * np.sqrt(2))
    # Corners of boxes whose blocks along the axes overlap are apart along a diagonal
    aside = np.array([0.28, 0.28, 0.0])
    turn = np.array(np.pi / 4)
    assert upright_gap(still, turn, other, aside, turn, other) > 0.19
    assert upright_gap(still, np.array(0.0), half, aside, np.array(0.0), other) < 0.09


def test_latches_share_the_moment_that_turns_a_box() -> None:
    offsets = np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.08, 0]])
    wrench = np.array([1.0, -2.0, 9.0, 0.4])
    both = (compute_load_sharing(offsets, 20.0, 0.7) @ wrench).reshape(2, 3, 3)
    np.testing.assert_allclose(both[0].sum(axis=0), wrench[:3])
    moment = np.cross(offsets, both[0]).sum(axis=0) + both[1].sum(axis=0)
    np.testing.assert_allclose(moment, [0, 0, 0.4], atol=1e-12)


# --- the corridor


def test_blocks_of_placements_are_free() -> None:
    own = scene_of_spec("limms_turned")
    blocks = decompose_free_space(own)
    assert blocks.shape[1:] == (2, 4)
    rng, half = np.random.default_rng(2), own.box_size[0] / 2
    for low, high in blocks[rng.integers(len(blocks), size=60)]:
        *centre, yaw = rng.uniform(low, high)
        for solid in own.solids:
            block = solid.mean(axis=0), np.array(0.0), (solid[1] - solid[0]) / 2
            assert upright_gap(np.array(centre), np.array(yaw), half, *block) > -1e-9
    way = find_corridor(blocks, own.start_placement, own.goal_placement)
    assert way is not None
    assert own.goal_placement[3] == pytest.approx(QUARTER)
    np.testing.assert_allclose(list_standing_yaws(own), [0, QUARTER / 2, QUARTER])


def test_a_turn_goes_the_near_way_round() -> None:
    own = scene_of_spec("limms_turned", "box.start_yaw_deg=170", "box.goal_yaw_deg=-100")
    assert own.goal_placement[3] == pytest.approx(np.radians(260))
    half = scene_of_spec("limms_turned", "box.goal_yaw_deg=180")
    assert half.goal_placement[3] == pytest.approx(np.pi)


def test_no_way_is_proved_only_where_no_attitude_passes(tmp_path: Path) -> None:
    # A gap of 0.16 m: the box of 0.24 by 0.14 m passes it in one attitude only
    walls = [
        {"name": "one", "lower": [0, 0.1, 0], "upper": [1.12, 0.12, 2.2]},
        {"name": "other", "lower": [1.28, 0.1, 0], "upper": [2.4, 0.12, 2.2]},
    ]
    goal = [1.2, 0.6, 0.08]
    path = changed(tmp_path, "limms_turned", terrain__obstacles=walls, box__goal=goal)
    own = scene_of_spec_at(path)
    assert find_corridor(decompose_relaxed_free_space(own), own.box_start[0], own.goal) is not None
    assert prove_infeasible(own, ()) is None
    narrow = [{**walls[0], "upper": [1.16, 0.12, 2.2]}, {**walls[1], "lower": [1.24, 0.1, 0]}]
    path = changed(tmp_path, "limms_turned", terrain__obstacles=narrow, box__goal=goal)
    own = scene_of_spec_at(path)
    refused = prove_infeasible(own, ())
    assert refused is not None
    assert "no way for the box" in str(refused)


def scene_of_spec_at(path: Path) -> ModuleScene:
    return build_scene(load_limms(path))


# --- between knots


def test_a_motion_with_twice_the_knots_is_the_same() -> None:
    own = scene_of_spec("limms_turned")
    limb = replace(build_arm(0, 1, compute_anchor_pose(own, 0, 1), 0), branch=(1, 1, 1))
    way = find_corridor(decompose_free_space(own), own.start_placement, own.goal_placement)
    assert way is not None
    task = HeldTask(own.start_placement, own.goal_placement, way, False, 0.0)
    trace = build_guess(own, [limb], task)[0]
    rng = np.random.default_rng(3)
    jerk = rng.normal(size=trace.acceleration.shape)
    step = trace.duration / trace.phase.intervals
    # Any accelerations, and the motion that follows from them
    velocity, position = trace.velocity.copy(), trace.position.copy()
    for k in range(trace.phase.intervals):
        velocity[k + 1] = velocity[k] + step * (jerk[k] + jerk[k + 1]) / 2
        position[k + 1] = (
            position[k] + step * velocity[k] + step**2 * (2 * jerk[k] + jerk[k + 1]) / 6
        )
    trace = replace(trace, position=position, velocity=velocity, acceleration=jerk)
    finer = refine_trajectory(own, [limb], trace)
    assert finer.phase.intervals == 2 * trace.phase.intervals
    time = np.linspace(0, trace.duration, 101)
    one = evaluate_box_path(trace.duration, position, velocity, jerk, time)
    two = evaluate_box_path(
        trace.duration, finer.position, finer.velocity, finer.acceleration, time
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


# --- plans


def test_a_box_is_turned_onto_a_shelf(turned: LimmsPlan, tmp_path: Path) -> None:
    assert verify_plan(turned).passed
    motion = turned.motion
    assert motion.box_yaw[0, 0] == 0
    assert motion.box_yaw[-1, 0] == pytest.approx(QUARTER, abs=1e-6)
    held = motion.box_mode[:, 0] == 3
    assert np.ptp(motion.box_yaw[~held], axis=0).max() == 0  # it turns in the arm
    side = motion.anchor_position[-1, 0] - motion.box_position[-1, 0]
    np.testing.assert_allclose(side, [0, 0.12, 0], atol=1e-6)  # +x of the box looks along y
    write_limms_plan(turned, tmp_path / "plan.h5")
    again = read_limms_plan(tmp_path / "plan.h5")
    assert np.array_equal(again.motion.box_yaw, motion.box_yaw)
    assert verify_plan(again).passed


def test_a_yaw_that_is_not_the_motions_is_found(turned: LimmsPlan) -> None:
    motion = turned.motion
    # All of it elsewhere: latches are not where they are said to be, nor is the goal
    off = failing(tampered(turned, box_yaw=motion.box_yaw + 0.1))
    assert {"goal.rotation", "file.spec_values", "latch.rotation", "latch.position"} <= off
    # A little, for a moment
    middle = motion.box_yaw.copy()
    middle[len(middle) - 40] += 1e-3
    assert {"box.kinematics", "latch.rotation"} <= failing(tampered(turned, box_yaw=middle))
    # As if it had never turned
    unturned = tampered(
        turned,
        box_yaw=0 * motion.box_yaw,
        box_yaw_rate=0 * motion.box_yaw,
        box_yaw_acceleration=0 * motion.box_yaw,
    )
    assert {"goal.rotation", "latch.rotation", "latch.position"} <= failing(unturned)
    assert "box.kinematics" in failing(tampered(turned, box_yaw_rate=1.01 * motion.box_yaw_rate))
    faster = tampered(turned, box_yaw_acceleration=1.01 * motion.box_yaw_acceleration)
    told = failing(replace(faster, goal_yaw=np.array([1.5])))
    assert {"box.kinematics", "goal.rotation", "file.spec_values"} <= told


def test_anchors_of_a_box_turn_with_it(turned: LimmsPlan) -> None:
    moved = turned.motion.anchor_position.copy()
    moved[-1, 2, 0] += 1e-3
    assert failing(tampered(turned, anchor_position=moved)) == {"box.kinematics"}


def test_a_box_that_keeps_its_yaw_may_not_turn(throw: LimmsPlan) -> None:
    yaw = throw.motion.box_yaw.copy()
    yaw[-30:-20] = 0.01
    assert "goal.rotation" in failing(tampered(throw, box_yaw=yaw))


def test_nothing_turns_a_box_in_flight(throw: LimmsPlan) -> None:
    faster = throw.motion.box_yaw_acceleration.copy()
    faster[throw.motion.box_mode[:, 0] == 2] = 5.0
    found = failing(tampered(throw, box_yaw_acceleration=faster))
    assert {"box.moment", "box.kinematics"} <= found


def test_latches_feel_what_turns_the_box(turned: LimmsPlan) -> None:
    """Of a box that speeds up its turn, the contacts give I alpha more about its middle."""
    module = ModuleSpec.model_validate(turned.module)
    plain = tampered(turned, box_yaw_acceleration=0 * turned.motion.box_yaw_acceleration)
    inertia = inertia_about_vertical(float(turned.box_mass[0]), turned.box_size[0])
    compared = 0
    for with_, without in zip(
        compute_loads(turned, module), compute_loads(plain, module), strict=True
    ):
        for contact, one, other in zip(with_.contacts, with_.wrench, without.wrench, strict=True):
            if contact.kind == "latch" and "box" in contact.name:
                alpha = np.interp(
                    with_.stretch.time,
                    turned.motion.time,
                    turned.motion.box_yaw_acceleration[:, 0],
                )
                # The last sample is that of the stretch after it as well
                gained = (one - other)[:-1, 5]
                np.testing.assert_allclose(gained, -inertia * alpha[:-1], atol=1e-6)
                compared += len(alpha)
    assert compared > 100


def test_plans_of_boxes_that_do_not_turn_are_read_as_before(
    throw_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "old.h5"
    path.write_bytes(throw_file.read_bytes())
    with h5py.File(path, "r+") as file:
        for name in ("yaw", "yaw_rate", "yaw_acceleration", "goal_yaw"):
            del file["box"][name]
    old = read_limms_plan(path)
    assert not old.motion.box_yaw.any()
    assert verify_plan(old).passed


def test_a_thrown_box_goes_on_turning() -> None:
    plan = plan_limms(loaded("limms_throw", "box.goal_yaw_deg=90"))
    assert verify_plan(plan).passed
    flown = plan.motion.box_mode[:, 0] == 2
    rate = plan.motion.box_yaw_rate[flown, 0]
    assert rate[0] > 0.5
    assert np.ptp(rate) < 1e-9
    assert plan.motion.box_yaw[-1, 0] - plan.motion.box_yaw[flown, 0][0] > 0.1
    # What is let go of keeps its spin: a yaw that runs otherwise is no flight
    slower = plan.motion.box_yaw.copy()
    slower[np.flatnonzero(flown)[5:]] -= 0.01
    assert {"box.kinematics", "goal.rotation"} <= failing(tampered(plan, box_yaw=slower))


@pytest.mark.slow
def test_short_legs_give_latches_their_time() -> None:
    plan = plan_limms(loaded("limms_turned", "box.goal_yaw_deg=-90"))
    assert plan.sequence.startswith("relay")
    assert verify_plan(plan).passed


@pytest.mark.slow
@pytest.mark.parametrize(("start", "goal", "ends"), [(170, -120, 240), (45, 45, 45)])
def test_boxes_may_stand_turned_at_the_start(start: float, goal: float, ends: float) -> None:
    yaws = (f"box.start_yaw_deg={start}", f"box.goal_yaw_deg={goal}")
    plan = plan_limms(loaded("limms_turned", *yaws))
    assert verify_plan(plan).passed
    told = np.degrees(plan.motion.box_yaw[[0, -1], 0])
    np.testing.assert_allclose(told, [start, ends], atol=1e-4)


@pytest.mark.slow
def test_boxes_are_swapped_and_turned() -> None:
    turns = ("boxes.0.goal_yaw_deg=20", "boxes.1.goal_yaw_deg=-20")
    plan = plan_limms(loaded("limms_swap", *turns))
    assert verify_plan(plan).passed
    np.testing.assert_allclose(plan.motion.box_yaw[-1], np.radians([20, -20]), atol=1e-6)


# --- specs


def test_what_cannot_be_turned_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="does not turn boxes"):
        loaded("limms_turned", "solver.method=admm")
    # Turned by half a quarter its corners are in the wall
    with pytest.raises(SpecError, match=r"box.goal.*reaches 14 mm out of the free space"):
        load_limms(
            changed(tmp_path, "limms_turned", box__goal=[0.12, 0.5, 0.48], box__goal_yaw_deg=45)
        )
    with pytest.raises(SpecError, match="<= 180, got 200"):
        loaded("limms_turned", "box.goal_yaw_deg=200")


def test_a_box_may_be_turned_where_it_stands(tmp_path: Path) -> None:
    spec = load_limms(changed(tmp_path, "limms_turned", box__goal=[0.6, -0.1, 0.08]))
    assert not spec.spec.box.stays  # type: ignore[union-attr]
    with pytest.raises(SpecError, match="another place than the start"):
        load_limms(
            changed(tmp_path, "limms_turned", box__goal=[0.6, -0.1, 0.08], box__goal_yaw_deg=0)
        )


def test_frames_turn_from_x_to_y() -> None:
    np.testing.assert_allclose(rotation_about_vertical(QUARTER) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
