"""The box as body of a quadruped made into a plan: footholds, gait, program, assembly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np

from climbplan.limms.answers import Outcome
from climbplan.limms.assembly import initial, latch_box, stand_leg
from climbplan.limms.carrying import TOUCH, Attempts
from climbplan.limms.corridor import Way, centre_blocks, ways
from climbplan.limms.densify import Follow, add_traces
from climbplan.limms.gaits import Gait, gaits
from climbplan.limms.held import clearance
from climbplan.limms.legs import Stand, first_stands, legs_of, plan_legs
from climbplan.limms.reaching import Blocked
from climbplan.limms.scene import Array, Scene
from climbplan.limms.statement import Limb
from climbplan.limms.timeline import Progress


def walk(
    scene: Scene, attempts: Attempts, left: float, most_steps: int, rng: np.random.Generator
) -> Progress | None:
    """A plan in which four modules are legs of the box, or None."""
    start = scene.box_start[0]
    way = ways(centre_blocks(scene), start, scene.goal)
    if way is None:
        attempts.notes.append("there is no way for the box")
        return None
    reach = sum(scene.module.link_lengths[:5])  # the last link but one stands upright
    for gait in gaits(4, len(way.blocks), scene.goal - start, reach, most_steps):
        toward = _toward(way, start, scene.goal, gait)
        choices = [first_stands(scene, side, start, toward) for side in range(4)]
        if not all(choices):
            attempts.notes.append("quadruped: a side of the box cannot be latched by a leg")
            return None
        most = 400 if gait.steps == 0 else 200
        for stands in _stand_sets(choices, 2):
            outcome = plan_legs(scene, stands, gait, way, start, scene.goal, min(left, 25.0), most)
            attempts.count(outcome, f"quadruped, {gait.name}")
            if not outcome.solved:
                continue
            try:
                return _whole(scene, stands, outcome, rng)
            except (Blocked, Follow) as error:
                attempts.notes.append(f"quadruped, {gait.name}: {error}")
    return None


def _toward(way: Way, start: Array, goal: Array, gait: Gait) -> Array:
    """Centres of the box that the first footholds have to serve."""
    if gait.steps == 0:
        return np.vstack([way.crossings, goal])
    return (start + np.array([0, 0, 0.15]))[None]


def _stand_sets(choices: Sequence[Sequence[Stand]], most: int) -> Iterator[tuple[Stand, ...]]:
    """Sets of first footholds, least trouble first, that do not stand on each other."""
    ranked = sorted(product(*choices), key=lambda stands: sum(s.trouble for s in stands))
    count = 0
    for stands in ranked:
        feet = np.array([s.foot for s in stands])
        apart = np.linalg.norm(feet[:, None] - feet[None], axis=-1) + np.eye(len(feet))
        if apart.min() < 0.15:
            continue
        yield tuple(stands)
        count += 1
        if count >= most:
            return


def _whole(
    scene: Scene, stands: Sequence[Stand], outcome: Outcome, rng: np.random.Generator
) -> Progress:
    """Modules drive up, latch at once, and the box moves.

    Raises:
        Blocked: a way there is not free, or the motion touches something.
    """
    limbs = legs_of(stands)
    # Footholds are the program's own
    feet = outcome.traces[0].feet[0]
    reason: Exception | None = None
    check_traces(scene, limbs, outcome)
    for owners in _owners(scene, feet):
        for order in _orders(len(limbs)):
            world = initial(scene)
            owned = [
                Limb(**{**vars(limb), "module": owner})
                for limb, owner in zip(limbs, owners, strict=True)
            ]
            try:
                for i in order:
                    stand = Stand(stands[i].side, feet[i], stands[i].patch, stands[i].branch, 0.0)
                    name = scene.module_names[owners[i]]
                    stand_leg(world, owners[i], stand, outcome.traces[0].angles[0, i], name, rng)
            except Blocked as error:
                reason = error
                continue
            latch_box(world, owned)
            add_traces(world, owned, outcome.traces)
            return world
    raise Blocked(str(reason))


def check_traces(scene: Scene, limbs: Sequence[Limb], outcome: Outcome) -> None:
    """Raise Blocked if the legs touch anything at the knots."""
    for trace in outcome.traces:
        worst = float(clearance(scene, limbs, trace.position, trace.feet, trace.angles).min())
        if worst < 50 * TOUCH:
            raise Blocked(f"legs reach {-1e3 * worst:.1f} mm into something")


def _orders(n: int) -> Iterator[tuple[int, ...]]:
    yield tuple(range(n))
    yield tuple(reversed(range(n)))


def _owners(scene: Scene, feet: Array) -> Iterator[tuple[int, ...]]:
    """Which module goes to which foothold: least distance, on the same level of ground."""
    free = [m for m in range(scene.count) if scene.held[m] < 0]
    ranked = []
    for modules in permutations(free, len(feet)):
        away = scene.stand[list(modules)] - feet
        if np.abs(away[:, 2]).max() > 1e-6:
            continue
        ranked.append((float(np.linalg.norm(away, axis=1).sum()), modules))
    ranked.sort()
    for _, modules in ranked[:3]:
        yield modules
