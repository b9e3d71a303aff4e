"""The nonlinear block, eq. (6.12b): all knots, each by itself."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.limms.consensus.copies import Copy, Modes
from climbplan.limms.consensus.knot_modes import Hands, hands_at
from climbplan.limms.consensus.knot_program import KnotPrograms, Pose, Solved
from climbplan.limms.consensus.knot_start import start_at
from climbplan.limms.consensus.planes import planes_at
from climbplan.limms.consensus.setting import POINTS, STABLE, Setting, start_points
from climbplan.limms.modules.chain import forward, from_last
from climbplan.limms.scene import Array, Points
from climbplan.limms.scene import Pose as Frame

BOX_WEIGHT, POINT_WEIGHT = 10.0, 1.0  # [1/m^2] of disagreements
DEEP = 1e-4  # [m] penetration that calls for new planes
ROUNDS = 3


@dataclass(frozen=True)
class Bent:
    """An answer of the block: positions, joint angles (K + 1, L, 6), and what is left over."""

    copy: Copy
    angles: Array
    violation: float  # of latches and bounds, the worst knot [m]
    penetration: float  # of links, the worst knot [m]
    seconds: float


class Nonlinear:
    """The block of one setting; remembers joint angles to begin from."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.programs = KnotPrograms(setting)
        self._angles: Array | None = None
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
        angles = np.zeros((K, L, 6))
        box[0], points[0] = setting.scene.box_start[0], start_points(setting)
        worst, deep = 0.0, 0.0
        for knot in range(1, K):
            if time.monotonic() > deadline:
                box[knot:], points[knot:] = target.box[knot:], target.points[knot:]
                worst = np.inf
                break
            hands = hands_at(setting, modes, knot)
            earlier = [
                np.array(
                    [
                        angles[knot - 1, m],
                        *([] if self._angles is None else [self._angles[knot, m]]),
                    ]
                )
                for m in range(L)
            ]
            rests = modes.box[knot - 1] == STABLE
            solved, penetration = self._knot(
                hands,
                box[0] if rests else target.box[knot],
                rests,
                target.points[knot],
                earlier,
                modes.region[knot],
                deadline,
            )
            box[knot], points[knot] = solved.pose.box, solved.points
            angles[knot] = solved.pose.angles
            worst, deep = max(worst, solved.violation), max(deep, penetration)
        self._angles = angles
        spent = time.perf_counter() - began - (self.programs.build_seconds - built)
        return Bent(Copy(box, points), angles, worst, deep, spent)

    def _knot(
        self,
        hands: tuple[Hands, ...],
        box: Array,
        rests: bool,
        points: Array,
        earlier: Sequence[Array | None],
        region: Array,
        deadline: float,
    ) -> tuple[Solved, float]:
        setting = self.setting
        pose, placed = start_at(setting, hands, box, points, earlier)
        planes, _ = planes_at(setting, hands, placed, box)
        blocks = setting.free[region]
        for _ in range(ROUNDS):
            solved = self.programs.solve(
                hands,
                pose,
                box,
                points,
                (BOX_WEIGHT, POINT_WEIGHT),
                planes,
                blocks,
                rests,
                deadline,
            )
            self.solves += 1
            placed = placed_at(setting, hands, solved.pose)
            fresh, penetration = planes_at(setting, hands, placed, solved.pose.box)
            if penetration <= DEEP:
                break
            pose, planes = solved.pose, fresh
        return solved, penetration


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
