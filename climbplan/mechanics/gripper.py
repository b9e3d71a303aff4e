"""Fit the shear force of a spine gripper by Gaussian-process regression (chapter 3.4).

Inputs s = (alpha, beta, gamma, lambda): orientation of the gripper [rad] and friction coefficient
of the surface; output is the shear force f^g it holds. Squared-exponential kernel, eq. (3.4), on
standardised inputs; predictive mean and variance by eqs. (3.5), (3.6). What a planner may count on
is the lower confidence bound at a chosen risk.
"""

from __future__ import annotations

import csv
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from climbplan.arrays import Array
from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.mechanics.gripper_model import MAX_ROWS, GripperModel, Prediction
from climbplan.reading import read_text, reading

COLUMNS = ("alpha_deg", "beta_deg", "gamma_deg", "friction")
FORCE = "force_N"
_LEAST_ROWS = 20
_MAX_BYTES = 5_000_000
_RESTARTS = 2


@dataclass(frozen=True)
class Grips:
    """Measured shear forces."""

    state: Array  # (n, 4) alpha, beta, gamma [rad], friction
    force: Array  # (n,) [N]


@dataclass(frozen=True)
class Calibration:
    """Cross-validated predictions against what was measured."""

    held_out: Prediction  # of every row by a model that did not see it
    rmse: float  # [N]
    levels: Array  # (q,) confidence of a lower bound
    covered: Array  # (q,) share of held-out forces above it

    def share_above(self, grips: Grips, confidence: float) -> float:
        """Share of held-out forces above the lower bound of a confidence."""
        return float((grips.force >= self.held_out.bound(1 - confidence)).mean())


def read_grips(path: Path) -> Grips:
    """Measured grips in a CSV file (alpha_deg, beta_deg, gamma_deg, friction, force_N).

    Raises UsageError for a file that cannot be read and SpecError for missing columns or values.
    """
    expected = "a CSV file of grips"
    lines = read_text(path, _MAX_BYTES, expected).splitlines()
    kept = [(n, text) for n, text in enumerate(lines, 1) if text.strip() and text[0] != "#"]
    with reading(path, expected):  # a quoted cell does not go on in the next line
        cells = [cell_row for _, text in kept for cell_row in csv.reader([text])]
    wanted = (*COLUMNS, FORCE)
    names = cells[0] if cells else []
    missing = [name for name in wanted if name not in names]
    if missing:
        raise SpecError(str(path), [SpecMistake(name, "column is missing") for name in missing])
    if len(kept) - 1 > MAX_ROWS:
        raise UsageError(
            f"{path}: {len(kept) - 1} grips, expected at most {MAX_ROWS}: the time of a fit grows "
            "with their number cubed; fit a part of them"
        )
    places = [names.index(name) for name in wanted]
    rows, mistakes = [], []
    for (line, _), row in zip(kept[1:], cells[1:], strict=True):
        try:
            values = [float(row[place]) for place in places]
        except (IndexError, ValueError):
            values = [np.nan]
        if np.isfinite(values).all() and values[3] >= 0:
            rows.append(values)
        else:
            mistakes.append(SpecMistake("", f"expected numbers in {', '.join(wanted)}", line))
    if mistakes:
        raise SpecError(str(path), mistakes)
    if len(rows) < _LEAST_ROWS:
        raise UsageError(f"{path}: {len(rows)} grips, expected at least {_LEAST_ROWS}")
    data = np.array(rows)
    return Grips(np.column_stack([np.deg2rad(data[:, :3]), data[:, 3]]), data[:, 4])


def fit_gripper(grips: Grips, seed: int = 0) -> GripperModel:
    """sigma_f, l and sigma_n by the largest marginal likelihood."""
    center = grips.state.mean(axis=0)
    scale = grips.state.std(axis=0)
    scale = np.where(scale > 1e-12, scale, 1.0)
    offset, spread = float(grips.force.mean()), max(float(grips.force.std()), 1e-9)
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(2.0, (0.2, 50.0))
    kernel = kernel + WhiteKernel(0.3, (1e-6, 10.0))
    search = GaussianProcessRegressor(kernel, n_restarts_optimizer=_RESTARTS, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a bound of the search is an answer
        search.fit((grips.state - center) / scale, (grips.force - offset) / spread)
    signal, length, noise = np.exp(search.kernel_.theta)
    return GripperModel(
        grips.state,
        grips.force,
        center,
        scale,
        signal=float(np.sqrt(signal)) * spread,
        length=float(length),
        noise=float(np.sqrt(noise)) * spread,
    )


def cross_validate(grips: Grips, folds: int = 10, seed: int = 0) -> Calibration:
    """Predictions of every row by models of the other folds."""
    rng = np.random.default_rng(seed)
    fold = rng.permutation(len(grips.force)) % folds
    mean, deviation = np.empty(len(fold)), np.empty(len(fold))
    for part in range(folds):
        rest, held = fold != part, fold == part
        model = fit_gripper(Grips(grips.state[rest], grips.force[rest]), seed)
        found = model.predict(grips.state[held])
        mean[held], deviation[held] = found.mean, found.deviation
    held_out = Prediction(mean, deviation)
    levels = np.linspace(0.05, 0.99, 48)
    covered = np.array([(grips.force >= held_out.bound(1 - level)).mean() for level in levels])
    rmse = float(np.sqrt(np.mean((mean - grips.force) ** 2)))
    return Calibration(held_out, rmse, levels, covered)
