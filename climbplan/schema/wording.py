"""Turn validation errors of the models into messages: the value found and what was expected."""

from __future__ import annotations

import json
import math
import re
from typing import Any

from pydantic import ValidationError

from climbplan.schema.base import LARGEST_NUMBER, SpecModel
from climbplan.schema.document import Finding, KeyPath
from climbplan.schema.fields import (
    FILE_TAG,
    MAPPING_TAG,
    NUMBER_TAG,
    Slot,
    explain_unknown_key,
    find_closest_name,
    find_slot,
)

# Per SI unit of a field: how much of it one of the written unit is.
_FACTORS: dict[str, dict[str, float]] = {
    "m": {"m": 1, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "rad": {"rad": 1, "deg": math.pi / 180, "°": math.pi / 180},
    "deg": {"deg": 1, "°": 1, "rad": 180 / math.pi},
    "kg": {"kg": 1, "g": 1e-3, "t": 1e3, "lb": 0.45359237},
    "N": {"n": 1, "kn": 1e3},
    "N m": {"nm": 1, "n m": 1, "n*m": 1},
    "N m/rad": {"nm/rad": 1, "n m/rad": 1, "nm/deg": 180 / math.pi},
    "s": {"s": 1, "ms": 1e-3, "min": 60, "h": 3600},
    "m/s": {"m/s": 1, "cm/s": 1e-2, "mm/s": 1e-3, "cm/min": 1e-2 / 60, "m/min": 1 / 60},
    "rad/s": {"rad/s": 1, "deg/s": math.pi / 180, "rpm": math.pi / 30},
    "Hz": {"hz": 1, "khz": 1e3},
    "": {"%": 1e-2},
}
_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:e[-+]?\d+)?)\s*(.*?)\s*\Z")


def parse_quantity(text: str, unit: str) -> float | None:
    """Return the number in `unit` that `text` stands for; None if the unit is unknown."""
    match = _NUMBER_AND_UNIT.match(text.lower()) if len(text) <= 40 else None
    if match is None:
        return None
    written = match[2]
    factor = 1.0 if not written else _FACTORS.get(unit, {}).get(written)
    return None if factor is None else float(match[1].replace(",", ".")) * factor


_TAGS = (FILE_TAG, MAPPING_TAG, NUMBER_TAG)
MOST_FINDINGS = 200  # enough to mend a file by; beyond, it is no spec


def collect_findings(error: ValidationError, model: type[SpecModel]) -> list[Finding]:
    """Return all mistakes that validating a spec as `model` found, once each.

    Args:
        error: What Pydantic raised.
        model: Model of the spec, for the expected values and names that messages give.
    """
    findings: dict[KeyPath, Finding] = {}
    details = error.errors(include_url=False)
    for detail in details[:MOST_FINDINGS]:
        path: KeyPath = tuple(s for s in detail["loc"] if s not in _TAGS)
        if detail["type"] == "too_short" and _has_nested_mistake(path, details):
            continue  # entries that are wrong were not counted
        if detail["type"] == "spec":
            for fault in detail["ctx"]["faults"]:
                below = (*path, *_split_key(fault.key))
                findings.setdefault(below, Finding(below, fault.message))
            continue
        finding = _build_finding(path, detail["type"], detail["input"], model)
        findings.setdefault(finding.path, finding)
    if len(details) > MOST_FINDINGS:
        findings[()] = Finding((), f"and {len(details) - MOST_FINDINGS} more mistakes")
    # A misspelt key is one mistake, not also a missing one.
    meant = {(*f.path[:-1], f.suggestion) for f in findings.values() if f.suggestion}
    return [f for f in findings.values() if f.path not in meant]


def _has_nested_mistake(path: KeyPath, details: list[Any]) -> bool:
    """Return whether there is a mistake below `path`."""
    return any(len(d["loc"]) > len(path) and d["loc"][: len(path)] == path for d in details)


def _build_finding(path: KeyPath, kind: str, value: Any, model: type[SpecModel]) -> Finding:
    if kind == "extra_forbidden":
        message, suggestion = explain_unknown_key(model, path)
        return Finding(path, message, suggestion)
    slot = find_slot(model, path)
    if kind == "missing":
        if isinstance(path[-1], int):  # a list that is too short
            parent = find_slot(model, path[:-1])
            return Finding(path[:-1], _describe_mismatch(parent, value))
        meaning = f": {slot.meaning}" if slot is not None and slot.meaning else ""
        expected = slot.describe_expected() if slot is not None else "a value"
        return Finding(path, f"missing, expected {expected}{meaning}")
    suggestion = None
    if slot is not None and slot.choices and isinstance(value, str):
        suggestion = find_closest_name(value, list(slot.choices))
    return Finding(path, _describe_mismatch(slot, value), suggestion)


def _describe_mismatch(slot: Slot | None, value: Any) -> str:
    if slot is None:
        return f"not expected here, got {format_value(value)}"
    remedy = _suggest_remedy(slot, value)
    return f"expected {slot.describe_expected()}, got {format_value(value)}{remedy}"


def _suggest_remedy(slot: Slot, value: Any) -> str:
    if slot.is_number and isinstance(value, str):
        number = parse_quantity(value, slot.unit)
        return "" if number is None else f" (write {number:.6g})"
    if slot.is_number and isinstance(value, float | int) and abs(value) > LARGEST_NUMBER:
        return f" (numbers end at {LARGEST_NUMBER:g})" if math.isfinite(value) else ""
    if slot.type is str and isinstance(value, bool | int | float):
        return f' (write "{format_value(value)}" in quotes)'
    if slot.type is str and value == "":
        return " (empty)"
    return ""


def format_value(value: Any) -> str:
    """Return a YAML value as a person would recognise it, cut to one short line."""
    if value is None:
        return "nothing"
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    if isinstance(value, dict):
        return f"a mapping with the keys {', '.join(value)}"[:80] if value else "an empty mapping"
    if isinstance(value, list):
        text = f"[{', '.join(format_value(item) for item in value[:40])}]"
        return text if len(text) <= 80 else f"{text[:60]}... ({len(value)} entries)"
    if isinstance(value, float) and not math.isfinite(value):
        return f"{'-' if value < 0 else ''}.{'nan' if math.isnan(value) else 'inf'}"
    return json.dumps(value)


def _split_key(key: str) -> KeyPath:
    return tuple(int(s) if s.isdigit() else s for s in key.split(".")) if key else ()
