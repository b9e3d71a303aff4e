"""A problem kind whose rows take no time, and that die, hang or raise where they are told to."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.datasets.recipe import Recipe
from climbplan.store.dataset import DatasetFrame, build_solution_layout
from climbplan.store.dataset_row import RowAnswer

FRAME = DatasetFrame(
    kind="toy",
    problem="toy",
    facts={"size": 2},
    parameter_names=("a", "b"),
    integer_names=("sign",),
    layouts={"x": build_solution_layout((2,), "m")},
)


@dataclass
class ToyRows:
    """x = -parameters; `trouble`: what happens at the n-th row that this process draws."""

    trouble: Mapping[str, str] = field(default_factory=dict)  # "draw" or "solve" -> what
    below: float = 0.0  # where the first parameter is below this
    once: str = ""  # a directory: each row is troubled only the first time
    frame: DatasetFrame = FRAME

    def draw(self, rng: np.random.Generator) -> Array:
        drawn = rng.uniform(0.0, 1.0, 2)
        self._trouble("draw", drawn)
        return drawn

    def parameters(self, drawn: Array) -> Array:
        return drawn

    def solve(self, drawn: Array) -> RowAnswer:
        self._trouble("solve", drawn)
        if drawn[1] < 0.1:
            return RowAnswer("infeasible", "no way", bound=np.inf)
        sign = np.array([int(drawn[0] > 0.5)])
        return RowAnswer("optimal", "", {"x": -drawn}, sign, float(drawn.sum()), 0.0, 1e-3)

    def _trouble(self, stage: str, drawn: Array) -> None:
        what = self.trouble.get(stage)
        if what is None or drawn[0] >= self.below:
            return
        if self.once:
            mark = Path(self.once, f"{drawn[0]!r}")
            if mark.exists():
                return
            mark.touch()
        if what == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "hang":
            time.sleep(600)
        elif what == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        raise ValueError("told to raise")


def toy_source(trouble: Mapping[str, str], below: float, once: str) -> ToyRows:
    """As a worker makes it."""
    return ToyRows(trouble, below, once)


def toy_recipe(
    trouble: Mapping[str, str] | None = None,
    below: float = 0.15,
    once: Path | None = None,
    seconds: float = 60.0,
) -> Recipe:
    """Rows of seed 3; those whose first parameter is `below` are in trouble."""
    source = partial(toy_source, dict(trouble or {}), below, "" if once is None else str(once))
    return Recipe(source, 3, seconds, f"toy {trouble} {once}")
