"""The nonlinear block, eq. (6.12b): all knots, each by itself."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.copies import Copy, Modes
from climbplan.limms.consensus.knot_modes import Hands, hands_at
from climbplan.limms.consensus.knot_program import KnotPrograms, Pose, Solved
from climbplan.limms.consensus.knot_start import start_at
from climbplan.limms.consensus.planes import planes_at
from climbplan.limms.consensus.setting import CHAIN_POINTS, POINTS, STABLE, Setting, start_points
from climbplan.limms.modules.chain import forward, from_last
from climbplan.limms.scene.limms_scene import Points
from climbplan.limms.scene.limms_scene import Pose as Frame

BOX_WEIGHT, POINT_WEIGHT = 10.0, 1.0  # [1/m^2] of disagreements
DEEP = 1e-4  # [m] penetration that calls for new planes
HELD_WITHIN = 1e-4  # [m] an answer that is off by more is begun anew
CLOSE = 0.05  # [m] from targets in the mean: an answer that is further off is begun anew, too
INSIDE = 1e-3  # [m] by which a link may stick out of its free block and keep it
ROUNDS = 3
_ANYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])  # free blocks are the other block's alone


@dataclass(frozen=True)
class Bent:
    """An answer of the block: positions, joint angles (K + 1, L, 6), and what is left over."""

    copy: Copy
    angles: Array
    region: IntArray  # (K + 1, L, 4) free block of each link
    violation: float  # of latches and bounds, the worst knot [m]
    penetration: float  # of links, the worst knot [m]
    seconds: float


@dataclass(frozen=True)
class _Target:
    """Of one knot: box (3,), points (L, 5, 3) [m], and whether the box rests where it starts."""

    box: Array
    points: Array
    rests: bool


@dataclass(frozen=True)
class _Knot:
    """An answer at a knot, how deep links are in each other [m], and their free blocks (L, 4)."""

    solved: Solved
    penetration: float
    region: IntArray
    away: float  # of points from their targets, the mean [m]

    @property
    def holds(self) -> bool:
        """Whether latches hold and links are apart."""
        return self.off() <= HELD_WITHIN

    def off(self) -> float:
        """By how much they do not [m]."""
        return max(self.solved.violation, self.penetration)

    def rank(self) -> tuple[float, float]:
        """Smaller is better: what holds, then what is near."""
        return (0.0 if self.holds else self.off(), self.away)


class Nonlinear:
    """The block of one setting; remembers joint angles to begin from."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.programs = KnotPrograms(setting)
        self._poses: list[Pose | None] = [None] * setting.knots
        self.solves = 0

    def solve(self, target: Copy, modes: Modes, deadline: float) -> Bent:
        """The nearest kinematics to a target, with the modes as chosen.

        deadline: `time.monotonic` [s], after which no knot is begun: the violation is infinite.
        """
        began = time.perf_counter()
        built = self.programs.build_seconds
        setting = self.setting
        K, L = setting.knots, setting.scene.count
        box, points = np.zeros((K, 3)), np.zeros((K, L, POINTS, 3))
        angles, region = np.zeros((K, L, 6)), modes.region.copy()
        box[0], points[0] = setting.scene.box_start[0], start_points(setting)
        poses: list[Pose | None] = [None] * K
        worst, deep = 0.0, 0.0
        for knot in range(1, K):
            if time.monotonic() > deadline:
                box[knot:], points[knot:] = target.box[knot:], target.points[knot:]
                worst = np.inf
                break
            hands = hands_at(setting, modes, knot)
            before = [poses[knot - 1], self._poses[knot]]
            rests = modes.box[knot - 1] == STABLE
            found = self._knot(
                hands,
                _Target(box[0] if rests else target.box[knot], target.points[knot], rests),
                [pose for pose in before if pose is not None],
                modes.region[knot],
                deadline,
            )
            poses[knot] = found.solved.pose
            box[knot], points[knot] = found.solved.pose.box, found.solved.points
            angles[knot], region[knot] = found.solved.pose.angles, found.region
            worst, deep = max(worst, found.solved.violation), max(deep, found.penetration)
        self._poses = poses
        spent = time.perf_counter() - began - (self.programs.build_seconds - built)
        return Bent(Copy(box, points), angles, region, worst, deep, spent)

    def _knot(
        self,
        hands: tuple[Hands, ...],
        target: _Target,
        before: Sequence[Pose],
        region: IntArray,
        deadline: float,
    ) -> _Knot:
        """The nearest pose to the targets; begun anew where latches do not hold or links overlap.

        before: poses of the knot before and of the last iterate, whose angles are candidates in
        the first start, and which are whole starts if that one fails.
        """
        setting = self.setting
        earlier = [
            np.array([pose.angles[m] for pose in before]).reshape(-1, 6) for m in range(len(hands))
        ]
        pose, placed = start_at(setting, hands, target.box, target.points, earlier)
        found = self._from(hands, target, pose, placed, region, deadline)
        for other in before:
            if found.holds and found.away <= CLOSE:
                break
            pose = Pose(target.box, other.root, other.angles)
            placed = placed_at(setting, hands, pose)
            again = self._from(hands, target, pose, placed, region, deadline)
            found = min(found, again, key=_Knot.rank)
        return found

    def _from(
        self,
        hands: tuple[Hands, ...],
        target: _Target,
        pose: Pose,
        placed: Sequence[Points],
        region: IntArray,
        deadline: float,
    ) -> _Knot:
        setting = self.setting
        planes, _ = planes_at(setting, hands, placed, pose.box)
        blocks = _ANYWHERE
        if setting.form.follow:
            region = region_at(setting, placed, region)
            blocks = setting.free[region]
        blocks = np.broadcast_to(blocks, (*region.shape, 2, 3))
        for _ in range(ROUNDS):
            solved = self.programs.solve(
                hands,
                pose,
                target.box,
                target.points,
                (BOX_WEIGHT, POINT_WEIGHT),
                planes,
                blocks,
                target.rests,
                deadline,
            )
            self.solves += 1
            placed = placed_at(setting, hands, solved.pose)
            fresh, penetration = planes_at(setting, hands, placed, solved.pose.box)
            if penetration <= DEEP:
                break
            pose, planes = solved.pose, fresh
        away = np.linalg.norm(solved.points - target.points, axis=-1)
        return _Knot(solved, penetration, region, float(away.mean()))


