"""The nonlinear block at one knot, eq. (6.12b): kinematics and collisions of all modules.

The program minimises the weighted squared distance of box and points to their targets. Constraints
are joint ranges, contacts of ends, separating planes and free blocks of links. Dynamics and speeds
are in the other block, so the knots are independent. One program is compiled for each pattern of
roots, and used again with other parameters.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.knot_contacts import (
    FIXED,
    ON_BOX,
    ON_MODULE,
    ON_PATCH,
    EndContact,
    ModuleContacts,
    compute_patch_bounds,
)
from climbplan.limms.consensus.module_rows import FOOT_CLEARANCE
from climbplan.limms.consensus.problem import CHAIN_POINTS, POINTS, ConsensusProblem
from climbplan.limms.modules.chain_symbols import build_chain_function
from climbplan.limms.scene.limms_scene import SIDE_NORMALS
from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram

MAX_PLANES = 40  # separating planes in a program
MAX_ITERATIONS = 60
REGULARISATION = 1e-5  # weight of squared changes of joint angles from the guess
_SETTINGS = {
    "max_iter": MAX_ITERATIONS,
    "tol": 1e-6,
    "constr_viol_tol": 1e-7,
    "acceptable_tol": 1e-3,
    "acceptable_iter": 4,
    "mu_strategy": "adaptive",
}
Pattern = tuple[tuple[int, int, bool], ...]  # root end, parent, root is on the parent


@dataclass(frozen=True)
class KnotConfiguration:
    """All modules at a knot: box (3,), first or last ends (L, 3) as rooted, angles (L, 6)."""

    box: Array
    root: Array
    angles: Array


@dataclass(frozen=True)
class SeparatingPlane:
    """A separating plane, eq. (6.4): coefficients . (points of all modules, box) >= offset."""

    coefficients: Array  # (15 L + 3,)
    offset: float


@dataclass(frozen=True)
class KnotSolution:
    """A solution at a knot."""

    pose: KnotConfiguration
    points: Array  # (L, 5, 3) [m]
    violation: float
    seconds: float


@dataclass(frozen=True)
class _ModuleFrames:
    """A module in symbols: points (3, 5) and frames of its ends (3, 3)."""

    points: ca.SX
    first: ca.SX
    last: ca.SX


class _ContactModeBounds:
    """Bounds of rows and parameters that depend on the contacts of L modules."""

    def __init__(self, num_modules: int) -> None:
        """Initialise without any contact: rows are free."""
        self.roots = np.tile(np.eye(3), (num_modules, 1, 1))  # rotation of the root
        self.frames = np.tile(np.eye(3), (num_modules, 1, 1))  # rotation of the other end
        self.sides = np.zeros(2 * num_modules)  # 1 where an end moves with the box
        self.faces = np.zeros((num_modules, 3))  # normal of the face that a foot is in front of
        self.offsets = np.zeros((2 * num_modules, 3))  # [m]
        self.place_low = np.full((num_modules, 2, 3), -np.inf)
        self.place_high = np.full((num_modules, 2, 3), np.inf)
        self.rotation_low = np.full((num_modules, 3), -np.inf)
        self.rotation_high = np.full((num_modules, 3), np.inf)
        self.face_low = np.full(num_modules, -np.inf)
        self.child_low = np.full((num_modules, 5), -np.inf)
        self.child_high = np.full((num_modules, 5), np.inf)

    def attach(
        self, problem: ConsensusProblem, module: int, index: int, end: EndContact, *, is_root: bool
    ) -> None:
        """Constrain one end of a module by its contact."""
        if end.kind in (FIXED, ON_BOX) and end.place is not None:
            self.place_low[module, index] = self.place_high[module, index] = 0.0
            self.offsets[2 * module + index] = end.place
            if end.kind == ON_BOX:
                self.sides[2 * module + index] = 1.0
        elif end.kind == ON_PATCH:
            low, high = compute_patch_bounds(problem, end.patch)
            self.place_low[module, index], self.place_high[module, index] = low, high
        elif end.kind == ON_MODULE:
            num_fixed = 3 if is_root else 5  # the frame of a root is already that of its parent
            self.child_low[module, :num_fixed] = self.child_high[module, :num_fixed] = 0.0
        if end.side >= 0:
            normal = SIDE_NORMALS[end.side]
            half = float(abs(normal) @ problem.scene.box_size[0]) / 2
            self.faces[module], self.face_low[module] = normal, half + FOOT_CLEARANCE
        if end.rotation is not None and is_root:
            self.roots[module] = end.rotation
        elif end.rotation is not None:
            self.frames[module] = end.rotation
            self.rotation_low[module] = self.rotation_high[module] = 0.0

    def parameters(self) -> tuple[Array, ...]:
        """Return the parameters in the order of the program."""
        return (
            self.roots.ravel(order="C"),
            self.sides,
            self.faces.ravel(),
            self.offsets.ravel(),
            self.frames.ravel(order="C"),
        )


class KnotPrograms:
    """Compiled programs by pattern of roots."""

    def __init__(self, problem: ConsensusProblem) -> None:
        self.problem = problem
        self._programs: dict[Pattern, tuple[IpoptProgram, ca.Function]] = {}
        self.build_seconds = 0.0
        self.variables = 0
        self.constraints = 0

    def solve(
        self,
        contacts: Sequence[ModuleContacts],
        start: KnotConfiguration,
        *,
        target_box: Array,
        target_points: Array,
        weights: tuple[float, float],
        planes: Sequence[SeparatingPlane],
        blocks: Array,
        is_box_at_start: bool,
        deadline: float = np.inf,
    ) -> KnotSolution:
        """Solve for the nearest poses to the targets.

        Args:
            contacts: Contacts of all modules.
            start: The initial guess.
            target_box: Position of the box (3,) [m].
            target_points: Points of modules (L, 5, 3) [m].
            weights: Weights of box and points [1/m^2].
            planes: Separating planes; the first `MAX_PLANES` are used.
            blocks: Free block of each link (L, 4, 2, 3) [m].
            is_box_at_start: Whether the box rests where it starts.
            deadline: Time at which IPOPT stops, as `time.monotonic` [s].
        """
        start_time = time.perf_counter()
        key = tuple((h.root, h.parent, h.ends[h.root].kind == ON_MODULE) for h in contacts)
        if key not in self._programs:
            self._programs[key] = self._build(key)
            self.build_seconds += time.perf_counter() - start_time
            start_time = time.perf_counter()
        program, points_of = self._programs[key]
        num_modules = self.problem.scene.num_modules
        lower, upper, g_lower, g_upper, rows = self._build_bounds(contacts, blocks)
        if is_box_at_start:
            lower[:3] = upper[:3] = self.problem.scene.box_start[0]
        matrix = np.zeros((MAX_PLANES, 15 * num_modules + 3))
        cut_lower = np.full(MAX_PLANES, -np.inf)
        for i, plane in enumerate(planes[:MAX_PLANES]):
            matrix[i], cut_lower[i] = plane.coefficients, plane.offset
        x0 = np.concatenate([start.box, start.root.ravel(), start.angles.ravel()])
        target = [target_box, target_points.ravel(), weights, start.angles.ravel()]
        parameters = np.concatenate([*target, *rows.parameters(), matrix.ravel(order="C")])
        row_lower = np.concatenate([g_lower, cut_lower])
        row_upper = np.concatenate([g_upper, np.full(MAX_PLANES, np.inf)])
        bounds = Bounds(lower, upper, row_lower, row_upper)
        answer = program.solve(np.clip(x0, lower, upper), parameters, bounds, deadline)
        x, g = answer.v, answer.rows
        violation = float(np.max(np.maximum(row_lower - g, g - row_upper), initial=0.0))
        points = np.asarray(points_of(x, parameters)).ravel().reshape(num_modules, POINTS, 3)
        pose = KnotConfiguration(
            x[:3],
            x[3 : 3 + 3 * num_modules].reshape(num_modules, 3),
            x[3 + 3 * num_modules :].reshape(num_modules, 6),
        )
        return KnotSolution(pose, points, violation, time.perf_counter() - start_time)

    def _build_bounds(
        self, contacts: Sequence[ModuleContacts], blocks: Array
    ) -> tuple[Array, Array, Array, Array, _ContactModeBounds]:
        """Return bounds of variables and of rows, and the rows that depend on contacts."""
        problem, num_modules = self.problem, self.problem.scene.num_modules
        joint_range = np.array(problem.scene.module.joint_range)
        box_low = problem.centre_blocks[:, 0].min(axis=0)
        box_high = problem.centre_blocks[:, 1].max(axis=0)
        root = np.full(3 * num_modules, 50.0)
        point_low, point_high = _compute_block_bounds(problem, blocks)
        rows = _ContactModeBounds(num_modules)
        for module, contact in enumerate(contacts):
            for index, end in enumerate(contact.ends):
                rows.attach(problem, module, index, end, is_root=index == contact.root)
        lower = np.concatenate([box_low, -root, np.tile(-joint_range, num_modules)])
        upper = np.concatenate([box_high, root, np.tile(joint_range, num_modules)])
        row_low = [point_low, rows.place_low, rows.rotation_low, rows.face_low, rows.child_low]
        face_high = np.full(num_modules, np.inf)
        row_high = [point_high, rows.place_high, rows.rotation_high, face_high, rows.child_high]
        return (
            lower,
            upper,
            np.concatenate([v.ravel() for v in row_low]),
            np.concatenate([v.ravel() for v in row_high]),
            rows,
        )

    def _build(self, key: Pattern) -> tuple[IpoptProgram, ca.Function]:
        """Compile the program of a pattern of roots."""
        num_modules = self.problem.scene.num_modules
        box, root = ca.SX.sym("box", 3), ca.SX.sym("root", 3, num_modules)
        q = ca.SX.sym("q", 6, num_modules)
        t_box, t_points = ca.SX.sym("tb", 3), ca.SX.sym("tp", 15 * num_modules)
        weights, stay = ca.SX.sym("w", 2), ca.SX.sym("q0", 6, num_modules)
        roots = [ca.SX.sym(f"R{m}", 9) for m in range(num_modules)]
        sides, faces = ca.SX.sym("on", 2 * num_modules), ca.SX.sym("n", 3, num_modules)
        offsets = ca.SX.sym("o", 3, 2 * num_modules)
        frames = [ca.SX.sym(f"F{m}", 9) for m in range(num_modules)]
        matrix = ca.SX.sym("C", MAX_PLANES * (15 * num_modules + 3))
        placed = self._place_modules(key, roots, root, q)
        all_points = ca.vertcat(*(ca.vec(placed[m].points) for m in range(num_modules)))
        rows = [all_points]
        for m in range(num_modules):
            for index, j in ((0, 0), (1, 4)):
                point = placed[m].points[:, j]
                n = 2 * m + index
                rows.append(point - sides[n] * box - offsets[:, n])
        for m in range(num_modules):
            far_frame = placed[m].last if key[m][0] == 0 else placed[m].first
            rows.append(_rotation_error(ca.reshape(frames[m], 3, 3) @ far_frame))
        rows += [ca.dot(faces[:, m], placed[m].points[:, 0] - box) for m in range(num_modules)]
        rows += [self._compute_parent_error(placed, m, key[m][1]) for m in range(num_modules)]
        planes = ca.reshape(matrix, 15 * num_modules + 3, MAX_PLANES)
        rows.append(planes.T @ ca.vertcat(all_points, box))
        cost = weights[0] * ca.sumsqr(box - t_box) + weights[1] * ca.sumsqr(all_points - t_points)
        cost += REGULARISATION * ca.sumsqr(q - stay)
        x = ca.vertcat(box, ca.vec(root), ca.vec(q))
        p = ca.vertcat(
            t_box, t_points, weights, ca.vec(stay), *roots, sides, ca.vec(faces), ca.vec(offsets),
            *frames, matrix,
        )  # fmt: skip
        g = ca.vertcat(*rows)
        self.variables = max(self.variables, x.numel())
        self.constraints = max(self.constraints, g.numel())
        program = IpoptProgram("knot", {"x": x, "p": p, "f": cost, "g": g}, _SETTINGS)
        return program, ca.Function("points", [x, p], [all_points])

    def _place_modules(
        self, key: Pattern, roots: Sequence[ca.SX], root: ca.SX, q: ca.SX
    ) -> dict[int, _ModuleFrames]:
        """Return all modules in symbols, parents before their children.

        Args:
            key: The pattern of roots.
            roots: Rotations of the roots (9), row by row.
            root: Positions of the roots (3, L) [m].
            q: Joint angles (6, L) [rad].
        """
        problem = self.problem
        chain = build_chain_function(problem.scene.module)
        placed: dict[int, _ModuleFrames] = {}
        for m in sorted(range(len(key)), key=lambda m: key[m][2]):
            end, parent, is_on_parent = key[m]
            local_points, last_rotation, _ = chain(q[:, m], ca.SX.zeros(6))
            frame = ca.reshape(roots[m], 3, 3).T  # given row by row
            if is_on_parent:
                # Face to face; the child's roll is free
                frame = _face_to_face(placed[parent], int(problem.box_end[parent]), end)
            first = frame if end == 0 else frame @ last_rotation.T
            shift = root[:, m] - (0 if end == 0 else first @ local_points[:, 7])
            world = [shift + first @ local_points[:, j] for j in CHAIN_POINTS]
            placed[m] = _ModuleFrames(ca.horzcat(*world), first, first @ last_rotation)
        return placed

    def _compute_parent_error(
        self, placed: Mapping[int, _ModuleFrames], child: int, parent: int
    ) -> ca.SX:
        """Return position error (3) and axis error (2) of a child's last end on its parent."""
        if parent < 0:
            return ca.SX.zeros(5)
        end = int(self.problem.box_end[parent])
        frame = _face_to_face(placed[parent], end, 1)
        offset = placed[child].points[:, 4] - placed[parent].points[:, 0 if end == 0 else 4]
        axis = frame.T @ placed[child].last[:, 2]
        return ca.vertcat(offset, axis[:2])


