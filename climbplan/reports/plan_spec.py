"""The spec inside a plan, for what only the spec says."""

from __future__ import annotations

from climbplan.errors import SpecError
from climbplan.plans.climb_plan import ClimbPlan
from climbplan.spec.climb import ClimbSpec
from climbplan.spec.kinds import validate
from climbplan.spec.yaml_source import parse_yaml


def plan_spec(plan: ClimbPlan) -> ClimbSpec | None:
    """The plan's own spec; None if its text is not a climb spec of this version.

    A report is made of the plan's numbers, so a text that cannot be read only leaves gaps.
    """
    try:
        spec, _ = validate(parse_yaml(plan.spec_text, "spec"), ClimbSpec)
    except SpecError:
        return None
    return spec
