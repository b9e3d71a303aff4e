"""Why no contact sequence exists: which contacts slip, and by how much, or what is out of reach."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.plan.climb_plan import sequence_name
from climbplan.climb.transition.footholds import GOAL, START, Poses
from climbplan.climb.transition.pose_ways import Sequence, State, stance_of_move
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import Search, toe_step_limits
from climbplan.climb.transition.stances import (
    Laboratory,
    balances,
    largest_friction_factor,
    largest_torque_factor,
    slipping,
    stance_instants,
)
from climbplan.errors import Conflict, NotProved, Remedy

_LISTED = 3  # sequences whose refusal is told
_SHIFT = 0.6  # of the level distance of the farthest toe
_LOOKED_INTO = 400  # kinematic sequences whose forces are asked for


SEARCHED = "the search looks at some footholds and poses between start and goal (`search`)"


class OutOfReach(NotProved):
    """No sequence is within reach: another way to find forces would not help."""


def no_sequence(
    scene: TransitionScene, deadline: float = np.inf, beside: Poses | None = None
) -> NotProved:
    """The error that says why the search found nothing on the footholds and poses it looks at.

    beside: poses that it looked at beside those of the grid.
    """
    kinematic = Search(scene, forces=False, deadline=deadline, beside=beside)
    found = kinematic.sequences()
    task = scene.spec.task
    asked = f"{task.rounds} round{'s' * (task.rounds != 1)}"
    if task.sequence:
        asked += f" as {task.sequence}"
    if not found:
        conflicts, remedies = _unreached(kinematic)
        return OutOfReach(
            f"no contact sequence of {asked}",
            conflicts,
            because=SEARCHED,
            stage="search",
            remedies=remedies,
        )
    _standing(kinematic.lab, scene)
    return NotProved(
        f"no contact sequence of {asked}: {len(found)} are within reach, none finds admissible "
        "forces at the poses searched",
        _refusals(kinematic, found[:_LOOKED_INTO]),
        because=SEARCHED,
        stage="search",
    )


def _standing(lab: Laboratory, scene: TransitionScene) -> None:
    """Raises NoForces in words if the robot cannot even stand at its start or goal."""
    n = scene.robot.limb_count
    for number, pose in ((START, 0), (GOAL, lab.poses.count - 1)):
        row = np.full((1, n), number, np.int64)
        plan_forces(scene, stance_instants(lab, row, np.array([pose])))


def _unreached(search: Search) -> tuple[list[Conflict], list[Remedy]]:
    """Limbs that cannot reach their goal from any pose, or not in so many rounds."""
    lab, names = search.lab, search.scene.robot.limb_names
    conflicts: list[Conflict] = []
    longer: dict[str, float] = {}
    if not lab.footholds.real[:, START].any():
        text = "every toe stands where it has to in the end: no limb has to move"
        return [Conflict("search", (text,), in_words=True)], []
    for limb, name in enumerate(names):
        old, new = lab.reach.valid[:, limb, START], lab.reach.valid[:, limb, GOAL]
        if not lab.footholds.real[limb, START]:
            continue
        between = [c for c in range(2, lab.footholds.count) if lab.footholds.real[limb, c]]
        over = [c for c in between if (old & lab.reach.valid[:, limb, c]).any()]
        if not (old & new).any() and not over:
            text = f"{name} reaches its goal from no pose at which it stands on its start"
            conflicts.append(Conflict("search", (text,), in_words=True))
            continue
        needed, most = _longest_step(lab, limb, between), toe_step_limits(search.scene)[limb]
        if needed > most:
            text = (
                f"{name} gets to its goal by steps of {1e3 * needed:.0f} mm at least on the "
                f"footholds searched, and may step {1e3 * most:.0f} mm"
            )
            conflicts.append(Conflict("search", (text,), in_words=True))
            longer[name] = needed
    if not conflicts:
        text = "limbs reach their footholds, but not in so few rounds or from the same poses"
        conflicts.append(Conflict("search", (text,), in_words=True))
    return conflicts, _longer_steps(search.scene, longer)


def _longer_steps(scene: TransitionScene, needed: dict[str, float]) -> list[Remedy]:
    """Largest steps of limbs with which they get to their goal; needed: by limb [m]."""
    if not needed:
        return []
    asked = {name: np.ceil(1e3 * step + 1) / 1e3 for name, step in needed.items()}
    own, most = scene.spec.task.step_max, scene.spec.posture.steps.toe_max
    words = f"steps of {1e3 * max(asked.values()):.0f} mm"
    if max(asked.values()) > most:
        return [Remedy(words, "posture.steps.toe_max", float(max(asked.values())))]
    whole = {**own, **asked}
    text = ", ".join(f"{name}: {step:.6g}" for name, step in whole.items())
    return [Remedy(words, "task.step_max", f"{{{text}}}")]


def _longest_step(lab: Laboratory, limb: int, between: list[int]) -> float:
    """The longest step [m] of the way of a limb to its goal on which that is shortest."""
    toe = lab.footholds.toe[limb]
    start, goal = toe[START], toe[GOAL]
    over = [max(np.linalg.norm(toe[c] - start), np.linalg.norm(goal - toe[c])) for c in between]
    return float(min([np.linalg.norm(goal - start), *over]))


def _refusals(search: Search, found: list[Sequence]) -> list[Conflict]:
    """Of the sequences that need least more friction, the round that is refused and the slip."""
    lab = search.lab
    cells: dict[tuple[State, int], int] = {}
    rounds: list[list[tuple[State, list[int]]]] = []
    for sequence in found:
        own = []
        for j, (a, b) in enumerate(itertools.pairwise(sequence.states)):
            stance = stance_of_move(a, b)
            at = [int(p) for p in np.flatnonzero(np.isfinite(search.uses(j, a, b)))]
            own.append((stance, at))
            for pose in at:
                cells.setdefault((stance, pose), len(cells))
        rounds.append(own)
    factor = largest_friction_factor(
        lab,
        np.array([stance for stance, _ in cells], np.int64),
        np.array([pose for _, pose in cells], np.int64),
    )

    def best(stance: State, at: list[int]) -> int:
        return max(at, key=lambda pose: factor[cells[stance, pose]])

    worst: list[tuple[float, int, int, int]] = []  # factor, sequence, round, pose
    for number, own in enumerate(rounds):
        by_round = [best(stance, at) for stance, at in own]
        factors = [factor[cells[s, p]] for (s, _), p in zip(own, by_round, strict=True)]
        j = int(np.argmin(factors))
        worst.append((float(factors[j]), number, j, by_round[j]))
    worst.sort(reverse=True)
    return [
        _refusal(search, found[number], j, pose, rounds[number][j][0], allowed)
        for allowed, number, j, pose in worst[:_LISTED]
    ]


def _refusal(
    search: Search, sequence: Sequence, j: int, pose: int, stance: State, factor: float
) -> Conflict:
    """One round in words: "LF on 'brick front' would need mu 0.62 and has 0.50"."""
    scene, lab = search.scene, search.lab
    names = scene.robot.limb_names
    moved = sequence.moved
    limbs = " ".join(names[i] for i in np.flatnonzero(moved[j]))
    where = f"{sequence_name(moved, names)}: round {j + 1}, {limbs} lifted"
    row: IntArray = np.array(stance, np.int64)
    if factor <= 0 and not balances(lab, row, pose):
        held = " ".join(names[i] for i in np.flatnonzero(~moved[j]))
        least = f"each pressing with {100 * scene.spec.search.least_load:.3g} % of the weight"
        text = f"the body does not balance on {held}, {least} (`search.least_load`) or more"
        return Conflict(where, (text,), _shifted(scene) if j == 0 else (), in_words=True)
    words, remedies = _weak(scene, largest_torque_factor(lab, row, pose))
    if factor <= 0:
        named = tuple(words) or ("torque limits of the limbs that stay",)
        return Conflict(where, named, tuple(remedies), in_words=bool(words))
    asked = scene.spec.force.safety_friction
    slips = slipping(lab, row, pose, factor)
    for slip in slips[:3]:
        surface = _surface_name(lab, slip.limb, row)
        words.append(
            f"{names[slip.limb]} slips on {surface!r}: it needs mu {slip.needed:.2f}, "
            f"and has {slip.available:.2f} / S_mu {asked:g} = {slip.available / asked:.2f}"
        )
    if factor >= 1:
        safety = float(np.floor(1e2 * factor)) / 1e2
        remedies.append(Remedy(f"S_mu <= {safety:g}", "force.safety_friction", safety))
    remedies += _rougher(scene, {_surface_name(lab, s.limb, row) for s in slips}, asked / factor)
    remedies.append(Remedy(f"friction {np.ceil(1e2 * asked / factor) / 1e2:.2f} times as high"))
    return Conflict(where, tuple(words) or ("friction",), tuple(remedies), in_words=bool(words))


def _weak(scene: TransitionScene, holds: float) -> tuple[list[str], list[Remedy]]:
    """Torque limits that are in the way, holds: the largest S_tau with the friction asked for."""
    asked = scene.spec.force.safety_torque
    if not 0 < holds < asked:
        return [], []
    words = f"motors would have S_tau {holds:.3g} at the friction there is, {asked:g} is asked"
    if holds < 1:
        times = f"{np.ceil(1e2 * asked / holds) / 1e2:.2f} times the torque limits"
        return [words], [Remedy(times)]
    value = float(np.floor(1e2 * holds) / 1e2)
    return [words], [Remedy(f"S_tau <= {value:g}", "force.safety_torque", value)]


def _shifted(scene: TransitionScene) -> tuple[Remedy, ...]:
    """The body over the limbs that stay before the first lift, where it may not shift as yet."""
    level = np.linalg.norm((scene.start.toes - scene.start.com)[:, :2], axis=1).max()
    value = float(np.ceil(1e2 * _SHIFT * level) / 1e2)
    if scene.spec.posture.steps.shift_max >= value:
        return ()
    words = f"a body that shifts by up to {1e3 * value:.0f} mm before the first lift"
    return (Remedy(words, "posture.steps.shift_max", value),)


def _surface_name(lab: Laboratory, limb: int, stance: IntArray) -> str:
    return lab.scene.terrain.surfaces[lab.footholds.region[limb, stance[limb]]].name


def _rougher(scene: TransitionScene, surfaces: set[str], times: float) -> Iterator[Remedy]:
    """More friction where limbs slip: of boxes that have their own, and of all the rest."""
    terrain = scene.spec.terrain
    own = {f"terrain.boxes.{k}.friction": box for k, box in enumerate(terrain.boxes)}
    rougher = {
        key: box.friction
        for key, box in own.items()
        if box.friction is not None and box.name in surfaces
    }
    if surfaces - {box.name for box in own.values() if box.friction is not None}:
        rougher["terrain.friction"] = terrain.friction
    for key, friction in rougher.items():
        value = float(np.ceil(1e3 * times * friction)) / 1e3
        yield Remedy(f"mu of {value:g}", key, value)
