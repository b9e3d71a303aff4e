"""P gains of somebody's controller, from the command line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.reading import read_text
from climbplan.schema.yaml_source import parse_yaml

RIGID = "rigid"  # in place of a number: gains of simulators whose links do not bend
_MOST_BYTES = 1_000_000


def read_gains(given: str, names: tuple[str, ...], slides: tuple[bool, ...] = ()) -> Array:
    """(J,) [N m/rad] of one number, or of a YAML file that maps every joint's name to its gain.

    Of joints that slide, (J,) truths, [N/m]: where there are some one number does not do. Raises
    UsageError that lists every mistake of the file.
    """
    try:
        one = float(given)
    except ValueError:
        return _of_file(Path(given), names)
    if not (math.isfinite(one) and one > 0):
        raise UsageError(f"--gains {given}: expected a positive number of N m/rad, or a file")
    if any(slides) and not all(slides):
        raise UsageError(
            f"--gains {given}: one number for joints that turn [N m/rad] and joints that slide "
            "[N/m]; expected a file of `joint: gain` a line"
        )
    return np.full(len(names), one)


def _of_file(path: Path, names: tuple[str, ...]) -> Array:
    text = read_text(path, _MOST_BYTES, "a number or a YAML file of gains")
    stored = parse_yaml(text, f"--gains {path}").value
    if not isinstance(stored, dict):
        raise UsageError(f"--gains {path}: expected `joint: gain` a line [N m/rad]")
    wrong = [f"{name} is missing" for name in names if name not in stored]
    wrong += [f"no joint {name!r}" for name in stored if name not in names]
    wrong += [
        f"{name}: {stored[name]!r} is no positive number"
        for name in names
        if name in stored and not _positive(stored[name])
    ]
    if wrong:
        raise UsageError(f"--gains {path}: {'; '.join(wrong)}")
    return np.array([float(stored[name]) for name in names])


def _positive(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
