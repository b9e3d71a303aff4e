"""The nonlinear block at one knot, eq. (6.12b): kinematics and collisions of all modules.

With dynamics and speeds in the other block, knots do not know of each other. One program is
compiled for each pattern of roots and used with other numbers from then on.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_modes import (
    FIXED,
    ON_BOX,
    ON_MODULE,
    ON_PATCH,
    Hands,
    patch_bounds,
)
from climbplan.limms.consensus.module_rows import AHEAD
from climbplan.limms.consensus.setting import CHAIN_POINTS, POINTS, Setting
from climbplan.limms.modules.chain_symbols import chain_function
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram

CUTS = 40  # planes between links that a program has room for
ITERATIONS = 60
STAY = 1e-5  # weight of squared changes of joint angles from the start
Pattern = tuple[tuple[int, int, bool], ...]  # root end, parent, whether the root is on it


@dataclass(frozen=True)
class Pose:
    """All modules at a knot: box (3,), first or last ends (L, 3) as rooted, angles (L, 6)."""

    box: Array
    root: Array
    angles: Array


@dataclass(frozen=True)
class Plane:
    """coefficients . (points of all modules, box) >= offset: a separating plane, eq. (6.4)."""

    coefficients: Array  # (15 L + 3,)
    offset: float


@dataclass(frozen=True)
class Solved:
    """An answer at a knot."""

    pose: Pose
    points: Array  # (L, 5, 3) [m]
    violation: float
    seconds: float


@dataclass(frozen=True)
class _Placed:
    """A module in symbols: points (3, 5), frames of its ends (3, 3)."""

    points: ca.SX
    first: ca.SX
    last: ca.SX


class KnotPrograms:
    """Programs by pattern of roots."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self._programs: dict[Pattern, tuple[IpoptProgram, ca.Function]] = {}
        self.build_seconds = 0.0
        self.variables = 0
        self.constraints = 0

    def solve(
        self,
        hands: Sequence[Hands],
        start: Pose,
        target_box: Array,
        target_points: Array,
        weights: tuple[float, float],
        planes: Sequence[Plane],
        blocks: Array,
        rests: bool,
        deadline: float = np.inf,
    ) -> Solved:
        """The nearest poses to the targets.

        blocks: (L, 4, 2, 3) free block of each link; rests: whether the box is where it starts.
        deadline: `time.monotonic` [s] at which IPOPT stops where it is.
        """
        began = time.perf_counter()
        key = tuple((h.root, h.parent, h.ends[h.root].kind == ON_MODULE) for h in hands)
        if key not in self._programs:
            self._programs[key] = self._build(key)
            self.build_seconds += time.perf_counter() - began
            began = time.perf_counter()
        program, points_of = self._programs[key]
        L = self.setting.scene.count
        lower, upper, g_lower, g_upper, roots, sides, offsets, frames = self._numbers(hands, blocks)
        if rests:
            lower[:3] = upper[:3] = self.setting.scene.box_start[0]
        matrix = np.zeros((CUTS, 15 * L + 3))
        cut_lower = np.full(CUTS, -np.inf)
        for i, plane in enumerate(planes[:CUTS]):
            matrix[i], cut_lower[i] = plane.coefficients, plane.offset
        x0 = np.concatenate([start.box, start.root.ravel(), start.angles.ravel()])
        parameters = np.concatenate(
            [
                target_box,
                target_points.ravel(),
                weights,
                start.angles.ravel(),
                roots.ravel(order="C"),
                sides,
                offsets.ravel(),
                frames.ravel(order="C"),
                matrix.ravel(order="C"),
            ]
        )
        low = np.concatenate([g_lower, cut_lower])
        high = np.concatenate([g_upper, np.full(CUTS, np.inf)])
        bounds = Bounds(lower, upper, low, high)
        answer = program.solve(np.clip(x0, lower, upper), parameters, bounds, deadline)
        x, g = answer.v, answer.rows
        violation = float(np.max(np.maximum(low - g, g - high), initial=0.0))
        points = np.asarray(points_of(x, parameters)).ravel().reshape(L, POINTS, 3)
        pose = Pose(x[:3], x[3 : 3 + 3 * L].reshape(L, 3), x[3 + 3 * L :].reshape(L, 6))
        return Solved(pose, points, violation, time.perf_counter() - began)

    def _numbers(self, hands: Sequence[Hands], blocks: Array) -> tuple[Array, ...]:
        """Bounds of variables and rows, and the parameters that depend on what holds."""
        setting, scene = self.setting, self.setting.scene
        L = scene.count
        reach = np.array(scene.module.joint_range)
        box_low, box_high = setting.centres[:, 0].min(axis=0), setting.centres[:, 1].max(axis=0)
        root_low, root_high = np.full((L, 3), -50.0), np.full((L, 3), 50.0)
        roots, sides = np.tile(np.eye(3), (L, 1, 1)), np.zeros(2 * L)
        offsets, frames = np.zeros((2 * L, 3)), np.tile(np.eye(3), (L, 1, 1))
        place_low, place_high = np.full((L, 2, 3), -np.inf), np.full((L, 2, 3), np.inf)
        turn_low, turn_high = np.full((L, 3), -np.inf), np.full((L, 3), np.inf)
        ahead_low = np.full(L, -np.inf)
        child_low, child_high = np.full((L, 5), -np.inf), np.full((L, 5), np.inf)
        faces = np.zeros((L, 3))
        point_low, point_high = _block_bounds(setting, blocks)
        for m, both in enumerate(hands):
            root = both.root
            for number, end in enumerate(both.ends):
                if end.kind == FIXED and end.place is not None:
                    place_low[m, number] = place_high[m, number] = 0.0
                    offsets[2 * m + number] = end.place
                elif end.kind == ON_BOX and end.place is not None:
                    place_low[m, number] = place_high[m, number] = 0.0
                    offsets[2 * m + number] = end.place
                    sides[2 * m + number] = 1.0
                elif end.kind == ON_PATCH:
                    low, high = patch_bounds(setting, end.patch)
                    place_low[m, number], place_high[m, number] = low, high
                elif end.kind == ON_MODULE:
                    free = 3 if number == root else 5  # its frame is its parent's already
                    child_low[m, :free] = child_high[m, :free] = 0.0
                if end.side >= 0:
                    normal = SIDE_NORMALS[end.side]
                    faces[m] = normal
                    ahead_low[m] = float(abs(normal) @ scene.box_size[0]) / 2 + AHEAD
                if end.rotation is None:
                    continue
                if number == root:
                    roots[m] = end.rotation
                else:
                    frames[m] = end.rotation
                    turn_low[m] = turn_high[m] = 0.0
        lower = np.concatenate([box_low, root_low.ravel(), np.tile(-reach, L)])
        upper = np.concatenate([box_high, root_high.ravel(), np.tile(reach, L)])
        g_low = [point_low, place_low, turn_low, ahead_low, child_low]
        g_high = [point_high, place_high, turn_high, np.full(L, np.inf), child_high]
        return (
            lower,
            upper,
            np.concatenate([v.ravel() for v in g_low]),
            np.concatenate([v.ravel() for v in g_high]),
            roots,
            np.concatenate([sides, faces.ravel()]),
            offsets,
            frames,
        )

    def _build(self, key: Pattern) -> tuple[IpoptProgram, ca.Function]:
        """The program of a pattern: roots, and on whose end they are."""
        setting, L = self.setting, self.setting.scene.count
        box, root, q = ca.SX.sym("box", 3), ca.SX.sym("root", 3, L), ca.SX.sym("q", 6, L)
        t_box, t_points = ca.SX.sym("tb", 3), ca.SX.sym("tp", 15 * L)
        weights, stay = ca.SX.sym("w", 2), ca.SX.sym("q0", 6, L)
        roots = [ca.SX.sym(f"R{m}", 9) for m in range(L)]
        sides, faces = ca.SX.sym("on", 2 * L), ca.SX.sym("n", 3, L)
        offsets = ca.SX.sym("o", 3, 2 * L)
        frames = [ca.SX.sym(f"F{m}", 9) for m in range(L)]
        matrix = ca.SX.sym("C", CUTS * (15 * L + 3))
        chain = chain_function(setting.scene.module)
        placed: dict[int, _Placed] = {}
        for m in sorted(range(L), key=lambda m: key[m][2]):  # parents before their children
            end, parent, rooted = key[m]
            own, turn, _ = chain(q[:, m], ca.SX.zeros(6))
            frame = ca.reshape(roots[m], 3, 3).T  # given row by row
            if rooted:
                # Face to face; the roll is the child's own
                frame = _facing(placed[parent], int(setting.box_end[parent]), end)
            first = frame if end == 0 else frame @ turn.T
            shift = root[:, m] - (0 if end == 0 else first @ own[:, 7])
            world = [shift + first @ own[:, j] for j in CHAIN_POINTS]
            placed[m] = _Placed(ca.horzcat(*world), first, first @ turn)
        rows = []
        every = ca.vertcat(*(ca.vec(placed[m].points) for m in range(L)))
        rows.append(every)
        for m in range(L):
            for number, j in ((0, 0), (1, 4)):
                at = placed[m].points[:, j]
                n = 2 * m + number
                rows.append(at - sides[n] * box - offsets[:, n])
        for m in range(L):
            other = placed[m].last if key[m][0] == 0 else placed[m].first
            error = ca.reshape(frames[m], 3, 3) @ other  # transposed by rows against columns
            rows.append(
                ca.vertcat(
                    error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]
                )
            )
        for m in range(L):
            rows.append(ca.dot(faces[:, m], placed[m].points[:, 0] - box))
        for m in range(L):
            rows.append(self._off_parent(placed, m, key[m][1]))
        rows.append(ca.reshape(matrix, 15 * L + 3, CUTS).T @ ca.vertcat(every, box))
        cost = weights[0] * ca.sumsqr(box - t_box) + weights[1] * ca.sumsqr(every - t_points)
        cost += STAY * ca.sumsqr(q - stay)
        x = ca.vertcat(box, ca.vec(root), ca.vec(q))
        p = ca.vertcat(
            t_box, t_points, weights, ca.vec(stay), *roots, sides, ca.vec(faces), ca.vec(offsets),
            *frames, matrix,
        )  # fmt: skip
        g = ca.vertcat(*rows)
        self.variables = max(self.variables, x.numel())
        self.constraints = max(self.constraints, g.numel())
        settings = {
            "max_iter": ITERATIONS,
            "tol": 1e-6,
            "constr_viol_tol": 1e-7,
            "acceptable_tol": 1e-3,
            "acceptable_iter": 4,
            "mu_strategy": "adaptive",
        }
        program = IpoptProgram("knot", {"x": x, "p": p, "f": cost, "g": g}, settings)
        return program, ca.Function("points", [x, p], [every])

    def _off_parent(self, placed: Mapping[int, _Placed], child: int, parent: int) -> ca.SX:
        """How far a child's last end is off its parent's, and its way out off the parent's (5)."""
        if parent < 0:
            return ca.SX.zeros(5)
        end = int(self.setting.box_end[parent])
        frame = _facing(placed[parent], end, 1)
        off = placed[child].points[:, 4] - placed[parent].points[:, 0 if end == 0 else 4]
        way = frame.T @ placed[child].last[:, 2]
        return ca.vertcat(off, way[:2])


def _facing(parent: _Placed, parent_end: int, end: int) -> ca.SX:
    """Frame of an end that is latched face to face on an end of another module."""
    frame = parent.first if parent_end == 0 else parent.last
    flip = ca.DM(np.diag([1.0, -1.0, -1.0])) if parent_end == end else ca.DM.eye(3)
    return frame @ flip


def _block_bounds(setting: Setting, blocks: Array) -> tuple[Array, Array]:
    """Bounds (L, 5, 3) of points from the free blocks of their links."""
    L, radius = len(blocks), setting.scene.module.radius
    low, high = np.full((L, POINTS, 3), -np.inf), np.full((L, POINTS, 3), np.inf)
    for i in range(POINTS - 1):
        for point in (i, i + 1):
            margin = 0.0 if point in (0, POINTS - 1) else radius
            low[:, point] = np.maximum(low[:, point], blocks[:, i, 0] + margin)
            high[:, point] = np.minimum(high[:, point], blocks[:, i, 1] - margin)
    return low, high
