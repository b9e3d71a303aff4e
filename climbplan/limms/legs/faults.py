"""What is wrong with an answer between its knots, as samples and cuts for the next program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.motion import LegMotion
from climbplan.limms.legs.statement import BoxCut, LegCut, LegSample, LegTrace
from climbplan.limms.modules.contact import LINKS, gap_between, gap_to_blocks, link_segments
from climbplan.limms.modules.distances import block_gap
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb

GROUND_MARGIN = 0.006  # [m] beyond the radius
FOOT_MARGIN = 0.0005  # [m] of feet, which stand on the ground before and after
BOX_TOUCH = -5e-5  # [m], of the box
BOX_MARGIN = 0.005  # [m]
TOUCH = -5e-5  # [m] gap below which links collide
BENDS = (1, 2, 4)  # joints that are no rolls
PARTS = 6  # of a phase in which one fault each is looked at
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class Faults:
    """Samples and cuts that rule the faults out, and the worst of each kind in words."""

    samples: tuple[LegSample, ...]
    cuts: tuple[LegCut | BoxCut, ...]
    words: tuple[str, ...]


def faults_of(
    scene: Scene, limbs: Sequence[Limb], number: int, trace: LegTrace, motion: LegMotion
) -> Faults:
    """All faults of phase `number`."""
    samples, words = _standing(scene, limbs, number, trace, motion)
    cuts, more = _collisions(scene, limbs, number, trace, motion)
    box = _box_cuts(scene, number, trace, motion)
    if box:
        words.append(f"{trace.phase.name}: the box is in something")
    return Faults(tuple(samples), (*cuts, *box), (*words, *more))


def _worst_each(trace: LegTrace, time: Array, badness: Array, limit: float) -> list[int]:
    """Indices of the worst instants, one for each part of the phase where it is over."""
    count = PARTS
    k = np.clip((time / trace.duration * count).astype(int), 0, count - 1)
    found = []
    for interval in range(count):
        at = np.flatnonzero(k == interval)
        if len(at) and badness[at].max() > limit:
            found.append(int(at[np.argmax(badness[at])]))
    return found


def _standing(
    scene: Scene, limbs: Sequence[Limb], number: int, trace: LegTrace, motion: LegMotion
) -> tuple[list[LegSample], list[str]]:
    module = scene.module
    samples, words = [], []
    for i in range(len(limbs)):
        if i in trace.phase.swing:
            continue
        bends = np.abs(motion.angles[:, i, BENDS]) - np.array(module.joint_range)[list(BENDS)]
        fast = np.abs(motion.rates[:, i]).max(axis=1) / module.max_joint_speed - 1.0
        bad = np.maximum.reduce([bends.max(axis=1), fast, 10 * motion.missing[:, i] - 1e-9])
        for at in _worst_each(trace, motion.time, bad, 0.0):
            samples.append(LegSample(number, float(motion.time[at] / trace.duration), i))
        if bad.max() > 0:
            words.append(
                f"{trace.phase.name}: leg {i} {1e3 * motion.missing[:, i].max():.1f} mm out of "
                f"reach, {bends.max():.3f} rad out of range, {1 + fast.max():.2f} of its speed"
            )
    return samples, words


def _collisions(
    scene: Scene, limbs: Sequence[Limb], number: int, trace: LegTrace, motion: LegMotion
) -> tuple[list[LegCut], list[str]]:
    radius, half = scene.module.radius, scene.box_size[0] / 2
    centre = motion.box.position
    fixed = obstacles(scene)
    segments = [link_segments(p, radius) for p in motion.points]
    cuts: list[LegCut] = []
    words: list[str] = []
    share = motion.time / trace.duration
    for i in range(len(limbs)):
        gap = gap_to_blocks(segments[i], fixed[:, 0], fixed[:, 1], radius)  # (n, 4, S)
        worst = gap.min()
        for link in range(4):
            for s in range(len(fixed)):
                for at in _worst_each(trace, motion.time, -gap[:, link, s], -TOUCH):
                    ends = segments[i][at, link]
                    cuts += _block_cuts(number, float(share[at]), i, link, ends, fixed[s], radius)
        low, high = (centre - half)[:, None], (centre + half)[:, None]
        own = gap_to_blocks(segments[i], low, high, radius)[..., 0]
        worst = min(worst, own.min())
        for link in range(4):
            for at in _worst_each(trace, motion.time, -own[:, link], -TOUCH):
                ends = segments[i][at, link] - centre[at]
                block = np.array([-half, half])
                cuts += _block_cuts(
                    number, float(share[at]), i, link, ends, block, radius, with_box=True
                )
        if worst < TOUCH:
            words.append(
                f"{trace.phase.name}: leg {i} reaches {-1e3 * worst:.1f} mm into something"
            )
        for j in range(i):
            between = gap_between(segments[i], segments[j], radius)  # (n, 4, 4)
            for a, b in np.argwhere(between.min(axis=0) < TOUCH):
                for at in _worst_each(trace, motion.time, -between[:, a, b], -TOUCH):
                    here = segments[i][at, a] - centre[at], segments[j][at, b] - centre[at]
                    cuts += _pair_cuts(
                        number, float(share[at]), ((i, int(a)), (j, int(b))), here, radius
                    )
            if between.min() < TOUCH:
                words.append(
                    f"{trace.phase.name}: legs {j} and {i} reach {-1e3 * between.min():.1f} mm "
                    "into each other"
                )
    return cuts, words


def _box_cuts(scene: Scene, number: int, trace: LegTrace, motion: LegMotion) -> list[BoxCut]:
    """Keep the box beyond the face of a solid that it is nearest to leave by."""
    half = scene.box_size[0] / 2
    cuts = []
    for low, high in obstacles(scene):
        gap = block_gap(motion.box.position, half, low, high)
        for at in _worst_each(trace, motion.time, -gap, -BOX_TOUCH):
            grown = np.concatenate([high + half, half - low])
            face = int(np.argmax(_NORMALS @ motion.box.position[at] - grown))
            share = float(motion.time[at] / trace.duration)
            cuts.append(BoxCut(number, share, _NORMALS[face], float(grown[face]) + BOX_MARGIN))
    return cuts


def obstacles(scene: Scene) -> Array:
    """Blocks (S, 2, 3) that stand still: solids and parked boxes."""
    if scene.num_boxes == 1:
        return scene.solids
    half, centres = scene.box_size[1:] / 2, scene.box_start[1:]
    return np.concatenate([scene.solids, np.stack([centres - half, centres + half], axis=1)])


def _cuttable(point: int) -> bool:
    """Latched ends are where they are."""
    return point != 7


def _block_cuts(
    phase: int,
    share: float,
    limb: int,
    link: int,
    ends: Array,
    block: Array,
    radius: float,
    with_box: bool = False,
) -> list[LegCut]:
    """Keep both ends of a link beyond the face of a block that it is nearest to leave by."""
    faces = np.concatenate([block[1], -block[0]])
    ahead = (_NORMALS @ ends.T).min(axis=1) - faces  # of the worse end, beyond each face
    face = int(np.argmax(ahead))
    offset = float(faces[face] + radius)
    return [
        LegCut(
            phase,
            share,
            limb,
            point,
            _NORMALS[face],
            offset + (GROUND_MARGIN if point else FOOT_MARGIN),
            with_box,
        )
        for point in LINKS[link]
        if _cuttable(point)
    ]


def _pair_cuts(
    phase: int,
    share: float,
    pair: tuple[tuple[int, int], tuple[int, int]],
    ends: tuple[Array, Array],
    radius: float,
) -> list[LegCut]:
    """A plane, moving with the box, between two links (limb, link) of different legs."""
    (one, other), (a, b) = pair, ends
    normal = a.mean(axis=0) - b.mean(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    middle = float(((a @ normal).min() + (b @ normal).max()) / 2)
    away = radius + GROUND_MARGIN / 2
    cuts = []
    for (limb, link), sign in ((one, 1.0), (other, -1.0)):
        cuts += [
            LegCut(phase, share, limb, point, sign * normal, sign * middle + away, True)
            for point in LINKS[link]
            if _cuttable(point)
        ]
    return cuts
