"""What a plan is verified in, and what that leaves out, wherever a verification is shown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_climb import Climb

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.file import write_climb
from climbplan.reports.page_parts import build_check_rows, summarise_verification
from climbplan.verification.check import Check, LeftOut, judge, mark_not_compared, mark_unjudged
from climbplan.verification.verification import Verification, find_stored_differences, mark_verified

GOOD = judge("force.friction", -0.1)
BAD = judge("force.friction", 0.1)
OFF = mark_unjudged(judge("static.pose", 0.02), "linear model", "linear sag", "off by {figure}")


def test_each_check_has_one_of_three_marks() -> None:
    assert [check.mark for check in (GOOD, BAD, OFF)] == ["passed", "failed", "not judged"]
    told = OFF.as_dict()
    assert (told["passed"], told["judged"], told["result"]) == (True, False, "not judged")
    assert told["residual"] == 0.02  # the figure itself, not a zero in its place
    assert GOOD.as_dict()["result"] == "passed"


def test_tables_have_the_marks_failed_checks_first() -> None:
    lines = Verification((GOOD, OFF, BAD)).table().splitlines()
    assert ["FAILED" in lines[1], "not judged" in lines[2], " ok" in lines[3]] == [True] * 3
    report = {"verification": [check.as_dict() for check in (GOOD, OFF)]}
    assert [row.mark for row in build_check_rows(report, {})] == ["not judged", "passed"]
    assert (
        summarise_verification(report)
        == "All 1 checks passed that are judged; not judged: static.pose."
    )


def test_badge_is_plain_only_where_nothing_is_left_out() -> None:
    assert Verification((GOOD,)).badge == "verified"
    assert Verification((GOOD, BAD, OFF)).badge == "not verified"
    found = Verification((GOOD, OFF), beyond=(LeftOut("massless modules", "they weigh 40 N"),))
    assert found.passed
    assert found.badge == "verified in its model (massless modules, linear sag)"
    assert found.leaves_out == ("they weigh 40 N", "off by 0.02 m, rad")
    assert "1 not judged" in found.headline()


def test_the_level_says_what_to_do_in_one_sentence() -> None:
    fine = Verification((GOOD,))
    assert (fine.level, fine.level.label, fine.objection) == ("fine", "fine", "")
    fragile = replace(GOOD, fragile="round 1, push: RF: normal force 2.0 of 10.1 N")
    look = Verification((GOOD, fragile, OFF))
    assert (look.level, look.level.label, look.objection) == ("look", "look at this", "")
    assert "margins are not all kept and it is verified in its model only" in look.advice
    failed = Verification((GOOD, BAD))
    assert failed.level == "do_not_use"
    assert failed.objection.startswith("fails its verification: 1 of 2 checks failed")
    odd = Verification((GOOD,), implausible=("friction 9 of left",))
    assert odd.passed
    assert (odd.level, odd.level.label) == ("do_not_use", "do not use")
    assert odd.objection == "must not be used: implausible: friction 9 of left"
    answer, proof = replace(fine, is_motion=False), replace(look, is_motion=False)
    assert fine.advice == f"{answer.advice}: simulate the plan, then run it"
    assert look.advice == f"{proof.advice} and simulate the plan before a robot runs it"
    for found in (fine, look, failed, odd, answer, proof):
        assert "\n" not in found.advice
        assert ". " not in found.advice
        assert found.scope()["level"] == found.level.value
        assert found.scope()["advice"] == found.advice


def test_what_holds_without_being_asked_leaves_nothing_out() -> None:
    holds = mark_unjudged(
        judge("static.pose", 1e-9), "linear model", "linear sag", "off by {figure}"
    )
    assert holds.mark == "not judged"
    assert Verification((holds,)).badge == "verified"


@pytest.mark.parametrize("residual", [np.nan, np.inf])
def test_a_figure_that_is_no_number_does_not_hold(residual: float) -> None:
    lost = mark_unjudged(judge("static.pose", residual), "linear model", "linear sag", "off")
    assert Verification((lost,)).badge == "verified in its model (linear sag)"
    assert lost.as_dict()["residual"] is None


def test_what_the_file_alone_does_not_tell_is_not_judged(original: Path) -> None:
    """The example's robot is neither built in nor carried."""
    found = verify(original)
    (robot,) = (check for check in found.checks if check.name == "robot.spec")
    assert robot.mark == "not judged"
    assert found.badge == "verified in its model (robot as stored)"
    assert mark_not_compared(GOOD, "why", "model", "words").left_out == LeftOut("model", "words")


