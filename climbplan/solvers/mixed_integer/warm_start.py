"""Decide when a tree is warm-started with the leaves of the last, and when with its root."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from climbplan.arrays import Array
from climbplan.certificates.certificate import Certificate
from climbplan.solvers.mixed_integer import nodes as slots
from climbplan.solvers.mixed_integer.indicator_form import IndicatorForm
from climbplan.solvers.mixed_integer.leaf_cover import HorizonShift, LeafCover
from climbplan.solvers.mixed_integer.nodes import UNLIMITED
from climbplan.solvers.mixed_integer.tree_run import TreeRun
from climbplan.solvers.result import FEASIBILITY

_NODES_PER_LEAF = 4  # nodes allowed for each stored leaf
_EXTRA_NODES = 256  # nodes allowed in addition
_STEPS_PER_LEAF = 8  # dual steps of a tree for each leaf that may be stored
_MAX_NODE_RATIO = 2.0  # largest ratio to the nodes of a tree from its root
_NODE_SLACK = 8  # nodes allowed beyond this ratio


@dataclass
class WarmStart:
    """Leaves of the last tree, and whether starting with them paid off."""

    max_leaves: int  # largest number of leaves stored
    leaves: LeafCover | None = None
    _num_nodes_from_root: int = (
        UNLIMITED  # nodes of the last finished tree that began with its root
    )
    _is_worse: bool = False  # whether the last tree would have been smaller from its root

    def select_start(
        self, form: IndicatorForm, move: Callable[[IndicatorForm], HorizonShift] | None = None
    ) -> LeafCover | None:
        """Return the leaves with which the next tree begins, shifted by `move`."""
        leaves = self.leaves
        if leaves is not None and move is not None:
            leaves = leaves.shift(move(form))
        return leaves.root() if leaves is not None and self._is_worse else leaves

    @staticmethod
    def compute_node_limit(leaves: LeafCover) -> int:
        """Return the number of nodes after which stored leaves are dropped as unhelpful.

        The limit counts nodes, so the search stays deterministic.
        """
        return _NODES_PER_LEAF * len(leaves.low) + _EXTRA_NODES

    def store(
        self,
        run: TreeRun,
        form: IndicatorForm,
        start: LeafCover | None,
        warm_started: bool,
        best: Array | None,
        work: int = UNLIMITED,
    ) -> None:
        """Store the leaves of a tree.

        Args:
            run: The tree.
            form: Its indicator form.
            began: Leaves that it was given.
            remembered: Whether it used them.
            best: (size,) incumbent in the variables of the indicator form; None for that of
                `began`.
            work: Dual steps that a tree may make.
        """
        if best is None and start is not None:
            best = start.best
        # Each leaf costs about a dual step to evaluate, so too many are worse than a new tree
        max_leaves = int(np.clip(work // _STEPS_PER_LEAF, 1, self.max_leaves))
        self.leaves = LeafCover.from_tree(run.program, form, run.search, run.tree, max_leaves, best)
        num_nodes = int(run.search.counters[slots.NUM_PROCESSED])
        if not warm_started:
            self._num_nodes_from_root = num_nodes if run.is_finished else UNLIMITED
        self._is_worse = (
            warm_started and num_nodes > _MAX_NODE_RATIO * self._num_nodes_from_root + _NODE_SLACK
        )


@dataclass
class WarmStartedSolver:
    """Solves instances of one statement in turn; each tree begins with the leaves of the last.

    Its `solve` is that of `method.WarmStartedTree`, or of `spatial_method.WarmStartedSpatialTree`.
    """

    MAX_LEAVES: ClassVar[int]  # largest number of leaves stored

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    proves: bool = False  # whether each answer comes with its certificate
    certificate: Certificate | None = None  # certificate of the last answer
    work: int = UNLIMITED  # dual steps after which a tree stops with its incumbent
    warm_start: WarmStart = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a warm start."""
        self.reset()

    @property
    def leaves(self) -> LeafCover | None:
        """Leaves with which the next tree begins, None for its root."""
        return self.warm_start.leaves

    @property
    def has_warm_start(self) -> bool:
        """Return whether the next tree begins with leaves of the last."""
        return self.warm_start.leaves is not None

    def reset(self) -> None:
        """Begin the next tree with its root."""
        self.warm_start = WarmStart(self.MAX_LEAVES)
