"""The modes that both blocks agreed on, made into a plan by the program of method `modes`."""

from __future__ import annotations

import numpy as np

from climbplan.errors import LimitReached
from climbplan.limms.arms.carrying import carry
from climbplan.limms.arms.chain_carrying import Chain, carry_on_chains
from climbplan.limms.attempts.attempts import Attempts
from climbplan.limms.consensus.copies import Modes
from climbplan.limms.consensus.iteration import Iterate
from climbplan.limms.consensus.setting import FREE, HELD, LEAPS, STANDS
from climbplan.limms.consensus.warm_start import carry_on
from climbplan.limms.legs.walking import walk
from climbplan.limms.motion.assembly import initial
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.scene.actions import Action
from climbplan.limms.scene.bounds import Connection
from climbplan.limms.scene.limms_scene import Scene

REFINED = 60  # programs and courses of events of one refinement


def chains_of(modes: Modes) -> tuple[Chain, ...]:
    """Who holds the box from where, from the first interval in which it is held."""
    held = np.flatnonzero(modes.box == HELD)
    if not len(held):
        return ()
    k = int(held[0])
    chains = []
    for m in np.flatnonzero(modes.hold[:, k] >= 0):
        parent = int(modes.parent[m, k])
        modules = (int(m),) if parent < 0 else (parent, int(m))
        root = int(modes.wall[modules[0], k])
        chains.append(Chain(Connection(root, int(modes.hold[m, k]), len(modules)), modules))
    chains.sort(key=lambda chain: chain.connection.root)
    return tuple(chains)


def action_of(modes: Modes) -> Action:
    """The modes in the terms of method `modes`."""
    if (modes.box == STANDS).any():
        return Action("quadruped")
    kind = "throw" if (modes.box == FREE).any() else "arms"
    return Action(kind, tuple(chain.connection for chain in chains_of(modes)))


def refine(
    scene: Scene, best: Iterate, attempts: Attempts, rng: np.random.Generator
) -> PlanSoFar | None:
    """A plan with the mode sequence kept, or None; `attempts` says why not.

    Raises:
        LimitReached: budget or time of the whole planning are over.
    """
    part = attempts.part(REFINED)
    try:
        return _refined(scene, best, part, rng)
    except LimitReached as error:
        part.notes.append(f"{action_of(best.modes).named(scene)}: its share of the work was over")
        if part.over or part.most >= attempts.spare:
            raise error
        return None
    finally:
        attempts.add(part)


def _refined(
    scene: Scene, best: Iterate, attempts: Attempts, rng: np.random.Generator
) -> PlanSoFar | None:
    """Arms that carry begin where the blocks agreed, and where that fails as in method `modes`. A
    throw begins as there at once: between the knots of its fastest intervals nothing is known.
    """
    modes = best.modes
    action, start = action_of(modes), initial(scene)
    if action.kind == "quadruped":
        gait = "leap" if (modes.box == LEAPS).any() else "stand"
        return walk(start, attempts, 1, rng, gait)
    chains = chains_of(modes)
    if any(len(chain.modules) > 1 for chain in chains):
        return carry_on_chains(start, action, attempts, rng, chains)
    if action.kind == "arms":
        world = carry_on(start, action, chains, best, attempts, rng)
        if world is not None:
            return world
    owners = tuple(chain.modules[0] for chain in chains)
    return carry(start, action, attempts, rng, owners)
