"""Explain why no contact sequence exists: contacts that slip, or toes out of reach."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.plan.climb_plan import format_sequence
from climbplan.climb.transition.footholds import GOAL, START, CandidateBodyPoses
from climbplan.climb.transition.pose_paths import ContactSequence, State, get_stance
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import SequenceSearch, compute_step_limits
from climbplan.climb.transition.stance_forces import (
    SearchTables,
    build_stance_instants,
    find_max_friction_factor,
    find_max_torque_factor,
    find_slipping_contacts,
    is_balanced,
)
from climbplan.errors import Conflict, Remedy, Unresolved

_MAX_LISTED = 3  # sequences that are explained
_SHIFT_FRACTION = 0.6  # of the horizontal distance of the farthest toe
_MAX_EXPLAINED = 400  # kinematic sequences whose forces are solved


SEARCHED = "the search looks at some footholds and poses between start and goal (`search`)"


class OutOfReach(Unresolved):
    """No sequence is kinematically feasible: another force method would not help."""


def explain_no_sequence(
    scene: TransitionScene, deadline: float = np.inf, extra_poses: CandidateBodyPoses | None = None
) -> Unresolved:
    """Explain why the search found no sequence on its footholds and poses; return the error.

    extra_poses: poses that it searched in addition to those of the grid.
    """
    kinematic = SequenceSearch(scene, forces=False, deadline=deadline, extra_poses=extra_poses)
    sequences = kinematic.list_sequences()
    task = scene.spec.task
    request_text = f"{task.rounds} round{'s' * (task.rounds != 1)}"
    if task.sequence:
        request_text += f" as {task.sequence}"
    if not sequences:
        conflicts, remedies = _explain_reach(kinematic)
        return OutOfReach(
            f"no contact sequence of {request_text}",
            conflicts,
            because=SEARCHED,
            stage="search",
            remedies=remedies,
        )
    _require_standing(kinematic.tables, scene)
    return Unresolved(
        f"no contact sequence of {request_text}: {len(sequences)} are within reach, "
        "none finds admissible forces at the poses searched",
        _explain_forces(kinematic, sequences[:_MAX_EXPLAINED]),
        because=SEARCHED,
        stage="search",
    )


def _require_standing(tables: SearchTables, scene: TransitionScene) -> None:
    """Raise NoForces if the robot cannot even stand at its start or goal."""
    n = scene.robot.limb_count
    for number, pose in ((START, 0), (GOAL, tables.poses.count - 1)):
        row = np.full((1, n), number, np.int64)
        plan_forces(scene, build_stance_instants(tables, row, np.array([pose])))


def _explain_reach(search: SequenceSearch) -> tuple[list[Conflict], list[Remedy]]:
    """Explain which limbs cannot reach their goal from any pose, or not in the rounds."""
    tables, names = search.tables, search.scene.robot.limb_names
    conflicts: list[Conflict] = []
    required_steps: dict[str, float] = {}
    if not tables.footholds.real[:, START].any():
        text = "every toe is at its goal from the start: no limb has to move"
        return [Conflict("search", (text,), in_words=True)], []
    for limb, name in enumerate(names):
        reachable_start, reachable_goal = (
            tables.reach.valid[:, limb, START],
            tables.reach.valid[:, limb, GOAL],
        )
        if not tables.footholds.real[limb, START]:
            continue
        intermediate = [
            c for c in range(2, tables.footholds.count) if tables.footholds.real[limb, c]
        ]
        via = [c for c in intermediate if (reachable_start & tables.reach.valid[:, limb, c]).any()]
        if not (reachable_start & reachable_goal).any() and not via:
            text = f"{name} reaches its goal from no pose at which it stands on its start"
            conflicts.append(Conflict("search", (text,), in_words=True))
            continue
        required_step, max_step = (
            _find_longest_step(tables, limb, intermediate),
            compute_step_limits(search.scene)[limb],
        )
        if required_step > max_step:
            text = (
                f"{name} gets to its goal by steps of {1e3 * required_step:.0f} mm at least on the "
                f"footholds searched, and may step {1e3 * max_step:.0f} mm"
            )
            conflicts.append(Conflict("search", (text,), in_words=True))
            required_steps[name] = required_step
    if not conflicts:
        text = "limbs reach their footholds, but not in so few rounds or from the same poses"
        conflicts.append(Conflict("search", (text,), in_words=True))
    return conflicts, _suggest_steps(search.scene, required_steps)


def _suggest_steps(scene: TransitionScene, required_steps: dict[str, float]) -> list[Remedy]:
    """Suggest step limits with which limbs reach their goal; required_steps: by limb [m]."""
    if not required_steps:
        return []
    required = {name: np.ceil(1e3 * step + 1) / 1e3 for name, step in required_steps.items()}
    current_limits, max_step = scene.spec.task.step_max, scene.spec.posture.steps.toe_max
    text_of_remedy = f"steps of {1e3 * max(required.values()):.0f} mm"
    if max(required.values()) > max_step:
        return [Remedy(text_of_remedy, "posture.steps.toe_max", float(max(required.values())))]
    limits = {**current_limits, **required}
    text = ", ".join(f"{name}: {step:.6g}" for name, step in limits.items())
    return [Remedy(text_of_remedy, "task.step_max", f"{{{text}}}")]


def _find_longest_step(tables: SearchTables, limb: int, intermediate: list[int]) -> float:
    """Find the longest step of a limb's path to its goal, minimised over paths [m]."""
    toe = tables.footholds.toe[limb]
    start, goal = toe[START], toe[GOAL]
    via = [max(np.linalg.norm(toe[c] - start), np.linalg.norm(goal - toe[c])) for c in intermediate]
    return float(min([np.linalg.norm(goal - start), *via]))


