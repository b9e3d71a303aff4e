"""The base of all spec models and the types their fields share.

Every field states its unit and meaning; both become the JSON Schema that editors show.
SI units and radians unless a field's name says otherwise (`_deg`, `_mm`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

LARGEST_NUMBER = 1e9  # anything beyond is a slip of units, and its square still a finite float

LARGEST_COUNT = 2**32 - 1  # a seed; of anything else there is less


class SpecModel(BaseModel):
    """Frozen, no unknown keys, no NaN or infinity, no silent conversion of text to numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


class Fault(NamedTuple):
    """Something wrong with a model as a whole, and the dotted key below it that is to blame."""

    key: str  # "" for the model itself
    message: str


def refuse(faults: Sequence[Fault]) -> None:
    """Make a validator report all `faults` at once; an empty sequence passes.

    Args:
        faults: Mistakes, each with its dotted key below the validated model; "" is the model.

    Raises:
        PydanticCustomError: of type `spec`, with the faults in its context.
    """
    if faults:
        text = "; ".join(f"{f.key}: {f.message}" if f.key else f.message for f in faults)
        raise PydanticCustomError("spec", "{text}", {"text": text, "faults": tuple(faults)})


def _plain_number(value: Any) -> Any:
    """Refuse what YAML or pydantic would quietly turn into a number."""
    if isinstance(value, bool | str):
        raise ValueError(f"expected a number, got {value!r}")
    return value


def _sensible_size(value: float) -> float:
    if abs(value) > LARGEST_NUMBER:
        raise ValueError(f"expected a number within +-{LARGEST_NUMBER:g}, got {value!r}")
    return value


def _countable(value: int) -> int:
    if abs(value) > LARGEST_COUNT:
        raise ValueError(f"expected a whole number within +-{LARGEST_COUNT}")
    return value


def quantity(unit: str, description: str, default: Any = ..., **bounds: Any) -> Any:
    """Return a model's field with a unit, such as `quantity("m", "gap of the walls", gt=0)`.

    Args:
        unit: Unit for messages, pages and the JSON Schema; "" for plain numbers.
        description: One line on the key, without the unit.
        default: Value of a key that is left out; `...` makes the key required.
        bounds: Bounds and other arguments of `pydantic.Field` (`ge`, `gt`, `le`, `lt`).
    """
    return Field(
        default,
        description=f"{description} [{unit}]" if unit else description,
        json_schema_extra={"unit": unit},
        **bounds,
    )


# Names end up in messages, pages, tables and file formats, where other characters mean something
NAME_PATTERN = r"^\w[\w .,:/()+'#-]*$"
NAME_WORDS = "a name that begins with a letter or digit, then also spaces and . , : / ( ) + ' # -"


def is_name(text: str) -> bool:
    """Return whether `text` may be the name of a limb, a region or another part."""
    return re.match(NAME_PATTERN, text) is not None and not text.endswith("\n")


def name_field(description: str) -> Any:
    """Return the field of a name, for messages and reports."""
    return Field(min_length=1, pattern=NAME_PATTERN, description=description)


Number = Annotated[float, BeforeValidator(_plain_number), AfterValidator(_sensible_size)]
Count = Annotated[int, BeforeValidator(_plain_number), AfterValidator(_countable)]
Vector = tuple[Number, Number, Number]
Interval = tuple[Number, Number]
