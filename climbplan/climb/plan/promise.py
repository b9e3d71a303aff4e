"""What a plan promises of falls: counted in worlds of its uncertainty, with an exact interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Promise:
    """Falls in worlds that nothing was chosen by."""

    risk: float  # largest probability of a fall that the spec allows
    engine: str
    # Of the worlds: `simulate --worlds N --seed SEED --engine ENGINE` repeats them, with
    # `--closed-loop` where falls were counted so
    seed: int
    worlds: int
    falls: int
    lower: float  # of the probability, 95 % (Clopper and Pearson)
    upper: float
    uncertainty: Mapping[str, Any]  # distributions by quantity: kind and two numbers, SI units
    fells: tuple[str, ...]  # what went wrong first in how many worlds, most first
    helps: tuple[str, ...]  # what would be needed, where the promise is not met
    tried: tuple[str, ...]  # plans judged on the way: margins asked for, and falls
    closed_loop: bool = False  # whether falls were counted in closed-loop execution
    stops: int = 0  # worlds in which the robot then stopped before its goal, and stands

    @property
    def met(self) -> bool:
        """True if the upper limit is within the risk."""
        return self.upper <= self.risk

    @property
    def words(self) -> str:
        """The promise in one line: "stands in 2990 of 3000 worlds"."""
        execution = " in closed loop" if self.closed_loop else ""
        stops = f", stops before its goal in {self.stops}" if self.stops else ""
        return f"stands in {self.worlds - self.falls} of {self.worlds} worlds{execution}{stops}"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values."""
        return {**vars(self), "uncertainty": dict(self.uncertainty), "met": self.met}


NEEDED = ("risk", "engine", "seed", "worlds", "falls", "lower", "upper", "uncertainty")


def parse_promise(stored_values: Mapping[str, Any]) -> Promise:
    """Return the promise in a plan file's values; raises ValueError or TypeError otherwise."""
    falls, worlds = int(stored_values["falls"]), int(stored_values["worlds"])
    if not 0 <= falls <= worlds or worlds < 1:
        raise ValueError(f"{falls} falls in {worlds} worlds")
    stops = int(stored_values.get("stops", 0))
    if not 0 <= stops <= worlds - falls:
        raise ValueError(f"{falls} falls and {stops} stops in {worlds} worlds")
    fells, helps, tried = (
        tuple(map(str, stored_values.get(name, ()))) for name in ("fells", "helps", "tried")
    )
    return Promise(
        risk=float(stored_values["risk"]),
        engine=str(stored_values["engine"]),
        seed=int(stored_values["seed"]),
        worlds=worlds,
        falls=falls,
        lower=float(stored_values["lower"]),
        upper=float(stored_values["upper"]),
        uncertainty=dict(stored_values["uncertainty"]),
        fells=fells,
        helps=helps,
        tried=tried,
        closed_loop=bool(stored_values.get("closed_loop", False)),
        stops=stops,
    )


def compute_interval(falls: int, worlds: int) -> tuple[float, float]:
    """Return the exact 95 % interval of a probability (Clopper and Pearson 1934), by counts."""
    from scipy.special import betaincinv

    tail = (1 - CONFIDENCE) / 2
    low = float(betaincinv(falls, worlds - falls + 1, tail)) if falls else 0.0
    high = float(betaincinv(falls + 1, worlds - falls, 1 - tail)) if falls < worlds else 1.0
    return low, high
