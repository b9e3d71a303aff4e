"""The multi-phase nonlinear program of arms that carry or throw the box, for IPOPT through CasADi.

Variables: durations; position, velocity and acceleration of the box at knots, and of its yaw where
it turns. Joint angles and speeds of the arms are closed functions of these (`symbols.py`), so that
closed chains hold at every iterate, eqs. (6.1) and (6.2).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.held_branches import APPROACH_MARGIN, RANGE_MARGIN, SINGULAR
from climbplan.limms.arms.loads import load_function
from climbplan.limms.arms.symbols import arm_function, box_frame, least_margins
from climbplan.limms.budget.program_results import BoundaryConditions, Cut, ProgramOutcome
from climbplan.limms.budget.solver_work import measure_work
from climbplan.limms.modules.chain import inverse
from climbplan.limms.modules.chain_symbols import chain_function
from climbplan.limms.modules.limbs import limb_frames
from climbplan.limms.scene.limms_scene import GRAVITY, Scene
from climbplan.limms.scene.phases import Limb, PhaseTrajectory, compute_load_sharing
from climbplan.limms.scene.placement import inertia_about_vertical
from climbplan.program.trajectory import Trajectory
from climbplan.solvers.ipopt.trajectory import solve_trajectory

SPEED_SHARE = 0.93  # of the joint speed limit that knots may use; the path between them needs some
FORCE_SHARE = 0.985  # of the limits of latches
MASS_SHARE = 0.95  # of torques and latches with masses: knots only, and a spline between them
_SPARE = 1e-3  # [s] of latches beyond their dwell time
TURNING = 0.2  # weight of squared joint speeds against time
_SETTINGS = {
    "tol": 1e-5,
    "constr_viol_tol": 1e-7,
    "acceptable_tol": 1e-3,
    "acceptable_constr_viol_tol": 1e-7,
    "acceptable_iter": 6,
    # Adaptive barriers took three times as long on random throws, and a start at 0.1 twice as long
    "mu_strategy": "monotone",
    "mu_init": 0.01,
}


def solve_arms(
    scene: Scene,
    limbs: Sequence[Limb],
    guess: Sequence[PhaseTrajectory],
    ends: BoundaryConditions,
    cuts: Sequence[Cut] = (),
    deadline: float = np.inf,
    iterations: int = 100,
) -> ProgramOutcome:
    """Build and solve the program of some phases from a guess; `guess` carries the phases.

    deadline: `time.monotonic` [s] at which IPOPT stops where it is.
    """
    began = time.perf_counter()
    parts = _Arms(scene, limbs, ends)
    for number, trace in enumerate(guess):
        parts.phase(trace, [cut for cut in cuts if cut.phase == number])
    parts.finish(guess)
    settings = {**_SETTINGS, "max_iter": iterations}
    answer = solve_trajectory(parts.store, parts.outputs, settings, began, deadline)
    return ProgramOutcome(
        traces=_traces(scene, limbs, answer.values, guess),
        is_optimal=answer.optimal,
        work=measure_work(answer),
        **answer.figures(),
    )


class _Arms:
    """Adds phase after phase."""

    def __init__(self, scene: Scene, limbs: Sequence[Limb], ends: BoundaryConditions) -> None:
        self.scene, self.limbs, self.ends, self.store = scene, limbs, ends, Trajectory("arms")
        self.arms = [arm_function(scene, limb) for limb in limbs]
        self.loads = [] if scene.massless else [load_function(scene, limb) for limb in limbs]
        self.chain = chain_function(scene.module)
        self.outputs: list[ca.MX] = []
        # Placement and velocity at the end, and which of their entries are variables
        self.last = (ca.MX(ca.DM(ends.start)), ca.MX.zeros(len(ends.start)))
        self.varied: tuple[int, ...] = ()
        self.is_first = True

    def phase(self, guess: PhaseTrajectory, cuts: Sequence[Cut]) -> None:
        """One phase: motion of the box, and of the arms that hold it."""
        store, phase = self.store, guess.phase
        count = phase.intervals
        duration = store.variable("T", guess.duration, phase.shortest, phase.longest)
        step = duration / count
        knots = range(count + 1)
        # What keeps still in this phase, a yaw, is no variable in it
        own = [i for i in range(len(phase.lower)) if phase.upper[i] > phase.lower[i]]
        still = phase.lower[len(own) :]
        p = [
            self._with(
                store.variable("p", guess.position[k, own], phase.lower[own], phase.upper[own]),
                still,
            )
            for k in knots
        ]
        rest = np.zeros(len(still))
        v = [
            self._with(store.variable("v", guess.velocity[k, own], -8.0, 8.0), rest) for k in knots
        ]
        a = [
            self._with(store.variable("a", guess.acceleration[k, own], -60.0, 60.0), rest)
            for k in knots
        ]
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(count):
            # The chain of cubics, and its control points inside the phase's free block
            speeding = v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2
            moving = p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6
            store.equal("box.motion", speeding[own])
            store.equal("box.motion", moving[own])
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.between("clear.box", (control - lower)[own], 0.0, unit="m")
                store.between("clear.box", (upper - control)[own], 0.0, unit="m")
            effort = ca.sumsqr((a[k] + a[k + 1])[:3] / 2) + _turning(a[k] + a[k + 1]) ** 2 / 4
            store.minimise("acceleration", 0.02 * step * effort)
        store.minimise("time", duration)
        joined = sorted({*own, *self.varied})
        store.equal("box.motion", (p[0] - self.last[0])[joined])
        store.equal("box.motion", (v[0] - self.last[1])[joined])
        if phase.kind == "flight":
            falling = ca.DM([0, 0, GRAVITY, 0][: len(phase.lower)])
            for acceleration in a:
                store.equal("box.dynamics", (acceleration + falling)[own], "m/s^2")
        else:
            self._latches(p, a)
            self._joints(guess, p, v, step, cuts, self.is_first)
            if not self.scene.massless:
                self._masses(guess, p, v, a)
        self.last, self.varied, self.is_first = (p[-1], v[-1]), tuple(own), False
        self.outputs += [duration, *(ca.horzcat(*rows).T for rows in (p, v, a))]

    def finish(self, guess: Sequence[PhaseTrajectory]) -> None:
        """The goal at the end, and time for the latches where the way may be too short for it."""
        store, ends, own = self.store, self.ends, list(self.varied)
        dwell = self.scene.module.latch_dwell
        if sum(trace.duration for trace in guess if trace.phase.kind != "flight") < 3 * dwell:
            held = zip(self.outputs[::4], guess, strict=True)
            together = sum(time for time, trace in held if trace.phase.kind != "flight")
            store.between("latch.dwell", together, dwell + _SPARE, unit="s")
        p, v = self.last
        store.equal("goal.reached", (p - ca.DM(ends.goal))[own], "m")
        if ends.arrival_speed > 0:
            store.between("goal.speed", ca.sumsqr(v[:3]), 0.0, ends.arrival_speed**2)
            store.minimise("arrival", 0.5 * ca.sumsqr(v[:3]))
        else:
            store.equal("goal.speed", v[own], "m/s")

    @staticmethod
    def _with(variable: ca.MX, still: Array) -> ca.MX:
        return ca.vertcat(variable, ca.DM(still)) if len(still) else variable

    def _wrench(self, p: ca.MX, a: ca.MX) -> ca.MX:
        """Force on the box in its own frame, and moment about the vertical (4), eq. (6.5)."""
        mass = float(self.scene.box_mass[0])
        force = box_frame(p).T @ (mass * (a[:3] + ca.DM([0, 0, GRAVITY])))
        inertia = inertia_about_vertical(mass, self.scene.box_size[0])
        return ca.vertcat(force, inertia * _turning(a))

    def _latches(self, p: list[ca.MX], a: list[ca.MX]) -> None:
        """Dynamics, eq. (6.5), within what the latches hold."""
        scene, module = self.scene, self.scene.module
        offsets = np.array([scene.side_offset(0, limb.side) for limb in self.limbs])
        n = len(offsets)
        share = ca.DM(compute_load_sharing(offsets, module.max_force, module.latch_moment))
        limits = [FORCE_SHARE * module.max_force] * n + [FORCE_SHARE * module.latch_moment] * n
        for place, acceleration in zip(p, a, strict=True):
            both = share @ self._wrench(place, acceleration)
            for i, limit in enumerate(limits):
                name = "force.limit" if i < n else "latch.moment"
                share_used = ca.sumsqr(both[3 * i : 3 * i + 3]) / limit**2
                self.store.between(name, share_used, 0.0, 1.0)

    def _masses(
        self, guess: PhaseTrajectory, p: list[ca.MX], v: list[ca.MX], a: list[ca.MX]
    ) -> None:
        """Box and arms together: joint torques, and what the latches on anchors hold.

        Latches on the box share its load as `_latches` has it; the checker's sharing, among all
        contacts, may differ where there are several.
        """
        scene, module = self.scene, self.scene.module
        offsets = np.array([scene.side_offset(0, limb.side) for limb in self.limbs])
        n = len(offsets)
        share = ca.DM(compute_load_sharing(offsets, module.max_force, module.latch_moment))
        for k in range(len(p)):
            both, frame = share @ self._wrench(p[k], a[k]), box_frame(p[k])
            for i in range(n):
                force = frame @ both[3 * i : 3 * i + 3]
                moment = frame @ both[3 * (n + i) : 3 * (n + i) + 3]
                reference = ca.DM(guess.angles[k, i])
                found = self.loads[i](p[k], v[k], a[k], reference, force, moment)
                torque = found[0] / module.max_torque
                self.store.between("load.torque", torque, -MASS_SHARE, MASS_SHARE)
                for name, value, limit in (
                    ("load.force", found[1], module.max_force),
                    ("load.moment", found[2], module.latch_moment),
                ):
                    used = ca.sumsqr(value) / limit**2
                    self.store.between(name, used, upper=MASS_SHARE**2)

    def _joints(
        self,
        guess: PhaseTrajectory,
        p: list[ca.MX],
        v: list[ca.MX],
        step: ca.MX,
        cuts: Sequence[Cut],
        is_first: bool,
    ) -> None:
        """Joint ranges and speeds, no change of branch, and planes that links stay beyond."""
        store, module = self.store, self.scene.module
        reach = np.array(module.joint_range) - RANGE_MARGIN
        limit = SPEED_SHARE * module.max_joint_speed
        low, high = least_margins(SINGULAR)
        for i, limb in enumerate(self.limbs):
            before: ca.MX | None = None
            for k in range(len(p)):
                angles, rates, margins = self.arms[i](p[k], v[k], ca.DM(guess.angles[k, i]))
                # Where latches close, a module still has to get there: along the anchor's normal
                bound = reach - (APPROACH_MARGIN if is_first and k == 0 else 0.0)
                store.between("joint.range", angles, -bound, bound, "rad")
                store.between("joint.speed", rates, -limit, limit, "rad/s")
                store.between("joint.branch", margins, low, high)
                if before is not None:
                    change = angles - before
                    store.between("joint.speed", change - limit * step, upper=0.0)
                    store.between("joint.speed", change + limit * step, 0.0)
                    store.minimise("turning", TURNING * ca.sumsqr(change) / step)
                before = angles
                for cut in cuts:
                    if cut.limb == i and cut.knot == k:
                        self._cut(cut, limb, angles, p[k])

    def _cut(self, cut: Cut, limb: Limb, angles: ca.MX, p: ca.MX) -> None:
        points, _, _ = self.chain(angles, ca.DM.zeros(6))
        frame = box_frame(p)
        first, turn = ca.MX(ca.DM(limb.fixed_position)), ca.MX(ca.DM(limb.other_rotation))
        if limb.box_end == 0:
            first = p[:3] + frame @ ca.DM(self.scene.side_offset(0, limb.side))
            turn = frame @ ca.DM(limb.box_rotation)
        point = first + turn @ points[:, cut.point]
        if cut.moves_with_box:
            point = frame.T @ (point - p[:3])
        self.store.between("clear.cut", ca.dot(ca.DM(cut.normal), point), cut.offset, unit="m")


def _turning(entries: ca.MX) -> ca.MX | float:
    """The yaw's part of a placement's velocity or acceleration, 0 of a box that does not turn."""
    return entries[3] if entries.numel() == 4 else 0.0


def _traces(
    scene: Scene, limbs: Sequence[Limb], read: Sequence[Array], guess: Sequence[PhaseTrajectory]
) -> tuple[PhaseTrajectory, ...]:
    """The answer, phase by phase; joint angles solved anew, so that chains close exactly."""
    traces: list[PhaseTrajectory] = []
    for number, old in enumerate(guess):
        duration, position, velocity, acceleration = read[4 * number : 4 * number + 4]
        angles = old.angles
        if old.phase.kind != "flight":
            angles = np.stack(
                [_angles(scene, limb, position, old.angles[:, i]) for i, limb in enumerate(limbs)],
                axis=1,
            )
        traces.append(
            replace(
                old,
                duration=float(duration[0, 0]),
                position=position,
                velocity=velocity,
                acceleration=acceleration,
                angles=angles,
            )
        )
    return tuple(traces)


def _angles(scene: Scene, limb: Limb, position: Array, near: Array) -> Array:
    first, last = limb_frames(scene, limb, position, limb.fixed_position)
    angles = inverse(scene.module, first, last, limb.branch).angles
    turned: Array = angles + np.round((near - angles) / (2 * np.pi)) * 2 * np.pi
    return turned
