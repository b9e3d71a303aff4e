"""A fuzz test: no command ends in a bug, hangs or fills the memory, whatever is in its files.

`pytest tests/cli/test_mutations.py --fuzz-cases 5000 --fuzz-seed 3` runs more, with another seed.
What fails is printed with the command that repeats it; its folder stays below pytest's own.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mutation_cases import Case, cases, names_of_plans
from mutation_runs import Outcome, Runner, plan_paths

# Mutants of earlier runs that ended in a bug
KNOWN = [
    Case("spec", "envelopes_ground3.yaml", 956993),
]


def test_no_mutant_ends_in_a_bug(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    count, seed = (pytestconfig.getoption(name) for name in ("--fuzz-cases", "--fuzz-seed"))
    plans = plan_paths(tmp_path / "plans", names_of_plans(count))
    codes: Counter[int] = Counter()
    bugs: list[Outcome] = []
    with Runner(tmp_path / "mutants", plans) as runner:
        for case in [*KNOWN, *cases(seed, count, plans)]:
            outcomes = runner.outcomes(case)
            codes.update(outcome.code for outcome in outcomes)
            bugs += [outcome for outcome in outcomes if outcome.is_bug]
    assert not bugs, "\n".join(map(str, bugs))
    assert codes[0] > 0.05 * count  # some change nothing that matters,
    assert codes[2] > 0.3 * count  # most are refused as files,
    assert codes[5] > 0  # and some as plans
