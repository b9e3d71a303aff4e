"""Mode sequences: what is listed, what is ruled out and why."""

from __future__ import annotations

from pathlib import Path

import pytest
from limms_scenes import changed, loaded, scene

from benchmarks.limms.random_rooms import random_room
from climbplan.errors import Infeasible, Unresolved
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.schema.loading import load_limms
from climbplan.limms.task_planning.infeasibility import (
    prove_latch_too_weak,
    prove_out_of_reach,
    prove_unliftable,
)
from climbplan.limms.task_planning.single_actions import find_single_actions


def test_light_box_takes_two_arms_first() -> None:
    found = find_single_actions(scene("limms_lift_light"))
    assert found.actions[0].kind == "arms"
    assert found.actions[0].num_modules == 2  # one latch does not hold the moment
    assert found.configurations == 2 * (2 * 4) + 4 * (4 * 3) + 1  # one or two modules a chain


def test_weak_latch_is_what_asks_for_two() -> None:
    alone = find_single_actions(scene("limms_lift_light", "box.mass=0.4"))
    assert alone.actions[0].num_modules == 1


def test_heavy_box_is_too_much_for_arms() -> None:
    found = find_single_actions(scene("limms_lift_light", "box.mass=7"))
    assert [s.kind for s in found.actions] == ["quadruped"]
    assert "28.7 N short" in str(found.conflicts[0])


def test_arms_forced_on_a_heavy_box_are_proved_infeasible() -> None:
    forced = loaded("limms_lift_light", "box.mass=7", "task.allow=[arms]")
    with pytest.raises(Infeasible, match=r"28\.7 N short"):
        plan_limms(forced)


def test_too_heavy_for_anything() -> None:
    with pytest.raises(Infeasible, match="4 legs push"):
        plan_limms(loaded("limms_lift_light", "box.mass=9"))


def test_throw_needs_an_arrival_speed() -> None:
    with pytest.raises(Unresolved, match="reach"):
        plan_limms(loaded("limms_throw", "box.arrival_speed=0"))


def test_no_way_for_the_box_is_told(tmp_path: Path) -> None:
    spec = changed(
        tmp_path,
        "limms_throw",
        terrain__regions=[
            {"name": "room", "lower": [0, -1.2, 0], "upper": [2.6, 1.2, 1.3]},
            {"name": "slit", "lower": [0.7, -0.05, 1.3], "upper": [0.8, 0.05, 1.34]},
            {"name": "loft", "lower": [0, -1.2, 1.34], "upper": [2.6, 1.2, 2.6]},
        ],
    )
    with pytest.raises(Infeasible, match="no way for the box"):
        plan_limms(load_limms(spec))


def test_one_latch_that_holds_too_little_is_a_proof() -> None:
    heavy = loaded("limms_throw", "box.mass=1.0")
    with pytest.raises(Infeasible, match=r"holds 0.7 N m, 0.98 N m needed.*box.mass <= 0.71 kg"):
        plan_limms(heavy)
    assert find_single_actions(scene("limms_throw", "box.mass=0.7")).actions


def test_a_box_that_nothing_reaches_is_a_proof() -> None:
    far = loaded("limms_throw", "box.start=[2.0, 0, 0.1]")
    with pytest.raises(Infeasible, match=r"span 0.74 m.*nearest anchor \(wall\).* it is 1.76"):
        plan_limms(far)


def test_arms_that_reach_but_do_not_hold_are_a_proof() -> None:
    """Chains of three modules in all come to the box, and none of them hold its moment."""
    with pytest.raises(Infeasible, match=r"leave 0\.92 N m to a latch, which holds 0\.7 N m"):
        plan_limms(random_room(16))


@pytest.mark.parametrize("name", ["lift_light", "throw", "relatch", "double_arm"])
def test_proofs_leave_alone_what_arms_can_do(name: str) -> None:
    possible = scene(f"limms_{name}", "task.allow=[arms, flight]")
    assert not prove_unliftable(possible)
    assert not prove_out_of_reach(possible)
    assert not prove_latch_too_weak(possible)
