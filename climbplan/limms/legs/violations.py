"""Violations of a solution between its knots, as samples and cuts for the next program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.leg_phases import BoxCut, LegCut, LegSample, LegTrajectory
from climbplan.limms.legs.motion import LegMotion
from climbplan.limms.modules.contact import LINKS, gap_between, gap_to_blocks, link_segments
from climbplan.limms.modules.distances import block_gap
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule

CUT_MARGIN = 0.006  # [m] of cuts, beyond the radius
FOOT_MARGIN = 0.0005  # [m] of cuts at feet, which stand before and after
BOX_TOUCH_TOLERANCE = -5e-5  # [m], of the box
BOX_MARGIN = 0.005  # [m]
TOUCH_TOLERANCE = -5e-5  # [m], smallest gap without collision
PITCH_JOINTS = (1, 2, 4)  # joints that are not rolls
NUM_PARTS = 6  # parts of a phase; the worst violation of each is used
_NORMALS = np.vstack([np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class MotionViolations:
    """Samples and cuts that exclude the violations, and a message for the worst of each kind."""

    samples: tuple[LegSample, ...]
    cuts: tuple[LegCut | BoxCut, ...]
    messages: tuple[str, ...]


def find_violations(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    phase: int,
    trajectory: LegTrajectory,
    motion: LegMotion,
) -> MotionViolations:
    """Return all violations of a phase."""
    samples, messages = _check_standing(scene, limbs, phase, trajectory, motion)
    cuts, collision_messages = _find_collisions(scene, limbs, phase, trajectory, motion)
    box_cuts = _build_box_cuts(scene, phase, trajectory, motion)
    if box_cuts:
        messages.append(f"{trajectory.phase.name}: the box is in something")
    return MotionViolations(tuple(samples), (*cuts, *box_cuts), (*messages, *collision_messages))


def _find_worst_instants(
    trajectory: LegTrajectory, time: Array, violation: Array, limit: float
) -> list[int]:
    """Return the indices of the worst instants, one for each part of the phase over the limit."""
    num_parts = NUM_PARTS
    part_of_instant = np.clip(
        (time / trajectory.duration * num_parts).astype(int), 0, num_parts - 1
    )
    worst = []
    for interval in range(num_parts):
        in_part = np.flatnonzero(part_of_instant == interval)
        if len(in_part) and violation[in_part].max() > limit:
            worst.append(int(in_part[np.argmax(violation[in_part])]))
    return worst


def _check_standing(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    phase: int,
    trajectory: LegTrajectory,
    motion: LegMotion,
) -> tuple[list[LegSample], list[str]]:
    """Return samples where standing legs exceed reach, ranges or speeds, with messages."""
    module = scene.module
    samples, messages = [], []
    for i in range(len(limbs)):
        if i in trajectory.phase.swing:
            continue
        range_excess = (
            np.abs(motion.angles[:, i, PITCH_JOINTS])
            - np.array(module.joint_range)[list(PITCH_JOINTS)]
        )
        speed_excess = np.abs(motion.rates[:, i]).max(axis=1) / module.max_joint_speed - 1.0
        violation = np.maximum.reduce(
            [range_excess.max(axis=1), speed_excess, 10 * motion.reach_error[:, i] - 1e-9]
        )
        for instant in _find_worst_instants(trajectory, motion.time, violation, 0.0):
            samples.append(LegSample(phase, float(motion.time[instant] / trajectory.duration), i))
        if violation.max() > 0:
            messages.append(
                f"{trajectory.phase.name}: leg {i} {1e3 * motion.reach_error[:, i].max():.1f} mm "
                f"out of reach, {range_excess.max():.3f} rad out of range, "
                f"{1 + speed_excess.max():.2f} of its speed"
            )
    return samples, messages


def _find_collisions(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    phase: int,
    trajectory: LegTrajectory,
    motion: LegMotion,
) -> tuple[list[LegCut], list[str]]:
    """Return cuts for links that collide, with messages."""
    radius, half = scene.module.radius, scene.box_size[0] / 2
    centre = motion.box.position
    blocks = collect_obstacles(scene)
    segments = [link_segments(p, radius) for p in motion.points]
    cuts: list[LegCut] = []
    messages: list[str] = []
    fraction = motion.time / trajectory.duration
    for i in range(len(limbs)):
        gap = gap_to_blocks(segments[i], blocks[:, 0], blocks[:, 1], radius)  # (n, 4, S)
        min_gap = gap.min()
        for link in range(4):
            for s in range(len(blocks)):
                for instant in _find_worst_instants(
                    trajectory, motion.time, -gap[:, link, s], -TOUCH_TOLERANCE
                ):
                    cuts += _build_block_cuts(
                        phase,
                        float(fraction[instant]),
                        limb=i,
                        link=link,
                        ends=segments[i][instant, link],
                        block=blocks[s],
                        radius=radius,
                    )
        low, high = (centre - half)[:, None], (centre + half)[:, None]
        box_gap = gap_to_blocks(segments[i], low, high, radius)[..., 0]
        min_gap = min(min_gap, box_gap.min())
        for link in range(4):
            for instant in _find_worst_instants(
                trajectory, motion.time, -box_gap[:, link], -TOUCH_TOLERANCE
            ):
                cuts += _build_block_cuts(
                    phase,
                    float(fraction[instant]),
                    limb=i,
                    link=link,
                    ends=segments[i][instant, link] - centre[instant],
                    block=np.array([-half, half]),
                    radius=radius,
                    with_box=True,
                )
        if min_gap < TOUCH_TOLERANCE:
            messages.append(
                f"{trajectory.phase.name}: leg {i} reaches {-1e3 * min_gap:.1f} mm into something"
            )
        for j in range(i):
            pair_cuts, pair_messages = _find_pair_collisions(
                phase, trajectory, motion, segments, (i, j), radius
            )
            cuts += pair_cuts
            messages += pair_messages
    return cuts, messages


def _find_pair_collisions(
    phase: int,
    trajectory: LegTrajectory,
    motion: LegMotion,
    segments: Sequence[Array],
    pair: tuple[int, int],
    radius: float,
) -> tuple[list[LegCut], list[str]]:
    """Return cuts for links of two legs that collide, with messages."""
    i, j = pair
    centre = motion.box.position
    cuts: list[LegCut] = []
    gap = gap_between(segments[i], segments[j], radius)  # (n, 4, 4)
    for a, b in np.argwhere(gap.min(axis=0) < TOUCH_TOLERANCE):
        for instant in _find_worst_instants(
            trajectory, motion.time, -gap[:, a, b], -TOUCH_TOLERANCE
        ):
            ends_of_links = (
                segments[i][instant, a] - centre[instant],
                segments[j][instant, b] - centre[instant],
            )
            fraction = float(motion.time[instant] / trajectory.duration)
            links = (i, int(a)), (j, int(b))
            cuts += _build_pair_cuts(phase, fraction, links, ends_of_links, radius)
    if not gap.min() < TOUCH_TOLERANCE:
        return cuts, []
    depth = -1e3 * gap.min()
    name = trajectory.phase.name
    return cuts, [f"{name}: legs {j} and {i} reach {depth:.1f} mm into each other"]


def _build_box_cuts(
    scene: ModuleScene, phase: int, trajectory: LegTrajectory, motion: LegMotion
) -> list[BoxCut]:
    """Return cuts that keep the box beyond the nearest face of a solid."""
    half = scene.box_size[0] / 2
    cuts = []
    for low, high in collect_obstacles(scene):
        gap = block_gap(motion.box.position, half, low, high)
        for instant in _find_worst_instants(trajectory, motion.time, -gap, -BOX_TOUCH_TOLERANCE):
            faces = np.concatenate([high + half, half - low])
            face = int(np.argmax(_NORMALS @ motion.box.position[instant] - faces))
            fraction = float(motion.time[instant] / trajectory.duration)
            cuts.append(BoxCut(phase, fraction, _NORMALS[face], float(faces[face]) + BOX_MARGIN))
    return cuts


def collect_obstacles(scene: ModuleScene) -> Array:
    """Return the blocks (S, 2, 3) that stand still: solids and static boxes."""
    if scene.num_boxes == 1:
        return scene.solids
    half, centres = scene.box_size[1:] / 2, scene.box_start[1:]
    return np.concatenate([scene.solids, np.stack([centres - half, centres + half], axis=1)])


def _is_cuttable(point: int) -> bool:
    """Return whether a point can move: latched ends cannot."""
    return point != 7


def _build_block_cuts(
    phase: int,
    fraction: float,
    *,
    limb: int,
    link: int,
    ends: Array,
    block: Array,
    radius: float,
    with_box: bool = False,
) -> list[LegCut]:
    """Return cuts that keep both ends of a link beyond the nearest face of a block."""
    faces = np.concatenate([block[1], -block[0]])
    face_distances = (_NORMALS @ ends.T).min(axis=1) - faces  # of the worse end beyond each face
    face = int(np.argmax(face_distances))
    offset = float(faces[face] + radius)
    return [
        LegCut(
            phase,
            fraction,
            limb,
            point,
            _NORMALS[face],
            offset + (CUT_MARGIN if point else FOOT_MARGIN),
            with_box,
        )
        for point in LINKS[link]
        if _is_cuttable(point)
    ]


def _build_pair_cuts(
    phase: int,
    fraction: float,
    pair: tuple[tuple[int, int], tuple[int, int]],
    ends: tuple[Array, Array],
    radius: float,
) -> list[LegCut]:
    """Return a plane, moving with the box, between two links (limb, link) of different legs."""
    (first, second), (a, b) = pair, ends
    normal = a.mean(axis=0) - b.mean(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    middle = float(((a @ normal).min() + (b @ normal).max()) / 2)
    clearance = radius + CUT_MARGIN / 2
    cuts = []
    for (limb, link), sign in ((first, 1.0), (second, -1.0)):
        cuts += [
            LegCut(phase, fraction, limb, point, sign * normal, sign * middle + clearance, True)
            for point in LINKS[link]
            if _is_cuttable(point)
        ]
    return cuts
