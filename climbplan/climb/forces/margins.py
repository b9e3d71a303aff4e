"""Margins: forces that still hold in a world that differs from the planned one.

In addition to its bounds each instant should keep margins (`margins` of a spec): pressure at every
toe, pressure that may be lost before slip, penetration of the command, torque reserve of motors,
and stiffness of the braced body. Where not all are feasible, the largest common fraction t is
found,

    maximise    t                              0 <= t <= 1
    subject to  the bounds of `statement`, each interpolated linearly from what forces of least
                cost attain without margins (t = 0; for torque: from the bound itself) to its
                margin (t = 1).

Every bound enters linearly, so that this program is convex. Forces of least cost are then computed
at nearly that fraction. So there are forces wherever there are some without margins, and none has
less than those.

A toe that comes off its surface finds it again if its command lies inside, at the position of a
free toe. Limbs with large deflections move on arcs, so that this position is not linear in the
forces. The linearisation error at one answer is added to the required penetration of the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.forces.cones import ConicProgram, build_instant_cones
from climbplan.climb.forces.solving import SolvedForces, solve_forces
from climbplan.climb.forces.statement import (
    TORQUE_MARGIN,
    ForceStatement,
    compute_contact_torque_ratio,
    compute_free_penetration,
    compute_penetration,
)
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.mechanics.friction import split_force
from climbplan.mechanics.stability import loaded_stiffness

_KEPT_FRACTION = (
    0.95  # of the largest share: at all of it forces have no room left, and cost what they may
)
_TRIED_FRACTIONS = (
    _KEPT_FRACTION,
    0.5 * _KEPT_FRACTION,
)  # parts of the largest share solved at in turn
_SLIP_FRACTIONS = (0.5, 0.0)  # parts of the friction that surfaces may lack, tried in turn
_MAX_ARC_CORRECTIONS = 4  # times the first order of a command's depth is put right
_PENETRATION_TOLERANCE = 1e-4  # [m] by which that may miss the margin
_MIN_IMPROVEMENT = 1e-3  # share by which an answer is better than another
_COMPLETE_TOLERANCE = (
    0.05  # share that may be missing where a margin counts as kept: rounding, arcs
)
_MIN_MU = 1e-9  # least friction coefficient divided by


@dataclass(frozen=True)
class MarginedForces:
    """Answers of the force problems with as much of their margins as is feasible."""

    solved: SolvedForces
    margin_fraction: Array  # (K,) of the margins that forces keep, at most 1
    required: ForceStatement  # the problems with all of their margins


@dataclass(frozen=True)
class MarginRequest:
    """The margins that are asked for."""

    margins: MarginsSpec
    is_compensated: bool  # commands hold the body at its planned pose


def get_margin_request(scene: MotionScene) -> MarginRequest:
    """Return the margins of a scene's spec."""
    force = scene.spec.force
    return MarginRequest(scene.spec.margins, force.deflection_compensation == "compensated")


def solve_with_margins(
    request: MarginRequest, statement: ForceStatement, solver: str, facets: int
) -> MarginedForces:
    """Solve and check force problems with the margins asked for.

    Instants are missing in the answer only where there are no forces without margins either.

    Args:
        request: The margins.
        statement: The force problems of the instants.
        solver: Name of the force solver.
        facets: Number of sides of the friction pyramids.
    """
    margins = request.margins
    if not margins.asked:
        without_margins = solve_forces(statement, solver, facets)
        return MarginedForces(without_margins, np.ones(len(statement.arms)), statement)
    margined = _solve_on_friction(
        request, statement, _reduce_friction(statement, margins.slip), solver, facets
    )
    for slip_fraction in _SLIP_FRACTIONS:
        infeasible = np.setdiff1d(margined.solved.missing, margined.solved.unbalanced)
        if not len(infeasible):
            break
        # No forces at all on so little friction: on some more
        with_more_friction = _reduce_friction(statement, slip_fraction * margins.slip).take(
            infeasible
        )
        replacement = _solve_on_friction(
            request, statement.take(infeasible), with_more_friction, solver, facets
        )
        margined = _merge_answers(margined, replacement, infeasible)
    return margined


def _reduce_friction(statement: ForceStatement, slip: float) -> ForceStatement:
    """Return the problems on surfaces that lack a fraction of their friction, as far as S_mu leaves
    less.
    """
    factor = min(1.0, statement.safety_friction * (1.0 - slip))
    return replace(statement, mu=statement.mu * factor)


def _merge_answers(
    margined: MarginedForces, replacement: MarginedForces, rows: IntArray
) -> MarginedForces:
    """Return the answers with those of some instants (rows) replaced."""
    force, fraction = margined.solved.force.copy(), margined.margin_fraction.copy()
    force[rows], fraction[rows] = replacement.solved.force, replacement.margin_fraction
    solved = replace(
        margined.solved,
        force=force,
        missing=rows[replacement.solved.missing],
        num_resolved=margined.solved.num_resolved + replacement.solved.num_resolved,
    )
    return replace(margined, solved=solved, margin_fraction=fraction)


