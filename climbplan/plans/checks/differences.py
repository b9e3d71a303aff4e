"""How far what a plan stores is from what its spec says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Difference:
    """How far a stored value is from the spec's."""

    key: str
    size: float


def apart(key: str, stored: Any, asked: Any) -> Difference:
    """Largest absolute difference; infinite if the shapes differ."""
    a, b = np.asarray(stored, float), np.asarray(asked, float)
    if a.shape != b.shape:
        return Difference(key, math.inf)
    return Difference(key, float(np.abs(a - b).max(initial=0.0)))


def same(key: str, equal: bool) -> Difference:
    return Difference(key, 0.0 if equal else math.inf)
