"""A study's axes: what each key means, and where the plan itself stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.pages.plan_spec import parse_plan_spec
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.climb.schema.model import ClimbSpec
from climbplan.schema.base import SpecModel
from climbplan.schema.fields import Slot


@dataclass(frozen=True)
class StudyAxis:
    """One key of a study's grid."""

    key: str
    unit: str  # "" for pure numbers
    values: Array  # (C,)
    own: float | None  # the plan's own value

    @property
    def label(self) -> str:
        """Key and unit, such as "terrain.walls.angle_deg [deg]"."""
        return f"{self.key} [{self.unit}]" if self.unit else self.key


def _split_key(key: str) -> list[str | int]:
    return [int(segment) if segment.isdigit() else segment for segment in key.split(".")]


def _find_unit(key: str) -> str:
    slot: Slot | None = Slot(ClimbSpec)
    for segment in _split_key(key):
        slot = slot.child(segment) if slot is not None else None
    return slot.unit if slot is not None else ""


def _read_plan_value(spec: SpecModel | None, key: str) -> float | None:
    """Return the number at a key of the plan's spec, defaults included; None if there is none."""
    value: object = spec.model_dump() if spec is not None else None
    for segment in _split_key(key):
        if isinstance(value, dict):
            value = value.get(str(segment))
        elif isinstance(value, (list, tuple)) and isinstance(segment, int) and segment < len(value):
            value = value[segment]
        else:
            return None
    return float(value) if isinstance(value, (int, float)) else None


def build_study_axes(plan: ClimbPlan, study: Study) -> tuple[StudyAxis, ...]:
    """Return the one or two axes of a plan's study."""
    spec = parse_plan_spec(plan)
    return tuple(
        StudyAxis(key, _find_unit(key), np.asarray(values), _read_plan_value(spec, key))
        for key, values in zip(study.keys, study.values, strict=True)
    )


def compute_cell_edges(values: Array) -> Array:
    """Return borders (C+1,) half way between ascending grid values (C,)."""
    if len(values) == 1:
        half = 0.5 * abs(values[0]) or 0.5
        return np.array([values[0] - half, values[0] + half])
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
