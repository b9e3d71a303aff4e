"""How far what a plan stores is from what its spec says."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Difference:
    """How far a stored value is from the spec's."""

    key: str
    size: float
    index: tuple[int, ...] = ()  # of the entry that is furthest off
    values: str = ""  # "2 in the file, 1 by the spec"


def measure_difference(key: str, stored: Any, expected: Any) -> Difference:
    """Return largest absolute difference; infinite if the shapes differ."""
    a, b = np.asarray(stored, float), np.asarray(expected, float)
    if a.shape != b.shape:
        return Difference(key, math.inf)
    return Difference(key, float(np.abs(a - b).max(initial=0.0)))


def check_equality(key: str, equal: bool) -> Difference:
    return Difference(key, 0.0 if equal else math.inf)


def compare_recursively(
    key: str, stored: Any, built: Any, unknown: Iterable[str] = ()
) -> Iterator[Difference]:
    """Yield every value of what is stored against what was built anew, part by part.

    Dataclasses, mappings and tuples are compared member by member, numbers and arrays by their
    difference relative to their size (absolute below one), everything else by equality. `unknown`
    names members of the whole that cannot be known.
    """
    if type(stored) is not type(built) and not (_is_number(stored) and _is_number(built)):
        yield Difference(key, math.inf, values=_format_pair(stored, built))
    elif is_dataclass(stored):
        for member in fields(stored):
            if member.name not in unknown:
                yield from compare_recursively(
                    f"{key}.{member.name}", vars(stored)[member.name], vars(built)[member.name]
                )
    elif isinstance(stored, Mapping):
        for name in sorted({*stored, *built} - {*unknown}, key=str):
            yield from compare_recursively(f"{key}.{name}", stored.get(name), built.get(name))
    elif isinstance(stored, tuple | list):
        if len(stored) != len(built):
            yield Difference(key, math.inf, values=f"{len(stored)} in the file, {len(built)} asked")
            return
        for number, (stored_entry, built_entry) in enumerate(zip(stored, built, strict=True)):
            name = (
                built_entry.name
                if is_dataclass(built_entry) and hasattr(built_entry, "name")
                else number
            )
            yield from compare_recursively(f"{key}.{name}", stored_entry, built_entry)
    elif _is_number(stored) or isinstance(stored, np.ndarray):
        yield _compare_numbers(key, np.asarray(stored, float), np.asarray(built, float))
    else:
        yield Difference(
            key, 0.0 if stored == built else math.inf, values=_format_pair(stored, built)
        )


def select_largest(differences: Iterable[Difference]) -> Difference:
    """Return the largest of some differences; NaN is larger than anything."""
    return max(differences, key=lambda d: math.inf if math.isnan(d.size) else d.size)


def _compare_numbers(key: str, stored: Any, built: Any) -> Difference:
    if stored.shape != built.shape:
        return Difference(key, math.inf, values=f"shape {stored.shape}, expected {built.shape}")
    if stored.size == 0:
        return Difference(key, 0.0)
    deviation = np.abs(stored - built) / np.maximum(1.0, np.abs(built))
    deviation = np.where((stored == built) | (np.isnan(stored) & np.isnan(built)), 0.0, deviation)
    worst = np.unravel_index(int(np.argmax(deviation)), deviation.shape)
    values = _format_pair(float(stored[worst]), float(built[worst]))
    return Difference(key, float(deviation[worst]), tuple(int(i) for i in worst), values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _format_pair(stored: Any, built: Any) -> str:
    return f"{_format_value(stored)} in the file, {_format_value(built)} by the spec"


def _format_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return repr(value)[:40] if isinstance(value, str | bool | int | None) else type(value).__name__
