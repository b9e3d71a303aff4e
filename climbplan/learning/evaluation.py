"""How well a trained strategy ranks the integers of problems that it has not seen."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel

FIRST = (1, 3, 5, 10, 20, 50)
_BINS = np.linspace(0.0, 1.0, 6)


@dataclass(frozen=True)
class Evaluation:
    """Of T problems held out: where the optimum's integers (or cluster) stand among candidates."""

    place: IntArray  # (T,) from 0; -1 if not among them
    probability: Array  # (T,) of the first candidate, NaN where the strategy gives none
    hard: BoolArray  # (T,) problems that are reported apart

    def within(self, first: int, hard: bool = False) -> float:
        """Share of problems whose integers are among the first candidates; NaN of none."""
        chosen = self.place[self.hard] if hard else self.place
        return float(((chosen >= 0) & (chosen < first)).mean()) if len(chosen) else float("nan")

    def calibration(self) -> list[dict[str, float]]:
        """For probabilities of the first candidate in fifths: how often it is right."""
        out = []
        for low, high in itertools.pairwise(_BINS):
            upper = self.probability <= high if high == 1 else self.probability < high
            inside = (self.probability >= low) & upper
            if inside.any():
                out.append(
                    {
                        "predicted": float(self.probability[inside].mean()),
                        "observed": float((self.place[inside] == 0).mean()),
                        "problems": int(inside.sum()),
                    }
                )
        return out

    def as_dict(self) -> dict[str, Any]:
        """For reports."""
        return {
            "problems": len(self.place),
            "hard_problems": int(self.hard.sum()),
            "within_first": {str(k): self.within(k) for k in FIRST},
            "within_first_hard": {str(k): self.within(k, True) for k in FIRST},
            "calibration": self.calibration(),
        }


def held_out(groups: IntArray, share: float, seed: int) -> BoolArray:
    """Which rows (S,) to hold out: whole groups (S,), so that no scene is on both sides."""
    kinds = np.unique(groups)
    count = round(share * len(kinds))
    chosen = np.random.default_rng(seed).permutation(kinds)[:count]
    return np.asarray(np.isin(groups, chosen))


def evaluate(
    model: StrategyModel, test: Library, hard: Sequence[bool] | BoolArray, most: int = 50
) -> Evaluation:
    """Rank the candidates of a model for solved problems that it was not trained on."""
    strategy = model.strategy()
    key = _keys(model.library)
    number = {row.tobytes(): k for k, row in enumerate(key)}
    wanted = [number.get(row.tobytes(), -1) for row in _keys(test)]
    place = np.full(test.size, -1, np.int64)
    probability = np.full(test.size, np.nan)
    for k in range(test.size):
        found = strategy.candidates(test.features[k], most)
        order = list(dict.fromkeys(candidate.number for candidate in found))
        right = wanted[test.strategy[k]]
        place[k] = order.index(right) if right in order else -1
        if model.classifier is not None:
            probability[k] = float(model.classifier.probabilities(test.features[k]).max())
    if model.kind == "reduce":
        probability[:] = np.nan  # its probabilities are of clusters, not of integers
    return Evaluation(place, probability, np.asarray(hard, bool))


def _keys(library: Library) -> IntArray:
    return np.ascontiguousarray(
        np.hstack(
            [
                library.strategies.astype(np.int64),
                library.strategy_alternatives,
                library.strategy_labels,
            ]
        )
    )
