"""A trained strategy: solved problems, a classifier of plain arrays, and its context."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.boosting import Boosting, fit_boosting
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.clusters import (
    OUTLIER,
    ClusterOptions,
    build_solution_vectors,
    cluster_solutions,
)
from climbplan.learning.forest import Forest, fit_forest
from climbplan.learning.library import Library
from climbplan.learning.neighbours import NearestProblems
from climbplan.learning.network import Network, fit_network
from climbplan.learning.ranking import RankedStrategies
from climbplan.learning.strategy import Strategy

ModelKind = Literal["knn", "forest", "boosting", "network", "reduce"]
MODEL_KINDS: tuple[ModelKind, ...] = get_args(ModelKind)


@dataclass(frozen=True)
class FitOptions:
    """Options of training; options that a kind does not use are ignored."""

    kind: ModelKind = "forest"
    trees: int = 150
    depth: int = 75
    hidden: tuple[int, ...] = (128, 128)
    epochs: int = 60
    rounds: int = 60
    rate: float = 0.1
    leaves: int = 31
    cluster_trees: int = 150
    clusters: ClusterOptions = field(default_factory=ClusterOptions)
    seed: int = 0


@dataclass(frozen=True)
class StrategyModel:
    """One trained strategy.

    The context has plain values that a problem must share (shelf, meaning, features).
    """

    kind: ModelKind
    library: Library
    scale: Array  # (p,) of the features in distances
    classifier: Forest | Network | Boosting | None  # None: knn
    cluster: IntArray | None  # (S,) of reduce
    context: Mapping[str, Any] = field(default_factory=dict)

    def create_strategy(self) -> Strategy:
        """Create the strategy of the model."""
        if self.kind == "knn":
            return NearestProblems(self.library, self.scale, "mixed")
        if self.kind == "reduce":
            return self.create_cluster_ranking()
        if self.classifier is None:
            raise UsageError(f"a model of kind {self.kind!r} needs a classifier")
        return RankedStrategies(self.library, self.classifier, self.scale)

    def create_cluster_ranking(self) -> ClusterRanking:
        """Create the ranking of clusters of a model of kind `reduce`."""
        if self.cluster is None or self.classifier is None:
            raise UsageError(f"a model of kind {self.kind!r} has no clusters")
        return ClusterRanking(self.library, self.cluster, self.classifier, self.scale)

    def require(self) -> None:
        """Check that classifier, clusters and library fit one another.

        Raises:
            UsageError: They do not.
        """
        library, p = self.library, self.library.features.shape[1]
        if not library.size:
            raise UsageError("a model without solved problems")
        if self.scale.shape != (p,) or not (self.scale > 0).all():
            raise UsageError(f"scale: {p} positive numbers expected")
        classes = len(library.strategies)
        if self.cluster is not None:
            if self.cluster.shape != (library.size,) or self.cluster.min() < OUTLIER:
                raise UsageError(f"cluster: {library.size} cluster numbers expected")
            classes = int(self.cluster.max()) + 1
            if len(np.unique(self.cluster[self.cluster >= 0])) != classes or not classes:
                raise UsageError("cluster: some cluster has no member")
        if isinstance(self.classifier, Forest):
            self.classifier.require(p)
            if self.classifier.classes != classes:
                raise UsageError(f"forest: {self.classifier.classes} classes, expected {classes}")
        elif self.classifier is not None:
            self.classifier.require(p, classes)


def fit_strategy(
    library: Library,
    options: FitOptions,
    columns: IntArray,
    scale: Array | None = None,
    context: Mapping[str, Any] | None = None,
) -> StrategyModel:
    """Train a strategy on solved problems; the same rows and seed give the same model.

    Args:
        library: Solved problems.
        options: Options of training.
        columns: Variables by which solutions are clustered (`select_solution_columns`).
        scale: (p,) scale of features in distances, by default their standard deviations.
        context: Plain values that a problem must share.

    Raises:
        UsageError: The library is empty, or no cluster is found.
    """
    if not library.size:
        raise UsageError("a strategy needs at least one solved problem")
    deviation = library.features.std(axis=0)
    feature_scale = np.where(deviation > 1e-12, deviation, 1.0) if scale is None else scale
    kind, seed, U = options.kind, options.seed, len(library.strategies)
    features, labels = library.features, library.strategy
    classifier: Forest | Network | Boosting | None = None
    cluster: IntArray | None = None
    if kind == "forest":
        classifier = fit_forest(features, labels, U, options.trees, options.depth, seed)
    elif kind == "network":
        classifier = fit_network(features, labels, U, options.hidden, options.epochs, seed)
    elif kind == "boosting":
        classifier = fit_boosting(library, options.rounds, options.rate, options.leaves, seed)
    elif kind == "reduce":
        cluster = cluster_solutions(
            build_solution_vectors(library, columns), options.clusters, seed
        )
        is_clustered = cluster != OUTLIER
        classifier = fit_forest(
            features[is_clustered],
            cluster[is_clustered],
            int(cluster.max()) + 1,
            options.cluster_trees,
            options.depth,
            seed,
        )
    model = StrategyModel(kind, library, feature_scale, classifier, cluster, dict(context or {}))
    model.require()
    return model