def _solve_on_friction(
    request: MarginRequest,
    unreduced: ForceStatement,
    statement: ForceStatement,
    solver: str,
    facets: int,
) -> MarginedForces:
    """Return forces with as much of the margins as is feasible on reduced friction.

    Args:
        request: The margins.
        unreduced: The problems with the surfaces' own friction, for measuring margins.
        statement: The problems with reduced friction.
        solver: Name of the force solver.
        facets: Number of sides of the friction pyramids.
    """
    margins = request.margins
    required = apply_margins(statement, margins)
    solved = _maximise_margins(statement, required, solver, facets)
    force = solved.force
    fraction = compute_margin_fraction(unreduced, margins, force)
    fraction[solved.missing] = 0.0
    linearisation = force.copy()  # the answer whose arcs are known
    infeasible = np.concatenate([solved.missing, solved.unbalanced])
    rows = np.setdiff1d(np.arange(len(force)), infeasible)
    for _ in range(_MAX_ARC_CORRECTIONS if request.is_compensated else 0):
        free_penetration = compute_free_penetration(statement, linearisation)
        is_too_shallow = statement.standing & (
            free_penetration < margins.depth - _PENETRATION_TOLERANCE
        )
        rows = np.intersect1d(rows, np.flatnonzero(is_too_shallow.any(axis=1)))
        if not len(rows):
            break
        subproblem, target_penetration = (
            statement.take(rows),
            margins.depth - free_penetration + compute_penetration(statement, linearisation),
        )
        solution = _maximise_margins(
            subproblem,
            _set_min_penetration(required.take(rows), target_penetration[rows]),
            solver,
            facets,
        )
        kept_fraction = compute_margin_fraction(unreduced.take(rows), margins, solution.force)
        kept_fraction[solution.missing] = -np.inf
        is_better = kept_fraction > fraction[rows] + _MIN_IMPROVEMENT
        linearisation[rows] = solution.force
        force[rows[is_better]], fraction[rows[is_better]] = (
            solution.force[is_better],
            kept_fraction[is_better],
        )
        rows = np.setdiff1d(rows, rows[solution.missing])
    return MarginedForces(replace(solved, force=force), fraction, required)


def _set_min_penetration(required: ForceStatement, penetration: Array) -> ForceStatement:
    """Return the problems with other penetrations (K, N), to first order, of toes in contact."""
    return replace(
        required, min_penetration=np.where(required.standing, penetration, required.min_penetration)
    )


def compute_margin_fraction(statement: ForceStatement, margins: MarginsSpec, force: Array) -> Array:
    """Return the smallest fraction (K,) of its margins that forces (K, C, 3) keep, at most 1.

    Margins of pressure and friction are divided evenly among the points at which a limb is pushed.
    """
    contact, weight = statement.contact, statement.robot.weight / statement.points
    components = split_force(force, statement.normal)
    slip_reserve = components.normal - components.shear / np.maximum(statement.usable_mu, _MIN_MU)
    stiffness_ratio = loaded_stiffness(statement.braced_body, force).left
    max_shear = np.maximum(statement.mu * components.normal, _MIN_MU)
    round_factor = margins.factors(statement.rounds)
    fraction = np.ones(len(force))
    for margin, attained in (
        (
            round_factor * margins.normal_force * weight,
            _min_over_contacts(components.normal, contact),
        ),
        (round_factor * margins.friction * weight, _min_over_contacts(slip_reserve, contact)),
        (
            np.full(len(force), margins.slip),
            _min_over_contacts(1 - components.shear / max_shear, contact),
        ),
        (
            np.full(len(force), margins.depth),
            _min_over_contacts(compute_free_penetration(statement, force), statement.standing),
        ),
        (np.full(len(force), margins.torque), 1 - compute_contact_torque_ratio(statement, force)),
        (np.full(len(force), margins.stiffness), stiffness_ratio),
    ):
        kept_part = np.ones(len(force))
        np.divide(attained, margin, out=kept_part, where=margin > 0)
        fraction = np.minimum(fraction, kept_part)
    return np.where(fraction > 1 - _COMPLETE_TOLERANCE, 1.0, fraction)


