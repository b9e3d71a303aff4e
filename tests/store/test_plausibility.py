"""Data and deflections that no such robot has are warned of, with figures; others are not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_climb import Climb

from climbplan.climb.check.plausibility import find_implausible_values, find_massless_links
from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.verification.verification import mark_verified

SPECS = Path(__file__).parents[2] / "specs"
Change = Callable[[ClimbPlan], ClimbPlan]


def robot(**changes: object) -> Change:
    return lambda plan: replace(plan, robot=replace(plan.robot, **changes))


def scaled(name: str, factor: float) -> Change:
    return lambda plan: robot(**{name: vars(plan.robot)[name] * factor})(plan)


def forces(name: str, factor: float) -> Change:
    def change(plan: ClimbPlan) -> ClimbPlan:
        value = vars(plan.forces)[name] * factor
        return replace(plan, forces=replace(plan.forces, **{name: value}))

    return change


def leading(degrees: float) -> Change:
    def change(plan: ClimbPlan) -> ClimbPlan:
        command = plan.instants.joint_angles + np.deg2rad(degrees)
        return replace(plan, forces=replace(plan.forces, joint_command=command))

    return change


def pushed_in(plan: ClimbPlan) -> ClimbPlan:
    command = plan.instants.toes + np.array([0.5, 0.0, 0.0])
    return replace(plan, forces=replace(plan.forces, toe_command=command))


def sagging(plan: ClimbPlan) -> ClimbPlan:
    sag = np.zeros_like(plan.forces.com_deflection)
    sag[3, 2] = -0.2
    return replace(plan, forces=replace(plan.forces, com_deflection=sag))


def slipless(plan: ClimbPlan) -> ClimbPlan:
    surfaces = tuple(replace(s, friction=2.5) for s in plan.terrain.surfaces)
    return replace(plan, terrain=replace(plan.terrain, surfaces=surfaces))


def test_the_example_is_plausible(climb: Climb) -> None:
    assert find_implausible_values(climb.plan) == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (robot(max_torque=np.full((6, 3), 5000.0)), "torque limit 5000 N m at RF"),
        (scaled("joint_stiffness", 1e-2), "would bend it by"),
        (scaled("joint_stiffness", 1e7), "as no motor's control does"),
        (scaled("mass", 1e-3), "kg/m^3"),
        (scaled("link_lengths", 20.0), "lengths are in metres"),
        (scaled("max_joint_speed", 100.0), "turns a minute"),
        (robot(gravity=981.0), "gravity 981"),
        (slipless, "friction 2.5 of left"),
        (forces("force", 10.0), "times the robot's weight (R"),
        (leading(169.0), "commands 169 degrees beyond the joint's angle"),
        (pushed_in, "commands that would put a toe 500 mm off where it stands"),
        (sagging, "the body sags by 200 mm"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_implausible_data_are_named_with_figures(climb: Climb, change: Change, words: str) -> None:
    found = find_implausible_values(change(climb.plan))
    assert any(words in text for text in found), found


def test_a_urdf_whose_moving_links_have_no_mass() -> None:
    text = (SPECS / "walker.urdf").read_text(encoding="utf-8")
    assert list(find_massless_links(text)) == []
    legs = re.sub(r'<mass value="[^"]*"/>', '<mass value="0"/>', text)
    (words,) = find_massless_links(legs)
    assert "moving links of the URDF have no mass (" in words
    assert list(find_massless_links("")) == []
    assert list(find_massless_links("no URDF")) == []


def test_a_plan_with_implausible_data_passes_its_checks_and_must_not_be_used(
    climb: Climb, tmp_path: Path
) -> None:
    fast = scaled("max_joint_speed", 100.0)(climb.plan)
    write_climb(fast, tmp_path / "plan.h5")
    found = verify(tmp_path / "plan.h5")
    assert found.implausible == find_implausible_values(fast) != ()
    assert found.as_dict()["implausible"] == list(found.implausible)
    assert found.passed
    assert found.badge == "verified in its model (implausible data, robot as stored)"
    assert found.level == "do_not_use"
    mark_verified(tmp_path / "plan.h5", found)
    with h5py.File(tmp_path / "plan.h5") as file:
        assert file.attrs["level"] == "do_not_use"
        assert json.loads(file.attrs["implausible"]) == list(found.implausible)


def test_nothing_is_said_of_a_plan_whose_data_are_unsound(climb: Climb, tmp_path: Path) -> None:
    write_climb(robot(mass=-1.0)(climb.plan), tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").implausible == ()
