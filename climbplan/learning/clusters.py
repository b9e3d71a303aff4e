"""Cluster solutions without labels (section 7.2.2.1).

Solutions are compared by the factors of products, each scaled by its spread. The published method
is OPTICS with a DBSCAN cut, whose distance has to be tuned by hand. HDBSCAN selects the most
persistent clusters and needs no distance; it is the default.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
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
    """Options of clustering, and the treatment of outliers."""

    method: Clustering = "hdbscan"
    least: int = 10  # smallest cluster size; for optics and dbscan neighbours of a core point
    distance: float = 2.5  # of dbscan and the cut of optics, on scaled solutions
    count: int = 50  # number of clusters of kmeans
    outliers: Outliers = "nearest"


def select_solution_columns(instance: Instance) -> IntArray:
    """Select variables to compare solutions: factors of products, else all continuous."""
    products = instance.products
    factors = np.unique(np.concatenate([products.first, products.second])).astype(np.int64)
    continuous = factors[~instance.integer[factors]]
    return continuous if len(continuous) else np.flatnonzero(~instance.integer)


def build_solution_vectors(library: Library, columns: IntArray) -> Array:
    """Return solutions (S, d) in some variables, each scaled by its spread in the library."""
    values = library.points[:, columns]
    deviation = values.std(axis=0)
    return np.asarray((values - values.mean(axis=0)) / np.where(deviation > 1e-9, deviation, 1.0))


def cluster_solutions(vectors: Array, options: ClusterOptions, seed: int) -> IntArray:
    """Return the cluster (S,) of each solution, the largest first, or OUTLIER.

    `vectors` (S, d) are scaled. Without any cluster all solutions are one, unless outliers are
    dropped.

    Raises:
        UsageError: No cluster is found and outliers are dropped.
    """
    label = _fit_labels(vectors, options, seed)
    inside = label != OUTLIER
    if not inside.any() and options.outliers == "nearest":
        return np.zeros(len(vectors), np.int64)
    if not inside.any():
        raise UsageError(
            f"{options.method} finds no cluster of {options.least} or more among "
            f"{len(vectors)} solutions: more data, or fewer members"
        )
    assigned = label.copy()
    if options.outliers == "nearest" and not inside.all():
        from scipy.spatial import cKDTree

        _, nearest = cKDTree(vectors[inside]).query(vectors[~inside])
        assigned[~inside] = label[inside][nearest]
    is_clustered = assigned != OUTLIER
    size = np.bincount(assigned[is_clustered])
    rank = np.empty(len(size), np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    return np.where(is_clustered, rank[assigned], OUTLIER)


def _fit_labels(vectors: Array, options: ClusterOptions, seed: int) -> IntArray:
    """Run the clustering method."""
    from sklearn import cluster

    min_size = min(options.least, max(len(vectors) // 2, 2))
    if options.method == "hdbscan":
        method = cluster.HDBSCAN(min_cluster_size=min_size, min_samples=min(5, min_size), copy=True)
    elif options.method == "dbscan":
        method = cluster.DBSCAN(eps=options.distance, min_samples=min_size)
    elif options.method == "optics":
        method = cluster.OPTICS(min_samples=min_size, cluster_method="dbscan", eps=options.distance)
    else:
        count = min(options.count, len(np.unique(vectors, axis=0)))
        method = cluster.KMeans(count, n_init=1, random_state=seed)
    return np.asarray(method.fit(vectors).labels_, np.int64)
