"""The spec inside a plan, for what only the spec says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import SpecError
from climbplan.schema.kinds import validate
from climbplan.schema.yaml_source import parse_yaml

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionSpec


def parse_plan_spec(plan: ClimbPlan) -> ClimbSpec | TransitionSpec | None:
    """Return the plan's own spec; None if its text is not a spec of its kind in this version.

    A report is made of the plan's numbers, so a text that cannot be read only leaves gaps.
    """
    try:
        document = parse_yaml(plan.spec_text, "spec")
        if plan.kind == "transition":
            from climbplan.climb.schema.transition import TransitionSpec

            return validate(document, TransitionSpec)[0]
        return validate(document, ClimbSpec)[0]
    except SpecError:
        return None
