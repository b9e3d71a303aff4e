"""Identification of joint stiffness and structural compliance by robust least squares.

The unknowns are one compliance per joint, the structure's part, and, for each matrix whose posture
the file does not contain, one number that places the foot. Residuals are the entries of
K - K_measured in units of their known error, under a loss that grows linearly for outliers
(soft_l1).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.mechanics.identification.limb_model import MeasuredLimb, limb_matrices
from climbplan.mechanics.identification.measurements import Matrix

MODEL_ERROR = 0.05  # relative, of a column: postures and geometry are never exact
_NORMAL = 1.4826
_OUTLIER = 4.0  # robust standard deviations of an outlier
_NUM_RESAMPLES = 120
_START_STIFFNESS = np.geomspace(6.0, 400.0, 9)  # [N m/rad] grid of starts
_NUM_PLACES = 121  # of an unknown foot, in the grid of starts
_COMPLIANCE_RANGE = (1e-5, 10.0)  # [rad/(N m)]
FEET = ("known", "horizontal", "radial")  # what a stated foot distance means


@dataclass(frozen=True)
class FitModel:
    """The unknowns of a fit."""

    structure: bool  # the structure has an isotropic compliance
    by_gain: bool  # the structure deflects in the shape of the joints' motion, seen by the gain
    feet: str  # one of FEET

    @property
    def name(self) -> str:
        """The name of the model in words."""
        terms = ["joints"]
        terms += ["structure alike in all directions"] if self.structure else []
        terms += ["structure in the shape of the joints"] if self.by_gain else []
        return " and ".join(terms)


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float
    lower: float
    upper: float

    @property
    def is_determined(self) -> bool:
        """True if the data determine it to within a factor of two."""
        return bool(self.lower > 0 and self.upper <= 2 * self.lower)


@dataclass(frozen=True)
class Fit:
    """The result of one model."""

    model: FitModel
    matrices: tuple[Matrix, ...]  # those used
    joint_stiffness: tuple[Estimate, ...]  # of the joints felt [N m/rad]
    share: Estimate | None  # the structure's fraction of the compliance, mean over postures
    predicted: Array  # (T, a, a) [N/m]
    angles: Array  # (T, j) [rad]
    misfit: Array  # (T,) rms residual of each matrix, in robust standard deviations
    relative_error: float  # median |K - K_measured| / |K_measured|
    outliers: tuple[str, ...]
    cost: float  # robust, in units of the error model
    freedom: int  # entries less unknowns
    unusable: tuple[str, ...]  # matrices that no posture explains


@dataclass(frozen=True)
class _FitData:
    """The matrices as arrays."""

    limb: MeasuredLimb
    model: FitModel
    measured: Array  # (T, a, a)
    weight: Array  # (T, a, a) 1 / standard deviation, 0 for entries counted already
    softening: Array  # (T,) reference gain / gain
    angles: Array  # (T, j), NaN where unknown
    distance: Array  # (T,) NaN where known

    @property
    def joints(self) -> int:
        return len(self.limb.joints)

    def compute_angles(self, place: Array) -> Array:
        """Return joint angles for feet at places (T,): heights [m], or directions [rad]."""
        if self.model.feet == "known":
            return self.angles
        if self.model.feet == "horizontal":
            return self.limb.angles_for_foot(self.distance, place)
        r = self.distance
        return self.limb.angles_for_foot(r * np.cos(place), r * np.sin(place))

    def split(self, x: Array) -> tuple[Array, Array, float, Array]:
        """Return compliances of joints and structure (j,), of structure [m/N], and places (T,)."""
        j = self.joints
        compliance = np.exp(x[:j])
        index = j
        shape = np.zeros(j)
        if self.model.by_gain:
            shape, index = np.exp(x[index : index + j]), index + j
        even = 0.0
        if self.model.structure:
            even, index = float(np.exp(x[index])), index + 1
        return compliance, shape, even, x[index:]

    def predict(self, x: Array) -> Array:
        """Return the matrices of the model (T, a, a) [N/m]."""
        compliance, shape, even, place = self.split(x)
        jacobian = self.limb.jacobians(self.compute_angles(place))
        compliances = self.softening[:, None] * compliance + shape
        return limb_matrices(jacobian, compliances, even)

    def residual(self, x: Array) -> Array:
        """Return the weighted residuals (T, a a)."""
        out = (self.predict(x) - self.measured) * self.weight
        # A foot out of reach has large residuals, so that the search turns back.
        return np.where(np.isfinite(out), out, 1e3).reshape(len(self.measured), -1)

    def take(self, rows: IntArray) -> _FitData:
        """Return the problem of some matrices."""
        arrays = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return _FitData(**{**vars(self), **arrays})


def fit_stiffness(
    limb: MeasuredLimb, matrices: Sequence[Matrix], model: FitModel, seed: int = 0
) -> Fit:
    """Fit one model, with intervals from bootstrap resampling of the matrices.

    Args:
        limb: The limb.
        matrices: Measured matrices.
        model: The unknowns.
        seed: Of the resampling.

    Raises:
        UsageError: There are fewer numbers than unknowns.
    """
    usable, unusable = _select_usable(limb, matrices, model)
    problem = _build_problem(limb, usable, model)
    entries = int((problem.weight > 0).sum())
    unknowns = _count_fixed(problem) + (0 if model.feet == "known" else len(usable))
    if entries <= unknowns:
        raise UsageError(f"{entries} measured numbers are not enough for {unknowns} unknowns")
    x = _solve(problem, _find_start(problem))
    scale = max(_NORMAL * float(np.median(np.abs(_compute_scaled_residuals(problem, x)))), 1e-3)
    problem = replace(problem, weight=problem.weight / scale)
    x = _solve(problem, x)
    residual = problem.residual(x)
    draws = _resample(problem, x, seed)
    predicted = problem.predict(x)
    size = np.linalg.norm(problem.measured, axis=(1, 2))
    misfit = np.sqrt((residual**2).sum(axis=1) / (problem.weight > 0).sum(axis=(1, 2)))
    compliance, _, _, place = problem.split(x)
    stiffness = [
        _build_estimate(1 / compliance[j], [1 / np.exp(d[j]) for d in draws])
        for j in range(problem.joints)
    ]
    structural_share = None
    if model.structure or model.by_gain:
        structural_share = _build_estimate(
            _compute_structural_share(problem, x),
            [_compute_structural_share(problem, _append_places(d, x)) for d in draws],
        )
    return Fit(
        model=model,
        matrices=tuple(usable),
        joint_stiffness=tuple(stiffness),
        share=structural_share,
        predicted=predicted,
        angles=problem.compute_angles(place),
        misfit=misfit,
        relative_error=float(
            np.median(np.linalg.norm(predicted - problem.measured, axis=(1, 2)) / size)
        ),
        outliers=tuple(m.name for m, off in zip(usable, misfit, strict=True) if off > _OUTLIER),
        cost=float(2 * (np.sqrt(1 + residual**2) - 1).sum()) * scale**2,
        freedom=entries - unknowns,
        unusable=tuple(unusable),
    )


def _select_usable(
    limb: MeasuredLimb, matrices: Sequence[Matrix], model: FitModel
) -> tuple[list[Matrix], list[str]]:
    """Return the matrices that some posture explains, and why others are not usable."""
    usable, unusable = [], []
    for matrix in matrices:
        eigenvalues = np.linalg.eigvalsh((matrix.stiffness + matrix.stiffness.T) / 2)
        if eigenvalues[0] <= 0:
            unusable.append(f"{matrix.name}: its matrix is not positive definite")
            continue
        r = matrix.posture.distance
        if r is not None and not limb.reaches(r, model.feet == "radial"):
            unusable.append(f"{matrix.name}: no posture has its foot {1e3 * r:.0f} mm away")
            continue
        usable.append(matrix)
    if not usable:
        raise UsageError(f"no matrix is usable; {unusable[0] if unusable else 'there are none'}")
    return usable, unusable


def _build_problem(limb: MeasuredLimb, matrices: Sequence[Matrix], model: FitModel) -> _FitData:
    """Build the arrays of the problem."""
    measured = np.array([matrix.stiffness for matrix in matrices])
    deviation = np.array([matrix.deviation for matrix in matrices])
    column = np.linalg.norm(measured, axis=1)[:, None, :]
    column = np.sqrt(column * np.swapaxes(column, 1, 2))  # the same for both halves
    weight = 1 / np.sqrt(deviation**2 + (MODEL_ERROR * column) ** 2)
    symmetric = np.array([np.array_equal(k, k.T) for k in measured])
    # A symmetric table contains each off-diagonal entry once.
    weight[symmetric] *= np.triu(np.ones(measured.shape[1:]))
    gains = np.array([matrix.gain if matrix.gain is not None else np.nan for matrix in matrices])
    is_known = np.isfinite(gains)
    softening = (
        np.where(is_known, np.median(gains[is_known]) / gains, 1.0) if is_known.any() else None
    )
    unknown_angles = np.full(len(limb.angles.names), np.nan)
    return _FitData(
        limb,
        model,
        measured,
        weight,
        softening if softening is not None else np.ones(len(measured)),
        np.array(
            [unknown_angles if m.posture.angles is None else m.posture.angles for m in matrices]
        ),
        np.array([m.posture.distance or np.nan for m in matrices]),
    )


def _count_fixed(problem: _FitData) -> int:
    """Return the number of unknowns besides the places of feet."""
    model = problem.model
    return problem.joints * (2 if model.by_gain else 1) + int(model.structure)


def _find_start(problem: _FitData) -> Array:
    """Return the best start of a grid, with each foot where it suits the stiffness best."""
    j, model = problem.joints, problem.model
    extra = [np.log(1e-3)] * (j if model.by_gain else 0)
    extra += [np.log(1e-5)] if model.structure else []
    if model.feet == "known":
        return min(
            (np.array([*-np.log([k] * j), *extra]) for k in _START_STIFFNESS),
            key=lambda x: float(np.log1p(problem.residual(x) ** 2).sum()),
        )
    reach = float(problem.limb.lengths[1:].sum())
    span = reach if model.feet == "horizontal" else np.pi / 2
    places = np.linspace(-span, span, _NUM_PLACES)
    everywhere = [np.full(len(problem.measured), place) for place in places]
    jacobian = np.array([problem.limb.jacobians(problem.compute_angles(p)) for p in everywhere])
    reached = np.isfinite(jacobian).all(axis=(-1, -2))  # (P, T)
    best, best_cost = np.zeros(0), np.inf
    for soft in 1 / np.array(list(itertools.product(_START_STIFFNESS, repeat=j))):
        off = limb_matrices(np.nan_to_num(jacobian), soft, 1e-7) - problem.measured
        cost = np.log1p((off * problem.weight) ** 2).sum(axis=(-1, -2))
        cost = np.where(reached, cost, np.inf)
        total = float(cost.min(axis=0).sum())
        if total < best_cost:
            best_cost = total
            best = np.concatenate([np.log(soft), extra, places[cost.argmin(axis=0)]])
    return best


def _solve(problem: _FitData, start: Array, evaluations: int = 400) -> Array:
    """Solve the robust least-squares problem from a start."""
    fixed = _count_fixed(problem)
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    low[:fixed], high[:fixed] = np.log(1e-9), np.log(_COMPLIANCE_RANGE[1])
    low[: problem.joints] = np.log(_COMPLIANCE_RANGE[0])
    solution = least_squares(
        lambda x: problem.residual(x).ravel(),
        np.clip(start, low, high),
        bounds=(low, high),
        loss="soft_l1",
        x_scale="jac",
        max_nfev=evaluations,
    )
    return np.asarray(solution.x)


def _compute_scaled_residuals(problem: _FitData, x: Array) -> Array:
    """Return the residuals of the entries that count, corrected for the degrees of freedom."""
    residual = problem.residual(x)[problem.weight.reshape(len(problem.measured), -1) > 0]
    return np.asarray(residual * np.sqrt(residual.size / max(residual.size - x.size, 1)))


def _resample(problem: _FitData, x: Array, seed: int) -> list[Array]:
    """Fit matrices drawn with replacement (bootstrap): a campaign samples postures."""
    rng = np.random.default_rng(seed)
    count, fixed = len(problem.measured), _count_fixed(problem)
    draws = []
    for _ in range(_NUM_RESAMPLES):
        rows = rng.integers(count, size=count)
        start = np.concatenate([x[:fixed], x[fixed:][rows] if len(x) > fixed else []])
        draws.append(_solve(problem.take(rows), start, 40)[:fixed])
    return draws


def _append_places(draw: Array, x: Array) -> Array:
    """Return the unknowns of a draw with the places of feet of the fit."""
    return np.concatenate([draw, x[len(draw) :]])


def _compute_structural_share(problem: _FitData, x: Array) -> float:
    """Return the structure's fraction of the trace of the compliance, mean over postures."""
    compliance, shape, even, place = problem.split(x)
    jacobian = problem.limb.jacobians(problem.compute_angles(place))
    square = (jacobian**2).sum(axis=1)  # (T, j)
    joints = square @ compliance
    structure = square @ shape + even * jacobian.shape[1]
    return float(np.mean(structure / (joints + structure)))


def _build_estimate(value: float, draws: Sequence[float]) -> Estimate:
    """Return a value with the 95 % interval of draws."""
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(value), float(min(low, value)), float(max(high, value)))
