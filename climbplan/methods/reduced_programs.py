"""ReDUCE: the reduced programs of the clusters that a classifier ranks first.

Online the reduced mixed-integer programs of the likeliest clusters are solved one after the other;
the integers of each optimum become candidates, from the optimum itself and from the cluster's
nearest solutions with the same integers, and the pipeline makes them exact. Envelopes are not the
products: integers that are best over them need not hold, or be best. So the cluster's other
strategies follow, nearest first; each costs milliseconds where the program took seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.strategy import Candidate, candidate_of
from climbplan.methods.envelope_rounds import MICP_SOLVERS
from climbplan.methods.reduced import ROOM, ReducedForm, Reduction
from climbplan.program.instance import Instance
from climbplan.reformulations.envelopes import Squares
from climbplan.reformulations.grids import Partition
from climbplan.solvers.registry import require

_STARTS = 3  # of the nearest solutions with the same integers, besides the optimum itself
OTHERS = 20  # of a cluster's strategies that follow, at most


@dataclass(frozen=True)
class ClusterSolve:
    """What a reduced program was and how it went."""

    cluster: int
    binaries: int
    status: str
    seconds: float


@dataclass(frozen=True)
class ClusterOptimum:
    """How a reduced program went, and the integers and point it found."""

    told: ClusterSolve
    candidate: Candidate | None


@dataclass
class ReducedPrograms:
    """The reduced programs of a ranking's clusters, built when they are first needed.

    solver: highs, scip or gurobi. seconds: time limit of one program. room: around a cluster's
    solutions, see `Reduction.of`. others: strategies of a cluster that follow its program's.
    """

    ranking: ClusterRanking
    partitions: Sequence[Partition]
    squares: Squares = "envelope"
    solver: str = "highs"
    gap: float = 1e-2
    seconds: float = 60.0
    room: float = ROOM
    others: int = OTHERS
    report: Callable[[ClusterSolve], None] | None = None
    _forms: dict[int, ReducedForm] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.solver not in MICP_SOLVERS:
            known = ", ".join(MICP_SOLVERS)
            raise UsageError(
                f"reduced programs: no solver {self.solver!r}, expected one of {known}"
            )
        require(MICP_SOLVERS[self.solver])

    def reduction(self, cluster: int) -> Reduction:
        """What is left of the integers in a cluster."""
        rows, library = self.ranking.members(cluster), self.ranking.library
        return Reduction.of(
            self.partitions,
            library.points[rows],
            library.alternatives[rows],
            library.frame.integer,
            self.squares,
            self.room,
        )

    def candidates(
        self,
        instance: Instance,
        features: Array,
        most: int,
        time_limit: float = np.inf,
        more: int = 0,
        done: Callable[[], bool] | None = None,
    ) -> Iterator[Candidate]:
        """Candidates of the likeliest clusters, each solved when those before are used up.

        Scores are the programs' optima; infinite for strategies that follow.

        most: clusters that are solved in any case. more: further ones, until `done`. time_limit:
        [s] of all of them together.
        """
        begin = time.perf_counter()
        for k, cluster in enumerate(self.ranking.ranked(features, most + more)):
            left = min(self.seconds, time_limit - (time.perf_counter() - begin))
            if left <= 0 or (k >= most and (done is None or done())):
                return
            yield from self._of_cluster(instance, features, int(cluster), left)

    def _of_cluster(
        self, instance: Instance, features: Array, cluster: int, seconds: float
    ) -> Iterator[Candidate]:
        found = self.solved(instance, cluster, seconds)
        library = self.ranking.library
        tried: set[int] = set()
        if found.candidate is not None:
            yield found.candidate
            x, alternatives = found.candidate.values, found.candidate.alternatives
            for row in self.ranking.alike(features, cluster, x, alternatives)[:_STARTS]:
                tried.add(int(row))
                yield candidate_of(library, int(row), found.candidate.score)
        for row in self.ranking.strategies(features, cluster)[: self.others]:
            if int(row) not in tried:
                yield candidate_of(library, int(row), np.inf)

    def solved(self, instance: Instance, cluster: int, seconds: float) -> ClusterOptimum:
        """The reduced program of a cluster at an instance, solved."""
        start = time.perf_counter()
        if cluster not in self._forms:
            self._forms[cluster] = self.reduction(cluster).form(instance)
        form = self._forms[cluster]
        program = form.at(instance)
        solve = require(MICP_SOLVERS[self.solver]).load()
        found = solve(program.instance, gap=self.gap, time_limit=seconds)
        spent = time.perf_counter() - start
        told = ClusterSolve(cluster, form.reduction.binary_count, found.status, spent)
        if self.report is not None:
            self.report(told)
        if found.x is None:
            return ClusterOptimum(told, None)
        x = found.x[: instance.size]
        score = float(found.objective or 0.0)
        return ClusterOptimum(told, Candidate(x, program.alternatives(found.x), x, score=score))
