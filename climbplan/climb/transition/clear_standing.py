"""Where limbs may stand without meeting the terrain, the body or one another, for the search.

Of every limb on every foothold from every body pose: its links, as thick as they are, off all
solids and off the body. Of every two of them: their capsules apart. What is compared is as
in the checks `limbs.clearance`, `limbs.capsules` and `limbs.self_collision`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limb_pairs import body_room, standing_overlap
from climbplan.climb.clearance.limbs import closest_link, links_room, world_capsules
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.transition.scene import TransitionScene
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.touching_parts import limbs_room, parts_beside

_OVERLAP = 1e-6  # [m] that counts
_APART = 1e-3  # [m] that capsules keep from one another, from the body and from solids


@dataclass
class ClearStanding:
    """Limbs on footholds from poses, of joint angles (B, N, C, J), NaN where out of reach."""

    scene: TransitionScene
    links: tuple[Capsules, ...]  # by foothold: (B, N, K) in the body frame
    alone: BoolArray  # (B, N, C) whether a limb meets neither terrain nor body there
    _between: IntArray = field(repr=False)
    _known: dict[tuple[int, int, int, int], BoolArray] = field(default_factory=dict, repr=False)

    def apart(self, state: tuple[int, ...]) -> BoolArray:
        """(B,) whether no two limbs meet, each on a foothold or, at a number below zero, left out.

        True where a limb is out of reach.
        """
        clear = np.ones(len(self.alone), bool)
        for (i, c), (k, d) in itertools.combinations(enumerate(state), 2):
            if c < 0 or d < 0:
                continue
            known = self._known.get((i, c, k, d))
            if known is None:
                known = self._known[i, c, k, d] = self._two_apart(i, c, k, d)
            clear &= known
        return clear

    def _two_apart(self, i: int, c: int, k: int, d: int) -> BoolArray:
        own = self._between[(self._between[:, [0, 2]] == [i, k]).all(axis=1)]
        if not len(own):
            return np.ones(len(self.alone), bool)
        one, other = self.links[c], self.links[d]
        both = Capsules(
            np.stack([one.starts[:, i], other.starts[:, k]], axis=1),
            np.stack([one.ends[:, i], other.ends[:, k]], axis=1),
            np.stack([one.radius[i], other.radius[k]]),
            np.stack([one.link[i], other.link[k]]),
            np.stack([one.to_toe[i], other.to_toe[k]]),
        )
        pairs = own.copy()
        pairs[:, 0], pairs[:, 2] = 0, 1
        room = limbs_room(both, pairs).min(axis=-1)
        return np.asarray(np.isnan(room) | (room > _APART))


def clear_standing(scene: TransitionScene, com: Array, rpy: Array, angles: Array) -> ClearStanding:
    """The tables for poses (B, 3), (B, 3) and joint angles (B, N, C, J)."""
    robot, rotation = scene.robot, rotation_world_body(rpy)
    links = tuple(limb_capsules(robot, angles[:, :, c]) for c in range(angles.shape[2]))
    pairs, between = parts_beside(robot, links[0])
    alone = []
    for own in links:
        room = links_room(scene, own.moved(com, rotation), _APART)
        clear = _kept(room.min(axis=(-2, -1), initial=np.inf), _APART)
        off = body_room(robot, own, pairs)  # (B, P)
        for limb in range(robot.limb_count):
            rows = pairs[:, 0] == limb
            clear[:, limb] &= _kept(off[:, rows].min(axis=-1, initial=np.inf), _APART)
        alone.append(clear)
    return ClearStanding(scene, links, np.stack(alone, axis=2), between)


def standing_trouble(scene: TransitionScene, instants: Instants) -> str | None:
    """Where limbs meet the terrain, the body or one another at instants, in words; None if not."""
    robot = scene.robot
    pose = instants.com, instants.rpy, instants.toes, instants.normal
    nearest = closest_link(scene, world_capsules(scene, *pose))
    if nearest.distance < -_OVERLAP:
        k, limb = nearest.index
        where = instants.label(k, robot.limb_names)
        one = f"{robot.limb_names[limb]}'s {robot.joint_name(limb, nearest.link)}"
        name = scene.terrain.link_solids[nearest.solid].name
        return f"{where}, {one} would be {-1e3 * nearest.distance:.1f} mm deep in {name!r}"
    meets = standing_overlap(scene, instants)
    return None if meets is None else f"{meets[1]}, {meets[0].words(robot)}"


def _kept(room: Array, least: float) -> BoolArray:
    """Whether there is room; so it counts where nothing is known."""
    return np.asarray(np.isnan(room) | (room > least))
