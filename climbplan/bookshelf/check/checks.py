"""Result of a placement check: the residual of every named constraint in every scene.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray


@dataclass(frozen=True)
class NamedResidual:
    """One constraint over S scenes. Residuals below zero are margins; NaN never passes."""

    name: str  # dotted, stable: reports and tests are keyed by it
    unit: str  # "mm" or "rad" ("" for sines)
    limit: float  # largest residual that passes
    residual: Array  # (S,) of the worst place of each scene
    place: tuple[str, ...]  # (S,) where that is: "books 0 and 1", "inserted"

    @property
    def passed(self) -> BoolArray:
        """Mask (S,) of the scenes that pass."""
        return self.residual <= self.limit

    @property
    def severity(self) -> Array:
        """Residuals in units of the limit (S,); infinite for NaN."""
        if self.limit > 0:
            severity: Array = self.residual / self.limit
        else:
            severity = np.where(self.residual > 0, math.inf, 0.0)
        return np.where(np.isnan(self.residual), math.inf, severity)


@dataclass(frozen=True)
class PlacementCheck:
    """All constraints of one meaning over S scenes."""

    meaning: str  # "contact" or "published"
    items: tuple[NamedResidual, ...]

    @property
    def passed(self) -> BoolArray:
        """Scenes in which every constraint holds (S,)."""
        return np.all([item.passed for item in self.items], axis=0)

    def __getitem__(self, name: str) -> NamedResidual:
        for item in self.items:
            if item.name == name:
                return item
        raise KeyError(name)

    def worst(self, scene: int) -> NamedResidual:
        """The constraint of a scene that is farthest beyond its limit, or nearest to it."""
        return max(self.items, key=lambda item: float(item.severity[scene]))

    def explain(self, scene: int) -> str:
        """One line a constraint that a scene breaks; empty if it breaks none."""
        return "\n".join(
            f"{item.name}: {item.residual[scene]:.3g} {item.unit}".rstrip()
            + f" at {item.place[scene]} (at most {item.limit:g})"
            for item in self.items
            if not item.passed[scene]
        )


def select_worst(
    name: str, unit: str, limit: float, residuals: Array, places: list[str]
) -> NamedResidual:
    """Select the worst of K places in every scene; NaN is worse than every number.

    Args:
        name: dotted name of the constraint.
        unit: "mm" or "rad", empty for sines.
        limit: largest residual that passes, in this unit.
        residuals: (S, K) by scene and place.
        places: K names for messages.
    """
    scenes = len(residuals)
    if not places:
        return NamedResidual(name, unit, limit, np.zeros(scenes), ("",) * scenes)
    worst = np.argmax(np.where(np.isnan(residuals), np.inf, residuals), axis=1)
    chosen = residuals[np.arange(scenes), worst]
    return NamedResidual(name, unit, limit, chosen, tuple(places[k] for k in worst))
