"""Envelopes by clustering: Algorithm 2 of chapter 5.2.2.1.

A Gaussian mixture finds centres; around each, the largest box without infeasible points (a
mixed-integer linear program); of the feasible points inside, those that the mixture finds likely;
their exterior boundary is the envelope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import LimitReached
from climbplan.learning.envelope_box import Envelope, exterior
from climbplan.solvers.highs.mixed_linear import MixedLinearProgram, solve_mixed_linear

_CLOSE = 1e-6  # of a box's span: how far a box ends before an excluded point
_RIDGE = 1e-4  # of the mixture's covariances, in squared standard deviations


@dataclass(frozen=True)
class Cluster:
    """One envelope and what it came from."""

    envelope: Envelope
    centre: Array  # (N, d)
    boundary: Envelope  # the largest box, before the filter
    boundary_gap: float  # relative, of its program
    kept: BoolArray  # (n,) feasible points that the exterior boundary is drawn about


def fit_clusters(
    feasible: Array,
    infeasible: Array,
    envelopes: int = 1,
    likelihood: float = 0.02,
    seed: int = 0,
    time_limit: float = 20.0,
) -> tuple[Cluster, ...]:
    """One cluster for each envelope.

    feasible: (n, N, d) points; infeasible: (m, N, d). likelihood: quantile of the likelihood of a
    cluster's points below which they are left out (p_th). time_limit: [s] of each largest box.
    """
    n = len(feasible)
    flat = feasible.reshape(n, -1)
    scale = np.maximum(flat.std(axis=0), 1e-6)
    middle = flat.mean(axis=0)
    from sklearn.mixture import GaussianMixture  # a second: envelopes are used without it

    mixture = GaussianMixture(envelopes, random_state=seed, reg_covar=_RIDGE, n_init=3)
    member = mixture.fit_predict((flat - middle) / scale)
    clusters = []
    for k in range(envelopes):
        own = member == k
        centre = mixture.means_[k] * scale + middle
        box, gap = largest_box(
            centre, infeasible.reshape(len(infeasible), -1), flat[own], time_limit
        )
        boundary = Envelope(
            box.lower.reshape(feasible.shape[1:]), box.upper.reshape(feasible.shape[1:])
        )
        inside = own & boundary.holds(feasible)
        score = mixture.score_samples((flat - middle) / scale)
        kept = inside & (score >= np.quantile(score[own], likelihood))
        if not kept.any():
            raise LimitReached(f"cluster {k}: no feasible point is left in its largest box")
        clusters.append(
            Cluster(
                exterior(feasible[kept]), centre.reshape(feasible.shape[1:]), boundary, gap, kept
            )
        )
    return tuple(clusters)


def largest_box(
    centre: Array, infeasible: Array, feasible: Array, time_limit: float = 20.0
) -> tuple[Envelope, float]:
    """The box about a centre (D,) with the largest sum of relative widths, and the gap proved.

    It stays within the exterior boundary of the feasible points (n, D) and holds none of the
    infeasible ones (m, D): each has an axis on which the box ends before it.
    Raises LimitReached if no box was found in time.
    """
    low, high = np.minimum(feasible.min(axis=0), centre), np.maximum(feasible.max(axis=0), centre)
    span = np.maximum(high - low, 1e-9)
    D = len(centre)
    within = ((infeasible >= low) & (infeasible <= high)).all(axis=1)
    points = infeasible[within]
    point, axis = np.nonzero(points != centre)
    count, binaries = len(points), len(point)
    # Columns: share of the lower side kept, share of the upper side kept, binaries
    below = points[point, axis] < centre[axis]
    side = np.where(below, axis, D + axis)
    room = np.where(below, (centre - low)[axis], (high - centre)[axis])
    distance = np.abs(points[point, axis] - centre[axis])
    limit = np.clip(distance / np.maximum(room, 1e-12) - _CLOSE, 0.0, 1.0)
    # kept + (1 - limit) z <= 1
    rows = np.arange(binaries)
    ends = sparse.csr_matrix(
        (
            np.concatenate([np.ones(binaries), 1.0 - limit]),
            (np.concatenate([rows, rows]), np.concatenate([side, 2 * D + rows])),
        ),
        shape=(binaries, 2 * D + binaries),
    )
    some = sparse.csr_matrix(
        (np.ones(binaries), (point, 2 * D + rows)), shape=(count, 2 * D + binaries)
    )
    widths = np.concatenate([(centre - low) / span, (high - centre) / span])
    answer = solve_mixed_linear(
        MixedLinearProgram(
            cost=np.concatenate([-widths, np.zeros(binaries)]),
            lower=np.zeros(2 * D + binaries),
            upper=np.ones(2 * D + binaries),
            A=sparse.vstack([ends, some]).tocsr(),
            row_lower=np.concatenate([np.full(binaries, -np.inf), np.ones(count)]),
            row_upper=np.concatenate([np.ones(binaries), np.full(count, np.inf)]),
            integer=np.arange(2 * D + binaries) >= 2 * D,
        ),
        time_limit,
    )
    if answer.x is None:
        raise LimitReached("no box about the centre without infeasible points was found in time")
    kept = np.clip(answer.x[: 2 * D], 0.0, 1.0)
    box = Envelope(centre - kept[:D] * (centre - low), centre + kept[D:] * (high - centre))
    return box, answer.gap
