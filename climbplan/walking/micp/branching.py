"""Nodes of the branch and bound on a walk, and how they branch.

A node first branches on the contacts of its first intervals. Where these are fixed, what is left of
the relaxation gap are products of continuous variables: the node is bisected in the range of an
attitude or of a moment arm (spatial branching). The range is selected by strong branching on the
prefix relaxation, scored as by Achterberg (2007, Constraint integer programming).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.micp.node_lp import BranchingDecision, NodeLp
from climbplan.walking.micp.prefix_relaxation import MIN_PREFIX, TaskRelaxation, bound_by_prefix
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.micp.variable_bounds import VariableBounds
from climbplan.walking.task.task import ANGLES

_FIRST_INTERVALS = 2  # whose contacts are branched on first
_MAX_CHILDREN = 8  # of a root; with more, early contacts say little about the cost
_EARLY_INTERVALS = 4  # that branching considers: errors of products add up from the start on
_FIRST_FREE_KNOT = 2  # the first knot whose attitude the start does not decide
_ARM_CANDIDATES = 2  # ranges of moment arms that strong branching tries
_WORSE_WEIGHT = 5.0 / 6.0  # of the smaller gain in the score (Achterberg 2007)
_MIN_WIDTH = 1e-3  # [m], [rad] narrower ranges are not bisected


@dataclass(frozen=True)
class WalkSubproblem:
    """A subproblem: all motions of a formulation within bounds of its variables."""

    formulation: TaskRelaxation
    breaks_symmetry: bool  # whether only one motion of each mirrored pair is kept
    bounds: VariableBounds | None = None  # None: those of the formulation
    lower_bound: float = 0.0
    num_decided: int = 0  # intervals whose contacts are fixed
    prefix_length: int = MIN_PREFIX  # intervals of the next prefix relaxation
    tail_cost: float | None = None  # lower bound on the cost after the prefix, if it is computed


@dataclass(frozen=True)
class TightenedRoot:
    """A root after bound tightening, and the program with its bounds."""

    node: WalkSubproblem
    program: MixedIntegerRelaxation


def count_early_intervals(formulation: TaskRelaxation) -> int:
    """Return how many intervals branching considers: fewer than all."""
    return min(_EARLY_INTERVALS, formulation.task.knots - 1)


def branch_on_contacts(
    node: WalkSubproblem,
    program: MixedIntegerRelaxation,
    tangent_tolerance: float,
    should_continue: Callable[[], bool],
) -> list[WalkSubproblem] | None:
    """Branch on the contacts of the next intervals, depth first, and prune by bound.

    Each undecided contact is fixed to both values in the order of knots. All linear programs are
    solved by one solver with warm starts.

    Args:
        node: The node to branch on.
        program: Its relaxation.
        tangent_tolerance: Largest violation of a square's tangents that is accepted (a cost).
        should_continue: Whether time is left. Contacts that it does not suffice for stay open.

    Returns:
        The children that are not pruned; None for a root with too many of them.
    """
    lp, bounds = NodeLp(program, tangent_tolerance, node.breaks_symmetry), program.bounds
    num_early = count_early_intervals(node.formulation)
    last = min(_FIRST_INTERVALS, num_early) if node.num_decided < _FIRST_INTERVALS else num_early
    index_of_row = {int(row): index for index, row in np.ndenumerate(program.contact_rows)}
    children, stack = list[WalkSubproblem](), [(node.lower_bound, tuple[BranchingDecision, ...]())]
    lp.reset()
    while stack:
        bound, decisions = stack.pop()
        x: Array | None = None
        if is_solved := should_continue():
            lp.apply_decisions(decisions)
            solution = lp.solve(np.inf)
            if solution is None:
                continue
            bound, x = max(bound, solution.bound), solution.x
        decided = {index_of_row[decision.place]: decision.value for decision in decisions}
        undecided = bounds.contact_low < bounds.contact_high
        undecided[last:] = False
        for index in decided:
            undecided[index] = False
        if not is_solved or not undecided.any():
            child = replace(
                node,
                bounds=_fix_contacts(bounds, decided),
                lower_bound=bound,
                num_decided=last if is_solved else node.num_decided,
                tail_cost=None,
                prefix_length=num_early,
            )
            children.append(child)
            if node.num_decided == 0 and len(children) > _MAX_CHILDREN:
                return None
            continue
        stack += [
            (bound, (*decisions, decision)) for decision in _select_contact(program, undecided, x)
        ]
    return children


def _select_contact(
    program: MixedIntegerRelaxation, undecided: BoolArray, x: Array | None
) -> tuple[BranchingDecision, BranchingDecision]:
    """Return both values of the most fractional contact of the first undecided knot.

    Args:
        program: The relaxation.
        undecided: (N, L) bool, contacts that may be branched on; one at least.
        x: A solution of the relaxation; None if there is none.

    Returns:
        The decisions; the one that rounds the solution comes last, as a stack takes it first.
    """
    n = int(np.flatnonzero(undecided.any(axis=1))[0])
    values = program.evaluate_contacts(x)[n] if x is not None else np.full(undecided.shape[1], 0.5)
    fractionality = np.where(undecided[n], np.minimum(values, 1.0 - values), -1.0)
    leg = int(fractionality.argmax())
    row, rounded = int(program.contact_rows[n, leg]), float(values[leg] >= 0.5)
    return BranchingDecision(True, row, 1.0 - rounded), BranchingDecision(True, row, rounded)


def _fix_contacts(bounds: VariableBounds, decided: dict[tuple[int, ...], float]) -> VariableBounds:
    """Return the bounds with contacts fixed; `decided` maps (knot, leg) to 0 or 1."""
    low, high = bounds.contact_low.copy(), bounds.contact_high.copy()
    for index, contact in decided.items():
        low[index] = high[index] = contact
    return replace(bounds, contact_low=low, contact_high=high)


@dataclass(frozen=True)
class Bisection:
    """Both halves of a node, without those that are infeasible or above the cutoff."""

    children: tuple[WalkSubproblem, ...]
    gain: float  # by which their prefix bounds raise the node's, mostly that of the worse child


def bisect_node(node: WalkSubproblem) -> Bisection | None:
    """Bisect a node in the range whose halves raise the prefix bound most (strong branching).

    Returns:
        The halves; None if every candidate range is narrow.
    """
    bounds, tail_cost, cutoff = node.bounds, node.tail_cost or 0.0, node.formulation.cutoff
    assert bounds is not None

    def compute_prefix_bound(bounds: VariableBounds) -> float:
        length = count_early_intervals(node.formulation)
        return min(bound_by_prefix(node.formulation, bounds, length, tail_cost), cutoff)

    parent_bound = compute_prefix_bound(bounds)
    best_score, best = -np.inf, None
    for halves in _enumerate_bisections(node.formulation, bounds):
        child_bounds = [compute_prefix_bound(half) for half in halves]
        score = _WORSE_WEIGHT * min(child_bounds) + (1.0 - _WORSE_WEIGHT) * max(child_bounds)
        if score > best_score:
            children = tuple(
                replace(node, bounds=half, lower_bound=max(node.lower_bound, child_bound))
                for half, child_bound in zip(halves, child_bounds, strict=True)
                if child_bound < cutoff
            )
            best_score, best = score, Bisection(children, score - parent_bound)
    return best


def _enumerate_bisections(
    formulation: TaskRelaxation, bounds: VariableBounds
) -> Iterator[tuple[VariableBounds, VariableBounds]]:
    """Yield bisections of attitudes, and of moment arms of standing legs, at early knots."""
    attitude_box = bounds.intersect_attitude_box(formulation.attitude_box)
    last = count_early_intervals(formulation)
    for n in range(_FIRST_FREE_KNOT, last):
        for k in range(3):
            if attitude_box.angles_half[n, k] > _MIN_WIDTH:
                index = (n, ANGLES.start + k)
                middle = float(attitude_box.angles[n, k])
                yield _bisect_range(bounds, "state_low", "state_high", index, middle)
    width = np.where(
        bounds.contact_low[:last, :, None] > 0, (bounds.arm_high - bounds.arm_low)[:last], 0.0
    )
    width = np.where(np.isfinite(width), width, 0.0)
    # The force that the arm is multiplied with in the moment about the vertical axis
    force_width = (bounds.force_high - bounds.force_low)[:last, :, 1::-1]
    for flat_index in np.argsort(-(width * force_width), axis=None)[:_ARM_CANDIDATES]:
        n, leg, k = (int(i) for i in np.unravel_index(int(flat_index), width.shape))
        if width[n, leg, k] > _MIN_WIDTH:
            middle = 0.5 * float(bounds.arm_low[n, leg, k] + bounds.arm_high[n, leg, k])
            yield _bisect_range(bounds, "arm_low", "arm_high", (n, leg, k), middle)


def _bisect_range(
    bounds: VariableBounds, low: str, high: str, index: tuple[int, ...], middle: float
) -> tuple[VariableBounds, VariableBounds]:
    """Return the bounds with one range below and with it above its middle.

    low, high: names of the fields with the ends of the range.
    """
    upper_end, lower_end = getattr(bounds, high).copy(), getattr(bounds, low).copy()
    upper_end[index] = lower_end[index] = middle
    return replace(bounds, **{high: upper_end}), replace(bounds, **{low: lower_end})
