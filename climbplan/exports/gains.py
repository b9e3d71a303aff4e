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


def read_gains(argument: str, names: tuple[str, ...], slides: tuple[bool, ...] = ()) -> Array:
    """Return P gains (J,) [N m/rad] from one number or from a file; [N/m] of sliding joints.

    Args:
        argument: A number, or the path of a YAML file that maps every joint's name to its gain.
        names: Names of the joints.
        slides: (J,) whether a joint slides; () means that none does. One number does not do for
            joints of both kinds.

    Raises:
        UsageError: With every mistake of the file, or for a number that is not positive.
    """
    try:
        number = float(argument)
    except ValueError:
        return _read_gain_file(Path(argument), names)
    if not (math.isfinite(number) and number > 0):
        raise UsageError(f"--gains {argument}: expected a positive number of N m/rad, or a file")
    if any(slides) and not all(slides):
        raise UsageError(
            f"--gains {argument}: one number for joints that turn [N m/rad] and joints that slide "
            "[N/m]; expected a file of `joint: gain` a line"
        )
    return np.full(len(names), number)


def _read_gain_file(path: Path, names: tuple[str, ...]) -> Array:
    text = read_text(path, _MOST_BYTES, "a number or a YAML file of gains")
    stored = parse_yaml(text, f"--gains {path}").value
    if not isinstance(stored, dict):
        raise UsageError(f"--gains {path}: expected `joint: gain` a line [N m/rad]")
    mistakes = [f"{name} is missing" for name in names if name not in stored]
    mistakes += [f"no joint {name!r}" for name in stored if name not in names]
    mistakes += [
        f"{name}: {stored[name]!r} is no positive number"
        for name in names
        if name in stored and not _is_positive(stored[name])
    ]
    if mistakes:
        raise UsageError(f"--gains {path}: {'; '.join(mistakes)}")
    return np.array([float(stored[name]) for name in names])


def _is_positive(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
