"""Increase the margins of a plan that falls too often, in the rounds and quantities that caused it.

- Each round in which falls began gets MARGIN_FACTOR times the margins of pressure and friction
  (`margins.rounds`).
- If friction differs between worlds with and without a fall, surfaces may lack more of it
  (`margins.slip`).
- If the geometry of surfaces or backlash differs, commands penetrate deeper (`margins.depth`).

Terrain and motors limit the margins. Another gait may help where they do not: an order of limbs
that lifts a corner too early leaves the robot nothing to press with.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.simulation.risk.estimation import RiskEstimate

MARGIN_FACTOR = 1.5  # on the margins of a round in which falls began
MIN_FALL_FRACTION = 0.02  # of all falls, for a round to count
_MIN_STANDARD_ERRORS = 3.0  # by which a quantity differs that causes falls
_SLIP_STEP, _MAX_SLIP = 0.1, 0.6  # fraction of friction that may be missing
_DEPTH_STEP, _MAX_DEPTH = 2e-3, 0.02  # [m] of commands below the surface
_GEOMETRY_KEYS = ("surface_mm", "surface_tilt_deg", "backlash_deg")


@dataclass(frozen=True)
class RequestedMargins:
    """Margins that a plan is requested to have."""

    rounds: dict[int, float]
    slip: float
    depth: float  # [m]
    stated: MarginsSpec
    gait: tuple[str, ...] = ()  # order in which limbs move, of climbs that leave it open

    @property
    def overrides(self) -> list[str]:
        """Overrides of the spec's keys."""
        overrides = []
        if self.rounds:
            pairs = ", ".join(f"{k}: {v:.4g}" for k, v in sorted(self.rounds.items()))
            overrides.append(f"margins.rounds={{{pairs}}}")
        if self.gait:
            overrides.append(f"task.gait=[{', '.join(self.gait)}]")
        if self.slip != self.stated.slip:
            overrides.append(f"margins.slip={self.slip:.4g}")
        if self.depth != self.stated.depth:
            overrides.append(f"margins.depth={self.depth:.4g}")
        return overrides

    @property
    def text(self) -> str:
        """The margins in one line."""
        items = [f"gait {' '.join(self.gait)}"] if self.gait else []
        items += [f"round {k} x {v:.3g}" for k, v in sorted(self.rounds.items())]
        if self.slip != self.stated.slip:
            items.append(f"slip {self.slip:.0%}")
        if self.depth != self.stated.depth:
            items.append(f"depth {1e3 * self.depth:.0f} mm")
        return ", ".join(items) or "as stated"


def read_margins(margins: MarginsSpec) -> RequestedMargins:
    """Return the margins that a spec states."""
    return RequestedMargins(dict(margins.rounds), margins.slip, margins.depth, margins)


def increase_margins(
    margins: RequestedMargins, risk: RiskEstimate, plan: ClimbPlan
) -> RequestedMargins:
    """Increase margins by the falls of a plan; falls before the first instant count for round 1."""
    falls_by_round = Counter(
        int(plan.instants.round[max(o.instant, 0)]) for o in risk.outcomes if o.fallen
    )
    rounds = dict(margins.rounds)
    for number, count in falls_by_round.items():
        if count > MIN_FALL_FRACTION * risk.falls:
            rounds[number] = MARGIN_FACTOR * rounds.get(number, 1.0)
    slip, depth = margins.slip, margins.depth
    different_keys = [key for key, off in risk.parameters if abs(off) >= _MIN_STANDARD_ERRORS]
    if "friction" in different_keys and slip > 0:
        slip = max(slip, min(slip + _SLIP_STEP, _MAX_SLIP))
    if any(key in _GEOMETRY_KEYS for key in different_keys) and depth > 0:
        depth = max(depth, min(depth + _DEPTH_STEP, _MAX_DEPTH))
    return replace(margins, rounds=rounds, slip=slip, depth=depth)


def list_gaits(limbs: tuple[str, ...], excluded: tuple[str, ...]) -> list[tuple[str, ...]]:
    """List gaits to try instead of a given one: opposite limbs in succession, and its reverse.

    limbs: in order around the body, so that the limb half their number on is opposite.
    """
    count, half = len(limbs), len(limbs) // 2
    gaits: list[tuple[str, ...]] = []
    for first in range(half if count % 2 == 0 else 0):
        pairs = [first, *(k for k in range(half) if k != first)]
        gaits.append(tuple(limbs[k + side] for k in pairs for side in (0, half)))
    gaits.append(tuple(reversed(excluded)))
    return [gait for gait in gaits if gait != excluded]
