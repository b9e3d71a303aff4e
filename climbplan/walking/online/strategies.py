"""Which stored sections a situation calls for, best first: neighbours, or trained strategies."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.learning.boosting import fit_boosting
from climbplan.learning.clusters import ClusterOptions, clustered
from climbplan.learning.forest import fit_forest
from climbplan.learning.library import Frame
from climbplan.learning.library import Library as Rows
from climbplan.learning.network import fit_network
from climbplan.walking.online.library import Library
from climbplan.walking.task.task import POSITION

StrategyName = Literal["knn", "forest", "boosting", "network", "reduce"]
_TREES, _DEPTH = 60, 30
_GAITS = 1000  # most that a classifier tells apart; most of ten thousand walks' gaits occur once
_ROUNDS, _RATE, _LEAVES = 30, 0.15, 16
_HIDDEN, _EPOCHS = (128, 128), 80
_CLUSTERS = ClusterOptions()
_COMPARED = 8000  # sections that clusters are found among, as time grows with their square
_SAME = 1e-9  # [m], [N]


class Ranking(Protocol):
    """Ranks the sections of a library for a situation."""

    def ranked(self, features: Array, count: int) -> IntArray:
        """Indices of at most `count` sections, best first; features (F,)."""
        ...


class _Classifier(Protocol):
    def probabilities(self, features: Array) -> Array: ...


class Neighbours:
    """The k nearest, by the distance of features."""

    def __init__(self, library: Library) -> None:
        self._features = library.features
        self._half_norm = 0.5 * (library.features**2).sum(axis=1)

    def apart(self, features: Array) -> Array:
        """(K,) half the squared distance of each section, less what is the same for all."""
        apart: Array = self._half_norm - self._features @ features
        return apart

    def ranked(self, features: Array, count: int) -> IntArray:
        """Indices of the nearest sections, nearest first."""
        apart = self.apart(features)
        count = min(count, len(apart))
        found = np.argpartition(apart, count - 1)[:count] if count else np.zeros(0, np.int64)
        nearest: IntArray = found[np.argsort(apart[found])]
        return nearest


class Trained:
    """Gaits by a classifier's probability; of each the section nearest to the situation."""

    def __init__(self, library: Library, gait: IntArray, model: _Classifier) -> None:
        """gait (K,): class of each section, -1 of those that are never proposed."""
        self._model = model
        self._near = Neighbours(library)
        order = np.argsort(gait, kind="stable")
        bounds = np.searchsorted(gait[order], np.arange(int(gait.max()) + 2))
        self._sections = [order[a:b] for a, b in pairwise(bounds)]

    def ranked(self, features: Array, count: int) -> IntArray:
        """One section of each of the likeliest gaits, likeliest first."""
        chance = self._model.probabilities(features)
        apart = self._near.apart(features)
        count = min(count, len(chance))
        likely = np.argpartition(-chance, count - 1)[:count]
        likely = likely[np.argsort(-chance[likely], kind="stable")]
        best = [self._sections[k][np.argmin(apart[self._sections[k]])] for k in likely]
        return np.array(best, np.int64)


class Reduced:
    """Sections by the likeliest cluster of solutions: its own gaits alone, nearest first.

    What a cluster's mixed-integer program may choose from is the combinations of contacts that
    occur in it (section 7.2.2); they are so few that a tick solves them one by one, contacts
    pinned. Where they are used up those of the next likeliest cluster follow.
    """

    def __init__(
        self, library: Library, cluster: IntArray, gait: IntArray, model: _Classifier
    ) -> None:
        """cluster, gait (K,): classes of each section."""
        self._model, self._gait = model, gait
        self._near = Neighbours(library)
        self._members = [np.flatnonzero(cluster == k) for k in range(int(cluster.max()) + 1)]

    def ranked(self, features: Array, count: int) -> IntArray:
        """One section of each gait of the likeliest clusters, by cluster and then by distance."""
        apart = self._near.apart(features)
        found: list[int] = []
        seen: set[int] = set()
        for k in np.argsort(-self._model.probabilities(features), kind="stable"):
            members = self._members[k]
            near = members[np.argsort(apart[members], kind="stable")]
            _, first = np.unique(self._gait[near], return_index=True)
            for section in near[np.sort(first)].tolist():
                if self._gait[section] not in seen:
                    seen.add(int(self._gait[section]))
                    found.append(section)
            if len(found) >= count:
                break
        return np.array(found[:count], np.int64)


def clusters_of(library: Library, seed: int) -> IntArray:
    """The cluster (K,) of each section, the largest of those compared first.

    Solutions are compared by what moments are products of: arms of legs that stand, and forces.
    Of many sections some are drawn and compared, and the others are in the cluster of the nearest.
    """
    arms = library.toes - library.state[:, :, None, POSITION]
    arms = np.where(library.contact[..., None], arms, 0.0)
    both = np.concatenate([arms, library.force], axis=-1).reshape(len(library), -1)
    spread = both.std(axis=0)
    scaled = (both - both.mean(axis=0)) / np.where(spread > _SAME, spread, 1.0)
    if len(scaled) <= _COMPARED:
        return clustered(scaled, _CLUSTERS, seed)
    from scipy.spatial import cKDTree

    drawn = np.random.default_rng(seed).choice(len(scaled), _COMPARED, replace=False)
    cluster = clustered(scaled[drawn], _CLUSTERS, seed)
    nearest: IntArray = cKDTree(scaled[drawn]).query(scaled)[1]
    return cluster[nearest]


def trained(name: StrategyName, library: Library, seed: int) -> Ranking:
    """A strategy by its name, trained on the library's sections where it has to be."""
    if name == "knn" or not len(library):
        return Neighbours(library)
    rows = _rows(library)
    gait, classes = rows.strategy, len(rows.strategies)
    model: _Classifier
    if name == "reduce":
        cluster = clusters_of(library, seed)
        count = int(cluster.max()) + 1
        model = fit_forest(library.features, cluster, count, _TREES, _DEPTH, seed)
        return Reduced(library, cluster, gait, model)
    if name == "boosting":  # knows contacts one by one, and so all gaits
        return Trained(library, gait, fit_boosting(rows, _ROUNDS, _RATE, _LEAVES, seed))
    gait, classes = commonest(gait, classes, _GAITS)
    known = gait >= 0
    features, labels = library.features[known], gait[known]
    if name == "forest":
        model = fit_forest(features, labels, classes, _TREES, _DEPTH, seed)
    else:
        model = fit_network(features, labels, classes, _HIDDEN, _EPOCHS, seed)
    return Trained(library, gait, model)


def commonest(labels: IntArray, classes: int, most: int) -> tuple[IntArray, int]:
    """Labels (K,) of the commonest classes alone, others -1, and how many classes are left.

    Where there are no more than `most` they stay as they are.
    """
    if classes <= most:
        return labels, classes
    size = np.bincount(labels, minlength=classes)
    kept = np.sort(np.argsort(-size, kind="stable")[:most])
    rank = np.full(classes, -1, np.int64)
    rank[kept] = np.arange(most)
    return rank[labels], most


def _rows(library: Library) -> Rows:
    """Sections as solved problems whose integers are their contacts."""
    bits = library.contact.reshape(len(library), -1).astype(float)
    frame = Frame("walk", np.ones(bits.shape[1], bool), np.zeros(0, np.int64))
    return Rows.of(frame, library.features, bits, np.zeros(len(bits)))