def _rotation_error(relative: ca.SX) -> ca.SX:
    """Return the antisymmetric part (3) of a relative rotation, zero where frames agree."""
    return ca.vertcat(
        relative[2, 1] - relative[1, 2],
        relative[0, 2] - relative[2, 0],
        relative[1, 0] - relative[0, 1],
    )


def _face_to_face(parent: _ModuleFrames, parent_end: int, end: int) -> ca.SX:
    """Return the frame of an end that is latched face to face on an end of another module."""
    frame = parent.first if parent_end == 0 else parent.last
    flip = ca.DM(np.diag([1.0, -1.0, -1.0])) if parent_end == end else ca.DM.eye(3)
    return frame @ flip


def _compute_block_bounds(problem: ConsensusProblem, blocks: Array) -> tuple[Array, Array]:
    """Return bounds (L, 5, 3) of points from the free blocks of their links [m]."""
    L, radius = len(blocks), problem.scene.module.radius
    low, high = np.full((L, POINTS, 3), -np.inf), np.full((L, POINTS, 3), np.inf)
    for i in range(POINTS - 1):
        for point in (i, i + 1):
            margin = 0.0 if point in (0, POINTS - 1) else radius
            low[:, point] = np.maximum(low[:, point], blocks[:, i, 0] + margin)
            high[:, point] = np.minimum(high[:, point], blocks[:, i, 1] - margin)
    return low, high
