"""Describe what a spec model allows at a key path, read from the model itself."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

from climbplan.schema.base import NAME_PATTERN, NAME_WORDS, SpecModel
from climbplan.schema.document import KeyPath

# Segments that pydantic adds below a field that is a text, a number or a mapping; they are no keys.
FILE_TAG, MAPPING_TAG, NUMBER_TAG = "<file>", "<mapping>", "<number>"
_COUNTS = {1: "one", 2: "two", 3: "three", 4: "four", 6: "six"}


@dataclass(frozen=True)
class Slot:
    """A place in a spec: the type that belongs there, its bounds, unit and meaning."""

    type: Any  # without Annotated and None
    bounds: tuple[Any, ...] = ()
    unit: str = ""
    meaning: str = ""
    or_text: bool = False  # a text may stand here instead of the mapping
    or_number: bool = False  # a number may
    or_words: tuple[str, ...] = ()  # one of these words may

    @property
    def model(self) -> type[SpecModel] | None:
        """The model whose keys stand below this place, if it is a mapping with fixed keys."""
        is_model = isinstance(self.type, type) and issubclass(self.type, SpecModel)
        return self.type if is_model else None

    @property
    def is_number(self) -> bool:
        return self.type in (int, float)

    @property
    def choices(self) -> tuple[str, ...]:
        """The texts allowed, if only some are."""
        return get_args(self.type) if get_origin(self.type) is Literal else ()

    def child(self, segment: str | int) -> Slot | None:
        """Return the place one key or list index further down; None if there is none."""
        if self.model is not None:
            field = self.model.model_fields.get(str(segment))
            return None if field is None else _build_slot(field)
        arguments = get_args(self.type)
        if get_origin(self.type) is tuple and isinstance(segment, int):
            if arguments[-1] is Ellipsis:
                return self._element(arguments[0])
            return self._element(arguments[segment]) if segment < len(arguments) else None
        if get_origin(self.type) is dict:
            return self._element(arguments[1])
        return None

    def _element(self, annotation: Any) -> Slot:
        inner_type, bounds = _strip_annotation(annotation)
        return Slot(inner_type, bounds, self.unit, self.meaning)

    def describe_expected(self) -> str:
        """Return what belongs here, such as `a number in m > 0`."""
        if self.model is not None:
            text = "text or " if self.or_text else ""
            if self.or_number:
                text = f"a number{f' in {self.unit}' if self.unit else ''} or "
            return f"{text}a mapping with the keys {_join_quoted(list(self.model.model_fields))}"
        if self.choices:
            return (
                f"one of {_join_quoted(list(self.choices))}"
                if self.choices[1:]
                else self.choices[0]
            )
        if self.is_number:
            number = "a whole number" if self.type is int else "a number"
            unit = f" in {self.unit}" if self.unit else ""
            alternatives = "".join(f", or {alternative}" for alternative in self.or_words)
            return f"{number}{unit}{self._range()}{alternatives}"
        if self.type is bool:
            return "true or false"
        if self.type is str:
            patterns = [getattr(bound, "pattern", None) for bound in self.bounds]
            return NAME_WORDS if NAME_PATTERN in patterns else "text"
        arguments = get_args(self.type)
        if get_origin(self.type) is tuple and arguments[-1] is Ellipsis:
            min_lengths = [
                b.min_length for b in self.bounds if isinstance(b, annotated_types.MinLen)
            ]
            at_least = (
                f" of at least {_COUNTS.get(min_lengths[0], min_lengths[0])}" if min_lengths else ""
            )
            return f"a list{at_least}, each {self._element(arguments[0]).describe_expected()}"
        if get_origin(self.type) is tuple:
            count = _COUNTS.get(len(arguments), str(len(arguments)))
            return f"a list of {count} numbers{f' in {self.unit}' if self.unit else ''}"
        if get_origin(self.type) is dict:
            return f"a mapping from name to {self._element(arguments[1]).describe_expected()}"
        raise TypeError(f"no words for the type {self.type}")

    def _range(self) -> str:
        limits = " and ".join(limit for bound in self.bounds if (limit := _format_bound(bound)))
        return f" {limits}" if limits else ""


def _format_bound(bound: Any) -> str:
    match bound:
        case annotated_types.Gt(gt=limit):
            return f"> {limit}"
        case annotated_types.Ge(ge=limit):
            return f">= {limit}"
        case annotated_types.Lt(lt=limit):
            return f"< {limit}"
        case annotated_types.Le(le=limit):
            return f"<= {limit}"
    return ""


def find_slot(model: type[SpecModel], path: KeyPath) -> Slot | None:
    """Return the place at `path` below a spec of `model`; None where no key is allowed.

    Args:
        model: Model of the spec, or of a part of it.
        path: Keys and list indices from the model downwards; () is the model itself.
    """
    slot: Slot | None = Slot(model)
    for segment in path:
        slot = slot.child(segment) if slot is not None else None
    return slot


def explain_unknown_key(model: type[SpecModel], path: KeyPath) -> tuple[str, str | None]:
    """Return message and suggestion for a key that `model` does not have at `path`.

    Args:
        model: Model of the whole spec, in which the key is searched elsewhere, too.
        path: Keys and list indices down to the unknown key.

    Returns:
        The message, and the nearest key that exists; None where no key is near.
    """
    key = str(path[-1])
    parent = find_slot(model, path[:-1])
    siblings = list(parent.model.model_fields) if parent is not None and parent.model else []
    if (closest := find_closest_name(key, siblings, cutoff=0.8)) is not None:
        return "unknown key", closest
    elsewhere = dict.fromkeys(
        where or "the top level" for where, name in _list_keys(model) if name == key
    )
    if elsewhere:
        return (
            f"unknown key here; `{key}` belongs under {_join_quoted(list(elsewhere), ' or ')}",
            None,
        )
    if (closest := find_closest_name(key, siblings)) is not None:
        return "unknown key", closest
    distant = find_closest_name(key, [name for _, name in _list_keys(model)], cutoff=0.8)
    if distant is not None:
        where = next(where for where, name in _list_keys(model) if name == distant)
        return "unknown key", f"{where}.{distant}" if where else distant
    return f"unknown key; expected one of {_join_quoted(siblings)}", None


def find_closest_name(typed: str, candidates: list[str], cutoff: float = 0.6) -> str | None:
    """Return the candidate that `typed` is most likely a slip of; None where none is near.

    Args:
        typed: Name as the user wrote it.
        candidates: Names that exist.
        cutoff: Smallest similarity, from 0 to 1 (`difflib.get_close_matches`).
    """
    if len(typed) > 64:  # no slip, and matching would be slow
        return None
    normalised = typed.lower().replace("-", "_").replace(" ", "_")
    for candidate in candidates:
        stem = candidate.lower().replace("-", "_")
        if (
            normalised == stem
            or stem.startswith(f"{normalised}_")
            or normalised.startswith(f"{stem}_")
        ):
            return candidate
    by_lowercase = {w.lower(): w for w in candidates}
    matches = difflib.get_close_matches(normalised, list(by_lowercase), n=1, cutoff=cutoff)
    return by_lowercase[matches[0]] if matches else None


def _list_keys(model: type[SpecModel], where: str = "") -> Iterator[tuple[str, str]]:
    """Yield every (parent, key) of a model, parents as `terrain.regions[]`."""
    for name, field in model.model_fields.items():
        yield where, name
        slot, place = _build_slot(field), f"{where}.{name}" if where else name
        if get_origin(slot.type) in (tuple, dict) and (element := slot.child(0)) is not None:
            slot, place = element, f"{place}[]"
        if slot.model is not None:
            yield from _list_keys(slot.model, place)


def _build_slot(field: FieldInfo) -> Slot:
    inner_type, bounds = _strip_annotation(field.annotation)
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    meaning = (field.description or "").removesuffix(f" [{unit}]").rstrip(".").replace("\n", " ")
    return replace(
        Slot(inner_type),
        bounds=(*field.metadata, *bounds),
        unit=unit,
        meaning=meaning,
        or_text=_is_union_with_model(field.annotation, str),
        or_number=_is_union_with_model(field.annotation, float),
        or_words=_extract_literals(field.annotation),
    )


def _is_union_with_model(annotation: Any, simple_type: type) -> bool:
    """Return whether an annotation is a union of a plain type and a mapping with fixed keys."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) not in (Union, types.UnionType):
        return False
    kinds = [_strip_annotation(a)[0] for a in get_args(annotation)]
    return simple_type in kinds and any(_is_model(kind) for kind in kinds)


def _extract_literals(annotation: Any) -> tuple[str, ...]:
    """Return words that may stand instead of the other kind of a union."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) not in (Union, types.UnionType):
        return ()
    literals = [a for a in get_args(annotation) if get_origin(a) is Literal]
    return tuple(str(choice) for literal in literals for choice in get_args(literal))


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, SpecModel)


def _strip_annotation(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return an annotation without `Annotated` and `| None`, and what was annotated."""
    bounds: tuple[Any, ...] = ()
    while True:
        origin, arguments = get_origin(annotation), get_args(annotation)
        if origin is Annotated:
            annotation, bounds = arguments[0], (*bounds, *arguments[1:])
        elif origin in (Union, types.UnionType) and type(None) in arguments:
            annotation = next(a for a in arguments if a is not type(None))
        elif origin in (Union, types.UnionType) and _extract_literals(annotation):
            annotation = next(a for a in arguments if get_origin(a) is not Literal)
        elif _is_union_with_model(annotation, str) or _is_union_with_model(annotation, float):
            annotation = next(a for a in arguments if _is_model(_strip_annotation(a)[0]))
        else:
            return annotation, bounds


def _join_quoted(names: list[str], separator: str = ", ") -> str:
    return separator.join(f"`{name}`" for name in names)
