"""One step on a node of the branch and bound: tighten its bounds, then branch on it.

The shortest prefix relaxation tightens the root, which then branches on the contacts of the first
two intervals. A prefix of four intervals tightens the children, which branch on the contacts of
these four. Nodes with fixed early contacts are bisected in the range of a continuous variable.
Where the first contacts decide little, ever longer prefixes tighten the root as long as its bound
rises, and the search over all contacts follows.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.walking.micp.branch_and_bound import SEARCH_TANGENT_TOLERANCE, BranchAndBound
from climbplan.walking.micp.branching import (
    WalkSubproblem,
    bisect_node,
    branch_on_contacts,
    count_early_intervals,
)
from climbplan.walking.micp.prefix_relaxation import (
    MIN_PREFIX_GAIN,
    bound_tail_cost,
    tighten_by_prefix,
)
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.micp.variable_bounds import VariableBounds

_MIN_BISECTION_GAIN = 0.001  # of the cost: with less gain, contacts are searched first
_NEARLY_CLOSED = 0.004  # of the cost: with a smaller gap, contacts are searched first


def process_node(run: BranchAndBound, node: WalkSubproblem) -> list[WalkSubproblem]:
    """Tighten a node and branch on it.

    Args:
        run: The state of the run; its bound is that of the node.
        node: The node.

    Returns:
        The children; none if the node is fathomed, or if there is nothing to branch on.
    """
    formulation, bounds = node.formulation, node.bounds
    cutoff = formulation.cutoff
    if node.tail_cost is None:
        program = formulation.build(bounds)
        if bounds is None:
            is_feasible, _ = run.bound_by_relaxation(program, cutoff)
            if not is_feasible or run.is_closed or run.seconds_left <= 0:
                return []
            formulation = run.reduce_rotation_rows(formulation)
            program = formulation.build(None)
        tail_cost = bound_tail_cost(program, node.prefix_length)
        if tail_cost is None:
            run.fathom(cutoff)
            return []
        node, bounds = replace(node, formulation=formulation, tail_cost=tail_cost), program.bounds
    assert bounds is not None  # a node with a tail cost has bounds
    return _tighten_and_branch(run, node, bounds)


def _tighten_and_branch(
    run: BranchAndBound, node: WalkSubproblem, bounds: VariableBounds
) -> list[WalkSubproblem]:
    """Tighten the bounds by the prefix relaxation of the node, and branch if it is not closed."""
    formulation, cutoff = node.formulation, node.formulation.cutoff
    tail_costs = {node.prefix_length: node.tail_cost or 0.0}
    tightened = tighten_by_prefix(
        formulation,
        bounds,
        node.prefix_length,
        tail_costs,
        0,
        seconds=run.seconds_left,
        clock=run.limits.clock,
    )
    if tightened is None:
        run.fathom(cutoff)
        return []
    program = formulation.build(tightened)
    if not run.bound_by_relaxation(program, cutoff, ())[0] or run.is_closed:
        return []
    last_bound = node.lower_bound
    node = replace(node, bounds=tightened, lower_bound=run.bounds[run.cell_index])
    if run.seconds_left <= 0:
        return [node]
    if node.num_decided < count_early_intervals(formulation):
        children = _branch_on_contacts(run, node, program, last_bound)
    else:
        children = _bisect(run, node, program)
    if children is None:
        return []
    if not children:
        run.fathom(cutoff)
    return children


def _branch_on_contacts(
    run: BranchAndBound, node: WalkSubproblem, program: MixedIntegerRelaxation, last_bound: float
) -> list[WalkSubproblem] | None:
    """Branch on the next contacts; without too many children of a root, else search all contacts.

    Args:
        run: The state of the run.
        node: The node, with tightened bounds.
        program: Its relaxation.
        last_bound: Lower bound of the node before its bounds were tightened.

    Returns:
        The children; None if the search over contacts has processed the node.
    """
    tangent_tolerance = SEARCH_TANGENT_TOLERANCE * run.objective
    children = branch_on_contacts(node, program, tangent_tolerance, lambda: run.seconds_left > 0)
    if children is not None:
        return children
    is_gaining = node.lower_bound >= last_bound + MIN_PREFIX_GAIN * node.formulation.cutoff
    if is_gaining and node.prefix_length + 1 < node.formulation.task.knots:
        return [replace(node, prefix_length=node.prefix_length + 1, tail_cost=None)]
    run.search_contacts(node, program)
    return None


def _bisect(
    run: BranchAndBound, node: WalkSubproblem, program: MixedIntegerRelaxation
) -> list[WalkSubproblem] | None:
    """Bisect a node, after a search over its contacts where that promises more.

    Returns:
        The children; None if the node is closed, or if no range can be bisected.
    """
    objective = run.objective
    bisection, gap = bisect_node(node), node.formulation.cutoff - node.lower_bound
    if (
        bisection is None
        or gap <= _NEARLY_CLOSED * objective
        or bisection.gain < _MIN_BISECTION_GAIN * objective
    ):
        run.search_contacts(node, program, is_brief=bisection is not None)
        if bisection is None or run.is_closed:
            return None
    bound = run.bounds[run.cell_index]
    return [
        replace(child, lower_bound=max(child.lower_bound, bound)) for child in bisection.children
    ]
