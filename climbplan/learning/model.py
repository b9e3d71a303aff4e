"""A trained strategy: solved problems, a classifier of plain arrays, and what it was made for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.boosting import Boosting, fit_boosting
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.clusters import OUTLIER, ClusterOptions, clustered, solution_vectors
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
    """What is trained and how; what a kind does not use it ignores."""

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

    context: plain values that a problem must share to be served (shelf, meaning, features).
    """

    kind: ModelKind
    library: Library
    scale: Array  # (p,) of the features in distances
    classifier: Forest | Network | Boosting | None  # None: knn
    cluster: IntArray | None  # (S,) of reduce
    context: Mapping[str, Any] = field(default_factory=dict)

    def strategy(self) -> Strategy:
        """The trained strategy behind the one interface."""
        if self.kind == "knn":
            return NearestProblems(self.library, self.scale, "mixed")
        if self.kind == "reduce":
            return self.clusters()
        if self.classifier is None:
            raise UsageError(f"a model of kind {self.kind!r} needs a classifier")
        return RankedStrategies(self.library, self.classifier, self.scale)

    def clusters(self) -> ClusterRanking:
        """The clusters of a model of kind `reduce`."""
        if self.cluster is None or self.classifier is None:
            raise UsageError(f"a model of kind {self.kind!r} has no clusters")
        return ClusterRanking(self.library, self.cluster, self.classifier, self.scale)

    def require(self) -> None:
        """Raises UsageError unless classifier, clusters and library fit one another."""
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


def fit(
    library: Library,
    options: FitOptions,
    columns: IntArray,
    scale: Array | None = None,
    context: Mapping[str, Any] | None = None,
) -> StrategyModel:
    """Train a strategy on solved problems; the same rows and seed give the same model.

    columns: variables that solutions are clustered by (`solution_columns`). scale: (p,) of the
    features in distances; their standard deviations if left out. Raises UsageError for an empty
    library, and if no cluster is found.
    """
    if not library.size:
        raise UsageError("a strategy needs at least one solved problem")
    deviation = library.features.std(axis=0)
    own = np.where(deviation > 1e-12, deviation, 1.0) if scale is None else scale
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
        cluster = clustered(solution_vectors(library, columns), options.clusters, seed)
        inside = cluster != OUTLIER
        classifier = fit_forest(
            features[inside],
            cluster[inside],
            int(cluster.max()) + 1,
            options.cluster_trees,
            options.depth,
            seed,
        )
    model = StrategyModel(kind, library, own, classifier, cluster, dict(context or {}))
    model.require()
    return model
