"""What to raise where bounds rule every behaviour out, and whether that is a proof.

The search knows arms in short chains, throws, relatching and quadrupeds, one after the other. That
none of these can do it proves nothing about what else modules might do. These do prove it, for a
box that stays upright, and turns about the vertical only where its goal asks for it:

- Force: each module holds the box with one end, and carries no more than its latch holds.
- Moment: a single latch is off the middle of the box, and holds no more than its moment. With less
  than the weight the box falls from rest at once, and it stands on the ground.
- Reach: a box that stands is moved by four legs, or by chains of modules that hang on anchors and
  hold the box where it stands. All of them together are no longer than there are modules, and hold
  its moment: one latch alone, two beside each other with less, two opposite ones with none at all.
- Way: the box fits through nothing that joins its start to its goal; of one that turns or stands
  turned, not even the cylinder that is in it however it turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import floor, hypot

from climbplan.errors import Conflict, Infeasible, NoPlanFound, NotProved, Remedy
from climbplan.limms.scene.bounds import anchor_wrist, chain_stretch, side_wrist, span
from climbplan.limms.scene.corridor import inner_blocks, ways
from climbplan.limms.scene.limms_scene import Scene

BEHAVIOURS = (
    "looked at are arms in chains of up to two, throws, relatching and quadrupeds, in courses of "
    "several legs, with a box that stays upright"
)


def ruled_out(scene: Scene, conflicts: Sequence[Conflict]) -> NoPlanFound:
    """The error for a scene in which each behaviour is ruled out."""
    return proof(scene, conflicts) or NotProved(
        "each behaviour that the search knows is ruled out",
        conflicts,
        because=BEHAVIOURS,
        stage="modes",
    )


def proof(scene: Scene, conflicts: Sequence[Conflict]) -> Infeasible | None:
    """Why no plan whatever exists for the scene's first box, if that is proved."""
    if too_weak(scene):
        return Infeasible("no plan exists: the modules are too weak", conflicts, stage="modes")
    if ways(inner_blocks(scene), scene.box_start[0], scene.goal) is None:
        return Infeasible("no plan exists: there is no way for the box", conflicts, stage="modes")
    for reason, found in (
        ("a latch holds too little", one_latch_too_weak(scene)),
        ("no module reaches the box", out_of_reach(scene)),
        ("too few modules reach the box", unliftable(scene)),
    ):
        if found:
            return Infeasible(f"no plan exists: {reason}", found, stage="modes")
    return None


def too_weak(scene: Scene) -> bool:
    """Whether all latches that can be on the box together hold less than its weight.

    From rest to rest forces carry the weight on average, with or without a flight.
    """
    return _contacts(scene) * scene.module.max_force < scene.weight


def _contacts(scene: Scene) -> int:
    """Ends that can be on the box together; as arms only, each needs an anchor of its own."""
    return min(scene.count, scene.walls) if _as_arms_only(scene) else scene.count


def _as_arms_only(scene: Scene) -> bool:
    """Whether a quadruped is out of the question: it takes four modules."""
    return "quadruped" not in scene.allow or scene.count < 4


def one_latch_too_weak(scene: Scene) -> tuple[Conflict, ...]:
    """Why a single latch cannot lift the box, if there is but one and it cannot."""
    lever = float(scene.box_size[0, :2].min()) / 2
    needed, held = lever * scene.weight, scene.module.latch_moment
    if _contacts(scene) != 1 or needed <= held:
        return ()
    words = (
        f"one latch holds {held:g} N m, {needed:.2f} N m needed: {scene.weight:.1f} N at "
        f"{1e3 * lever:.0f} mm from the middle of the box, and no second module shares them"
    )
    heaviest = floor(1e2 * scene.box_mass[0] * held / needed) / 1e2
    cures = (Remedy(f"box.mass <= {heaviest:.2f} kg", "box.mass", heaviest),) if heaviest else ()
    return (Conflict("arms", (words,), cures, in_words=True, enough=False),)


def out_of_reach(scene: Scene) -> tuple[Conflict, ...]:
    """Why nothing can move the box from its start, if no chain of all modules spans to it."""
    if not _as_arms_only(scene):
        return ()
    start, stretch = scene.start_place, chain_stretch(scene, scene.count)
    apart = [
        (span(anchor_wrist(scene, root), side_wrist(scene, side, start)), root)
        for root in range(scene.walls)
        for side in range(4)
    ]
    if not apart:
        words = "there is no anchor, and a quadruped takes 4 modules"
        return (Conflict("arms", (words,), in_words=True),)
    nearest, root = min(apart)
    if nearest <= stretch:
        return ()
    name = scene.anchor_names[scene.wall_offset + root]
    words = (
        f"all {scene.count} modules, stretched out, span {stretch:.2f} m between their outer "
        f"wrists, from the nearest anchor ({name}) to the box at its start it is {nearest:.2f} m"
    )
    return (Conflict("arms", (words,), in_words=True),)


def unliftable(scene: Scene) -> tuple[Conflict, ...]:
    """Why no chains that reach the box at its start together can hold it up, if none can.

    Of three sides two are opposite to each other, so that single chains and pairs are enough to
    look at. Latches share a moment evenly, as the model has it.
    """
    if not _as_arms_only(scene):
        return ()
    half, start = scene.box_size[0, :2] / 2, scene.start_place
    lever = (half[0], half[0], half[1], half[1])  # of sides +x, -x, +y, -y
    beside = half[0] * half[1] / hypot(*half) / 2
    chains = [
        (root, side, links)
        for root in range(scene.walls)
        for side in range(4)
        for links in range(1, scene.count + 1)
        if span(anchor_wrist(scene, root), side_wrist(scene, side, start))
        <= chain_stretch(scene, links)
    ]
    needed = [lever[side] * scene.weight for _, side, _ in chains]
    for one, other in combinations(chains, 2):
        if one[0] != other[0] and one[1] != other[1] and one[2] + other[2] <= scene.count:
            is_opposite = one[1] // 2 == other[1] // 2
            needed.append(0.0 if is_opposite else beside * scene.weight)
    held = scene.module.latch_moment
    if not needed or min(needed) <= held:
        return ()
    words = (
        f"chains of {scene.count} modules in all that reach the box at its start leave "
        f"{min(needed):.2f} N m to a latch, which holds {held:g} N m"
    )
    return (Conflict("arms", (words,), in_words=True),)
