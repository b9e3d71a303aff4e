"""What to raise where bounds rule every behaviour out, and whether that is a proof.

The search knows arms in short chains, throws, relatching, relays and quadrupeds. That none of these
can do it proves nothing about what else modules might do. These do prove it, for a box that does
not turn, as the model has it:

- Force: each module holds the box with one end, and carries no more than its latch holds.
- Moment: a single latch is off the middle of the box, and holds no more than its moment. With less
  than the weight the box falls from rest at once, and it stands on the ground.
- Reach: a box that stands is moved by four legs, or by a chain of modules that hangs on an anchor
  and holds the box where it stands.
- Way: the box fits through nothing that joins its start to its goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor

from climbplan.errors import Conflict, Infeasible, NoPlanFound, NotProved, Remedy
from climbplan.limms.bounds import anchor_wrist, chain_stretch, side_wrist, span
from climbplan.limms.corridor import centre_blocks, ways
from climbplan.limms.scene import Scene

BEHAVIOURS = (
    "looked at are arms in chains of up to two, throws, relatching, relays and quadrupeds, with a "
    "box that does not turn"
)


def ruled_out(scene: Scene, conflicts: Sequence[Conflict]) -> NoPlanFound:
    """The error for a scene in which each behaviour is ruled out."""
    if too_weak(scene):
        return Infeasible("no plan exists: the modules are too weak", conflicts, stage="modes")
    if ways(centre_blocks(scene), scene.box_start[0], scene.goal) is None:
        return Infeasible("no plan exists: there is no way for the box", conflicts, stage="modes")
    for reason, found in (
        ("a latch holds too little", one_latch_too_weak(scene)),
        ("no module reaches the box", out_of_reach(scene)),
    ):
        if found:
            return Infeasible(f"no plan exists: {reason}", found, stage="modes")
    return NotProved(
        "each behaviour that the search knows is ruled out",
        conflicts,
        because=BEHAVIOURS,
        stage="modes",
    )


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
    start, stretch = scene.box_start[0], chain_stretch(scene, scene.count)
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