def region_at(setting: Setting, placed: Sequence[Points], before: IntArray) -> IntArray:
    """Free blocks (L, 4) of the links of poses: as before where they are in them, else nearest.

    A block that was chosen for straight lines between loose points may hold no pose at all.
    """
    radius = setting.scene.module.radius
    points = np.array([own.position[list(CHAIN_POINTS)] for own in placed])[:, :, None]
    margin = radius * np.array([0.0, 1.0, 1.0, 1.0, 0.0])[:, None, None]
    low, high = setting.free[:, 0] + margin, setting.free[:, 1] - margin  # (5, R, 3)
    off = np.maximum(np.maximum(low - points, points - high), 0).max(axis=-1)  # (L, 5, R)
    off = np.maximum(off[:, :-1], off[:, 1:])
    kept = np.take_along_axis(off, before[..., None], axis=-1)[..., 0] <= INSIDE
    return np.where(kept, before, off.argmin(axis=-1))


def placed_at(setting: Setting, hands: tuple[Hands, ...], pose: Pose) -> list[Points]:
    """All points of all modules of a pose."""
    placed: dict[int, Points] = {}
    for m in sorted(range(len(hands)), key=lambda m: hands[m].parent >= 0):
        both = hands[m]
        end = both.ends[both.root]
        rotation = end.rotation
        if rotation is None:
            parent = placed[end.parent]
            there = 0 if setting.box_end[end.parent] == 0 else 7
            flip = np.eye(3) if there == 0 else np.diag([1.0, -1.0, -1.0])
            rotation = parent.rotation[there] @ flip
        place = forward if both.root == 0 else from_last
        placed[m] = place(setting.scene.module, Frame(pose.root[m], rotation), pose.angles[m])
    return [placed[m] for m in range(len(hands))]
