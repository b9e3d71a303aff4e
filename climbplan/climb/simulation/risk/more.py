"""What a plan that falls too often is asked for next: margins where and by what it fell.

Each round in which falls began is asked for STEP times the margins of pressure and friction
(`margins.rounds`). Where friction tells worlds that fall from worlds that stand, surfaces may lack
more of it (`margins.slip`); where the place of surfaces or play does, commands lie deeper
(`margins.depth`). Where no margins help, which terrain and motors allow, another order of the limbs
may: one that lifts a corner before the limbs beside it have found a wall has nothing to press with.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.simulation.risk.judging import Judged

STEP = 1.5  # factor on margins of a round in which falls began
FEW = 0.02  # part of the falls from which a round counts
_TELLS = 3.0  # standard errors by which a quantity differs where it fells
_SLIP, _MOST_SLIP = 0.1, 0.6  # added to the share of friction that may lack, and the most
_DEPTH, _MOST_DEPTH = 2e-3, 0.02  # [m] likewise
_PLACES = ("surface_mm", "surface_tilt_deg", "backlash_deg")


@dataclass(frozen=True)
class More:
    """Margins asked for."""

    rounds: dict[int, float]
    slip: float
    depth: float  # [m]
    stated: MarginsSpec
    gait: tuple[str, ...] = ()  # order in which limbs move, of climbs that leave it open

    @property
    def overrides(self) -> list[str]:
        """Of a spec."""
        out = []
        if self.rounds:
            words = ", ".join(f"{k}: {v:.4g}" for k, v in sorted(self.rounds.items()))
            out.append(f"margins.rounds={{{words}}}")
        if self.gait:
            out.append(f"task.gait=[{', '.join(self.gait)}]")
        if self.slip != self.stated.slip:
            out.append(f"margins.slip={self.slip:.4g}")
        if self.depth != self.stated.depth:
            out.append(f"margins.depth={self.depth:.4g}")
        return out

    @property
    def words(self) -> str:
        """In a line."""
        out = [f"gait {' '.join(self.gait)}"] if self.gait else []
        out += [f"round {k} x {v:.3g}" for k, v in sorted(self.rounds.items())]
        if self.slip != self.stated.slip:
            out.append(f"slip {self.slip:.0%}")
        if self.depth != self.stated.depth:
            out.append(f"depth {1e3 * self.depth:.0f} mm")
        return ", ".join(out) or "as stated"


def as_stated(margins: MarginsSpec) -> More:
    """What a spec asks for by itself."""
    return More(dict(margins.rounds), margins.slip, margins.depth, margins)


def more(asked: More, judged: Judged, plan: ClimbPlan) -> More:
    """More of it by how a plan fell; falls before the first instant count for round 1."""
    began = Counter(
        int(plan.instants.round[max(o.instant, 0)]) for o in judged.outcomes if o.fallen
    )
    rounds = dict(asked.rounds)
    for number, many in began.items():
        if many > FEW * judged.falls:
            rounds[number] = STEP * rounds.get(number, 1.0)
    slip, depth = asked.slip, asked.depth
    told = [key for key, off in judged.parameters if abs(off) >= _TELLS]
    if "friction" in told and slip > 0:
        slip = max(slip, min(slip + _SLIP, _MOST_SLIP))
    if any(key in _PLACES for key in told) and depth > 0:
        depth = max(depth, min(depth + _DEPTH, _MOST_DEPTH))
    return replace(asked, rounds=rounds, slip=slip, depth=depth)


def gaits(limbs: tuple[str, ...], given: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Orders to try instead of a given one: opposite limbs after one another, from each in turn.

    limbs: around the body, as robots list them, so that half of their number on is opposite.
    """
    count, half = len(limbs), len(limbs) // 2
    out: list[tuple[str, ...]] = []
    for first in range(half if count % 2 == 0 else 0):
        pairs = [first, *(k for k in range(half) if k != first)]
        out.append(tuple(limbs[k + side] for k in pairs for side in (0, half)))
    out.append(tuple(reversed(given)))
    return [one for one in out if one != given]
