"""Mutants of all that is shipped: no command ends in a bug or hangs, whatever is in its files.

What fails is printed with the command that repeats it; its folder stays below pytest's own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from mutation_cases import PLANS, QUICK_PLANS, Case, Outcome, Worker, cases, made_plans

SAMPLE = 8
ALL = 1000
# Mutants of earlier runs that ended in a bug
KNOWN = [
    Case("spec", "envelopes_ground3.yaml", 956993),
    Case("plan", "climb_tube", 352801),  # a body of 1e9 m, and a figure as tall
]


def run_all(worker: Worker, chosen: list[Case]) -> Counter[int]:
    """How the commands ended; fails with all those that ended in a bug."""
    codes: Counter[int] = Counter()
    bugs: list[Outcome] = []
    for case in chosen:
        found = worker.outcomes(case)
        codes.update(outcome.code for outcome in found)
        bugs += [outcome for outcome in found if outcome.is_bug]
    assert not bugs, "\n".join(map(str, bugs))
    return codes


@pytest.fixture
def worker(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Worker]:
    """What runs mutants, with plans of the kinds that the test names."""
    plans = made_plans(tmp_path / "plans", request.param)
    with Worker(tmp_path / "mutants", plans) as worker:
        yield worker


@pytest.mark.slow
@pytest.mark.parametrize("worker", [QUICK_PLANS], indirect=True)
def test_a_sample(worker: Worker) -> None:
    codes = run_all(worker, [*KNOWN, *cases(7, SAMPLE, worker.plans)])
    assert codes[0] > 0  # some change nothing that matters,
    assert codes[2] > 2  # some are refused as files
    assert codes[5] > 0  # and some as plans


@pytest.mark.slow
@pytest.mark.parametrize("worker", [tuple(PLANS)], indirect=True)
@pytest.mark.parametrize("seed", [1])
def test_all(worker: Worker, seed: int) -> None:
    codes = run_all(worker, cases(seed, ALL, worker.plans))
    assert sum(codes.values()) > ALL
    assert min(codes[0], codes[2], codes[5]) > ALL / 20
