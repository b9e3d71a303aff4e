"""Gaussian-process regression of the shear force of a spine gripper (chapter 3.4).

Inputs s = (alpha, beta, gamma, lambda) are the orientation of the gripper [rad] and the friction
coefficient of the surface. The output is the shear force f^g that it holds. The kernel is squared
exponential, eq. (3.4), on standardised inputs; predictive mean and variance follow eqs. (3.5) and
(3.6). A planner relies on the lower confidence bound at a chosen risk.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
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
from climbplan.mechanics.gripper_model import MAX_ROWS, GripperModel, ShearPrediction
from climbplan.reading import read_text, reading

COLUMNS = ("alpha_deg", "beta_deg", "gamma_deg", "friction")
FORCE = "force_N"
_MIN_ROWS = 20
_MAX_BYTES = 5_000_000
_RESTARTS = 2


@dataclass(frozen=True)
class ShearMeasurements:
    """Measured shear forces."""

    state: Array  # (n, 4) alpha, beta, gamma [rad], friction
    force: Array  # (n,) [N]


@dataclass(frozen=True)
class Calibration:
    """Cross-validated predictions compared with measurements."""

    held_out: ShearPrediction  # of every row by a model that did not see it
    rmse: float  # [N]
    levels: Array  # (q,) confidence of a lower bound
    covered: Array  # (q,) fraction of held-out forces above it

    def share_above(self, grips: ShearMeasurements, confidence: float) -> float:
        """Return the fraction of held-out forces above the lower bound of a confidence."""
        return float((grips.force >= self.held_out.bound(1 - confidence)).mean())


def read_grips(path: Path) -> ShearMeasurements:
    """Read measured grips from CSV (alpha_deg, beta_deg, gamma_deg, friction, force_N).

    Raises:
        UsageError: The file cannot be read.
        SpecError: Columns or values are missing.
    """
    expected = "a CSV file of grips"
    lines = read_text(path, _MAX_BYTES, expected).splitlines()
    lines_used = [(n, text) for n, text in enumerate(lines, 1) if text.strip() and text[0] != "#"]
    with reading(path, expected):  # a quoted cell does not go on in the next line
        cells = [cell_row for _, text in lines_used for cell_row in csv.reader([text])]
    columns = (*COLUMNS, FORCE)
    names = cells[0] if cells else []
    missing = [name for name in columns if name not in names]
    if missing:
        raise SpecError(str(path), [SpecMistake(name, "column is missing") for name in missing])
    if len(lines_used) - 1 > MAX_ROWS:
        raise UsageError(
            f"{path}: {len(lines_used) - 1} grips, expected at most {MAX_ROWS}: the time of a fit "
            "grows with their number cubed; fit a part of them"
        )
    column_indices = [names.index(name) for name in columns]
    rows, mistakes = [], []
    for (line, _), row in zip(lines_used[1:], cells[1:], strict=True):
        try:
            values = [float(row[index]) for index in column_indices]
        except (IndexError, ValueError):
            values = [np.nan]
        if np.isfinite(values).all() and values[3] >= 0:
            rows.append(values)
        else:
            mistakes.append(SpecMistake("", f"expected numbers in {', '.join(columns)}", line))
    if mistakes:
        raise SpecError(str(path), mistakes)
    if len(rows) < _MIN_ROWS:
        raise UsageError(f"{path}: {len(rows)} grips, expected at least {_MIN_ROWS}")
    data = np.array(rows)
    return ShearMeasurements(np.column_stack([np.deg2rad(data[:, :3]), data[:, 3]]), data[:, 4])


def fit_gripper(grips: ShearMeasurements, seed: int = 0) -> GripperModel:
    """Fit sigma_f, l and sigma_n by maximum marginal likelihood."""
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


def cross_validate(grips: ShearMeasurements, folds: int = 10, seed: int = 0) -> Calibration:
    """Predict every row by models fitted to the other folds."""
    rng = np.random.default_rng(seed)
    fold = rng.permutation(len(grips.force)) % folds
    mean, deviation = np.empty(len(fold)), np.empty(len(fold))
    for test_fold in range(folds):
        is_training, is_test = fold != test_fold, fold == test_fold
        model = fit_gripper(
            ShearMeasurements(grips.state[is_training], grips.force[is_training]), seed
        )
        prediction = model.predict(grips.state[is_test])
        mean[is_test], deviation[is_test] = prediction.mean, prediction.deviation
    held_out = ShearPrediction(mean, deviation)
    levels = np.linspace(0.05, 0.99, 48)
    covered = np.array([(grips.force >= held_out.bound(1 - level)).mean() for level in levels])
    rmse = float(np.sqrt(np.mean((mean - grips.force) ** 2)))
    return Calibration(held_out, rmse, levels, covered)
