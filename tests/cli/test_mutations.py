"""A fuzz test: no command ends in a bug, hangs or fills the memory, whatever is in its files.

`pytest tests/cli/test_mutations.py --fuzz-cases 5000 --fuzz-seed 3` runs more, with another seed.
What fails is printed with the command that repeats it; its folder stays below pytest's own.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mutation_cases import FEW, PLANS, QUICK_PLANS, Case, Outcome, Worker, cases, made_plans

# Mutants of earlier runs that ended in a bug
KNOWN = [
    Case("spec", "envelopes_ground3.yaml", 956993),
    Case("plan", "climb_tube", 352801),  # a body of 1e9 m, and a figure as tall
]


@pytest.mark.slow
def test_no_mutant_ends_in_a_bug(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    count, seed = (pytestconfig.getoption(name) for name in ("--fuzz-cases", "--fuzz-seed"))
    plans = made_plans(tmp_path / "plans", QUICK_PLANS if count <= FEW else tuple(PLANS))
    codes: Counter[int] = Counter()
    bugs: list[Outcome] = []
    with Worker(tmp_path / "mutants", plans) as worker:
        for case in [*KNOWN, *cases(seed, count, plans)]:
            found = worker.outcomes(case)
            codes.update(outcome.code for outcome in found)
            bugs += [outcome for outcome in found if outcome.is_bug]
    assert not bugs, "\n".join(map(str, bugs))
    assert codes[0] > 0.05 * count  # some change nothing that matters,
    assert codes[2] > 0.3 * count  # most are refused as files,
    assert codes[5] > 0  # and some as plans
