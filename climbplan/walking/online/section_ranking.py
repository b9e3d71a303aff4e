"""Rankings of library sections for a measurement: nearest neighbours or trained strategies.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.boosting import fit_boosting
from climbplan.learning.clusters import ClusterOptions, cluster_solutions
from climbplan.learning.forest import fit_forest
from climbplan.learning.library import Library as Rows
from climbplan.learning.library import ProgramSignature
from climbplan.learning.network import fit_network
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.task.task import POSITION

StrategyName = Literal["knn", "forest", "boosting", "network", "reduce"]
_TREES, _DEPTH = 60, 30
_MAX_GAITS = 1000  # classes of a classifier; most gaits of a large library occur once
_ROUNDS, _RATE, _LEAVES = 30, 0.15, 16
_HIDDEN, _EPOCHS = (128, 128), 80
_CLUSTERS = ClusterOptions()
_MAX_COMPARED = 8000  # sections; the time of clustering grows with their square
_MIN_SPREAD = 1e-9  # [m], [N]


class Ranking(Protocol):
    """A ranking of library sections for a measurement."""

    def rank(self, features: Array, count: int) -> IntArray:
        """Return indices of at most `count` sections, best first; features (F,)."""
        ...


class _Classifier(Protocol):
    """A classifier of features."""

    def probabilities(self, features: Array) -> Array:
        """Return the probability of each class; features (F,)."""
        ...


class NearestNeighbours:
    """A ranking by the distance of features (k nearest neighbours)."""

    def __init__(self, library: SectionLibrary) -> None:
        self._features = library.features
        self._half_norm = 0.5 * (library.features**2).sum(axis=1)

    def compute_distances(self, features: Array) -> Array:
        """Return half the squared distance (K,) of each section, up to a common constant."""
        distances: Array = self._half_norm - self._features @ features
        return distances

    def rank(self, features: Array, count: int) -> IntArray:
        """Return indices of the nearest sections, nearest first."""
        distances = self.compute_distances(features)
        count = min(count, len(distances))
        candidates = (
            np.argpartition(distances, count - 1)[:count] if count else np.zeros(0, np.int64)
        )
        nearest: IntArray = candidates[np.argsort(distances[candidates])]
        return nearest


class GaitRanking:
    """A ranking of gaits by a classifier; each gait is represented by its nearest section."""

    def __init__(self, library: SectionLibrary, gait: IntArray, model: _Classifier) -> None:
        """Group the sections by gait.

        Args:
            library: K sections.
            gait: (K,) class of each section, -1 for sections that are never proposed.
            model: classifier of gaits.
        """
        self._model = model
        self._neighbours = NearestNeighbours(library)
        order = np.argsort(gait, kind="stable")
        bounds = np.searchsorted(gait[order], np.arange(int(gait.max()) + 2))
        self._sections = [order[a:b] for a, b in pairwise(bounds)]

    def rank(self, features: Array, count: int) -> IntArray:
        """Return one section of each of the likeliest gaits, likeliest first."""
        probability = self._model.probabilities(features)
        distances = self._neighbours.compute_distances(features)
        count = min(count, len(probability))
        likeliest = np.argpartition(-probability, count - 1)[:count]
        likeliest = likeliest[np.argsort(-probability[likeliest], kind="stable")]
        best = [self._sections[k][np.argmin(distances[self._sections[k]])] for k in likeliest]
        return np.array(best, np.int64)


class SectionClusterRanking:
    """A ranking by clusters of solutions: the gaits of the likeliest cluster, nearest first.

    A cluster's reduced mixed-integer program chooses among the contact combinations that occur in
    the cluster (section 7.2.2). They are few, so a tick solves them one by one with fixed
    contacts. Gaits of the next likeliest cluster follow.
    """

    def __init__(
        self, library: SectionLibrary, cluster: IntArray, gait: IntArray, model: _Classifier
    ) -> None:
        """Group the sections by cluster.

        Args:
            library: K sections.
            cluster: (K,) cluster of each section.
            gait: (K,) gait of each section.
            model: classifier of clusters.
        """
        self._model, self._gait = model, gait
        self._neighbours = NearestNeighbours(library)
        self._members = [np.flatnonzero(cluster == k) for k in range(int(cluster.max()) + 1)]

    def rank(self, features: Array, count: int) -> IntArray:
        """Return one section of each gait of the likeliest clusters, by cluster and distance."""
        distances = self._neighbours.compute_distances(features)
        ranking: list[int] = []
        ranked_gaits: set[int] = set()
        for k in np.argsort(-self._model.probabilities(features), kind="stable"):
            members = self._members[k]
            by_distance = members[np.argsort(distances[members], kind="stable")]
            _, first = np.unique(self._gait[by_distance], return_index=True)
            for section in by_distance[np.sort(first)].tolist():
                if self._gait[section] not in ranked_gaits:
                    ranked_gaits.add(int(self._gait[section]))
                    ranking.append(section)
            if len(ranking) >= count:
                break
        return np.array(ranking[:count], np.int64)


def cluster_sections(library: SectionLibrary, seed: int) -> IntArray:
    """Cluster sections by their solutions and return the cluster (K,) of each, largest first.

    Solutions are compared by the factors of the bilinear moments: moment arms of standing legs,
    and forces. Of a large library a random sample is clustered; the other sections join the
    cluster of their nearest sample.
    """
    arms = library.toes - library.state[:, :, None, POSITION]
    arms = np.where(library.contact[..., None], arms, 0.0)
    vectors = np.concatenate([arms, library.force], axis=-1).reshape(len(library), -1)
    std = vectors.std(axis=0)
    scaled = (vectors - vectors.mean(axis=0)) / np.where(std > _MIN_SPREAD, std, 1.0)
    if len(scaled) <= _MAX_COMPARED:
        return cluster_solutions(scaled, _CLUSTERS, seed)
    from scipy.spatial import cKDTree

    sampled = np.random.default_rng(seed).choice(len(scaled), _MAX_COMPARED, replace=False)
    cluster = cluster_solutions(scaled[sampled], _CLUSTERS, seed)
    nearest: IntArray = cKDTree(scaled[sampled]).query(scaled)[1]
    return cluster[nearest]


def train_section_ranking(name: StrategyName, library: SectionLibrary, seed: int) -> Ranking:
    """Train the ranking of a name on a library; "knn" needs no training."""
    if name == "knn" or not len(library):
        return NearestNeighbours(library)
    rows = _build_training_rows(library)
    gait, classes = rows.strategy, len(rows.strategies)
    model: _Classifier
    if name == "reduce":
        cluster = cluster_sections(library, seed)
        count = int(cluster.max()) + 1
        model = fit_forest(library.features, cluster, count, _TREES, _DEPTH, seed)
        return SectionClusterRanking(library, cluster, gait, model)
    if name == "boosting":  # knows contacts one by one, and so all gaits
        return GaitRanking(library, gait, fit_boosting(rows, _ROUNDS, _RATE, _LEAVES, seed))
    gait, classes = select_commonest(gait, classes, _MAX_GAITS)
    is_common = gait >= 0
    features, labels = library.features[is_common], gait[is_common]
    if name == "forest":
        model = fit_forest(features, labels, classes, _TREES, _DEPTH, seed)
    else:
        model = fit_network(features, labels, classes, _HIDDEN, _EPOCHS, seed)
    return GaitRanking(library, gait, model)


def select_commonest(labels: IntArray, classes: int, max_classes: int) -> tuple[IntArray, int]:
    """Keep the labels (K,) of the commonest classes; others become -1.

    Labels stay as they are where there are at most `max_classes` classes.

    Returns:
        New labels (K,) and the number of classes.
    """
    if classes <= max_classes:
        return labels, classes
    size = np.bincount(labels, minlength=classes)
    commonest = np.sort(np.argsort(-size, kind="stable")[:max_classes])
    rank = np.full(classes, -1, np.int64)
    rank[commonest] = np.arange(max_classes)
    return rank[labels], max_classes


def _build_training_rows(library: SectionLibrary) -> Rows:
    """Return sections as solved problems whose integers are their contacts."""
    bits = library.contact.reshape(len(library), -1).astype(float)
    frame = ProgramSignature("walk", np.ones(bits.shape[1], bool), np.zeros(0, np.int64))
    return Rows.of(frame, library.features, bits, np.zeros(len(bits)))
