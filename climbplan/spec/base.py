"""The base of all spec models and the types their fields share.

Every field states its unit and meaning; both become the JSON Schema that editors show.
SI units and radians unless a field's name says otherwise (`_deg`, `_mm`).
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


class SpecModel(BaseModel):
    """Frozen, no unknown keys, no NaN or infinity, no silent conversion of text to numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


def _plain_number(value: Any) -> Any:
    """Refuse what YAML or pydantic would quietly turn into a number."""
    if isinstance(value, (bool, str)):
        raise ValueError(f"expected a number, got {value!r}")
    return value


def quantity(unit: str, description: str, default: Any = ..., **bounds: Any) -> Any:
    """A field with a unit: `gap: Number = quantity("m", "distance between the walls", gt=0)`."""
    return Field(
        default,
        description=f"{description} [{unit}]" if unit else description,
        json_schema_extra={"unit": unit},
        **bounds,
    )


Number = Annotated[float, BeforeValidator(_plain_number)]
Count = Annotated[int, BeforeValidator(_plain_number)]
Vector = tuple[Number, Number, Number]
Interval = tuple[Number, Number]