def test_commands_off_their_surfaces_are_told_where_nothing_is_asked(original: Path) -> None:
    (inward,) = (check for check in verify(original).checks if check.name == "force.penetration")
    assert inward.mark == "not judged"
    assert inward.residual > inward.limit
    assert inward.left_out is None  # friction there is judged by other checks


def test_a_predicted_sag_is_verified_in_its_linear_model(climb: Climb, tmp_path: Path) -> None:
    sag = np.zeros_like(climb.plan.forces.com_deflection)
    sag[:, 2] = -0.02
    plan = replace(climb.plan, forces=replace(climb.plan.forces, com_deflection=sag))
    write_climb(plan, tmp_path / "plan.h5")
    found = verify(tmp_path / "plan.h5")
    by_name = {check.name: check for check in found.checks}
    for name in ("static.pose", "static.torque", "trajectory.command", "trajectory.torque"):
        assert by_name[name].mark == "not judged", name
    assert "linear sag" in found.model
    assert any("hold the body elsewhere than planned" in words for words in found.leaves_out)


def test_the_badge_is_in_the_file_and_in_json(plan_file: Path) -> None:
    found = verify(plan_file)
    mark_verified(plan_file, found)
    with h5py.File(plan_file) as file:
        assert file.attrs["badge"] == found.badge == "verified in its model (robot as stored)"
        assert file.attrs["verified_in"] == "robot as stored"
        assert json.loads(file.attrs["leaves_out"]) == list(found.leaves_out)
        assert bool(file.attrs["verified"]) is True
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert told["badge"] == found.badge
    assert told["leaves_out"] == list(found.leaves_out)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("badge", "verified"),
        ("verified_in", ""),
        ("leaves_out", "[]"),
        ("fragile", '["round 1"]'),
        ("verified", np.bool_(False)),
    ],
)
def test_attributes_that_verification_does_not_give_are_told(
    plan_file: Path, name: str, value: object
) -> None:
    found = verify(plan_file)
    mark_verified(plan_file, found)
    assert find_stored_differences(plan_file, found) == ()
    with h5py.File(plan_file, "r+") as file:
        file.attrs[name] = value
    (difference,) = find_stored_differences(plan_file, found)
    assert difference.startswith(f"attribute `{name}` of the file is ")
    with h5py.File(plan_file, "r+") as file:
        del file.attrs[name]
    assert find_stored_differences(plan_file, found) == ()


def test_verification_says_which_spec_it_held_the_plan_against(
    original: Path, climb: Climb
) -> None:
    against = verify(original).against
    assert against is not None
    assert str(against) == f"{climb.plan.spec_sha256[:8]}…  stored in the plan (example)"
    assert against.as_dict()["differences"] == []


def test_a_changed_text_is_told_by_its_own_hash(plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        stored = str(file.attrs["spec_sha256"])
        file.attrs["spec"] = str(file.attrs["spec"]) + "# "
    against = verify(plan_file).against
    assert against is not None
    assert against.sha256 != stored


def test_unjudged_checks_use_up_nothing() -> None:
    assert Verification((replace(GOOD, used=0.5), OFF)).tightest.name == "force.friction"
    assert isinstance(OFF, Check)
    assert OFF.used == 0
