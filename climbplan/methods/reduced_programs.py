"""ReDUCE: the reduced programs of the clusters that a classifier ranks first.

Online the reduced mixed-integer programs of the likeliest clusters are solved one after the other.
The integers of each optimum become candidates, from the optimum itself and from the cluster's
nearest solutions with the same integers, and the pipeline makes them exact. Envelopes only relax
the products, so integers that are optimal over them need not be feasible or optimal. The cluster's
other strategies therefore follow, nearest first; each takes milliseconds, a program seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.cluster_ranking import ClusterRanking
from climbplan.learning.strategy import Candidate, build_candidate
from climbplan.methods.envelope_rounds import MICP_SOLVERS
from climbplan.methods.reduced import MARGIN, ClusterReduction, ReducedForm
from climbplan.program.instance import Instance
from climbplan.reformulations.envelopes import Squares
from climbplan.reformulations.grids import Partition
from climbplan.solvers.registry import require

_STARTS = 3  # nearest solutions with the same integers, in addition to the optimum itself
OTHERS = 20  # largest number of a cluster's strategies that follow


@dataclass(frozen=True)
class ClusterSolve:
    """Record of a reduced program."""

    cluster: int
    binaries: int
    status: str
    seconds: float


@dataclass(frozen=True)
class ClusterOptimum:
    """Record of a reduced program, and the integers and point it found."""

    record: ClusterSolve
    candidate: Candidate | None


@dataclass
class ReducedPrograms:
    """The reduced programs of a ranking's clusters, built when they are first needed.

    Attributes:
        solver: highs, scip or gurobi.
        seconds: Time limit of one program [s].
        room: Margin around a cluster's solutions, see `ClusterReduction.of`.
        others: Number of strategies of a cluster that follow its program's.
    """

    ranking: ClusterRanking
    partitions: Sequence[Partition]
    squares: Squares = "envelope"
    solver: str = "highs"
    gap: float = 1e-2
    seconds: float = 60.0
    room: float = MARGIN
    others: int = OTHERS
    report: Callable[[ClusterSolve], None] | None = None
    _forms: dict[int, ReducedForm] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.solver not in MICP_SOLVERS:
            solver_names = ", ".join(MICP_SOLVERS)
            raise UsageError(
                f"reduced programs: no solver {self.solver!r}, expected one of {solver_names}"
            )
        require(MICP_SOLVERS[self.solver])

    def build_reduction(self, cluster: int) -> ClusterReduction:
        """Build the reduction of the integers to a cluster."""
        rows, library = self.ranking.list_members(cluster), self.ranking.library
        return ClusterReduction.of(
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
        num_clusters: int,
        time_limit: float = np.inf,
        num_further: int = 0,
        done: Callable[[], bool] | None = None,
    ) -> Iterator[Candidate]:
        """Yield candidates of the likeliest clusters, whose programs are solved as needed.

        Scores are the programs' optima, infinite for strategies that follow.

        Args:
            instance: The instance.
            features: Features of the problem.
            most: Number of clusters that are solved in any case.
            time_limit: Time limit of all of them together [s].
            more: Number of further clusters, until `done`.
            done: Returns whether further clusters are needless.
        """
        begin = time.perf_counter()
        for k, cluster in enumerate(self.ranking.rank(features, num_clusters + num_further)):
            time_left = min(self.seconds, time_limit - (time.perf_counter() - begin))
            if time_left <= 0 or (k >= num_clusters and (done is None or done())):
                return
            yield from self._generate_from_cluster(instance, features, int(cluster), time_left)

    def _generate_from_cluster(
        self, instance: Instance, features: Array, cluster: int, seconds: float
    ) -> Iterator[Candidate]:
        """Yield candidates of one cluster."""
        optimum = self.solve_cluster(instance, cluster, seconds)
        library = self.ranking.library
        used_rows: set[int] = set()
        if optimum.candidate is not None:
            yield optimum.candidate
            x, alternatives = optimum.candidate.values, optimum.candidate.alternatives
            for row in self.ranking.find_equal_integers(features, cluster, x, alternatives)[
                :_STARTS
            ]:
                used_rows.add(int(row))
                yield build_candidate(library, int(row), optimum.candidate.score)
        for row in self.ranking.list_strategies(features, cluster)[: self.others]:
            if int(row) not in used_rows:
                yield build_candidate(library, int(row), np.inf)

    def solve_cluster(self, instance: Instance, cluster: int, seconds: float) -> ClusterOptimum:
        """Solve the reduced program of a cluster at an instance."""
        start = time.perf_counter()
        if cluster not in self._forms:
            self._forms[cluster] = self.build_reduction(cluster).build_form(instance)
        form = self._forms[cluster]
        program = form.build(instance)
        solve = require(MICP_SOLVERS[self.solver]).load()
        result = solve(program.instance, gap=self.gap, time_limit=seconds)
        duration = time.perf_counter() - start
        record = ClusterSolve(cluster, form.reduction.binary_count, result.status, duration)
        if self.report is not None:
            self.report(record)
        if result.x is None:
            return ClusterOptimum(record, None)
        x = result.x[: instance.size]
        score = float(result.objective or 0.0)
        return ClusterOptimum(record, Candidate(x, program.alternatives(result.x), x, score=score))
