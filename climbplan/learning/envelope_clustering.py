"""Envelopes by clustering: Algorithm 2 of chapter 5.2.2.1.

A Gaussian mixture gives centers. Around each center the largest box without infeasible points is
computed by a mixed-integer linear program. The envelope is the bounding box of the feasible points
in it that are likely under the mixture.

Chapter and algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray
from climbplan.errors import LimitReached
from climbplan.learning.envelope_box import Envelope, compute_bounding_box
from climbplan.solvers.highs.mixed_linear import MixedLinearProgram, solve_mixed_linear

_CLOSE = 1e-6  # distance of a box from an excluded point, relative to its span
_RIDGE = 1e-4  # of the mixture's covariances, in squared standard deviations


@dataclass(frozen=True)
class EnvelopeCluster:
    """One envelope and its origin."""

    envelope: Envelope
    centre: Array  # (N, d)
    boundary: Envelope  # the largest box, before the filter
    boundary_gap: float  # relative, of its program
    kept: BoolArray  # (n,) feasible points of which the envelope is the bounding box


def fit_clusters(
    feasible: Array,
    infeasible: Array,
    envelopes: int = 1,
    likelihood: float = 0.02,
    seed: int = 0,
    time_limit: float = 20.0,
) -> tuple[EnvelopeCluster, ...]:
    """Fit one cluster for each envelope.

    Args:
        feasible: (n, N, d) points.
        infeasible: (m, N, d) points.
        envelopes: Number of envelopes.
        likelihood: Quantile of the likelihood of a cluster's points below which they are left out
            (p_th).
        seed: Seed of the mixture.
        time_limit: Time limit of each largest box [s].
    """
    n = len(feasible)
    flat = feasible.reshape(n, -1)
    scale = np.maximum(flat.std(axis=0), 1e-6)
    mean = flat.mean(axis=0)
    from sklearn.mixture import GaussianMixture  # slow to import, and only needed for fitting

    mixture = GaussianMixture(envelopes, random_state=seed, reg_covar=_RIDGE, n_init=3)
    member = mixture.fit_predict((flat - mean) / scale)
    clusters = []
    for k in range(envelopes):
        is_member = member == k
        center = mixture.means_[k] * scale + mean
        box, gap = find_largest_box(
            center, infeasible.reshape(len(infeasible), -1), flat[is_member], time_limit
        )
        boundary = Envelope(
            box.lower.reshape(feasible.shape[1:]), box.upper.reshape(feasible.shape[1:])
        )
        inside = is_member & boundary.contains(feasible)
        score = mixture.score_samples((flat - mean) / scale)
        is_likely = inside & (score >= np.quantile(score[is_member], likelihood))
        if not is_likely.any():
            raise LimitReached(f"cluster {k}: no feasible point is left in its largest box")
        clusters.append(
            EnvelopeCluster(
                compute_bounding_box(feasible[is_likely]),
                center.reshape(feasible.shape[1:]),
                boundary,
                gap,
                is_likely,
            )
        )
    return tuple(clusters)


def find_largest_box(
    center: Array, infeasible: Array, feasible: Array, time_limit: float = 20.0
) -> tuple[Envelope, float]:
    """Find the box around a center (D,) with the largest sum of relative widths, and its gap.

    It stays within the bounding box of the feasible points (n, D) and contains none of the
    infeasible ones (m, D): for each there is an axis on which the box ends before it.

    Raises:
        LimitReached: No box was found in time.
    """
    low, high = np.minimum(feasible.min(axis=0), center), np.maximum(feasible.max(axis=0), center)
    span = np.maximum(high - low, 1e-9)
    D = len(center)
    is_candidate = ((infeasible >= low) & (infeasible <= high)).all(axis=1)
    points = infeasible[is_candidate]
    point, axis = np.nonzero(points != center)
    count, binaries = len(points), len(point)
    # Columns: fraction of the lower side, fraction of the upper side, binaries
    below = points[point, axis] < center[axis]
    side = np.where(below, axis, D + axis)
    side_width = np.where(below, (center - low)[axis], (high - center)[axis])
    distance = np.abs(points[point, axis] - center[axis])
    limit = np.clip(distance / np.maximum(side_width, 1e-12) - _CLOSE, 0.0, 1.0)
    # fraction + (1 - limit) z <= 1
    rows = np.arange(binaries)
    ends = sparse.csr_matrix(
        (
            np.concatenate([np.ones(binaries), 1.0 - limit]),
            (np.concatenate([rows, rows]), np.concatenate([side, 2 * D + rows])),
        ),
        shape=(binaries, 2 * D + binaries),
    )
    one_axis = sparse.csr_matrix(
        (np.ones(binaries), (point, 2 * D + rows)), shape=(count, 2 * D + binaries)
    )
    widths = np.concatenate([(center - low) / span, (high - center) / span])
    answer = solve_mixed_linear(
        MixedLinearProgram(
            cost=np.concatenate([-widths, np.zeros(binaries)]),
            lower=np.zeros(2 * D + binaries),
            upper=np.ones(2 * D + binaries),
            A=sparse.vstack([ends, one_axis]).tocsr(),
            row_lower=np.concatenate([np.full(binaries, -np.inf), np.ones(count)]),
            row_upper=np.concatenate([np.ones(binaries), np.full(count, np.inf)]),
            integer=np.arange(2 * D + binaries) >= 2 * D,
        ),
        time_limit,
    )
    if answer.x is None:
        raise LimitReached(
            "no box without infeasible points about the cluster's centre was found within the time "
            "limit"
        )
    fraction = np.clip(answer.x[: 2 * D], 0.0, 1.0)
    box = Envelope(center - fraction[:D] * (center - low), center + fraction[D:] * (high - center))
    return box, answer.gap
