"""The last program begun where the blocks agreed: the box's way, and the branches of the arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.carrying import limb_of, whole_carried
from climbplan.limms.arms.chain_carrying import Chain
from climbplan.limms.arms.guess import KNOTS, Piece, traces_along
from climbplan.limms.arms.held import plan_held
from climbplan.limms.arms.held_branches import HeldTask
from climbplan.limms.attempts.attempts import Attempts
from climbplan.limms.consensus.iteration import Iterate
from climbplan.limms.consensus.setting import HELD
from climbplan.limms.modules.chain import BRANCHES
from climbplan.limms.modules.limbs import limb_angles
from climbplan.limms.motion.densify import Follow
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.corridor import centre_blocks, ways
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.statement import Limb


def carry_on(
    world: PlanSoFar,
    action: Action,
    chains: Sequence[Chain],
    best: Iterate,
    attempts: Attempts,
    rng: np.random.Generator,
) -> PlanSoFar | None:
    """A plan in which single arms carry the box as the best iterate does, or None."""
    scene = world.scene
    start = scene.box_start[0]
    way = ways(centre_blocks(scene), start, scene.goal)
    if way is None or not chains:
        return None
    task = HeldTask(start, scene.goal, way, False, 0.0)
    held = np.flatnonzero(best.modes.box == HELD)
    path = best.copy.box[held[0] : held[-1] + 2]
    limbs = [
        _with_branch(
            scene,
            limb_of(world, chain.modules[0], chain.connection),
            start,
            best.angles[held[0], chain.modules[0]],
        )
        for chain in chains
    ]
    guess = traces_along(scene, limbs, task, _pieces(task, path, best.held_seconds))
    outcome = plan_held(scene, limbs, task, attempts.end, guess)
    name = f"{action.named(scene)}, from the best iterate"
    attempts.count(outcome, name)
    if not outcome.solved:
        return None
    try:
        return whole_carried(world, limbs, action.connections, outcome, rng)
    except (Blocked, Follow) as error:
        attempts.notes.append(f"{name}: {error}")
        return None


def _with_branch(scene: Scene, limb: Limb, box: Array, angles: Array) -> Limb:
    """The arm with the branch that comes nearest to angles (6,) where it takes the box."""

    def off(branch: tuple[int, int, int]) -> float:
        own, _ = limb_angles(scene, limb, box[None], limb.fixed_position[None], branch)
        return float(np.abs(np.sin((own[0] - angles) / 2)).max())

    return replace(limb, branch=min(BRANCHES, key=off))


def _pieces(task: HeldTask, path: Array, seconds: float) -> list[Piece]:
    """The way (n, 3) from knot to knot, `seconds` each, cut where it enters other blocks."""
    last = len(path) - 1.0
    fine = np.linspace(0, last, 20 * (len(path) - 1) + 1)
    dense = np.column_stack([np.interp(fine, np.arange(len(path)), path[:, i]) for i in range(3)])
    cuts = [0.0]
    for crossing in task.way.crossings:
        ahead = fine >= cuts[-1] + 0.1
        away = np.where(ahead, np.linalg.norm(dense - crossing, axis=1), np.inf)
        cuts.append(float(fine[int(np.argmin(away))]))
    cuts.append(last)
    pieces = []
    for begin, end, block in zip(cuts[:-1], cuts[1:], task.way.blocks, strict=True):
        at = np.linspace(begin, end, KNOTS + 1)
        position = np.column_stack(
            [np.interp(at, np.arange(len(path)), path[:, i]) for i in range(3)]
        )
        position = np.clip(position, block[0], block[1])
        duration = max((end - begin) * seconds, 0.2)
        velocity = np.gradient(position, duration / KNOTS, axis=0)
        pieces.append(Piece(position, duration, velocity, block))
    return pieces
