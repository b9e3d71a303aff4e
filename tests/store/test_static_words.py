"""What the static checks say is in the robot's terms, whatever rounding does to idle toes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from example_climb import Climb

from climbplan.climb.check import statics as static_checks
from climbplan.climb.check.anew.static_pose import StaticEquilibrium, solve_equilibrium
from climbplan.climb.check.verification import verify


def friction_margin(path: Path) -> str:
    """What `static.friction` says is left."""
    (check,) = (c for c in verify(path).checks if c.name == "static.friction")
    assert check.passed
    return check.margin


def test_rounding_at_an_idle_toe_is_no_friction(
    original: Path, climb: Climb, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = friction_margin(original)
    instants = climb.plan.instants
    k, limb = next(zip(*instants.contact.nonzero(), strict=True))

    def with_rounding(*args: Any) -> StaticEquilibrium:
        found = solve_equilibrium(*args)
        force = found.force.copy()
        # It pulls by a thousandth of a newton, and shears by twice that.
        normal = instants.normal[k, limb]
        force[k, limb] = -1e-3 * normal + 2e-3 * (1 - abs(normal))
        return replace(found, force=force)

    monkeypatch.setattr(static_checks, "solve_equilibrium", with_rounding)
    assert friction_margin(original) == before
