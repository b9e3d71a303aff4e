"""Several boxes: one after the other, put aside where they are in the way, checked as one plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import changed, loaded

from climbplan.errors import Infeasible, SpecError
from climbplan.limms.check.boxes import check_boxes
from climbplan.limms.check.loads import compute_loads
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.exports.table import export_csv
from climbplan.limms.motion.assembly import _choose_turns, build_initial_plan
from climbplan.limms.plan.file import read_limms_plan, write_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection
from climbplan.limms.scene.limms_scene import build_scene, put_box_first, remove_other_boxes
from climbplan.limms.schema.loading import load_limms
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.task_planning.best_first_search import search_task_plans
from climbplan.limms.task_planning.state_space import GOAL, START, StateSpace
from climbplan.verification.check import Check


@pytest.fixture(scope="module")
def swapped() -> LimmsPlan:
    return plan_limms(loaded("limms_swap"))


def checks_of(plan: LimmsPlan) -> dict[str, Check]:
    return {c.name: c for c in check_boxes(plan, ModuleSpec.model_validate(plan.module))}


@pytest.mark.slow
def test_two_modules_swap_two_boxes(swapped: LimmsPlan) -> None:
    verification = verify_plan(swapped)
    assert verification.passed
    names = [check.name for check in verification.checks]
    assert "goal.order" in names
    assert swapped.deliveries == 2
    assert swapped.sequence.startswith("box 1 aside by arms: ")
    motion = swapped.motion
    assert np.abs(motion.box_position[-1] - motion.box_position[0, ::-1]).max() < 1e-6
    # One at a time, the other one rests
    assert ((motion.box_mode == 1).sum(axis=1) >= 1).all()
    moved = [int(np.argmax(row != 1)) for row in motion.box_mode if (row != 1).any()]
    assert [b for k, b in enumerate(moved) if not k or b != moved[k - 1]] == [1, 0, 1]


@pytest.mark.slow
def test_checks_look_at_every_box(swapped: LimmsPlan) -> None:
    good = checks_of(swapped)
    assert all(check.passed for check in good.values())
    # Boxes that share the space
    motion = swapped.motion
    through = motion.box_position.copy()
    through[:, 1] = through[:, 0] + np.array([0.15, 0, 0])
    off = replace(swapped, motion=replace(motion, box_position=through))
    assert not checks_of(off)["box.collision"].passed
    # The second box not where it is to be, and still on its way
    late = motion.box_velocity.copy()
    late[-1, 0] = [0.1, 0, 0]
    off = replace(swapped, motion=replace(motion, box_velocity=late))
    assert not checks_of(off)["goal.speed"].passed
    other = replace(swapped, goal=swapped.goal + np.array([[0, 0, 0], [0, 0, 0.01]]))
    assert checks_of(other)["goal.position"].worst_at == "box 1"
    # Bodies of the second box bear loads of their own
    module = ModuleSpec.model_validate(swapped.module)
    held = [
        each for each in compute_loads(swapped, module) if any(c.other == 3 for c in each.contacts)
    ]
    assert held
    assert max(each.imbalance.max() for each in held) < 1e-5


@pytest.mark.slow
def test_order_of_boxes_is_checked(swapped: LimmsPlan) -> None:
    """The same motion, read as boxes in the other order: the second one comes first."""
    motion = swapped.motion
    flipped = replace(
        motion,
        box_position=motion.box_position[:, ::-1],
        box_velocity=motion.box_velocity[:, ::-1],
        box_mode=motion.box_mode[:, ::-1],
    )
    order = checks_of(replace(swapped, motion=flipped, goal=swapped.goal[::-1]))["goal.order"]
    assert not order.passed
    assert order.worst_at == "box 1 before the one it comes after"


@pytest.mark.slow
def test_files_hold_all_boxes(swapped: LimmsPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_limms_plan(swapped, path)
    again = read_limms_plan(path)
    assert again.deliveries == 2
    assert (again.goal == swapped.goal).all()
    table = tmp_path / "motion.csv"
    export_csv(path, table)
    head = table.read_text().splitlines()[0].split(",")
    assert head[:9] == [
        "time_s", "box_mode", "box_x_m", "box_y_m", "box_z_m",
        "box1_mode", "box1_x_m", "box1_y_m", "box1_z_m",
    ]  # fmt: skip


def test_places_aside_are_out_of_the_way() -> None:
    scene = build_scene(loaded("limms_swap"))
    listed = list(search_task_plans(build_initial_plan(scene), 1))
    assert [course.cost() for course in listed] == sorted(course.cost() for course in listed)
    first = listed[0].subtasks
    assert [(leg.box, leg.is_set_aside) for leg in first] == [(1, True), (0, False), (1, False)]
    for other in (*scene.goals, *scene.box_start):
        assert (np.abs(np.array(first[0].end) - other) >= scene.box_size[1] - 1e-9).any()
    assert first[2].start == first[0].end
    assert first[1].end == tuple(scene.goals[0])


def test_boxes_in_the_way_of_others_cost_a_leg_more() -> None:
    space = StateSpace(build_initial_plan(build_scene(loaded("limms_swap"))))
    assert [int(box.cost_to_go[START]) for box in space.boxes] == [1, 1]
    assert space.overlaps_goal(1, START, 0)
    assert not space.overlaps_goal(1, GOAL, 0)
    (means, *_) = space.find_actions(1, space.initial)
    # The other box stands at its goal, and is no obstacle elsewhere
    assert not means.find_successors(START)[GOAL]
    alone = StateSpace(build_initial_plan(remove_other_boxes(put_box_first(
        space.scene, 1, np.column_stack([space.scene.box_start, space.scene.start_yaws]),
        np.array([*space.scene.goals[1], 0.0]), 0.0,
    ))))  # fmt: skip
    assert alone.find_actions(0, alone.initial)[0].find_successors(START)[GOAL]


def test_latches_say_who_has_to_come_down(tmp_path: Path) -> None:
    """Of two modules one hangs on a wall already, by its first end: it does not come down."""
    modules = [{"name": "A", "anchor": "left"}, {"name": "B", "position": [-1.0, -0.4, 0]}]
    space = StateSpace(
        build_initial_plan(
            build_scene(load_limms(changed(tmp_path, "limms_swap", modules=modules)))
        )
    )
    assert space.initial.latched == (0,)
    left, right = Connection(0, 2), Connection(1, 3)
    both = space.compute_latch_effect(space.initial, Action("arms", (left, right)))
    assert both == ((0, 1), 1)
    assert space.compute_latch_effect(space.initial, Action("arms", (right,))) == ((0, 1), 1)
    # B hangs on the right then; a chain of two from there would need A
    hanging = space.initial._replace(latched=(0, 1))
    assert space.compute_latch_effect(hanging, Action("arms", (left,))) == ((0, 1), 0)
    assert space.compute_latch_effect(hanging, Action("arms", (Connection(1, 3, 2),))) is None
    assert space.compute_latch_effect(space.initial, Action("arms", (Connection(0, 2, 2),))) == (
        (0, 0),
        1,
    )


def test_scenes_keep_what_boxes_are() -> None:
    scene = build_scene(loaded("limms_swap"))
    moved = scene.box_start + np.array([[0, 0, 0], [0.1, 0, 0]])
    places = np.column_stack([moved, [0.0, 0.3]])
    other = put_box_first(scene, 1, places, np.array([*scene.goals[1], 0.5]), 0.0)
    assert other.box_number == (1, 0)
    assert other.anchor_names[:4] == scene.anchor_names[4:8]
    assert other.anchor_names[8:] == scene.anchor_names[8:]
    assert (other.start_placement == places[1]).all()
    assert np.isclose(other.goal_placement[3], 0.5)
    assert other.start_yaws[1] == 0
    alone = remove_other_boxes(other)
    assert alone.num_boxes == 1
    assert alone.wall_offset == 4
    assert alone.anchor_names[4:] == scene.anchor_names[8:]


def test_one_box_that_cannot_be_brought_is_a_proof(tmp_path: Path) -> None:
    heavy = changed(tmp_path, "limms_swap", boxes__1__mass=9.0)
    with pytest.raises(Infeasible, match=r"box 1, were it the only one: no plan exists"):
        plan_limms(load_limms(heavy))


def test_rolls_begin_at_the_turn_that_keeps_them_in_range() -> None:
    limits = np.full(6, 2 * np.pi)
    now = np.full(6, 6.0)
    path = np.linspace(0.0, 1.0, 9)[:, None] * np.ones(6)
    begun = _choose_turns(path, now, limits)
    assert begun == pytest.approx(np.zeros(6))  # 2 pi is nearer, but leaves the range
    assert _choose_turns(path - 1.1, now, limits) == pytest.approx(np.full(6, 2 * np.pi - 1.1))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"boxes": []}, "expected either `box` or `boxes`, got neither"),
        ({"boxes__0__arrival_speed": 0.5}, "only the last box may arrive with some speed"),
        ({"boxes__0__goal": [-0.35, 0, 0.35]}, "overlaps the box at boxes.0.goal"),
        ({"boxes__1__start": [-0.3, 0, 0.35]}, "overlaps the box at boxes.0.start"),
        ({"boxes__0__goal": [0.35, 0, 0.5]}, "does not stand on the ground"),
        ({"solver": {"method": "admm"}}, "`admm` delivers one box"),
        ({"task": {"allow": ["quadruped"]}}, "several boxes are delivered by `arms`"),
    ],
)
def test_mistakes_in_several_boxes_are_told(
    changes: dict[str, object], words: str, tmp_path: Path
) -> None:
    with pytest.raises(SpecError) as caught:
        load_limms(changed(tmp_path, "limms_swap", **changes))
    assert words in str(caught.value)
