"""Joint stiffness and the structure's share by robust least squares over measured matrices.

Unknown are one compliance a joint, the structure's part, and for each matrix whose posture the
file does not tell one number that places the foot. Residuals are the entries of K - K_measured in
units of what is known of their error, under a loss that grows linearly for bad rows (soft_l1).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.mechanics.identification.limb_model import Limb, limb_matrices
from climbplan.mechanics.identification.measurements import Matrix

MODEL_ERROR = 0.05  # of a column: postures and geometry are never known exactly
_NORMAL = 1.4826
_BAD = 4.0  # robust standard deviations at which a matrix is called an outlier
_RESAMPLES = 120
_STIFFNESS = np.geomspace(6.0, 400.0, 9)  # [N m/rad] where fits are started
_PLACES = 121  # places of an unknown foot that are tried
_COMPLIANCE = (1e-5, 10.0)  # [rad/(N m)] range of the search
FEET = ("known", "horizontal", "radial")  # what a stated foot distance means


@dataclass(frozen=True)
class Model:
    """What is unknown."""

    structure: bool  # the structure gives alike in all directions
    by_gain: bool  # the structure gives in the shape of the joints' motion, told by the gain
    feet: str  # one of FEET

    @property
    def name(self) -> str:
        """In words."""
        parts = ["joints"]
        parts += ["structure alike in all directions"] if self.structure else []
        parts += ["structure in the shape of the joints"] if self.by_gain else []
        return " and ".join(parts)


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float
    lower: float
    upper: float

    @property
    def told(self) -> bool:
        """Whether the data tell it to within a factor of two."""
        return bool(self.lower > 0 and self.upper <= 2 * self.lower)


@dataclass(frozen=True)
class Fit:
    """Outcome of one model."""

    model: Model
    matrices: tuple[Matrix, ...]  # those used
    joint_stiffness: tuple[Estimate, ...]  # of the joints felt [N m/rad]
    share: Estimate | None  # the structure's part of the compliance, mean over postures
    predicted: Array  # (T, a, a) [N/m]
    angles: Array  # (T, j) [rad]
    misfit: Array  # (T,) rms residual of each matrix, in robust standard deviations
    relative_error: float  # median |K - K_measured| / |K_measured|
    outliers: tuple[str, ...]
    cost: float  # robust, in units of the error model
    freedom: int  # entries less unknowns
    unusable: tuple[str, ...]  # matrices that no posture explains


@dataclass(frozen=True)
class _Problem:
    """Matrices as arrays."""

    limb: Limb
    model: Model
    measured: Array  # (T, a, a)
    weight: Array  # (T, a, a) 1 / standard deviation, 0 for entries counted already
    softening: Array  # (T,) reference gain / gain
    angles: Array  # (T, j), NaN where unknown
    distance: Array  # (T,) NaN where known

    @property
    def joints(self) -> int:
        return len(self.limb.joints)

    def posed(self, place: Array) -> Array:
        """Joint angles for feet at places (T,): heights [m], or directions [rad]."""
        if self.model.feet == "known":
            return self.angles
        if self.model.feet == "horizontal":
            return self.limb.angles_for_foot(self.distance, place)
        r = self.distance
        return self.limb.angles_for_foot(r * np.cos(place), r * np.sin(place))

    def parts(self, x: Array) -> tuple[Array, Array, float, Array]:
        """Compliances of joints and structure (j,), of structure [m/N], places (T,)."""
        j = self.joints
        own = np.exp(x[:j])
        at = j
        shape = np.zeros(j)
        if self.model.by_gain:
            shape, at = np.exp(x[at : at + j]), at + j
        even = 0.0
        if self.model.structure:
            even, at = float(np.exp(x[at])), at + 1
        return own, shape, even, x[at:]

    def predicted(self, x: Array) -> Array:
        own, shape, even, place = self.parts(x)
        jacobian = self.limb.jacobians(self.posed(place))
        soft = self.softening[:, None] * own + shape
        return limb_matrices(jacobian, soft, even)

    def residual(self, x: Array) -> Array:
        out = (self.predicted(x) - self.measured) * self.weight
        # A place out of reach is a bad one, and less so nearer to reach: the search turns back.
        return np.where(np.isfinite(out), out, 1e3).reshape(len(self.measured), -1)

    def take(self, rows: IntArray) -> _Problem:
        own = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return _Problem(**{**vars(self), **own})


def fit_stiffness(limb: Limb, matrices: Sequence[Matrix], model: Model, seed: int = 0) -> Fit:
    """Fit one model, with intervals from resampled matrices.

    Raises UsageError where there are fewer numbers than unknowns.
    """
    used, unusable = _usable(limb, matrices, model)
    problem = _problem(limb, used, model)
    entries = int((problem.weight > 0).sum())
    unknowns = _fixed(problem) + (0 if model.feet == "known" else len(used))
    if entries <= unknowns:
        raise UsageError(f"{entries} measured numbers are not enough for {unknowns} unknowns")
    x = _solve(problem, _started(problem))
    scale = max(_NORMAL * float(np.median(np.abs(_entries(problem, x)))), 1e-3)
    problem = replace(problem, weight=problem.weight / scale)
    x = _solve(problem, x)
    residual = problem.residual(x)
    draws = _resampled(problem, x, seed)
    predicted = problem.predicted(x)
    size = np.linalg.norm(problem.measured, axis=(1, 2))
    misfit = np.sqrt((residual**2).sum(axis=1) / (problem.weight > 0).sum(axis=(1, 2)))
    own, _, _, place = problem.parts(x)
    stiffness = [
        _estimate(1 / own[j], [1 / np.exp(d[j]) for d in draws]) for j in range(problem.joints)
    ]
    share = None
    if model.structure or model.by_gain:
        share = _estimate(_share(problem, x), [_share(problem, _with_places(d, x)) for d in draws])
    return Fit(
        model=model,
        matrices=tuple(used),
        joint_stiffness=tuple(stiffness),
        share=share,
        predicted=predicted,
        angles=problem.posed(place),
        misfit=misfit,
        relative_error=float(
            np.median(np.linalg.norm(predicted - problem.measured, axis=(1, 2)) / size)
        ),
        outliers=tuple(m.name for m, off in zip(used, misfit, strict=True) if off > _BAD),
        cost=float(2 * (np.sqrt(1 + residual**2) - 1).sum()) * scale**2,
        freedom=entries - unknowns,
        unusable=tuple(unusable),
    )


def _usable(limb: Limb, matrices: Sequence[Matrix], model: Model) -> tuple[list[Matrix], list[str]]:
    used, unusable = [], []
    for one in matrices:
        eigenvalues = np.linalg.eigvalsh((one.stiffness + one.stiffness.T) / 2)
        if eigenvalues[0] <= 0:
            unusable.append(f"{one.name}: its matrix is not positive definite")
            continue
        r = one.posture.distance
        if r is not None and not limb.reaches(r, model.feet == "radial"):
            unusable.append(f"{one.name}: no posture has its foot {1e3 * r:.0f} mm away")
            continue
        used.append(one)
    if not used:
        raise UsageError(f"no matrix is usable; {unusable[0] if unusable else 'there are none'}")
    return used, unusable


def _problem(limb: Limb, matrices: Sequence[Matrix], model: Model) -> _Problem:
    measured = np.array([one.stiffness for one in matrices])
    deviation = np.array([one.deviation for one in matrices])
    column = np.linalg.norm(measured, axis=1)[:, None, :]
    column = np.sqrt(column * np.swapaxes(column, 1, 2))  # the same for both halves
    weight = 1 / np.sqrt(deviation**2 + (MODEL_ERROR * column) ** 2)
    symmetric = np.array([np.array_equal(k, k.T) for k in measured])
    # A printed table tells each off-diagonal entry once.
    weight[symmetric] *= np.triu(np.ones(measured.shape[1:]))
    gains = np.array([one.gain if one.gain is not None else np.nan for one in matrices])
    known = np.isfinite(gains)
    softening = np.where(known, np.median(gains[known]) / gains, 1.0) if known.any() else None
    none = np.full(len(limb.angles.names), np.nan)
    return _Problem(
        limb,
        model,
        measured,
        weight,
        softening if softening is not None else np.ones(len(measured)),
        np.array([none if m.posture.angles is None else m.posture.angles for m in matrices]),
        np.array([m.posture.distance or np.nan for m in matrices]),
    )


def _fixed(problem: _Problem) -> int:
    """Unknowns beside the places of feet."""
    model = problem.model
    return problem.joints * (2 if model.by_gain else 1) + int(model.structure)


def _started(problem: _Problem) -> Array:
    """Where to start: the best of a grid, each foot where it suits the stiffness best."""
    j, model = problem.joints, problem.model
    extra = [np.log(1e-3)] * (j if model.by_gain else 0)
    extra += [np.log(1e-5)] if model.structure else []
    if model.feet == "known":
        return min(
            (np.array([*-np.log([k] * j), *extra]) for k in _STIFFNESS),
            key=lambda x: float(np.log1p(problem.residual(x) ** 2).sum()),
        )
    reach = float(problem.limb.lengths[1:].sum())
    span = reach if model.feet == "horizontal" else np.pi / 2
    places = np.linspace(-span, span, _PLACES)
    everywhere = [np.full(len(problem.measured), place) for place in places]
    jacobian = np.array([problem.limb.jacobians(problem.posed(p)) for p in everywhere])
    reached = np.isfinite(jacobian).all(axis=(-1, -2))  # (P, T)
    best, best_cost = np.zeros(0), np.inf
    for soft in 1 / np.array(list(itertools.product(_STIFFNESS, repeat=j))):
        off = limb_matrices(np.nan_to_num(jacobian), soft, 1e-7) - problem.measured
        cost = np.log1p((off * problem.weight) ** 2).sum(axis=(-1, -2))
        cost = np.where(reached, cost, np.inf)
        total = float(cost.min(axis=0).sum())
        if total < best_cost:
            best_cost = total
            best = np.concatenate([np.log(soft), extra, places[cost.argmin(axis=0)]])
    return best


def _solve(problem: _Problem, start: Array, evaluations: int = 400) -> Array:
    fixed = _fixed(problem)
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    low[:fixed], high[:fixed] = np.log(1e-9), np.log(_COMPLIANCE[1])
    low[: problem.joints] = np.log(_COMPLIANCE[0])
    found = least_squares(
        lambda x: problem.residual(x).ravel(),
        np.clip(start, low, high),
        bounds=(low, high),
        loss="soft_l1",
        x_scale="jac",
        max_nfev=evaluations,
    )
    return np.asarray(found.x)


def _entries(problem: _Problem, x: Array) -> Array:
    """Residuals of the entries that count, freed of what the unknowns take up."""
    residual = problem.residual(x)[problem.weight.reshape(len(problem.measured), -1) > 0]
    return np.asarray(residual * np.sqrt(residual.size / max(residual.size - x.size, 1)))


def _resampled(problem: _Problem, x: Array, seed: int) -> list[Array]:
    """Fits to matrices drawn with replacement: postures are what a campaign samples."""
    rng = np.random.default_rng(seed)
    count, fixed = len(problem.measured), _fixed(problem)
    draws = []
    for _ in range(_RESAMPLES):
        rows = rng.integers(count, size=count)
        start = np.concatenate([x[:fixed], x[fixed:][rows] if len(x) > fixed else []])
        draws.append(_solve(problem.take(rows), start, 40)[:fixed])
    return draws


def _with_places(drawn: Array, x: Array) -> Array:
    return np.concatenate([drawn, x[len(drawn) :]])


def _share(problem: _Problem, x: Array) -> float:
    """The structure's part of the trace of the compliance, mean over postures."""
    own, shape, even, place = problem.parts(x)
    jacobian = problem.limb.jacobians(problem.posed(place))
    square = (jacobian**2).sum(axis=1)  # (T, j)
    joints = square @ own
    structure = square @ shape + even * jacobian.shape[1]
    return float(np.mean(structure / (joints + structure)))


def _estimate(value: float, draws: Sequence[float]) -> Estimate:
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(value), float(min(low, value)), float(max(high, value)))
