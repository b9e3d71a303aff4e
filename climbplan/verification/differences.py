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


def apart(key: str, stored: Any, asked: Any) -> Difference:
    """Largest absolute difference; infinite if the shapes differ."""
    a, b = np.asarray(stored, float), np.asarray(asked, float)
    if a.shape != b.shape:
        return Difference(key, math.inf)
    return Difference(key, float(np.abs(a - b).max(initial=0.0)))


def same(key: str, equal: bool) -> Difference:
    return Difference(key, 0.0 if equal else math.inf)


def parts_apart(
    key: str, stored: Any, built: Any, unknown: Iterable[str] = ()
) -> Iterator[Difference]:
    """Every value of what is stored against what was built anew, part by part.

    Dataclasses, mappings and tuples are compared member by member, numbers and arrays by their
    difference relative to their size (absolute below one), everything else by equality. `unknown`
    names members of the whole that cannot be known.
    """
    if type(stored) is not type(built) and not (_is_number(stored) and _is_number(built)):
        yield Difference(key, math.inf, values=_values(stored, built))
    elif is_dataclass(stored):
        for part in fields(stored):
            if part.name not in unknown:
                yield from parts_apart(
                    f"{key}.{part.name}", vars(stored)[part.name], vars(built)[part.name]
                )
    elif isinstance(stored, Mapping):
        for name in sorted({*stored, *built} - {*unknown}, key=str):
            yield from parts_apart(f"{key}.{name}", stored.get(name), built.get(name))
    elif isinstance(stored, tuple | list):
        if len(stored) != len(built):
            yield Difference(key, math.inf, values=f"{len(stored)} in the file, {len(built)} asked")
            return
        for number, (one, other) in enumerate(zip(stored, built, strict=True)):
            name = other.name if is_dataclass(other) and hasattr(other, "name") else number
            yield from parts_apart(f"{key}.{name}", one, other)
    elif _is_number(stored) or isinstance(stored, np.ndarray):
        yield _numbers_apart(key, np.asarray(stored, float), np.asarray(built, float))
    else:
        yield Difference(key, 0.0 if stored == built else math.inf, values=_values(stored, built))


def largest(differences: Iterable[Difference]) -> Difference:
    """The largest of some differences; NaN is larger than anything."""
    return max(differences, key=lambda d: math.inf if math.isnan(d.size) else d.size)


def _numbers_apart(key: str, stored: Any, built: Any) -> Difference:
    if stored.shape != built.shape:
        return Difference(key, math.inf, values=f"shape {stored.shape}, expected {built.shape}")
    if stored.size == 0:
        return Difference(key, 0.0)
    off = np.abs(stored - built) / np.maximum(1.0, np.abs(built))
    off = np.where((stored == built) | (np.isnan(stored) & np.isnan(built)), 0.0, off)
    worst = np.unravel_index(int(np.argmax(off)), off.shape)
    values = _values(float(stored[worst]), float(built[worst]))
    return Difference(key, float(off[worst]), tuple(int(i) for i in worst), values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _values(stored: Any, built: Any) -> str:
    return f"{_shown(stored)} in the file, {_shown(built)} by the spec"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return repr(value)[:40] if isinstance(value, str | bool | int | None) else type(value).__name__
