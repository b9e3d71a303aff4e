"""A trained model of a spine gripper's shear force as plain arrays (chapter 3.4).

Inputs s = (alpha, beta, gamma, lambda) are the orientation of the gripper [rad] and the friction
coefficient of the surface. The output is the shear force f^g that it holds. The kernel is squared
exponential, eq. (3.4), on standardised inputs; predictive mean and variance follow eqs. (3.5) and
(3.6). A planner relies on the lower confidence bound at a chosen risk.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.special import ndtri

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.reading import read_text, reading

FORMAT = "climbplan/gripper"
FORMAT_VERSION = 1
MAX_ROWS = 2000  # of a model, whose matrices have their square
_MAX_BYTES = 5_000_000
INPUTS = 4  # alpha, beta, gamma, friction
_NUMBERS = ("signal", "length", "noise")


@dataclass(frozen=True)
class ShearPrediction:
    """The predicted shear force of a gripper at some states."""

    mean: Array  # (m,) [N]
    deviation: Array  # (m,) of one measured force, its noise included [N]

    def bound(self, risk: float) -> Array:
        """Return the force (m,) that a grip exceeds except for the risk, at least zero [N]."""
        return np.maximum(self.mean + ndtri(risk) * self.deviation, 0.0)


@dataclass(frozen=True)
class GripperModel:
    """A trained model as plain arrays."""

    state: Array  # (n, 4) training inputs
    force: Array  # (n,) training outputs [N]
    center: Array  # (4,) of the inputs
    scale: Array  # (4,) of the inputs
    signal: float  # sigma_f [N]
    length: float  # l, on standardised inputs
    noise: float  # sigma_n [N]

    def predict(self, state: Array) -> ShearPrediction:
        """Return mean and standard deviation at states (m, 4), eqs. (3.5), (3.6)."""
        offset = float(self.force.mean())
        factor = cholesky(
            self._kernel(self.state, self.state) + self.noise**2 * np.eye(len(self.state)),
            lower=True,
        )
        across = self._kernel(self.state, state)
        mean = offset + across.T @ cho_solve((factor, True), self.force - offset)
        explained = np.einsum("nm,nm->m", across, cho_solve((factor, True), across))
        variance = np.maximum(self.signal**2 - explained, 0.0) + self.noise**2
        return ShearPrediction(mean, np.sqrt(variance))

    def _kernel(self, first: Array, second: Array) -> Array:
        a, b = ((s - self.center) / (self.scale * self.length) for s in (first, second))
        square = ((a[:, None, :] - b[None, :, :]) ** 2).sum(axis=-1)
        return np.asarray(self.signal**2 * np.exp(-square / 2))


def builtin_models() -> list[str]:
    """List the gripper models that come with the package."""
    directory = files("climbplan").joinpath("robots", "grippers")
    names = [entry.name for entry in directory.iterdir()]
    return sorted(name.removesuffix(".json") for name in names if name.endswith(".json"))


def load_model(reference: str, directory: Path | None = None) -> GripperModel:
    """Load a built-in model by name, or one that `fit-gripper` wrote, relative to `directory`.

    Raises:
        UsageError: There is no such model, or the file is not a whole gripper model.
    """
    if not reference.endswith(".json"):
        names = builtin_models()
        if reference not in names:
            raise UsageError(
                f"gripper model {reference!r}: expected a built-in one ({', '.join(names)}) or "
                "the path of a gripper.json that fit-gripper wrote"
            )
        holder = files("climbplan").joinpath("robots", "grippers", f"{reference}.json")
        return _parse_model(holder.read_text(encoding="utf-8"), reference)
    path = (directory or Path()) / reference
    return _parse_model(read_text(path, _MAX_BYTES, "a gripper model"), str(path))


def _parse_model(text: str, where: str) -> GripperModel:
    """Parse and validate the JSON text of a gripper model."""
    with reading(where, "a gripper model in JSON"):
        data = json.loads(text)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise UsageError(f"{where}: not a gripper model (expected format {FORMAT!r})")
    if data.get("format_version") != FORMAT_VERSION:
        raise UsageError(
            f"{where}: format version {data.get('format_version')!r}, expected {FORMAT_VERSION}"
        )
    state = _parse_numbers(data, "state", where)
    if state.ndim != 2 or state.shape[1] != INPUTS or len(state) == 0:
        raise UsageError(f"{where}: state has shape {state.shape}, expected (n, {INPUTS})")
    if len(state) > MAX_ROWS:
        raise UsageError(f"{where}: {len(state)} states, expected at most {MAX_ROWS}")
    arrays = {"force": len(state), "center": INPUTS, "scale": INPUTS}
    arrays_found: dict[str, Any] = {name: _parse_numbers(data, name, where) for name in arrays}
    for name, size in arrays.items():
        if arrays_found[name].shape != (size,):
            raise UsageError(
                f"{where}: {name} has shape {arrays_found[name].shape}, expected ({size},)"
            )
    numbers: dict[str, Any] = {
        name: float(_parse_numbers(data, name, where).reshape(())) for name in _NUMBERS
    }
    if min(numbers.values()) <= 0 or arrays_found["scale"].min() <= 0:
        raise UsageError(f"{where}: expected signal, length, noise and scale > 0")
    return GripperModel(state=state, **arrays_found, **numbers)


def _parse_numbers(data: dict[str, Any], name: str, where: str) -> Array:
    """Return a finite array of the data; raises UsageError otherwise."""
    try:
        with reading(where, "a gripper model", damage=(OverflowError, RecursionError)):
            values = np.array(data[name], float)
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{where}: {name} is missing or not numbers") from error
    if not np.isfinite(values).all():
        raise UsageError(f"{where}: {name} is not finite")
    if name in _NUMBERS and values.ndim != 0:
        raise UsageError(f"{where}: {name} is not one number")
    return values