def _explain_forces(search: SequenceSearch, sequences: list[ContactSequence]) -> list[Conflict]:
    """Explain the infeasible rounds of the sequences that lack least friction."""
    tables = search.tables
    cells: dict[tuple[State, int], int] = {}
    rounds: list[list[tuple[State, list[int]]]] = []
    for sequence in sequences:
        stance_poses = []
        for j, (a, b) in enumerate(itertools.pairwise(sequence.states)):
            stance = get_stance(a, b)
            poses = [
                int(p) for p in np.flatnonzero(np.isfinite(search.compute_torque_use(j, a, b)))
            ]
            stance_poses.append((stance, poses))
            for pose in poses:
                cells.setdefault((stance, pose), len(cells))
        rounds.append(stance_poses)
    factor = find_max_friction_factor(
        tables,
        np.array([stance for stance, _ in cells], np.int64),
        np.array([pose for _, pose in cells], np.int64),
    )

    def find_best_pose(stance: State, poses: list[int]) -> int:
        return max(poses, key=lambda pose: factor[cells[stance, pose]])

    worst: list[tuple[float, int, int, int]] = []  # factor, sequence, round, pose
    for number, stance_poses in enumerate(rounds):
        by_round = [find_best_pose(stance, poses) for stance, poses in stance_poses]
        factors = [factor[cells[s, p]] for (s, _), p in zip(stance_poses, by_round, strict=True)]
        j = int(np.argmin(factors))
        worst.append((float(factors[j]), number, j, by_round[j]))
    worst.sort(reverse=True)
    return [
        _explain_round(search, sequences[number], j, pose, rounds[number][j][0], allowed)
        for allowed, number, j, pose in worst[:_MAX_LISTED]
    ]


