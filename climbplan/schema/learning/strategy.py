"""Strategy spec (`kind: strategy`): what is learned from which solved problems (chapter 7.2).

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from climbplan.schema.base import Count, Number, SpecModel, quantity

ShelfFeatures = Literal["gaps", "raw"]


class TrainingDataSpec(SpecModel):
    """Solved problems to learn from."""

    files: tuple[str, ...] = Field(
        min_length=1,
        description="datasets of `gen-data` or plan files, and files of bookshelf scenes, which "
        "`exact` solves first; relative to the spec",
    )
    size: Count | None = quantity(
        "", "how many solved problems to use, the first ones; all if left out", default=None, ge=1
    )
    features: ShelfFeatures = Field(
        default="gaps",
        description="of bookshelf scenes: free `gaps` and what may fill them, or `raw` as "
        "published; other problems state their own",
    )
    mirror: bool = Field(
        default=True, description="whether bookshelf scenes also count as seen in a mirror"
    )
    held_out: Number = quantity(
        "", "share of the problems kept from training to measure it by", default=0.1, ge=0, le=0.9
    )


class ForestSpec(SpecModel):
    """Random forest; the values of X. Lin (UCLA 2022)."""

    trees: Count = quantity("", "number of trees", default=150, ge=1, le=10_000)
    depth: Count = quantity("", "largest depth of a tree", default=75, ge=1, le=1000)


class BoostingSpec(SpecModel):
    """Gradient boosting of each choice that strategies are made of."""

    rounds: Count = quantity("", "trees an option", default=60, ge=1, le=10_000)
    rate: Number = quantity("", "share of a correction that is taken", default=0.1, gt=0, le=1)
    leaves: Count = quantity("", "most leaves of a tree", default=31, ge=2, le=1000)


class NetworkSpec(SpecModel):
    """Neural network with a softmax over strategies."""

    hidden: tuple[Count, ...] = Field(
        default=(128, 128), min_length=1, description="rectified units of each hidden layer"
    )
    epochs: Count = quantity("", "passes over the data at most", default=60, ge=1, le=100_000)


class ReduceSpec(SpecModel):
    """Clusters of solutions and the forest that tells which one a problem's solution is in."""

    clusters: Literal["hdbscan", "optics", "dbscan", "kmeans"] = Field(
        default="hdbscan",
        description="method; published: `optics` with a cut at a distance tuned by hand",
    )
    least: Count = quantity(
        "", "members of a cluster (hdbscan), neighbours of a core (others)", default=10, ge=2
    )
    distance: Number = quantity(
        "", "of neighbours in scaled solutions (optics, dbscan)", default=2.5, gt=0
    )
    count: Count = quantity("", "clusters of kmeans", default=50, ge=1)
    outliers: Literal["nearest", "drop"] = Field(
        default="nearest",
        description="solutions in no cluster join the `nearest` one, or are left out as published",
    )
    trees: Count = quantity(
        "", "trees of the forest; published: 1000", default=150, ge=1, le=10_000
    )


class ModelSpec(SpecModel):
    """What is trained; sections of other kinds are ignored."""

    kind: Literal["knn", "forest", "boosting", "network", "reduce"] = Field(
        default="forest", description="which strategy"
    )
    forest: ForestSpec = ForestSpec()
    """Of `forest`; `depth` also of `reduce`."""
    boosting: BoostingSpec = BoostingSpec()
    """Of `boosting`."""
    network: NetworkSpec = NetworkSpec()
    """Of `network`."""
    reduce: ReduceSpec = ReduceSpec()
    """Of `reduce`."""


class StrategySpec(SpecModel):
    """Learn from solved problems which integers to try first."""

    kind: Literal["strategy"] = Field(description="always `strategy`")
    title: str = Field(default="", description="one line for reports")
    problem: str | None = Field(
        default=None,
        description="the problem that this spec is written for, as `--problem` names it; never "
        "followed, only compared; bookshelves need none",
    )
    data: TrainingDataSpec
    """Solved problems to learn from."""
    model: ModelSpec = ModelSpec()
    """What is trained."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)
