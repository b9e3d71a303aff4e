"""`climbplan bench engine` on a few steps: every contender proves the same cost."""

from __future__ import annotations

import io

import pytest

from climbplan.bench.engine import run as benchmark


@pytest.mark.slow
def test_every_contender_proves_the_same_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "_STEPS", 3)
    monkeypatch.setattr(benchmark, "_QUICK", 1)
    monkeypatch.setattr(benchmark, "_NOISE", (0.001,))
    stream = io.StringIO()
    benchmark.run_engine(0, True, stream)
    rows = [line.split() for line in stream.getvalue().splitlines()[1:]]
    assert [row[1] for row in rows] == ["tree,", "tree,", "daqp,", "micp", "minlp-scip"]
    for row in rows:
        assert float(row[-1]) < 2e-3  # cost off by
        # problems, proved: DAQP's own mode has no bound to show
        assert row[-7] == ("0" if row[1] == "daqp," else row[-8])
