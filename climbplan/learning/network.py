"""A neural network with a softmax over strategies (CoCo: Cauligi et al. 2022, section 8.1.3.3).

Published: one hidden layer of 10,000 rectified units for 17 features. Two layers of 128 rank
strategies as well at a hundredth of the weights.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.quiet_training import quiet_training


@dataclass(frozen=True)
class Network:
    """Layers of rectified units on standardised features; sizes[0] features, sizes[-1] classes."""

    sizes: IntArray  # (L + 1,)
    weight: Array  # (sum of sizes[k] sizes[k + 1],) layer by layer, rows are inputs
    bias: Array  # (sum of sizes[1:],)
    mean: Array  # (p,)
    scale: Array  # (p,)

    @cached_property
    def _layers(self) -> list[tuple[Array, Array]]:
        out, w, b = [], 0, 0
        for wide, narrow in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            matrix = self.weight[w : w + wide * narrow].reshape(wide, narrow)
            out.append((matrix, self.bias[b : b + narrow]))
            w, b = w + wide * narrow, b + narrow
        return out

    def probabilities(self, features: Array) -> Array:
        """Softmax over the classes at features (p,)."""
        value = (features - self.mean) / self.scale
        for k, (matrix, bias) in enumerate(self._layers):
            value = (np.maximum(value, 0.0) if k else value) @ matrix + bias
        power = np.exp(value - value.max())
        return np.asarray(power / power.sum())

    def require(self, features: int, classes: int) -> None:
        """Raises UsageError unless the arrays are those of such a network."""
        sizes = [int(size) for size in self.sizes]  # exact: products of hostile sizes are large
        if len(sizes) < 2 or min(sizes) < 1:
            raise UsageError(f"network: layers of sizes {sizes}")
        if sizes[0] != features or sizes[-1] != classes:
            raise UsageError(
                f"network: {sizes[0]} features and {sizes[-1]} classes, "
                f"expected {features} and {classes}"
            )
        weights = sum(a * b for a, b in itertools.pairwise(sizes))
        if len(self.weight) != weights or len(self.bias) != sum(sizes[1:]):
            raise UsageError(
                f"network: {len(self.weight)} weights and {len(self.bias)} biases do not fit "
                f"layers of sizes {sizes}"
            )
        if self.mean.shape != (features,) or self.scale.shape != (features,):
            raise UsageError(f"network: mean or scale is not that of {features} features")
        if not (self.scale > 0).all():
            raise UsageError("network: a scale that is not positive")


def fit_network(
    features: Array,
    labels: IntArray,
    classes: int,
    hidden: tuple[int, ...],
    epochs: int,
    seed: int,
) -> Network:
    """Train with Adam on cross-entropy by scikit-learn; the same rows and seed give the same.

    features: (S, p). labels: (S,) below `classes`. hidden: units of each hidden layer. epochs:
    passes over the data at most.
    """
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    scale = np.where(deviation > 1e-12, deviation, 1.0)
    known = np.unique(labels)
    if len(known) == 1:
        # Nothing to tell apart; scikit-learn would make a single unit of it.
        bias = np.full(classes, -math.inf)
        bias[known] = 0.0
        sizes = np.array([features.shape[1], classes])
        return Network(sizes, np.zeros(sizes.prod()), np.maximum(bias, -50.0), mean, scale)
    from sklearn.neural_network import MLPClassifier

    trainer = MLPClassifier(
        hidden,
        alpha=1e-4,
        batch_size=min(64, len(features)),
        learning_rate_init=1e-3,
        max_iter=epochs,
        random_state=seed,
    )
    with quiet_training():
        trainer.fit((features - mean) / scale, labels)
    matrices, biases = list(trainer.coefs_), list(trainer.intercepts_)
    if len(known) == 2:
        # One logistic unit, as two classes of a softmax
        matrices[-1] = np.hstack([np.zeros_like(matrices[-1]), matrices[-1]])
        biases[-1] = np.concatenate([np.zeros(1), biases[-1]])
    whole = np.zeros((matrices[-1].shape[0], classes))
    offset = np.full(classes, -50.0)  # of classes without rows: as good as impossible
    whole[:, known], offset[known] = matrices[-1], biases[-1]
    matrices[-1], biases[-1] = whole, offset
    return Network(
        sizes=np.array([features.shape[1], *(m.shape[1] for m in matrices)], np.int64),
        weight=np.concatenate([m.ravel() for m in matrices]),
        bias=np.concatenate(biases),
        mean=mean,
        scale=scale,
    )
