"""Which spec a plan was held against: the one that it carries, or its user's own."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, Protocol

from climbplan.schema.holding import HeldSpec, KeyDifference
from climbplan.verification.check import Check

_SHOWN = 8  # digits of a hash


class Carries(Protocol):
    """A plan or dataset with the text of its spec."""

    @property
    def name(self) -> str: ...
    @property
    def spec_text(self) -> str: ...


@dataclass(frozen=True)
class Against:
    """The spec of a verification."""

    sha256: str
    where: str  # "stored in the plan (climb_obstacle)", "specs/climb_obstacle.yaml"
    stored_sha256: str  # of the text that the plan carries
    differences: tuple[KeyDifference, ...] = ()  # from the user's own spec

    def __str__(self) -> str:
        """Return one line, hash first."""
        text = f"{self.sha256[:_SHOWN]}…  {self.where}"
        if self.sha256 == self.stored_sha256:
            return text
        count = len(self.differences)
        keys = f"differs in {count} key{'' if count == 1 else 's'}" if count else "says the same"
        return f"{text} (the plan's own is {self.stored_sha256[:_SHOWN]}…: {keys})"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "sha256": self.sha256,
            "where": self.where,
            "stored_sha256": self.stored_sha256,
            "differences": [difference.as_dict() for difference in self.differences],
        }


def describe_reference(plan: Carries, user_spec: HeldSpec | None) -> Against:
    """Return the spec that a plan is held against; the hashes are those of the texts themselves."""
    stored = hashlib.sha256(plan.spec_text.encode()).hexdigest()
    if user_spec is None:
        return Against(stored, f"stored in the plan ({plan.name})", stored)
    return Against(user_spec.sha256, user_spec.source, stored, user_spec.differences)


def check_spec_differences(user_spec: HeldSpec) -> Check:
    """Check that no key differs that the plan's other checks do not evaluate."""
    broken = user_spec.broken
    place = str(broken[0]) if broken else ""
    return Check("spec.differences", float(len(broken)), 0.0, "", not broken, "", place)
