"""The gripper's Gaussian process: a known mean found again, bounds as good as their word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from climbplan.errors import SpecError, UsageError
from climbplan.mechanics.gripper import ShearMeasurements, cross_validate, fit_gripper, read_grips

NOISE = 1.5  # [N]


def true_force(state: np.ndarray) -> np.ndarray:
    return 10 * state[:, 3] * np.cos(state[:, 0]) * np.cos(state[:, 1])


def grips(count: int, seed: int) -> ShearMeasurements:
    rng = np.random.default_rng(seed)
    turn = np.deg2rad(rng.uniform(-30, 30, (count, 3)))
    state = np.column_stack([turn, rng.uniform(0.3, 1.2, count)])
    return ShearMeasurements(state, true_force(state) + NOISE * rng.normal(size=count))


def test_prediction_is_that_of_scikit_learn() -> None:
    data = grips(40, 0)
    model = fit_gripper(data)
    kernel = ConstantKernel(model.signal**2, "fixed") * RBF(model.length, "fixed")
    known = GaussianProcessRegressor(kernel, alpha=model.noise**2, optimizer=None)
    known.fit((data.state - model.center) / model.scale, data.force - data.force.mean())
    there = grips(10, 1).state
    mean, deviation = known.predict((there - model.center) / model.scale, return_std=True)
    found = model.predict(there)
    np.testing.assert_allclose(found.mean, mean + data.force.mean(), rtol=1e-8)
    np.testing.assert_allclose(found.deviation**2, deviation**2 + model.noise**2, rtol=1e-6)


def test_mean_and_noise_are_found_again() -> None:
    model = fit_gripper(grips(100, 2))
    there = grips(200, 3)
    off = model.predict(there.state).mean - true_force(there.state)
    assert np.sqrt(np.mean(off**2)) < 0.6 * NOISE
    assert model.noise == pytest.approx(NOISE, rel=0.25)


def test_bounds_hold_as_often_as_they_say() -> None:
    """95 % lower bounds on held-out grips, over several campaigns of 100."""
    shares = []
    for seed in range(5):
        model = fit_gripper(grips(100, seed))
        there = grips(2000, 100 + seed)
        shares.append((there.force >= model.predict(there.state).bound(0.05)).mean())
    assert 0.92 <= np.mean(shares) <= 0.98
    risky, safe = (model.predict(there.state).bound(risk) for risk in (0.3, 0.01))
    assert (risky >= safe).all()
    assert (safe >= 0).all()


def test_cross_validation_tells_the_calibration() -> None:
    data = grips(100, 4)
    found = cross_validate(data, folds=5)
    assert found.rmse == pytest.approx(NOISE, rel=0.3)
    assert 0.88 <= found.share_above(data, 0.95) <= 1.0
    assert (np.diff(found.covered) >= 0).all()


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "grips.csv"
    path.write_text("alpha_deg,beta_deg,friction,force_N\n1,2,3,4\n")
    with pytest.raises(SpecError, match="gamma_deg: column is missing"):
        read_grips(path)
    path.write_text("alpha_deg,beta_deg,gamma_deg,friction,force_N\n1,2,x,0.5,4\n")
    with pytest.raises(SpecError, match=r"grips.csv:2: expected numbers"):
        read_grips(path)
    path.write_text("alpha_deg,beta_deg,gamma_deg,friction,force_N\n1,2,3,0.5,4\n")
    with pytest.raises(UsageError, match="at least 20"):
        read_grips(path)
