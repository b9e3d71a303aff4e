"""Spatial branch and bound on a walk: bounds of attitude boxes, and incumbents from their gaits.

The program that is bounded is a relaxation: envelopes of products and the attitude box make it
cheaper than the true dynamics. Each gait of a relaxed solution is therefore rounded and solved by
SQP on the nonlinear dynamics, and only such trajectories become incumbents. Before branching, the
root is tightened by outer approximation and by optimality-based bound tightening (Gleixner et al.
2017, Three enhancements for optimization-based bound tightening; Belotti et al. 2009, Branching and
bounds tightening techniques for non-convex MINLP).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.progress import report_search
from climbplan.walking.check.checker import is_feasible
from climbplan.walking.micp.attitude_box import AttitudeBox, build_attitude_box
from climbplan.walking.micp.attitude_partition import (
    AttitudeCell,
    partition_attitudes,
    sort_narrow_first,
)
from climbplan.walking.micp.branching import TightenedRoot, WalkSubproblem, count_early_intervals
from climbplan.walking.micp.contact_search import ContactSearch
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.node_lp import NodeLp
from climbplan.walking.micp.outer_approximation import (
    TANGENT_TOLERANCE,
    create_lp_solver,
    refine_outer_approximation,
)
from climbplan.walking.micp.prefix_relaxation import (
    MIN_PREFIX,
    TaskRelaxation,
    bound_by_tightening,
    tighten_by_prefixes,
)
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation, build_relaxation
from climbplan.walking.micp.symmetry import include_mirror_images, is_mirror_symmetric
from climbplan.walking.offline.footing import build_gait
from climbplan.walking.offline.gaits import assign_regions
from climbplan.walking.offline.sqp import build_iterate, solve_gait
from climbplan.walking.plan.answer import Improvement
from climbplan.walking.task.task import WalkTask, WalkTrajectory

_TIGHTENING_FRACTION = 0.4  # of the remaining time, for bound tightening at the root
_PARTITION_FRACTION = 0.3  # of all time, for partitioning the attitudes
_RESTART_RATIO = 0.85  # an incumbent below this ratio of the cost restarts the search
TANGENT_RATIO = 2.0  # from one initial tangent to the next; cuts add more where needed
_ROUNDING_THRESHOLDS = (0.2, 0.35, 0.5)  # relaxed contacts above these are rounded to 1
MAX_TIGHTENING_ROUNDS = 3  # of bound tightening for a fixed contact sequence
_MIN_GAIT_PREFIX_GAIN = 0.0005  # of the cost, by which a prefix has to raise a gait's bound
SEARCH_TANGENT_TOLERANCE = 5.0 * TANGENT_TOLERANCE  # of the cost, in the search over contacts
_BRIEF_NODES = 60  # node limit of a brief search
_REDUCTION_TOLERANCE = 2e-4  # of the cost, that the bound may lose in a smaller program
_SCREENING_QPS = 8  # iterations of the SQP that screens a gait
_POLISH_QPS = 40  # iterations that let the SQP converge


@dataclass
class BranchAndBound:
    """The state of a run: incumbent, lower bound of each cell, and the time that is used."""

    task: WalkTask  # with the dynamics that incumbents satisfy
    euler_task: WalkTask  # the same by forward Euler, which the program relaxes
    limits: MicpLimits
    incumbent: WalkTrajectory
    objective: float  # cost of the incumbent
    start_time: float  # [s] of `limits.clock`
    bounds: list[float] = field(default_factory=lambda: [0.0])  # of each cell; costs are squares
    cell_index: int = 0  # of the cell that is processed
    time_fraction: float = 1.0  # of all time, at which the cell has to end
    worker_seconds: float = 0.0  # [s] of other processes, where the clock is per process
    message: str = "time limit"
    needs_restart: bool = False
    tried_gaits: set[bytes] = field(default_factory=set)
    history: list[Improvement] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Time used by the run [s]."""
        return self.limits.clock() - self.start_time + self.worker_seconds

    @property
    def bound(self) -> float:
        """Lower bound on the cost of all motions in the union of the cells."""
        return min(self.bounds)

    @property
    def cutoff(self) -> float:
        """Cost that a motion has to be below to improve the incumbent by more than the gap."""
        return self.objective * (1.0 - self.limits.gap)

    @property
    def seconds_left(self) -> float:
        """Time left for the cell that is processed [s]."""
        return max(self.time_fraction * self.limits.seconds - self.seconds, 0.0)

    @property
    def is_closed(self) -> bool:
        """True if the bound of the current cell is within the gap of the incumbent."""
        bound = self.bounds[self.cell_index]
        return self.objective - bound <= self.limits.gap * self.objective * (1 + 1e-9)

    @property
    def uses_wall_clock(self) -> bool:
        """True if HiGHS, which measures wall-clock time, can keep the time limit itself."""
        return self.limits.clock is time.perf_counter

    def create_timed_solver(self) -> Any:
        """Return a HiGHS instance that stops at the time limit, if that is by the wall clock."""
        return create_lp_solver(self.seconds_left if self.uses_wall_clock else np.inf)

    def build_cells(self, motions: Array) -> list[AttitudeCell]:
        """Partition the attitudes about motions (M, N + 1, 12) into cells, and start over.

        The bound of the run is from here on one of the union of these cells.
        """
        limits, begin = self.limits, self.seconds
        width = np.array(limits.angles), np.array(limits.spin)
        if len(motions) <= 2:  # the start, and the incumbent
            attitude_box = build_attitude_box(self.euler_task, motions, *width)
            cells = [AttitudeCell(attitude_box, motions, 0.0)]
        else:
            cells = partition_attitudes(
                self.euler_task,
                motions,
                width,
                self.cutoff,
                self.bound_by_root,
                lambda: self.seconds < begin + _PARTITION_FRACTION * (limits.seconds - begin),
            )
        # Bounds of earlier attitude boxes say nothing about these.
        self.bounds, self.needs_restart = [cell.bound for cell in cells], False
        self.history = [replace(entry, bound=0.0) for entry in self.history]
        self.record_progress()
        return cells

    def bound_cells(self, cells: Sequence[AttitudeCell]) -> None:
        """Bound one cell after the other."""
        # Narrow boxes end early: the time that they leave goes to the wider ones.
        order = sort_narrow_first(cells)
        for num_done, index in enumerate(order):
            used_fraction = self.seconds / self.limits.seconds
            self.cell_index = index
            self.time_fraction = used_fraction + (1.0 - used_fraction) / (len(cells) - num_done)
            self.bound_cell(cells[index].attitude_box)
            if self.needs_restart:
                break
        self.time_fraction, self.cell_index = 1.0, int(np.argmin(self.bounds))

    def bound_by_root(self, attitude_box: AttitudeBox) -> float:
        """Return the bound of an attitude box by its root relaxation, at most the cutoff."""
        limits, cutoff = self.limits, self.cutoff
        pieces = limits.arm_pieces, limits.height_pieces
        program = build_relaxation(self.euler_task, attitude_box, cutoff, *pieces, TANGENT_RATIO)
        bound = max((value for value, _ in self.refine_relaxation(program)), default=0.0)
        return min(bound, cutoff)

    def record_progress(self) -> None:
        """Append the incumbent's cost and the bound to the history."""
        self.history.append(Improvement(self.seconds, self.objective, self.bound))
        report_search(self.objective, self.bound)

    def bound_cell(self, attitude_box: AttitudeBox) -> None:
        """Search for motions below the cutoff; the cell is closed if there are none."""
        root = self.tighten_root(self.create_root(attitude_box))
        if root is not None:
            self.search_contacts(root.node, root.program)

    def create_root(self, attitude_box: AttitudeBox) -> WalkSubproblem:
        """Return the root node of an attitude box, and of its image if the task is symmetric."""
        limits, cutoff = self.limits, self.cutoff
        width = np.array(limits.angles), np.array(limits.spin)
        symmetric = (
            include_mirror_images(attitude_box, *width)
            if is_mirror_symmetric(self.euler_task)
            else None
        )
        formulation = TaskRelaxation(
            self.euler_task,
            attitude_box if symmetric is None else symmetric,
            cutoff,
            limits.arm_pieces,
            limits.height_pieces,
            TANGENT_RATIO,
        )
        length = min(MIN_PREFIX, count_early_intervals(formulation))
        return WalkSubproblem(formulation, symmetric is not None, prefix_length=length)

    def tighten_root(self, node: WalkSubproblem) -> TightenedRoot | None:
        """Tighten the bounds of a root by linear programs.

        Returns:
            The root, or None if its cell is closed or the time is over.
        """
        cutoff = node.formulation.cutoff
        is_feasible, _ = self.bound_by_relaxation(node.formulation.build(None), cutoff)
        if not is_feasible or self.seconds_left <= 0:
            return None
        formulation = self.reduce_rotation_rows(node.formulation)
        tightened = tighten_by_prefixes(
            formulation,
            formulation.build(None),
            _TIGHTENING_FRACTION * self.seconds_left,
            self.limits.clock,
        )
        if tightened is None:
            self.fathom(cutoff)
            return None
        program = formulation.build(tightened.bounds)
        is_feasible, _ = self.bound_by_relaxation(program, cutoff)
        node = replace(node, formulation=formulation, lower_bound=self.bounds[self.cell_index])
        return TightenedRoot(node, program) if is_feasible and self.seconds_left > 0 else None

    def reduce_rotation_rows(self, formulation: TaskRelaxation) -> TaskRelaxation:
        """Return the formulation without rotation rows of late knots, where the bound stays."""
        target = self.bounds[self.cell_index] - _REDUCTION_TOLERANCE * self.objective
        for knots in range(count_early_intervals(formulation) + 1, formulation.task.knots):
            reduced = replace(formulation, num_rotation_knots=knots)
            solutions = self.refine_relaxation(reduced.build(None))
            if max((bound for bound, _ in solutions), default=0.0) >= target:
                return reduced
        return formulation

    def search_contacts(
        self, node: WalkSubproblem, program: MixedIntegerRelaxation, is_brief: bool = False
    ) -> None:
        """Raise the bound of a node by branch and bound over its contacts.

        Args:
            node: The node; its motions are those of the program.
            program: Its relaxation, with the bounds of the node.
            is_brief: Stop after a few nodes, and do not tighten the bounds of gaits: for nodes that
                bisection would not raise.
        """
        formulation = node.formulation
        first_objective, cutoff = self.objective, formulation.cutoff

        def should_continue(bound: float) -> bool:
            self.raise_bound(bound, cutoff)
            self.needs_restart = self.objective < _RESTART_RATIO * first_objective
            is_ended = is_brief and search.num_nodes >= _BRIEF_NODES
            return (
                not is_ended
                and self.seconds_left > 0
                and not self.is_closed
                and not self.needs_restart
            )

        def bound_gait(contacts: BoolArray) -> float:
            gait_program = formulation.build(program.bounds.fix_contacts(contacts))
            tightened = tighten_by_prefixes(
                formulation,
                gait_program,
                self.seconds_left,
                self.limits.clock,
                _MIN_GAIT_PREFIX_GAIN,
            )
            if tightened is None:
                return cutoff
            return bound_by_tightening(
                formulation,
                tightened.bounds,
                MAX_TIGHTENING_ROUNDS,
                lambda: self.seconds_left,
                self.limits.clock,
            )

        lp = NodeLp(program, SEARCH_TANGENT_TOLERANCE * self.objective, node.breaks_symmetry)
        search = ContactSearch(
            lp,
            should_continue,
            lambda: self.seconds_left if self.uses_wall_clock else np.inf,
            (lambda contacts: 0.0) if is_brief else bound_gait,
            lambda x: self.try_rounded_gait(program, x),
        )
        search.run()
        self.message = (
            f"{search.num_nodes} nodes, {len(program.model.lower)} variables, "
            f"{len(lp.binaries)} binaries, {lp.num_rows} rows"
        )

    def fathom(self, cutoff: float) -> None:
        """Raise the bound of the cell to the cutoff: no motion is cheaper."""
        self.raise_bound(cutoff, cutoff)
        self.message = "no motion is cheaper by the gap, by linear programs alone"

    def bound_by_relaxation(
        self,
        program: MixedIntegerRelaxation,
        cutoff: float,
        thresholds: tuple[float, ...] = _ROUNDING_THRESHOLDS,
    ) -> tuple[bool, Array | None]:
        """Raise the bound by the linear relaxation, and try the gaits of its solution.

        Args:
            program: The relaxation, which the outer approximation adds tangents to.
            cutoff: The limit on the cost that the program has.
            thresholds: Relaxed contacts above each of these are rounded to 1.

        Returns:
            Whether the program may be feasible, and its solution; None if there is none, or if the
            time was over before the first.
        """
        x: Array | None = None
        for bound, solution in self.refine_relaxation(program):
            if solution is not None:
                self.raise_bound(bound, cutoff)
            else:
                self.fathom(cutoff)
                return False, None
            x = solution
        if x is not None:
            for threshold in thresholds:
                self.try_rounded_gait(program, x, threshold)
        return True, x

    def refine_relaxation(
        self, program: MixedIntegerRelaxation
    ) -> Iterator[tuple[float, Array | None]]:
        """Iterate over bounds and solutions of the relaxation under outer approximation.

        Yields infinity and None if the program is infeasible.
        """
        return refine_outer_approximation(
            program.model, TANGENT_TOLERANCE * self.objective, self.create_timed_solver()
        )

    def raise_bound(self, bound: float, cutoff: float) -> None:
        """Raise the bound of the cell; motions above the cutoff are not in the program."""
        bound = min(bound, cutoff)
        if np.isfinite(bound) and bound > self.bounds[self.cell_index]:
            self.bounds[self.cell_index] = bound
            self.record_progress()

    def try_rounded_gait(
        self, program: MixedIntegerRelaxation, x: Array, threshold: float = 0.5
    ) -> None:
        """Round the gait of a relaxed solution, and solve it by SQP on the true dynamics.

        The primal heuristic of the search: the trajectory becomes the incumbent if it is cheaper
        and passes the exact check.

        Args:
            program: The relaxation.
            x: A solution of it (n,).
            threshold: Relaxed contacts above it are rounded to 1.
        """
        contact, region = program.round_gait(x, threshold)
        if (contact.sum(axis=1) < self.task.min_contacts).any():
            return
        contact = np.vstack([contact, contact[-1:]])
        region = np.vstack([region, region[-1:]])
        gait = assign_regions(self.task, contact)
        if len(self.task.ground.height) > 1:
            gait = build_gait(contact, np.where(region >= 0, region, gait.region))
        if gait.key in self.tried_gaits:
            return
        self.tried_gaits.add(gait.key)
        for start in (None, build_iterate(self.incumbent, gait)):
            screened = solve_gait(self.task, gait, start, _SCREENING_QPS)
            if screened.trajectory is None or screened.objective >= self.objective:
                continue
            polished = solve_gait(
                self.task, gait, build_iterate(screened.trajectory, gait), _POLISH_QPS
            )
            if polished.trajectory is None or polished.objective >= self.objective:
                continue
            if polished.is_feasible and is_feasible(self.task, polished.trajectory):
                self.incumbent, self.objective = polished.trajectory, polished.objective
                self.record_progress()
