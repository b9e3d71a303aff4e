"""Evaluate how well a trained strategy ranks the integers of unseen problems."""

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
class RankingEvaluation:
    """Ranks of the optimum's integers (or cluster) among candidates, for T held-out problems."""

    place: IntArray  # (T,) rank from 0; -1 if not among the candidates
    probability: Array  # (T,) of the first candidate, NaN where the strategy gives none
    hard: BoolArray  # (T,) problems that are reported separately

    def compute_recall(self, first: int, hard: bool = False) -> float:
        """Return how many problems have their integers among the first candidates, in fractions.

        The result is NaN without any problem."""
        chosen = self.place[self.hard] if hard else self.place
        return float(((chosen >= 0) & (chosen < first)).mean()) if len(chosen) else float("nan")

    def compute_calibration(self) -> list[dict[str, float]]:
        """Return how often the first candidate is right, for fifths of its probability."""
        bins = []
        for low, high in itertools.pairwise(_BINS):
            upper = self.probability <= high if high == 1 else self.probability < high
            inside = (self.probability >= low) & upper
            if inside.any():
                bins.append(
                    {
                        "predicted": float(self.probability[inside].mean()),
                        "observed": float((self.place[inside] == 0).mean()),
                        "problems": int(inside.sum()),
                    }
                )
        return bins

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for reports."""
        return {
            "problems": len(self.place),
            "hard_problems": int(self.hard.sum()),
            "within_first": {str(k): self.compute_recall(k) for k in FIRST},
            "within_first_hard": {str(k): self.compute_recall(k, True) for k in FIRST},
            "calibration": self.compute_calibration(),
        }


def select_held_out(groups: IntArray, fraction: float, seed: int) -> BoolArray:
    """Select rows (S,) to hold out: whole groups (S,), so no scene is in both sets."""
    kinds = np.unique(groups)
    count = round(fraction * len(kinds))
    chosen = np.random.default_rng(seed).permutation(kinds)[:count]
    return np.asarray(np.isin(groups, chosen))


def evaluate(
    model: StrategyModel, test: Library, hard: Sequence[bool] | BoolArray, max_candidates: int = 50
) -> RankingEvaluation:
    """Rank the candidates of a model for solved problems on which it was not trained."""
    strategy = model.create_strategy()
    key = _build_keys(model.library)
    number = {row.tobytes(): k for k, row in enumerate(key)}
    true_strategy = [number.get(row.tobytes(), -1) for row in _build_keys(test)]
    place = np.full(test.size, -1, np.int64)
    probability = np.full(test.size, np.nan)
    for k in range(test.size):
        candidates = strategy.candidates(test.features[k], max_candidates)
        order = list(dict.fromkeys(candidate.number for candidate in candidates))
        right = true_strategy[test.strategy[k]]
        place[k] = order.index(right) if right in order else -1
        if model.classifier is not None:
            probability[k] = float(model.classifier.probabilities(test.features[k]).max())
    if model.kind == "reduce":
        probability[:] = np.nan  # its probabilities are of clusters, not of integers
    return RankingEvaluation(place, probability, np.asarray(hard, bool))


def _build_keys(library: Library) -> IntArray:
    """Return the integers of each strategy."""
    return np.ascontiguousarray(
        np.hstack(
            [
                library.strategies.astype(np.int64),
                library.strategy_alternatives,
                library.strategy_labels,
            ]
        )
    )
