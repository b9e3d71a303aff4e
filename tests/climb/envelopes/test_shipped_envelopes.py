"""Envelopes that come with the package: what they are of, and what they reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.envelopes.shipped import SHIPPED, read_shipped_envelopes
from climbplan.climb.schema.envelopes_loading import load_envelopes
from climbplan.errors import UsageError

SPECS = Path(__file__).parents[3] / "specs"
# Least shares of feasible and of infeasible held-out terrains that P1 tells right
ASKED = {"ground3": (0.98, 0.85), "wall3": (0.94, 0.85), "wall5": (0.95, 0.85)}


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_envelopes_are_of_their_specs(name: str) -> None:
    stored = read_shipped_envelopes(name)
    assert stored.spec_text == load_envelopes(SPECS / f"envelopes_{name}.yaml").text
    assert len(stored.fingerprint) == 64
    assert set(stored.envelopes) == {"clustering", "genetic", "heuristic"}
    for box in stored.envelopes.values():
        assert box.lower.shape == (len(stored.limb_names), 6)
        assert (box.lower <= box.upper).all()
        assert np.abs([box.lower, box.upper]).max() <= 1.2


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_envelopes_reach_what_is_asked(name: str) -> None:
    stored = read_shipped_envelopes(name)
    row = stored.validation["clustering"]
    assert min(row["feasible_count"], row["infeasible_count"]) >= 500
    assert row["feasible"] >= ASKED[name][0]
    assert row["infeasible"] >= ASKED[name][1]
    assert row["feasible"] - row["nlp"] <= 0.01
    best = stored.validation["genetic"]
    assert best["feasible"] * best["infeasible"] >= row["feasible"] * row["infeasible"]
    for table in stored.conditions.values():
        assert set(table) == {"meets", "excludes", "projects"}
        assert all(0 <= share <= 1 for share in table.values())


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="ground3, wall3, wall5"):
        read_shipped_envelopes("ceiling")
