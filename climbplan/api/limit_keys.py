"""The number of a spec that a search for a limit varies: its range, its unit, its stated value."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_origin

import annotated_types
from pydantic import BaseModel

from climbplan.api.limit_search import Bound, Domain
from climbplan.errors import UsageError
from climbplan.schema.base import LARGEST_COUNT, LARGEST_NUMBER, SpecModel
from climbplan.schema.document import Document, KeyPath
from climbplan.schema.fields import Slot, explain_unknown_key, find_slot
from climbplan.schema.kinds import KINDS
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.renamed_keys import renamed_override

# By unit: the first step away from zero
_FIRST_STEPS = {
    "kg": 0.5,
    "m": 0.02,
    "mm": 2.0,
    "deg": 2.0,
    "rad": 0.05,
    "N": 2.0,
    "N m": 0.2,
    "s": 0.05,
    "m/s": 0.05,
    "rad/s": 0.1,
}
_OTHER_FIRST_STEP = 0.1


@dataclass(frozen=True)
class NumericKey:
    """A key of a spec whose value is a number.

    Attributes:
        key: dotted key, under its present name.
        unit: unit of its values; "" for plain numbers.
        is_integer: whether its values are counts.
        lower: the lower end that the schema sets.
        upper: the upper end that the schema sets.
        stated: value in the spec or, where it has none, the default; None if there is neither.
    """

    key: str
    unit: str
    is_integer: bool
    lower: Bound
    upper: Bound
    stated: float | None

    def format(self, value: float) -> str:
        """Return a value with its unit, such as "1.25 kg"."""
        return f"{value:.6g} {self.unit}".rstrip()

    def to_yaml(self, value: float) -> str:
        """Return a value as `--set` takes it, without loss of digits."""
        return str(int(value)) if self.is_integer else repr(float(value))

    def narrow(self, lower: float | None, upper: float | None) -> Domain:
        """Return the range of a search and its start.

        Args:
            lower: smallest value; None takes the schema's end.
            upper: largest value; None takes the schema's end.

        Raises:
            UsageError: the range is empty, or nothing says where to start.
        """
        for end in (lower, upper):
            if end is not None and not math.isfinite(end):
                raise UsageError(f"{self.key}: expected finite ends of the range, got {end}")
            if end is not None and self.is_integer and end != int(end):
                raise UsageError(f"{self.key}: expected whole numbers, got {end:g}")
        if lower is not None and upper is not None and lower >= upper:
            raise UsageError(
                f"{self.key}: expected a lower end below the upper one, got {lower:g} and {upper:g}"
            )
        start = self.stated
        if start is None:
            start = lower if lower is not None else upper
        if start is None:
            raise UsageError(
                f"{self.key}: the spec has no value of it and there is no default: set one, or "
                "give an end of the range"
            )
        if lower is not None:
            start = max(start, lower)
        if upper is not None:
            start = min(start, upper)
        return Domain(
            start,
            self.lower if lower is None else Bound(lower),
            self.upper if upper is None else Bound(upper),
            1.0 if self.is_integer else _FIRST_STEPS.get(self.unit, _OTHER_FIRST_STEP),
            self.is_integer,
        )


def find_numeric_key(loaded: LoadedSpec, kind: str, key: str) -> NumericKey:
    """Return what a spec and its schema say about a key.

    Args:
        loaded: the spec.
        kind: its kind.
        key: dotted key, entries of lists by their index.

    Raises:
        UsageError: there is no such key, or its value is no number.
    """
    segments = renamed_override(loaded.document, key).split(".")
    path, slot = _follow(KINDS[kind].model, segments, loaded.document)
    key = ".".join(str(segment) for segment in path)
    if not slot.is_number and not slot.or_number:
        raise UsageError(f"{key}: expected a key whose value is a number, not {_describe(slot)}")
    stated = read_value(vars(loaded)["spec"], path)
    is_integer = slot.type is int
    largest = float(LARGEST_COUNT if is_integer else LARGEST_NUMBER)
    is_number = isinstance(stated, int | float) and not isinstance(stated, bool)
    return NumericKey(
        key,
        slot.unit,
        is_integer,
        _find_lower(slot, -largest, is_integer),
        _find_upper(slot, largest, is_integer),
        float(stated) if is_number else None,
    )


def _follow(
    model: type[SpecModel], segments: Sequence[str], document: Document
) -> tuple[KeyPath, Slot]:
    """Return the path and the place of a dotted key; raises UsageError where there is none."""
    slot, path = Slot(model), KeyPath()
    value: Any = document.value
    for segment in segments:
        is_list = get_origin(slot.type) is tuple
        if is_list and not segment.isdecimal():
            raise UsageError(
                f"{'.'.join(segments)}: expected the index of an entry of the list "
                f"`{'.'.join(map(str, path))}`, got {segment!r}"
            )
        name: str | int = int(segment) if is_list else segment
        path = (*path, name)
        below = find_slot(model, path)
        if below is None:
            if is_list:
                raise UsageError(f"{'.'.join(segments)}: there is no entry {segment}")
            message, suggestion = explain_unknown_key(model, path)
            hint = f" (did you mean {suggestion!r}?)" if suggestion else ""
            raise UsageError(f"{'.'.join(segments)}: {message}{hint}")
        value = _enter(value, name)
        if isinstance(value, str) and below.or_text and len(path) < len(segments):
            raise UsageError(
                f"{'.'.join(segments)}: `{'.'.join(map(str, path))}` is {value!r} in the spec, it "
                "has no keys there"
            )
        slot = below
    return path, slot


def _describe(slot: Slot) -> str:
    return "a list of them" if get_origin(slot.type) is tuple else slot.describe_expected()


def _find_lower(slot: Slot, default: float, is_integer: bool) -> Bound:
    for bound in slot.bounds:
        if isinstance(bound, annotated_types.Ge):
            return Bound(_to_float(bound.ge))
        if isinstance(bound, annotated_types.Gt):
            limit = _to_float(bound.gt)
            return Bound(limit + 1) if is_integer else Bound(limit, is_closed=False)
    return Bound(default, is_closed=False)


def _find_upper(slot: Slot, default: float, is_integer: bool) -> Bound:
    for bound in slot.bounds:
        if isinstance(bound, annotated_types.Le):
            return Bound(_to_float(bound.le))
        if isinstance(bound, annotated_types.Lt):
            limit = _to_float(bound.lt)
            return Bound(limit - 1) if is_integer else Bound(limit, is_closed=False)
    return Bound(default, is_closed=False)


def _to_float(limit: Any) -> float:
    return float(limit)


def read_value(spec: object, path: KeyPath) -> Any:
    """Return the value of a validated spec at a path, defaults included; None where none is."""
    value: Any = spec
    for segment in path:
        value = _enter(value, segment)
    return value


def _enter(value: Any, segment: str | int) -> Any:
    if isinstance(value, BaseModel):
        return getattr(value, str(segment), None)
    if isinstance(value, Mapping):
        return value.get(segment)
    if isinstance(value, list | tuple) and isinstance(segment, int) and segment < len(value):
        return value[segment]
    return None
