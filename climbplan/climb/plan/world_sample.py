"""In how many sampled worlds of its stated uncertainty a plan stands, as stored in its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

MIN_STANDING = 0.95  # fraction of worlds; a plan that stands in fewer keeps no margin for them
_Z = 1.959963984540054  # of the normal distribution, for 95 %


@dataclass(frozen=True)
class WorldSample:
    """Falls in worlds 0 to `worlds` - 1 of a seed, a Monte Carlo sample of the uncertainty."""

    engine: str
    seed: int  # `simulate --worlds N --seed SEED --engine ENGINE` plays the same worlds
    worlds: int
    falls: int
    lower: float  # of the probability to stand, Wilson score interval, 95 %
    upper: float
    uncertainty: Mapping[str, Any]  # distributions by quantity: kind and two numbers, SI units
    causes: tuple[str, ...] = ()  # what went wrong first in how many worlds, most frequent first

    @property
    def stands(self) -> str:
        """The count in one phrase: "stands in 97 of 100 worlds"."""
        return f"stands in {self.worlds - self.falls} of {self.worlds} worlds"

    @property
    def interval(self) -> str:
        """The Wilson interval of the probability to stand: "95 % interval 92 to 99 %"."""
        return f"95 % interval {100 * self.lower:.0f} to {100 * self.upper:.0f} %"

    @property
    def enough(self) -> bool:
        """Return whether the plan stands in at least `MIN_STANDING` of the worlds."""
        return self.worlds - self.falls >= MIN_STANDING * self.worlds

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values."""
        return {**vars(self), "uncertainty": dict(self.uncertainty), "causes": list(self.causes)}


REQUIRED = ("engine", "seed", "worlds", "falls", "lower", "upper", "uncertainty")


def parse_sample(values: Mapping[str, Any]) -> WorldSample:
    """Return the sample in a plan file's values; raises ValueError or TypeError otherwise."""
    falls, worlds = int(values["falls"]), int(values["worlds"])
    if not 0 <= falls <= worlds or worlds < 1:
        raise ValueError(f"{falls} falls in {worlds} worlds")
    return WorldSample(
        engine=str(values["engine"]),
        seed=int(values["seed"]),
        worlds=worlds,
        falls=falls,
        lower=float(values["lower"]),
        upper=float(values["upper"]),
        uncertainty=dict(values["uncertainty"]),
        causes=tuple(map(str, values.get("causes", ()))),
    )


def compute_wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson score interval, 95 %, of a probability by `successes` among `trials`."""
    p = successes / trials
    scale = 1 + _Z**2 / trials
    middle = (p + _Z**2 / (2 * trials)) / scale
    half = _Z / scale * sqrt(p * (1 - p) / trials + _Z**2 / (4 * trials**2))
    # Rounding leaves no probability outside of 0 to 1
    return max(middle - half, 0.0), min(middle + half, 1.0)