def _maximise_margins(
    statement: ForceStatement, required: ForceStatement, solver: str, facets: int
) -> SolvedForces:
    """Return forces with all required margins, or with their largest common fraction."""
    solved = solve_forces(required, solver, facets)
    infeasible = solved.missing
    if not len(infeasible):
        return solved
    force = solved.force
    unmargined, infeasible_required = statement.take(infeasible), required.take(infeasible)
    unmargined_solution = solve_forces(unmargined, solver, facets)
    force[infeasible] = unmargined_solution.force
    open_rows = np.setdiff1d(np.arange(len(infeasible)), unmargined_solution.missing)
    attained = _clip_to_attained(unmargined, infeasible_required, unmargined_solution.force)
    max_fraction = np.zeros(len(infeasible))
    for k in open_rows:
        max_fraction[k] = _find_max_fraction(attained, infeasible_required, int(k))
    for tried_fraction in _TRIED_FRACTIONS:
        open_rows = open_rows[max_fraction[open_rows] > 0]
        if not len(open_rows):
            break
        solution = solve_forces(
            _interpolate_margins(attained, infeasible_required, tried_fraction * max_fraction).take(
                open_rows
            ),
            solver,
            facets,
        )
        solved_rows = np.setdiff1d(np.arange(len(open_rows)), solution.missing)
        force[infeasible[open_rows[solved_rows]]] = solution.force[solved_rows]
        open_rows = open_rows[solution.missing]
    num_resolved = solved.num_resolved + unmargined_solution.num_resolved
    return SolvedForces(
        force, infeasible[unmargined_solution.missing], solved.unbalanced, num_resolved
    )


def apply_margins(statement: ForceStatement, margins: MarginsSpec) -> ForceStatement:
    """Return the force problems with their margins as bounds; tighter bounds of a spec stay."""
    weight = statement.robot.weight / statement.points * margins.factors(statement.rounds)
    return replace(
        statement,
        min_normal_force=np.maximum(statement.min_normal_force, margins.normal_force * weight),
        reserve=np.maximum(statement.reserve, margins.friction * weight),
        min_penetration=np.maximum(statement.min_penetration, margins.depth),
        max_s=np.minimum(statement.max_s, (1 - TORQUE_MARGIN) * (1 - margins.torque)),
        min_stiffness_ratio=np.maximum(statement.min_stiffness_ratio, margins.stiffness),
    )


def _clip_to_attained(
    unmargined: ForceStatement, required: ForceStatement, force: Array
) -> ForceStatement:
    """Return the problems with bounds that forces (K, N, 3) meet: the required ones as far as they
    do.

    The torque bound stays: those forces have the least torque, and a fraction of no reserve would
    leave no reserve for other margins.
    """
    contact = unmargined.contact
    components = split_force(force, unmargined.normal)
    slip_reserve = components.normal - components.shear / np.maximum(unmargined.usable_mu, _MIN_MU)
    penetration = np.where(
        unmargined.standing, compute_penetration(unmargined, force), required.min_penetration
    )
    stiffness_ratio = loaded_stiffness(unmargined.braced_body, force).left
    pressure, slip_reserve = (
        _min_over_contacts(components.normal, contact),
        _min_over_contacts(slip_reserve, contact),
    )
    return replace(
        unmargined,
        min_normal_force=np.clip(pressure, unmargined.min_normal_force, required.min_normal_force),
        reserve=np.clip(slip_reserve, unmargined.reserve, required.reserve),
        min_penetration=np.clip(penetration, unmargined.min_penetration, required.min_penetration),
        min_stiffness_ratio=np.clip(
            stiffness_ratio, unmargined.min_stiffness_ratio, required.min_stiffness_ratio
        ),
    )


def _min_over_contacts(values: Array, contact: BoolArray) -> Array:
    """Return the minimum (K,) of values (K, N) over the toes in contact."""
    return np.asarray(np.where(contact, values, np.inf).min(axis=1))


MARGIN_FIELDS = ("min_normal_force", "reserve", "min_penetration", "max_s", "min_stiffness_ratio")


def _interpolate_margins(
    attained: ForceStatement, required: ForceStatement, fraction: Array
) -> ForceStatement:
    """Return the problems with a fraction (K,) of what is required beyond what is attained."""
    interpolated = {}
    for name in MARGIN_FIELDS:
        low, high = vars(attained)[name], vars(required)[name]
        weight = fraction if low.ndim == 1 else fraction[:, None]
        interpolated[name] = low + weight * (high - low)
    return replace(attained, **interpolated)


def _find_max_fraction(attained: ForceStatement, required: ForceStatement, k: int) -> float:
    """Return the largest t of instant k; 0 where Clarabel finds none."""
    attained_cones, required_cones = (
        build_instant_cones(statement, k) for statement in (attained, required)
    )
    program, end_program = (ConicProgram(3 * attained_cones.num_contacts + 1) for _ in range(2))
    program.add_force_constraints(attained_cones)
    end_program.add_force_constraints(required_cones)
    # b(t) - A f in a cone, b(t) = b(0) + t (b(1) - b(0))
    for (_, _, A, b), (_, _, _, end_value) in zip(program.blocks, end_program.blocks, strict=True):
        A[:, -1] = b - end_value
    fraction_row = np.zeros((1, program.size))
    fraction_row[0, -1] = 1.0
    program.add_inequality("most", fraction_row, np.ones(1))
    program.add_inequality("none", -fraction_row, np.zeros(1))
    solution = program.minimise(-fraction_row[0])
    return 0.0 if solution is None else float(np.clip(solution.x[-1], 0.0, 1.0))
