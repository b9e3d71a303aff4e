"""Which error to raise where bounds exclude every behaviour, and whether that is a proof.

The search knows arms in short chains, throws, relatching and quadrupeds, in sequence. That none of
these succeeds proves nothing about other behaviours. The following necessary conditions are proofs,
for a box that stays upright and turns about the vertical only where its goal asks for it:

- Force: each module holds the box with one end, and carries at most what its latch holds.
- Moment: a single latch is off the centre of the box and holds at most its moment. With less than
  the required moment, the box falls from rest at once, and it stands on the ground.
- Reach: a standing box is moved by four legs, or by chains that hang on anchors and hold the box
  where it stands. All chains together use at most the modules of the scene and bear its moment. The
  moment is largest for one latch alone, smaller for two on adjacent sides, zero for two on opposite
  sides.
- Path: the box fits through no passage from its start to its goal. For a box with a yaw, the
  cylinder inscribed at any yaw does not fit either.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import floor, hypot

from climbplan.errors import Conflict, Infeasible, NoPlanFound, Remedy, Unresolved
from climbplan.limms.scene.bounds import anchor_wrist, joint_distance, max_chain_span, side_wrist
from climbplan.limms.scene.corridor import decompose_relaxed_free_space, find_corridor
from climbplan.limms.scene.limms_scene import ModuleScene

BEHAVIOURS = (
    "looked at are arms in chains of up to two, throws, relatching and quadrupeds, in plans of "
    "several subtasks, with a box that stays upright"
)


def build_failure(scene: ModuleScene, conflicts: Sequence[Conflict]) -> NoPlanFound:
    """Return the error for a scene in which each behaviour is excluded."""
    return prove_infeasible(scene, conflicts) or Unresolved(
        "each behaviour that the search knows is ruled out",
        conflicts,
        because=BEHAVIOURS,
        stage="modes",
    )


def prove_infeasible(scene: ModuleScene, conflicts: Sequence[Conflict]) -> Infeasible | None:
    """Return the proof that no plan exists for the first box of the scene, or None without one."""
    if is_too_weak(scene):
        return Infeasible("no plan exists: the modules are too weak", conflicts, stage="modes")
    if find_corridor(decompose_relaxed_free_space(scene), scene.box_start[0], scene.goal) is None:
        return Infeasible("no plan exists: there is no way for the box", conflicts, stage="modes")
    for reason, evidence in (
        ("a latch holds too little", prove_latch_too_weak(scene)),
        ("no module reaches the box", prove_out_of_reach(scene)),
        ("too few modules reach the box", prove_unliftable(scene)),
    ):
        if evidence:
            return Infeasible(f"no plan exists: {reason}", evidence, stage="modes")
    return None


def is_too_weak(scene: ModuleScene) -> bool:
    """Return whether all latches that fit on the box together hold less than its weight.

    From rest to rest the forces carry the weight on average, with or without a flight.
    """
    return _count_contacts(scene) * scene.module.max_force < scene.weight


def _count_contacts(scene: ModuleScene) -> int:
    """Return how many ends can hold the box together; arms need one anchor each."""
    return (
        min(scene.num_modules, scene.num_wall_anchors)
        if _excludes_quadruped(scene)
        else scene.num_modules
    )


def _excludes_quadruped(scene: ModuleScene) -> bool:
    """Return whether a quadruped is impossible: it takes four modules."""
    return "quadruped" not in scene.allow or scene.num_modules < 4


def prove_latch_too_weak(scene: ModuleScene) -> tuple[Conflict, ...]:
    """Return why the only possible latch cannot lift the box; empty if it can or there are more."""
    lever = float(scene.box_size[0, :2].min()) / 2
    needed, capacity = lever * scene.weight, scene.module.latch_moment
    if _count_contacts(scene) != 1 or needed <= capacity:
        return ()
    reason = (
        f"one latch holds {capacity:g} N m, {needed:.2f} N m needed: {scene.weight:.1f} N at "
        f"{1e3 * lever:.0f} mm from the middle of the box, and no second module shares them"
    )
    heaviest = floor(1e2 * scene.box_mass[0] * capacity / needed) / 1e2
    remedies = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),) if heaviest else ()
    return (Conflict("arms", (reason,), remedies, in_words=True, enough=False),)


def prove_out_of_reach(scene: ModuleScene) -> tuple[Conflict, ...]:
    """Return why no chain of all modules spans to the box at its start; empty if one does."""
    if not _excludes_quadruped(scene):
        return ()
    start, max_span = scene.start_placement, max_chain_span(scene, scene.num_modules)
    distances = [
        (joint_distance(anchor_wrist(scene, root), side_wrist(scene, side, start)), root)
        for root in range(scene.num_wall_anchors)
        for side in range(4)
    ]
    if not distances:
        reason = "there is no anchor, and a quadruped takes 4 modules"
        return (Conflict("arms", (reason,), in_words=True),)
    nearest, root = min(distances)
    if nearest <= max_span:
        return ()
    name = scene.anchor_names[scene.wall_offset + root]
    reason = (
        f"all {scene.num_modules} modules, stretched out, span {max_span:.2f} m between their "
        f"outer wrists, from the nearest anchor ({name}) to the box at its start it is "
        f"{nearest:.2f} m"
    )
    return (Conflict("arms", (reason,), in_words=True),)


def prove_unliftable(scene: ModuleScene) -> tuple[Conflict, ...]:
    """Return why chains that reach the box at its start cannot hold it; empty if some can.

    Two of any three sides are opposite, so single chains and pairs are enough to test. Latches
    share a moment evenly, as in the model.
    """
    if not _excludes_quadruped(scene):
        return ()
    half, start = scene.box_size[0, :2] / 2, scene.start_placement
    lever = (half[0], half[0], half[1], half[1])  # of sides +x, -x, +y, -y
    adjacent_lever = half[0] * half[1] / hypot(*half) / 2
    chains = [
        (root, side, links)
        for root in range(scene.num_wall_anchors)
        for side in range(4)
        for links in range(1, scene.num_modules + 1)
        if joint_distance(anchor_wrist(scene, root), side_wrist(scene, side, start))
        <= max_chain_span(scene, links)
    ]
    needed = [lever[side] * scene.weight for _, side, _ in chains]
    for first, second in combinations(chains, 2):
        if (
            first[0] != second[0]
            and first[1] != second[1]
            and first[2] + second[2] <= scene.num_modules
        ):
            is_opposite = first[1] // 2 == second[1] // 2
            needed.append(0.0 if is_opposite else adjacent_lever * scene.weight)
    capacity = scene.module.latch_moment
    if not needed or min(needed) <= capacity:
        return ()
    reason = (
        f"chains of {scene.num_modules} modules in all that reach the box at its start leave "
        f"{min(needed):.2f} N m to a latch, which holds {capacity:g} N m"
    )
    return (Conflict("arms", (reason,), in_words=True),)
