"""What number a person meant who wrote text such as `1230 mm` where a plain number belongs."""

from __future__ import annotations

import math
import re

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


def meant_number(text: str, unit: str) -> float | None:
    """The number in `unit` that `text` stands for; None if that is anybody's guess."""
    match = _NUMBER_AND_UNIT.match(text.lower()) if len(text) <= 40 else None
    if match is None:
        return None
    written = match[2]
    factor = 1.0 if not written else _FACTORS.get(unit, {}).get(written)
    return None if factor is None else float(match[1].replace(",", ".")) * factor
