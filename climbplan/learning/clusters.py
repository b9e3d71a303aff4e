"""Clusters of solutions, found without labels (section 7.2.2.1).

Solutions are compared by the variables that products are made of, each in its own spread.
Published: OPTICS with a DBSCAN cut, whose distance has to be tuned by hand. HDBSCAN cuts its tree
where clusters last longest and needs no distance; it is the default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.library import Library
from climbplan.program.instance import Instance

Clustering = Literal["hdbscan", "optics", "dbscan", "kmeans"]
Outliers = Literal["nearest", "drop"]
OUTLIER = -1


@dataclass(frozen=True)
class ClusterOptions:
    """Which method, and what becomes of solutions that belong nowhere."""

    method: Clustering = "hdbscan"
    least: int = 10  # members of a cluster at least; of optics and dbscan neighbours of a core
    distance: float = 2.5  # of dbscan and the cut of optics, on scaled solutions
    count: int = 50  # of kmeans
    outliers: Outliers = "nearest"


def solution_columns(instance: Instance) -> IntArray:
    """Variables that solutions are compared by: factors of products, all continuous without any."""
    products = instance.products
    factors = np.unique(np.concatenate([products.first, products.second])).astype(np.int64)
    continuous = factors[~instance.integer[factors]]
    return continuous if len(continuous) else np.flatnonzero(~instance.integer)


def solution_vectors(library: Library, columns: IntArray) -> Array:
    """Solutions (S, d) by some of their variables, each in its spread over the library."""
    values = library.points[:, columns]
    deviation = values.std(axis=0)
    return np.asarray((values - values.mean(axis=0)) / np.where(deviation > 1e-9, deviation, 1.0))


def clustered(vectors: Array, options: ClusterOptions, seed: int) -> IntArray:
    """The cluster (S,) of each solution, the largest first; OUTLIER where outliers are dropped.

    vectors: (S, d) scaled. Where no cluster is found all solutions are one, unless outliers are
    dropped: then raises UsageError.
    """
    label = _labels(vectors, options, seed)
    inside = label != OUTLIER
    if not inside.any() and options.outliers == "nearest":
        return np.zeros(len(vectors), np.int64)
    if not inside.any():
        raise UsageError(
            f"{options.method} finds no cluster of {options.least} or more among "
            f"{len(vectors)} solutions: more data, or fewer members"
        )
    out = label.copy()
    if options.outliers == "nearest" and not inside.all():
        from scipy.spatial import cKDTree

        _, nearest = cKDTree(vectors[inside]).query(vectors[~inside])
        out[~inside] = label[inside][nearest]
    found = out != OUTLIER
    size = np.bincount(out[found])
    rank = np.empty(len(size), np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    return np.where(found, rank[out], OUTLIER)


def _labels(vectors: Array, options: ClusterOptions, seed: int) -> IntArray:
    from sklearn import cluster

    least = min(options.least, max(len(vectors) // 2, 2))
    if options.method == "hdbscan":
        method = cluster.HDBSCAN(min_cluster_size=least, min_samples=min(5, least), copy=True)
    elif options.method == "dbscan":
        method = cluster.DBSCAN(eps=options.distance, min_samples=least)
    elif options.method == "optics":
        method = cluster.OPTICS(min_samples=least, cluster_method="dbscan", eps=options.distance)
    else:
        count = min(options.count, len(np.unique(vectors, axis=0)))
        method = cluster.KMeans(count, n_init=1, random_state=seed)
    return np.asarray(method.fit(vectors).labels_, np.int64)
