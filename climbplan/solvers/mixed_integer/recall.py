"""When a tree begins with what the last one left, and when it had better begin with its root."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from climbplan.arrays import Array
from climbplan.certificates.certificate import Certificate
from climbplan.solvers.mixed_integer import nodes as place
from climbplan.solvers.mixed_integer.conditional import Conditional
from climbplan.solvers.mixed_integer.memory import Leaves, Move
from climbplan.solvers.mixed_integer.nodes import MOST
from climbplan.solvers.mixed_integer.tree_run import TreeRun
from climbplan.solvers.result import FEASIBILITY

_PATIENCE = 4  # nodes for each leaf that is remembered
_PATIENT = 256  # and for all of them together
_LEAF_SHARE = 8  # dual steps of a tree for each leaf that it may remember
_WORSE = 2.0  # times the nodes of a tree from its root: leaves that need more are dropped
_FEW = 8  # nodes that do not count in this


@dataclass
class Recall:
    """Leaves of the last tree, and whether they were worth it."""

    most: int  # leaves that are remembered
    leaves: Leaves | None = None
    _from_root: int = MOST  # nodes of the last finished tree that began with its root
    _worse: bool = False  # whether the last tree would have been smaller from its root

    def begun(
        self, form: Conditional, move: Callable[[Conditional], Move] | None = None
    ) -> Leaves | None:
        """What the next tree begins with. move: where what is remembered stands now."""
        leaves = self.leaves
        if leaves is not None and move is not None:
            leaves = leaves.moved(move(form))
        return leaves.root() if leaves is not None and self._worse else leaves

    @staticmethod
    def patience(leaves: Leaves) -> int:
        """Nodes after which leaves that fit badly are dropped: work that counts bound."""
        return _PATIENCE * len(leaves.low) + _PATIENT

    def keep(
        self,
        run: TreeRun,
        form: Conditional,
        began: Leaves | None,
        remembered: bool,
        best: Array | None,
        work: int = MOST,
    ) -> None:
        """Keep what a tree leaves. began: what it was given; remembered: whether it used that.

        best: (size,) in the variables of the conditional form, what it began with if left out.
        work: dual steps that a tree may make.
        """
        if best is None and began is not None:
            best = began.best
        # More leaves are worth less than a new tree: each costs about a dual step to look at
        most = int(np.clip(work // _LEAF_SHARE, 1, self.most))
        self.leaves = Leaves.of(run.program, form, run.search, run.tree, most, best)
        made = int(run.search.whole[place.NODES])
        if not remembered:
            self._from_root = made if run.finished else MOST
        self._worse = remembered and made > _WORSE * self._from_root + _FEW


@dataclass
class Memory:
    """Solves instances of one statement in turn; each tree begins with the leaves of the last.

    Its `solve` is that of `method.TreeMemory`, or of `spatial_method.SpatialMemory` with products.
    """

    MOST_LEAVES: ClassVar[int]  # that are remembered

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    proves: bool = False  # whether each answer comes with its certificate
    certificate: Certificate | None = None  # of the last answer
    work: int = MOST  # dual steps of nodes after which a tree stops with what it has found
    recall: Recall = field(init=False)

    def __post_init__(self) -> None:
        """Nothing is remembered yet."""
        self.forget()

    @property
    def leaves(self) -> Leaves | None:
        """What the next tree begins with, None for its root."""
        return self.recall.leaves

    @property
    def remembers(self) -> bool:
        """Whether the next tree begins with something."""
        return self.recall.leaves is not None

    def forget(self) -> None:
        """Begin the next tree with its root."""
        self.recall = Recall(self.MOST_LEAVES)