def _explain_round(
    search: SequenceSearch,
    sequence: ContactSequence,
    j: int,
    pose: int,
    stance: State,
    factor: float,
) -> Conflict:
    """Explain one round, such as "LF on 'brick front' would need mu 0.62 and has 0.50"."""
    scene, tables = search.scene, search.tables
    names = scene.robot.limb_names
    moves = sequence.moves
    limbs = " ".join(names[i] for i in np.flatnonzero(moves[j]))
    where = f"{format_sequence(moves, names)}: round {j + 1}, {limbs} lifted"
    row: IntArray = np.array(stance, np.int64)
    if factor <= 0 and not is_balanced(tables, row, pose):
        standing = " ".join(names[i] for i in np.flatnonzero(~moves[j]))
        min_load_text = f"each pressing with {100 * scene.spec.search.min_load:.3g} % of the weight"
        text = (
            f"the body does not balance on {standing}, {min_load_text} (`search.min_load`) or more"
        )
        return Conflict(where, (text,), _suggest_shift(scene) if j == 0 else (), in_words=True)
    reasons, remedies = _explain_torque(scene, find_max_torque_factor(tables, row, pose))
    if factor <= 0:
        limits = tuple(reasons) or ("torque limits of the limbs that stay",)
        return Conflict(where, limits, tuple(remedies), in_words=bool(reasons))
    required = scene.spec.force.safety_friction
    slips = find_slipping_contacts(tables, row, pose, factor)
    for slip in slips[:3]:
        surface = _get_surface_name(tables, slip.limb, row)
        reasons.append(
            f"{names[slip.limb]} slips on {surface!r}: it needs mu {slip.needed:.2f}, "
            f"and has {slip.available:.2f} / S_mu {required:g} = {slip.available / required:.2f}"
        )
    if factor >= 1:
        safety = float(np.floor(1e2 * factor)) / 1e2
        remedies.append(Remedy(f"S_mu <= {safety:g}", "force.safety_friction", safety))
    remedies += _suggest_friction(
        scene, {_get_surface_name(tables, s.limb, row) for s in slips}, required / factor
    )
    remedies.append(Remedy(f"friction {np.ceil(1e2 * required / factor) / 1e2:.2f} times as high"))
    return Conflict(where, tuple(reasons) or ("friction",), tuple(remedies), in_words=bool(reasons))


def _explain_torque(scene: TransitionScene, max_factor: float) -> tuple[list[str], list[Remedy]]:
    """Explain insufficient torque; max_factor: the largest S_tau with the spec's friction."""
    required = scene.spec.force.safety_torque
    if not 0 < max_factor < required:
        return [], []
    text = (
        f"motors would have S_tau {max_factor:.3g} at the given friction, {required:g} is required"
    )
    if max_factor < 1:
        scale_text = f"{np.ceil(1e2 * required / max_factor) / 1e2:.2f} times the torque limits"
        return [text], [Remedy(scale_text)]
    value = float(np.floor(1e2 * max_factor) / 1e2)
    return [text], [Remedy(f"S_tau <= {value:g}", "force.safety_torque", value)]


def _suggest_shift(scene: TransitionScene) -> tuple[Remedy, ...]:
    """Suggest a shift of the body over the standing limbs before the first lift."""
    distance = np.linalg.norm((scene.start.toes - scene.start.com)[:, :2], axis=1).max()
    value = float(np.ceil(1e2 * _SHIFT_FRACTION * distance) / 1e2)
    if scene.spec.posture.steps.com_shift_max >= value:
        return ()
    text = f"a body that shifts by up to {1e3 * value:.0f} mm before the first lift"
    return (Remedy(text, "posture.steps.com_shift_max", value),)


def _get_surface_name(tables: SearchTables, limb: int, stance: IntArray) -> str:
    return tables.scene.terrain.surfaces[tables.footholds.region[limb, stance[limb]]].name


def _suggest_friction(
    scene: TransitionScene, surfaces: set[str], factor: float
) -> Iterator[Remedy]:
    """Suggest more friction where limbs slip: of boxes with their own, and of the terrain."""
    terrain = scene.spec.terrain
    boxes = {f"terrain.boxes.{k}.friction": box for k, box in enumerate(terrain.boxes)}
    friction_by_key = {
        key: box.friction
        for key, box in boxes.items()
        if box.friction is not None and box.name in surfaces
    }
    if surfaces - {box.name for box in boxes.values() if box.friction is not None}:
        friction_by_key["terrain.friction"] = terrain.friction
    for key, friction in friction_by_key.items():
        value = float(np.ceil(1e3 * factor * friction)) / 1e3
        yield Remedy(f"mu of {value:g}", key, value)
