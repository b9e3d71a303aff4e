"""A neural network with a softmax over strategies (CoCo: Cauligi et al. 2022, section 8.1.3.3).

The published network has one hidden layer of 10,000 rectified units for 17 features. Two layers of
128 units rank strategies as well with a hundredth of the weights.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.learning.quiet_training import suppress_expected_warnings


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
        """Return the softmax over the classes at features (p,)."""
        value = (features - self.mean) / self.scale
        for k, (matrix, bias) in enumerate(self._layers):
            value = (np.maximum(value, 0.0) if k else value) @ matrix + bias
        power = np.exp(value - value.max())
        return np.asarray(power / power.sum())

    def require(self, features: int, classes: int) -> None:
        """Check that the arrays are those of such a network.

        Raises:
            UsageError: They are not.
        """
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
    """Train with Adam on cross-entropy; the same rows and seed give the same network.

    Args:
        features: (S, p).
        labels: (S,) classes below `classes`.
        classes: Number of classes.
        hidden: Units of each hidden layer.
        epochs: Largest number of passes over the data.
        seed: Seed of the random numbers.
    """
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    scale = np.where(deviation > 1e-12, deviation, 1.0)
    present = np.unique(labels)
    if len(present) == 1:
        # scikit-learn would build a single unit for one class
        bias = np.full(classes, -math.inf)
        bias[present] = 0.0
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
    with suppress_expected_warnings():
        trainer.fit((features - mean) / scale, labels)
    matrices, biases = list(trainer.coefs_), list(trainer.intercepts_)
    if len(present) == 2:
        # One logistic unit, as two classes of a softmax
        matrices[-1] = np.hstack([np.zeros_like(matrices[-1]), matrices[-1]])
        biases[-1] = np.concatenate([np.zeros(1), biases[-1]])
    full_matrix = np.zeros((matrices[-1].shape[0], classes))
    offset = np.full(classes, -50.0)  # of classes without rows: as good as impossible
    full_matrix[:, present], offset[present] = matrices[-1], biases[-1]
    matrices[-1], biases[-1] = full_matrix, offset
    return Network(
        sizes=np.array([features.shape[1], *(m.shape[1] for m in matrices)], np.int64),
        weight=np.concatenate([m.ravel() for m in matrices]),
        bias=np.concatenate(biases),
        mean=mean,
        scale=scale,
    )
