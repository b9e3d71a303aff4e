"""Margins: forces that still hold in a world that is not quite the planned one.

Beside its bounds each instant is asked for margins (`margins` of a spec): pressure at every toe,
pressure it may miss before it slips, depth of its command, torque that motors have left, stiffness
that bracing leaves. Where all cannot be had the largest common share t of them is found first,

    maximise    t                              0 <= t <= 1
    such that   the bounds of `statement`, each moved from what forces of least cost have
                without margins (t = 0; that of torque: from itself) to its margin (t = 1),
                in proportion to t,

which is a convex program, since every bound enters it linearly; then forces of least cost at nearly
that share. So there are forces wherever there are without margins, and none has less than those.

A toe that comes off its surface finds it again if its command lies inside, where a free toe would
really be. Limbs that bend far move on arcs, so that this is not linear in the forces: what the
first order is off at one answer is asked for in addition at the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.forces.cones import ConicProgram, instant_cones
from climbplan.climb.forces.solving import SolvedForces, solve_forces
from climbplan.climb.forces.statement import (
    TORQUE_MARGIN,
    ForceStatement,
    depths_of,
    free_depths_of,
    standing_use,
)
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.mechanics.friction import split_force
from climbplan.mechanics.stability import loaded_stiffness

_KEPT = 0.95  # of the largest share: at all of it forces have no room left, and cost what they may
_TRIED = (_KEPT, 0.5 * _KEPT)  # parts of the largest share solved at in turn
_SLIPPERY = (0.5, 0.0)  # parts of the friction that surfaces may lack, tried in turn
_ARCS = 4  # times the first order of a command's depth is put right
_EXACT = 1e-4  # [m] by which that may miss the margin
_BETTER = 1e-3  # share by which an answer is better than another
_WHOLE = 0.05  # share that may be missing where a margin counts as kept: rounding, arcs
_SMOOTH = 1e-9  # least friction coefficient divided by


@dataclass(frozen=True)
class MarginedForces:
    """Answers of the force problems with as much of their margins as can be had."""

    solved: SolvedForces
    share: Array  # (K,) of the margins that forces keep, at most 1
    asked: ForceStatement  # the problems with all of their margins


def solve_with_margins(
    scene: MotionScene, statement: ForceStatement, solver: str, facets: int
) -> MarginedForces:
    """Solve and check the force problems of a scene's instants with the margins of its spec.

    Instants are missing in the answer only where there are no forces without margins either.
    """
    margins = scene.spec.margins
    if not margins.asked:
        plain = solve_forces(statement, solver, facets)
        return MarginedForces(plain, np.ones(len(statement.arms)), statement)
    found = _on_friction(scene, statement, _slippery(statement, margins.slip), solver, facets)
    for part in _SLIPPERY:
        lost = np.setdiff1d(found.solved.missing, found.solved.unbalanced)
        if not len(lost):
            break
        # No forces at all on so little friction: on some more
        less = _slippery(statement, part * margins.slip).take(lost)
        again = _on_friction(scene, statement.take(lost), less, solver, facets)
        found = _joined(found, again, lost)
    return found


def _slippery(statement: ForceStatement, slip: float) -> ForceStatement:
    """The problems on surfaces that lack a share of their friction, as far as S_mu leaves less."""
    factor = min(1.0, statement.safety_friction * (1.0 - slip))
    return replace(statement, mu=statement.mu * factor)


def _joined(found: MarginedForces, again: MarginedForces, rows: IntArray) -> MarginedForces:
    """Answers of which some (rows) were found again."""
    force, share = found.solved.force.copy(), found.share.copy()
    force[rows], share[rows] = again.solved.force, again.share
    solved = replace(
        found.solved,
        force=force,
        missing=rows[again.solved.missing],
        solved_again=found.solved.solved_again + again.solved.solved_again,
    )
    return replace(found, solved=solved, share=share)


def _on_friction(
    scene: MotionScene,
    known: ForceStatement,
    statement: ForceStatement,
    solver: str,
    facets: int,
) -> MarginedForces:
    """Forces with as much of the margins as can be had on a friction; known: with its own."""
    margins = scene.spec.margins
    asked = with_margins(statement, margins)
    solved = _best(statement, asked, solver, facets)
    force = solved.force
    share = kept_share(known, margins, force)
    share[solved.missing] = 0.0
    at = force.copy()  # the answer whose arcs are known
    lost = np.concatenate([solved.missing, solved.unbalanced])
    rows = np.setdiff1d(np.arange(len(force)), lost)
    for _ in range(_ARCS if scene.spec.force.sag == "compensated" else 0):
        free = free_depths_of(statement, at)
        short = statement.standing & (free < margins.depth - _EXACT)
        rows = np.intersect1d(rows, np.flatnonzero(short.any(axis=1)))
        if not len(rows):
            break
        part, deeper = statement.take(rows), margins.depth - free + depths_of(statement, at)
        again = _best(part, _deeper(asked.take(rows), deeper[rows]), solver, facets)
        kept = kept_share(known.take(rows), margins, again.force)
        kept[again.missing] = -np.inf
        better = kept > share[rows] + _BETTER
        at[rows] = again.force
        force[rows[better]], share[rows[better]] = again.force[better], kept[better]
        rows = np.setdiff1d(rows, rows[again.missing])
    return MarginedForces(replace(solved, force=force), share, asked)


def _deeper(asked: ForceStatement, depth: Array) -> ForceStatement:
    """The problems with other depths (K, N), to first order, of toes in contact."""
    return replace(asked, least_depth=np.where(asked.standing, depth, asked.least_depth))


def kept_share(statement: ForceStatement, margins: MarginsSpec, force: Array) -> Array:
    """(K,) the least part of its margin that forces (K, C, 3) keep, at most 1.

    Of pressures and friction each of the points at which a limb is pushed has its part.
    """
    contact, weight = statement.contact, statement.robot.weight / statement.points
    parts = split_force(force, statement.normal)
    spare = parts.normal - parts.shear / np.maximum(statement.usable_mu, _SMOOTH)
    left = loaded_stiffness(statement.braced, force).left
    held = np.maximum(statement.mu * parts.normal, _SMOOTH)
    factor = margins.factors(statement.rounds)
    kept = np.ones(len(force))
    for margin, value in (
        (factor * margins.pressure * weight, _least(parts.normal, contact)),
        (factor * margins.friction * weight, _least(spare, contact)),
        (np.full(len(force), margins.slip), _least(1 - parts.shear / held, contact)),
        (
            np.full(len(force), margins.depth),
            _least(free_depths_of(statement, force), statement.standing),
        ),
        (np.full(len(force), margins.torque), 1 - standing_use(statement, force)),
        (np.full(len(force), margins.stiffness), left),
    ):
        part = np.ones(len(force))
        np.divide(value, margin, out=part, where=margin > 0)
        kept = np.minimum(kept, part)
    return np.where(kept > 1 - _WHOLE, 1.0, kept)


def _best(
    statement: ForceStatement, asked: ForceStatement, solver: str, facets: int
) -> SolvedForces:
    """Forces with all that is asked, or with the largest common share of it."""
    solved = solve_forces(asked, solver, facets)
    short = solved.missing
    if not len(short):
        return solved
    force = solved.force
    bare, wanted = statement.take(short), asked.take(short)
    plain = solve_forces(bare, solver, facets)
    force[short] = plain.force
    left = np.setdiff1d(np.arange(len(short)), plain.missing)
    least = _attained(bare, wanted, plain.force)
    largest = np.zeros(len(short))
    for k in left:
        largest[k] = _largest_share(least, wanted, int(k))
    for part in _TRIED:
        left = left[largest[left] > 0]
        if not len(left):
            break
        there = solve_forces(_between(least, wanted, part * largest).take(left), solver, facets)
        held = np.setdiff1d(np.arange(len(left)), there.missing)
        force[short[left[held]]] = there.force[held]
        left = left[there.missing]
    again = solved.solved_again + plain.solved_again
    return SolvedForces(force, short[plain.missing], solved.unbalanced, again)


def with_margins(statement: ForceStatement, margins: MarginsSpec) -> ForceStatement:
    """The force problems with their margins as bounds; what a spec bounds more tightly stays."""
    weight = statement.robot.weight / statement.points * margins.factors(statement.rounds)
    return replace(
        statement,
        least_pressure=np.maximum(statement.least_pressure, margins.pressure * weight),
        reserve=np.maximum(statement.reserve, margins.friction * weight),
        least_depth=np.maximum(statement.least_depth, margins.depth),
        largest_s=np.minimum(statement.largest_s, (1 - TORQUE_MARGIN) * (1 - margins.torque)),
        stiffness_left=np.maximum(statement.stiffness_left, margins.stiffness),
    )


def _attained(bare: ForceStatement, asked: ForceStatement, force: Array) -> ForceStatement:
    """The problems with bounds that forces (K, N, 3) meet: those asked, as far as they do.

    Torque is left bounded as it is: those forces have the least, and a share of nothing beyond it
    would leave none of the others either.
    """
    contact = bare.contact
    parts = split_force(force, bare.normal)
    spare = parts.normal - parts.shear / np.maximum(bare.usable_mu, _SMOOTH)
    depth = np.where(bare.standing, depths_of(bare, force), asked.least_depth)
    left = loaded_stiffness(bare.braced, force).left
    pressure, spare = _least(parts.normal, contact), _least(spare, contact)
    return replace(
        bare,
        least_pressure=np.clip(pressure, bare.least_pressure, asked.least_pressure),
        reserve=np.clip(spare, bare.reserve, asked.reserve),
        least_depth=np.clip(depth, bare.least_depth, asked.least_depth),
        stiffness_left=np.clip(left, bare.stiffness_left, asked.stiffness_left),
    )


def _least(values: Array, contact: BoolArray) -> Array:
    """(K,) least of (K, N) over the toes in contact."""
    return np.asarray(np.where(contact, values, np.inf).min(axis=1))


_MOVED = ("least_pressure", "reserve", "least_depth", "largest_s", "stiffness_left")


def _between(least: ForceStatement, asked: ForceStatement, share: Array) -> ForceStatement:
    """The problems with a share (K,) of what is asked beyond the least."""
    moved = {}
    for name in _MOVED:
        low, high = vars(least)[name], vars(asked)[name]
        part = share if low.ndim == 1 else share[:, None]
        moved[name] = low + part * (high - low)
    return replace(least, **moved)


def _largest_share(least: ForceStatement, asked: ForceStatement, k: int) -> float:
    """The largest t of instant k; 0 where Clarabel finds none."""
    low, high = (instant_cones(statement, k) for statement in (least, asked))
    program, ends = (ConicProgram(3 * low.contacts + 1) for _ in range(2))
    program.forces(low)
    ends.forces(high)
    # b(t) - A f in a cone, b(t) = b(0) + t (b(1) - b(0))
    for (_, _, A, b), (_, _, _, end) in zip(program.blocks, ends.blocks, strict=True):
        A[:, -1] = b - end
    last = np.zeros((1, program.size))
    last[0, -1] = 1.0
    program.below("most", last, np.ones(1))
    program.below("none", -last, np.zeros(1))
    answer = program.minimise(-last[0])
    return 0.0 if answer is None else float(np.clip(answer.x[-1], 0.0, 1.0))
