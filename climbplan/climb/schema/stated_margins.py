"""Margins widened by the uncertainty that a spec states.

A margin that the spec states is kept, and none is less than its default. Defaults cover bounds of a
tenth of stiffness, a fifth of friction and 3 mm of surfaces. Of a uniform distribution the farther
end counts, of a normal one two standard deviations.
"""

from __future__ import annotations

from typing import Any

from climbplan.climb.schema.margins import MarginsSpec
from climbplan.schema.robots.uncertainty import SpreadSpec, UncertaintySpec

_NUM_SIGMAS = 2.0
_FRICTION_PER_STIFFNESS = (
    0.8  # weights that a toe may miss, by the share of stiffness that is uncertain
)
_EXTRA_DEPTH = 2e-3  # [m] deeper than a surface may lie behind its place
_EXTRA_EDGE_DISTANCE = 5e-3  # [m] farther from edges than footholds are missed by
_MAX_MARGINS = {"slip": 0.6, "friction": 0.3, "depth": 0.02, "edge": 0.05}


def widen_margins(
    margins: MarginsSpec, uncertainty: UncertaintySpec, safety_friction: float = 1.0
) -> MarginsSpec:
    """Return the margins, with unstated ones as large as the stated uncertainty.

    Args:
        margins: Margins of the spec.
        uncertainty: Uncertainty of the spec.
        safety_friction: S_mu that is kept on a surface that lacks friction as well. Grips need it,
            since they have no margin of their own for force errors.
    """
    if not margins.asked:
        return margins
    widened = {}
    for name, key, scale, extra in (
        ("slip", "friction", 1.0, 0.0),
        ("friction", "joint_stiffness", _FRICTION_PER_STIFFNESS, 0.0),
        ("depth", "surface_mm", 1e-3, _EXTRA_DEPTH),
        ("edge", "toe_placement_mm", 1e-3, _EXTRA_EDGE_DISTANCE),
    ):
        if key not in uncertainty.model_fields_set or name in margins.model_fields_set:
            continue
        size = scale * _compute_max_deviation(getattr(uncertainty, key), key != "joint_stiffness")
        if name == "slip":
            size = 1 - (1 - size) / safety_friction if 0 < size < 1 else size
        if size > 0:
            widened[name] = max(getattr(margins, name), min(size + extra, _MAX_MARGINS[name]))
    return margins.model_copy(update=widened) if widened else margins


def _compute_max_deviation(spread: Any, only_below: bool) -> float:
    """Return how far a quantity may be off; only_below: uniform ones below nominal only."""
    if not isinstance(spread, SpreadSpec):
        return _NUM_SIGMAS * float(spread)
    if spread.uniform is not None:
        low, high = spread.uniform
        return max(-low, 0.0) if only_below else max(-low, high, 0.0)
    return _NUM_SIGMAS * float(spread.normal or 0.0)
