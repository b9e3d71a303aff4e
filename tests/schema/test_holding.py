"""A plan's spec beside its user's, key by key: which differences count."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.schema.holding import RULES, HeldSpec, compare_specs
from climbplan.schema.kinds import KINDS
from climbplan.schema.loading import load_spec
from climbplan.schema.yaml_source import parse_yaml
from climbplan.walking.schema.loading import load_mpc

SPECS = Path(__file__).parents[2] / "specs"
SMALL = Path(__file__).parent / "small_climb.yaml"


def held(own: list[str], stored: list[str]) -> HeldSpec:
    """The small climb as its user set it, beside a plan made with other values."""
    mine, plans = load_climb(SMALL, own), load_climb(SMALL, stored)
    return compare_specs(mine, mine.spec, plans.text)


def told(found: HeldSpec) -> list[str]:
    return [str(difference) for difference in found.differences]


def test_the_same_text_says_the_same() -> None:
    assert held([], []).differences == ()


def test_what_checks_judge_is_told_and_the_users_value_stands() -> None:
    found = held([], ["force.safety_friction=1.0"])
    assert told(found) == ["force.safety_friction: plan's spec 1, yours 1.8"]
    assert found.broken == ()
    assert parse_yaml(found.text, "held").value["force"]["safety_friction"] == 1.8


def test_a_default_of_the_user_stands_against_a_laxer_plan() -> None:
    """Left out by the user is not left to the plan, except where the planner may choose."""
    found = held([], ["force.safety_torque=3", "posture.steps.com_max=9"])
    spec = ClimbSpec.model_validate(parse_yaml(found.text, "held").value)
    assert (spec.force.safety_torque, spec.posture.steps.com_max) == (1.0, 0.15)


def test_keys_that_no_check_judges_are_held_to_the_letter() -> None:
    found = held([], ["posture.limb_clearance=0.01"])
    assert [d.key for d in found.broken] == ["posture.limb_clearance"]


def test_how_a_plan_came_about_does_not_count() -> None:
    found = held([], ["seed=9", "solver.method=nlp", "title=another"])
    assert {d.role for d in found.differences} == {"how"}
    assert parse_yaml(found.text, "held").value["seed"] == 9


def test_what_the_planner_may_choose_is_its_choice_where_it_is_left_out() -> None:
    found = held([], ["trajectory.swing_clearance=0.03", "task.gait=[LF, LM, LR, RR, RM, RF]"])
    roles = {d.key: d.role for d in found.differences}
    assert roles == {
        "trajectory.swing_clearance": "chosen",
        "task.gait": "judged",
    }  # the user wrote a gait
    value = parse_yaml(found.text, "held").value
    assert value["trajectory"]["swing_clearance"] == 0.03
    assert value["task"]["gait"][0] == "RF"
    assert "the planner's choice" in told(found)[-1]
    written = held(["trajectory.swing_clearance=0.05"], ["trajectory.swing_clearance=0.03"])
    assert [d.role for d in written.differences] == ["judged"]


@pytest.mark.parametrize(("stated", "role"), [(False, "chosen"), (True, "judged")])
def test_the_goals_angles_are_open_together(stated: bool, role: str) -> None:
    mine = ["task.goal={com: [0, 0, 0.1]" + (", rpy_deg: [0, 0, 0]}" if stated else "}")]
    found = held(mine, [*mine, "task.goal.rotation_tolerance_deg=40"])
    assert [(d.key, d.role) for d in found.differences] == [
        ("task.goal.rotation_tolerance_deg", role)
    ]


def test_every_key_of_the_rules_is_a_key_of_its_spec() -> None:
    """A slip here would hold a plan to less than its user asks."""
    for kind, rules in RULES.items():
        for key in (*rules.how, *rules.judged, *rules.chosen):
            assert _is_key(KINDS[kind].model.model_json_schema(), key), f"{kind}: {key}"


def _is_key(schema: dict[str, object], key: str) -> bool:
    at = [schema]
    for name in key.split("."):
        at = [
            properties[name]
            for part in at
            for option in _options(schema, part)
            if name in (properties := option.get("properties", {}))
        ]
    return bool(at)


def _options(schema: dict[str, object], part: dict[str, object]) -> list[dict[str, object]]:
    if "$ref" in part:
        return _options(schema, schema["$defs"][str(part["$ref"]).rpartition("/")[2]])
    several = [*part.get("anyOf", ()), *part.get("allOf", ())]
    return [option for one in several for option in _options(schema, one)] or [part]


def test_a_plan_whose_text_is_no_spec_differs() -> None:
    mine = load_mpc(SPECS / "mpc_forward.yaml")
    found = compare_specs(mine, mine.spec, "no: spec")
    assert [d.key for d in found.broken] == ["kind"]


@pytest.mark.parametrize("name", ["bookshelf_scene", "limms_throw", "transition_flat", "cart_pole"])
def test_every_kind_of_plan_can_be_held(name: str) -> None:
    mine, other = (load_spec(SPECS / f"{name}.yaml", more) for more in ([], ["seed=5"]))
    found = compare_specs(mine, vars(mine)["spec"], vars(other)["text"])
    assert told(found) == ["seed: plan's spec 5, yours 0 (how the plan came about)"]
