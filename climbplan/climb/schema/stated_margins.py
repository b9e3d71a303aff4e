"""Margins that a spec's own uncertainty asks for, where it says how uncertain things are.

A margin that the spec states stays what it says, and none is less than its default, which covers a
tenth of stiffness, a fifth of friction and 3 mm of surfaces, read as bounds. Of a distribution its
farther end counts, of a normal one two standard deviations.
"""

from __future__ import annotations

from typing import Any

from climbplan.climb.schema.margins import MarginsSpec
from climbplan.schema.robots.uncertainty import SpreadSpec, UncertaintySpec

_SIGMAS = 2.0
_FRICTION = 0.8  # weights that a toe may miss, by the share of stiffness that is uncertain
_ROOM = 2e-3  # [m] deeper than a surface may lie behind its place
_ASIDE = 5e-3  # [m] farther from edges than footholds are missed by
_MOST = {"slip": 0.6, "friction": 0.3, "depth": 0.02, "edge": 0.05}


def margins_stated(
    margins: MarginsSpec, uncertainty: UncertaintySpec, beside: float = 1.0
) -> MarginsSpec:
    """The margins with those that are not stated as large as what is stated to be uncertain.

    beside: S_mu that is kept on a surface that lacks friction as well. Grips need it: they have no
    margin of their own for forces that are not what they were believed to be.
    """
    if not margins.asked:
        return margins
    asked = {}
    for name, key, scale, room in (
        ("slip", "friction", 1.0, 0.0),
        ("friction", "joint_stiffness", _FRICTION, 0.0),
        ("depth", "surface_mm", 1e-3, _ROOM),
        ("edge", "toe_placement_mm", 1e-3, _ASIDE),
    ):
        if key not in uncertainty.model_fields_set or name in margins.model_fields_set:
            continue
        size = scale * _farthest(getattr(uncertainty, key), key != "joint_stiffness")
        if name == "slip":
            size = 1 - (1 - size) / beside if 0 < size < 1 else size
        if size > 0:
            asked[name] = max(getattr(margins, name), min(size + room, _MOST[name]))
    return margins.model_copy(update=asked) if asked else margins


def _farthest(spread: Any, below: bool) -> float:
    """How far a quantity may be off; below: of uniform ones only less than nominal does harm."""
    if not isinstance(spread, SpreadSpec):
        return _SIGMAS * float(spread)
    if spread.uniform is not None:
        low, high = spread.uniform
        return max(-low, 0.0) if below else max(-low, high, 0.0)
    return _SIGMAS * float(spread.normal or 0.0)
