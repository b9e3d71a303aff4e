"""A made-up library: three one-of groups decided by two features, for tests of strategies."""

from __future__ import annotations

import numpy as np

from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import StrategyModel
from climbplan.learning.model_file import ModelFile

BITS = 6  # a group of three, a pair, a single binary
FRAME = ProgramSignature("made up", np.array([False, False, *[True] * BITS]), np.zeros(0, np.int64))


def made_up(count: int = 200, seed: int = 0) -> Library:
    """Solved problems whose integers follow from the signs and sizes of their features."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(count, 3))
    bits = np.zeros((count, BITS))
    bits[np.arange(count), np.digitize(features[:, 0], [-0.5, 0.5])] = 1.0
    bits[np.arange(count), 3 + (features[:, 1] > 0)] = 1.0
    bits[:, 5] = features.sum(axis=1) > 1.0
    points = np.hstack([features[:, :2] ** 2, bits])
    labels = (features[:, 2:] > 0.8).astype(np.int64)
    return Library.of(FRAME, features, points, np.arange(float(count)), labels=labels)


def stored_model(model: StrategyModel) -> ModelFile:
    """A model as `fit-strategy` keeps it."""
    origin = {"name": "name", "spec_text": "text", "spec_sha256": "0" * 64}
    return ModelFile(model=model, title="title", seed=3, **origin)
