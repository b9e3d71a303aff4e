"""The multi-phase nonlinear program of a mode sequence, for IPOPT through CasADi.

Variables: durations; position, velocity and acceleration of the box at knots; joint angles of all
limbs at knots; footholds, feet in the air, and foot forces. Built once, solved any number of times.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from climbplan.limms.chain import ROLLS
from climbplan.limms.scene import GRAVITY, SIDE_NORMALS, Array, Scene
from climbplan.limms.statement import Limb, Phase, Trace, held_forces
from climbplan.spec.limms_module import ModuleSpec

FEASIBLE = 1e-6  # largest violation of an answer that is used
SPEED_SHARE = 0.93  # of the joint speed limit that knots may use; the path between them needs some
FORCE_SHARE = 0.985
CONE_SHARE = 0.96
PATCH_MARGIN = 0.05  # [m] of a foot from the edge of the ground it stands on
RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] further
OWN_SIDE = 0.02  # [m] of a foot ahead of its face of the box
LEAST_FORCE = 0.05  # [N] on a foot that stands
TURNING = 0.2  # weight of squared joint speeds against time
SINGULAR = (0.05, 0.12, 0.08)  # [m], [rad], [rad] that poses keep from where branches meet
LIFT = 0.05  # [m] of a foot half-way through its swing


@dataclass(frozen=True)
class Cut:
    """A point of a limb that has to stay on one side of a plane, found by looking at an answer.

    point: 0 to 7 of the module; normal . (point - move * box centre) >= offset at one knot.
    """

    phase: int
    knot: int
    limb: int
    point: int
    normal: Array
    offset: float
    moves_with_box: bool


@dataclass(frozen=True)
class Outcome:
    """Whether a program was solved, and its answer."""

    solved: bool
    message: str
    traces: tuple[Trace, ...]
    violation: float
    objective: float
    seconds: float
    build_seconds: float
    variables: int
    constraints: int


@dataclass
class _Store:
    """Variables and constraints as they are added."""

    x: list[ca.MX] = field(default_factory=list)
    start: list[Array] = field(default_factory=list)
    low: list[Array] = field(default_factory=list)
    high: list[Array] = field(default_factory=list)
    g: list[ca.MX] = field(default_factory=list)
    g_low: list[Array] = field(default_factory=list)
    g_high: list[Array] = field(default_factory=list)

    def variable(
        self, name: str, start: float | Array, low: float | Array, high: float | Array
    ) -> ca.MX:
        value = np.atleast_1d(np.asarray(start, float))
        symbol = ca.MX.sym(name, len(value))
        self.x.append(symbol)
        self.low.append(np.broadcast_to(low, value.shape))
        self.high.append(np.broadcast_to(high, value.shape))
        self.start.append(np.clip(value, self.low[-1], self.high[-1]))
        return symbol

    def add(self, expression: ca.MX, low: float | Array, high: float | Array) -> None:
        size = expression.numel()
        self.g.append(ca.vec(expression))
        self.g_low.append(np.broadcast_to(np.asarray(low, float), (size,)))
        self.g_high.append(np.broadcast_to(np.asarray(high, float), (size,)))

    def equal(self, expression: ca.MX) -> None:
        self.add(expression, 0.0, 0.0)


def chain_function(module: ModuleSpec) -> ca.Function:
    """Points (3, 8), last rotation, and velocity and spin (6) of a module whose first end is at the
    origin, from angles and rates."""
    q = ca.SX.sym("q", 6)
    position, rotation = ca.SX.zeros(3), ca.SX.eye(3)
    points = [position]
    for joint in range(6):
        position = position + module.link_lengths[joint] * rotation[:, 2]
        c, s = ca.cos(q[joint]), ca.sin(q[joint])
        if ROLLS[joint]:
            turn = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
        else:
            turn = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
        rotation = rotation @ turn
        points.append(position)
    points.append(position + module.link_lengths[6] * rotation[:, 2])
    rate = ca.SX.sym("rate", 6)
    moved = ca.jtimes(points[-1], q, rate)
    turned = ca.reshape(ca.jtimes(ca.vec(rotation), q, rate), 3, 3)
    spin = turned @ rotation.T
    velocity = ca.vertcat(moved, spin[2, 1], spin[0, 2], spin[1, 0])
    return ca.Function("chain", [q, rate], [ca.horzcat(*points), rotation, velocity])


@dataclass(frozen=True)
class Ends:
    """What holds at the two ends of the motion."""

    start: Array  # (3,) [m]
    goal: Array  # (3,) [m]
    arrival_speed: float  # [m/s]


def solve(
    scene: Scene,
    limbs: Sequence[Limb],
    guess: Sequence[Trace],
    ends: Ends,
    cuts: Sequence[Cut] = (),
    time_limit: float = 30.0,
    iterations: int = 120,
) -> Outcome:
    """Build and solve the program of some phases from a guess; `guess` carries the phases."""
    began = time.perf_counter()
    store = _Store()
    parts = _Program(scene, limbs, store)
    for number, trace in enumerate(guess):
        parts.phase(number, trace, [c for c in cuts if c.phase == number])
    parts.finish(ends)
    x, g = ca.vertcat(*store.x), ca.vertcat(*store.g)
    nlp: dict[str, Any] = {"x": x, "f": parts.cost, "g": g}
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "print_time": False,
        "expand": True,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "ipopt.max_cpu_time": time_limit,
        "ipopt.tol": 1e-5,
        "ipopt.constr_viol_tol": 1e-7,
        "ipopt.acceptable_tol": 1e-3,
        "ipopt.acceptable_constr_viol_tol": 1e-7,
        "ipopt.acceptable_iter": 6,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.mumps_mem_percent": 200,
    }
    solver = ca.nlpsol("limms", "ipopt", nlp, options)
    built = time.perf_counter()
    answer = solver(
        x0=np.concatenate(store.start),
        lbx=np.concatenate(store.low),
        ubx=np.concatenate(store.high),
        lbg=np.concatenate(store.g_low),
        ubg=np.concatenate(store.g_high),
    )
    values = np.asarray(answer["g"]).ravel()
    violation = float(
        np.max(
            np.maximum(np.concatenate(store.g_low) - values, values - np.concatenate(store.g_high))
        )
    )
    status = solver.stats()["return_status"]
    read = ca.Function("read", [x], parts.outputs)(answer["x"])
    traces = parts.traces([np.asarray(v) for v in read], guess)
    return Outcome(
        solved=violation <= FEASIBLE,  # whatever the solver says of optimality
        message=f"{status}, {solver.stats()['iter_count']} iterations, violation {violation:.1e}",
        traces=traces,
        violation=violation,
        objective=float(answer["f"]),
        seconds=time.perf_counter() - built,
        build_seconds=built - began,
        variables=int(x.numel()),
        constraints=int(g.numel()),
    )


class _Program:
    """Adds phase after phase to a store."""

    def __init__(self, scene: Scene, limbs: Sequence[Limb], store: _Store) -> None:
        self.scene, self.limbs, self.store = scene, limbs, store
        self.chain = chain_function(scene.module)
        self.cost = ca.MX(0)
        self.outputs: list[ca.MX] = []
        self.last: tuple[ca.MX, ca.MX, list[ca.MX]] | None = None  # p, v, q at the end
        self.first_p: ca.MX | None = None
        self.first_v: ca.MX | None = None
        self.footholds: list[ca.MX | None] = [None] * len(limbs)

    def phase(self, number: int, guess: Trace, cuts: Sequence[Cut]) -> None:
        """One phase: motion, kinematics, forces, feet."""
        store, phase = self.store, guess.phase
        count = phase.intervals
        duration = store.variable(f"T{number}", guess.duration, phase.shortest, phase.longest)
        step = duration / count
        p = [
            store.variable("p", guess.position[k], phase.lower, phase.upper)
            for k in range(count + 1)
        ]
        v = [store.variable("v", guess.velocity[k], -8.0, 8.0) for k in range(count + 1)]
        a = [store.variable("a", guess.acceleration[k], -60.0, 60.0) for k in range(count + 1)]
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(count):
            # The chain of cubics, and its control points inside the phase's free block
            store.equal(v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2)
            store.equal(p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6)
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.add(control - lower, 0.0, np.inf)
                store.add(upper - control, 0.0, np.inf)
            self.cost += 0.02 * step * ca.sumsqr((a[k] + a[k + 1]) / 2)
        self.cost += duration
        feet = self._feet(phase, guess)
        q = self._kinematics(phase, guess, p, v, feet, step, cuts)
        force = self._forces(phase, guess, p, a, feet)
        if self.last is None:
            self.first_p, self.first_v = p[0], v[0]
        else:
            before_p, before_v, before_q = self.last
            store.equal(p[0] - before_p)
            store.equal(v[0] - before_v)
            if phase.kind != "flight":
                for mine, theirs in zip(q[0], before_q, strict=True):
                    store.equal(mine - theirs)
        self.last = (p[-1], v[-1], q[-1])
        self.outputs += [
            duration,
            ca.horzcat(*p).T,
            ca.horzcat(*v).T,
            ca.horzcat(*a).T,
            ca.horzcat(*(ca.vertcat(*row) for row in q)).T if q[0] else ca.MX(0),
            ca.horzcat(*(ca.vertcat(*row) for row in feet)).T if feet[0] else ca.MX(0),
            ca.horzcat(*(ca.vertcat(*row) for row in force)).T if force[0] else ca.MX(0),
        ]

    def finish(self, ends: Ends) -> None:
        """Rest at the start; the goal at the end."""
        assert self.last is not None
        assert self.first_p is not None
        assert self.first_v is not None
        store = self.store
        store.equal(self.first_p - ca.DM(ends.start))
        store.equal(self.first_v)
        p, v, _ = self.last
        store.equal(p - ca.DM(ends.goal))
        if ends.arrival_speed > 0:
            store.add(ca.sumsqr(v), 0.0, ends.arrival_speed**2)
            self.cost += 0.5 * ca.sumsqr(v)
        else:
            store.equal(v)

    def _feet(self, phase: Phase, guess: Trace) -> list[list[ca.MX]]:
        """Other ends of all limbs at all knots: anchors, footholds, or feet in the air."""
        store, count = self.store, phase.intervals
        feet: list[list[ca.MX]] = [[] for _ in range(count + 1)]
        for i, limb in enumerate(self.limbs):
            if not limb.is_leg:
                for k in range(count + 1):
                    feet[k].append(ca.MX(ca.DM(limb.fixed_position)))
                continue
            before = self.footholds[i]
            if before is None:
                before = self._foothold(phase.patches[i], guess.feet[0, i])
                self.footholds[i] = before
            if i not in phase.swing:
                for k in range(count + 1):
                    feet[k].append(before)
                continue
            after = self._foothold(phase.patches[i], guess.feet[-1, i])
            self.footholds[i] = after
            path = [before]
            for k in range(1, count):
                path.append(store.variable("foot", guess.feet[k, i], -50.0, 50.0))
                share = k / count
                height = LIFT * 4 * share * (1 - share)
                # Clear of the lower of both grounds early and late, of the straight line between
                store.add(path[k][2] - ca.fmin(before[2], after[2]) - height, 0.0, np.inf)
            path.append(after)
            for k in range(1, count):
                self.cost += 0.5 * ca.sumsqr(path[k + 1] - 2 * path[k] + path[k - 1]) * count
            for k in range(count + 1):
                feet[k].append(path[k])
        return feet

    def _foothold(self, patch: int, start: Array) -> ca.MX:
        ground = self.scene.patches[patch]
        margin = PATCH_MARGIN
        flat = self.store.variable("F", start[:2], ground.lower + margin, ground.upper - margin)
        return ca.vertcat(flat, ground.height)

    def _kinematics(
        self,
        phase: Phase,
        guess: Trace,
        p: list[ca.MX],
        p_velocity: list[ca.MX],
        feet: list[list[ca.MX]],
        step: ca.MX,
        cuts: Sequence[Cut],
    ) -> list[list[ca.MX]]:
        """Closed chains at every knot, eqs. (6.1) and (6.2), joint ranges and speeds."""
        store, module, count = self.store, self.scene.module, phase.intervals
        if phase.kind == "flight":
            return [[] for _ in p]
        reach = np.array(module.joint_range) - RANGE_MARGIN
        # Where latches close, a module still has to get there: along the anchor's normal
        latching = reach - (APPROACH_MARGIN if self.last is None else 0.0)
        q = [
            [store.variable("q", guess.angles[k, i], -bound, bound) for i in range(len(self.limbs))]
            for k in range(count + 1)
            for bound in ((latching if k == 0 else reach),)
        ]
        for k in range(count + 1):
            for i, limb in enumerate(self.limbs):
                on_box = p[k] + ca.DM(self.scene.side_offset(0, limb.side))
                first, last = (on_box, feet[k][i]) if limb.box_end == 0 else (feet[k][i], on_box)
                r_first, r_last = limb.other_rotation, limb.box_rotation
                if limb.box_end == 0:
                    r_first, r_last = r_last, r_first
                points, rotation, _ = self.chain(q[k][i], ca.DM.zeros(6))
                turned = ca.DM(r_first)
                store.equal(first + turned @ points[:, 7] - last)
                error = ca.DM(r_first.T @ r_last).T @ rotation
                store.equal(
                    ca.vertcat(
                        error[2, 1] - error[1, 2],
                        error[0, 2] - error[2, 0],
                        error[1, 0] - error[0, 1],
                    )
                )
                self._away_from_singular(q[k][i], limb.branch)
                if limb.is_leg and i not in phase.swing:
                    # Each foot on its own side of the box (chapter 6.3, support polygon)
                    ahead = ca.dot(ca.DM(SIDE_NORMALS[limb.side]), feet[k][i] - on_box)
                    store.add(ahead, OWN_SIDE, np.inf)
                for cut in cuts:
                    if cut.limb == i and cut.knot == k:
                        point = first + turned @ points[:, cut.point]
                        if cut.moves_with_box:
                            point = point - p[k]
                        store.add(ca.dot(ca.DM(cut.normal), point), cut.offset, np.inf)
        limit = SPEED_SHARE * module.max_joint_speed
        if phase.kind == "held":
            self._rates(p_velocity, q, limit)
        for i in range(len(self.limbs)):
            for k in range(count):
                change = q[k + 1][i] - q[k][i]
                store.add(change - limit * step, -np.inf, 0.0)
                store.add(change + limit * step, 0.0, np.inf)
                self.cost += TURNING * ca.sumsqr(change) / step
            if count >= 2 and phase.kind != "held":
                for k, weights in ((0, (-3, 4, -1)), (count, (1, -4, 3))):
                    rows = q[:3] if k == 0 else q[-3:]
                    end = sum(w * row[i] for w, row in zip(weights, rows, strict=True))
                    store.add(end - 2 * limit * step, -np.inf, 0.0)
                    store.add(end + 2 * limit * step, 0.0, np.inf)
        return q

    def _away_from_singular(self, q: ca.MX, branch: tuple[int, int, int]) -> None:
        """Keep to one branch of the inverse: wrist off the first axis, elbow and wrist bent."""
        lengths = self.scene.module.link_lengths
        shoulder, elbow, wrist = branch
        upper, fore = lengths[2], lengths[3] + lengths[4]
        reach = upper * ca.sin(q[1]) + fore * ca.sin(q[1] + q[2])
        self.store.add(shoulder * reach, SINGULAR[0], np.inf)
        self.store.add(elbow * q[2], SINGULAR[1], np.inf)
        self.store.add(wrist * q[4], SINGULAR[2], np.inf)

    def _rates(self, velocity: list[ca.MX], q: list[list[ca.MX]], limit: float) -> None:
        """Exact joint speeds at the knots of arms: near a straight elbow differences mislead."""
        for k, row in enumerate(q):
            for i, limb in enumerate(self.limbs):
                rate = self.store.variable("rate", np.zeros(6), -limit, limit)
                _, _, moved = self.chain(row[i], rate)
                if limb.box_end == 1:
                    wanted = ca.DM(limb.other_rotation.T) @ velocity[k]
                else:
                    wanted = -ca.DM(limb.box_rotation.T) @ velocity[k]
                self.store.equal(moved - ca.vertcat(wanted, ca.DM.zeros(3)))

    def _forces(
        self,
        phase: Phase,
        guess: Trace,
        p: list[ca.MX],
        a: list[ca.MX],
        feet: list[list[ca.MX]],
    ) -> list[list[ca.MX]]:
        """Dynamics, eq. (6.5), with limits of latches, or friction and moment balance of feet."""
        store, scene = self.store, self.scene
        mass, most = float(scene.box_mass[0]), FORCE_SHARE * scene.module.max_force
        up = ca.DM([0, 0, GRAVITY])
        if phase.kind == "flight":
            for k in range(len(a)):
                store.equal(a[k] + up)
            return [[] for _ in a]
        rows: list[list[ca.MX]] = []
        if phase.kind == "held":
            offsets = np.array([scene.side_offset(0, limb.side) for limb in self.limbs])
            n = len(offsets)
            share = held_forces(offsets, scene.module.max_force, scene.module.latch_moment)
            for k in range(len(a)):
                both = ca.DM(share) @ (mass * (a[k] + up))
                rows.append([both[3 * i : 3 * i + 3] for i in range(n)])
                for i in range(n):
                    moment = both[3 * (n + i) : 3 * (n + i) + 3]
                    store.add(ca.sumsqr(rows[k][i]) / most**2, 0.0, 1.0)
                    limit = FORCE_SHARE * scene.module.latch_moment
                    store.add(ca.sumsqr(moment) / limit**2, 0.0, 1.0)
            return rows
        friction = CONE_SHARE * scene.friction
        for k in range(len(a)):
            row = []
            total, moment = ca.MX.zeros(3), ca.MX.zeros(3)
            for i in range(len(self.limbs)):
                if i in phase.swing:
                    row.append(ca.MX.zeros(3))
                    continue
                start = guess.force[k, i]
                low = np.array([-1.0, -1.0, LEAST_FORCE / most])
                unit = store.variable("f", start / most, low, 1.0)
                f = most * unit
                store.add(ca.sumsqr(unit), 0.0, 1.0)
                # Friction cone of a foot on the ground, eq. (6.8)
                cone = (friction * unit[2]) ** 2 - unit[0] ** 2 - unit[1] ** 2
                store.add(cone, 0.0, np.inf)
                total += f
                moment += ca.cross(feet[k][i] - p[k], f)
                self.cost += 0.01 * ca.sumsqr(unit)
                row.append(f)
            store.equal((mass * (a[k] + up) - total) / 10.0)
            if len(phase.swing) < len(self.limbs):
                store.equal(moment / 10.0)  # eq. (6.6)
            rows.append(row)
        return rows

    def traces(self, read: list[Array], guess: Sequence[Trace]) -> tuple[Trace, ...]:
        """The answer, phase by phase."""
        traces = []
        n = len(self.limbs)
        for number, old in enumerate(guess):
            duration, p, v, a, q, feet, force = read[7 * number : 7 * number + 7]
            knots = old.phase.intervals + 1
            flight = old.phase.kind == "flight"
            traces.append(
                Trace(
                    phase=old.phase,
                    duration=float(duration[0, 0]),
                    position=p,
                    velocity=v,
                    acceleration=a,
                    angles=np.zeros((knots, n, 6)) if flight else q.reshape(knots, n, 6),
                    feet=feet.reshape(knots, n, 3),
                    force=np.zeros((knots, n, 3)) if flight else force.reshape(knots, n, 3),
                )
            )
        return tuple(traces)
