"""Multi-phase nonlinear program of arms that carry or throw the box, for IPOPT through CasADi.

The program minimises durations, accelerations of the box and joint motion. Variables are durations,
and position, velocity and acceleration of the box (and of its yaw where it turns) at knots.
Constraints are the chain of cubics, free blocks, latch limits, joint ranges and speeds,
singularities and cuts. Joint angles and speeds are closed functions of the variables
(`symbols.py`), so closed chains hold at every iterate, eqs. (6.1) and (6.2).

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.arms.branch_choices import APPROACH_MARGIN, RANGE_MARGIN, SINGULAR_MARGINS
from climbplan.limms.arms.loads import build_load_function
from climbplan.limms.arms.symbols import (
    build_arm_function,
    compute_box_frame,
    compute_margin_bounds,
)
from climbplan.limms.budget.program_results import BoundaryConditions, CollisionCut, ProgramOutcome
from climbplan.limms.budget.solver_work import measure_work
from climbplan.limms.modules.chain import solve_inverse_kinematics
from climbplan.limms.modules.chain_symbols import build_chain_function
from climbplan.limms.modules.limbs import compute_limb_frames
from climbplan.limms.scene.limms_scene import GRAVITY, ModuleScene
from climbplan.limms.scene.phases import PhaseTrajectory, SupportModule, compute_load_sharing
from climbplan.limms.scene.placement import inertia_about_vertical
from climbplan.program.staged_program import StagedProgram
from climbplan.solvers.ipopt.staged_program import solve_staged_program

SPEED_FRACTION = 0.93  # of the joint speed limit at knots; motion between them needs the rest
FORCE_FRACTION = 0.985  # of the limits of latches
LOAD_FRACTION = 0.95  # of loads with masses at knots; motion between them needs the rest
_DWELL_MARGIN = 1e-3  # [s] beyond the dwell time of latches
JOINT_SPEED_WEIGHT = 0.2  # weight of squared joint speeds against time
_SETTINGS = {
    "tol": 1e-5,
    "constr_viol_tol": 1e-7,
    "acceptable_tol": 1e-3,
    "acceptable_constr_viol_tol": 1e-7,
    "acceptable_iter": 6,
    # A monotone barrier from a small value suits guesses close to a solution
    "mu_strategy": "monotone",
    "mu_init": 0.01,
}


def solve_arms(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    guess: Sequence[PhaseTrajectory],
    ends: BoundaryConditions,
    *,
    cuts: Sequence[CollisionCut] = (),
    deadline: float = np.inf,
    iterations: int = 100,
) -> ProgramOutcome:
    """Build and solve the program of some phases from a guess, which carries the phases.

    Args:
        scene: The scene.
        limbs: The arms.
        guess: Initial trajectories of all phases.
        ends: Boundary conditions.
        cuts: Cutting planes.
        deadline: Time at which IPOPT stops, as `time.monotonic` [s].
        iterations: Largest number of iterations.
    """
    start_time = time.perf_counter()
    program = _ArmProgram(scene, limbs, ends)
    for index, trajectory in enumerate(guess):
        program.add_phase(trajectory, [cut for cut in cuts if cut.phase == index])
    program.finish(guess)
    settings = {**_SETTINGS, "max_iter": iterations}
    answer = solve_staged_program(program.store, program.outputs, settings, start_time, deadline)
    return ProgramOutcome(
        traces=_read_trajectories(scene, limbs, answer.values, guess),
        is_optimal=answer.optimal,
        work=measure_work(answer),
        **answer.figures(),
    )


class _ArmProgram:
    """The program under construction, phase after phase."""

    def __init__(
        self, scene: ModuleScene, limbs: Sequence[SupportModule], ends: BoundaryConditions
    ) -> None:
        self.scene, self.limbs, self.ends, self.store = scene, limbs, ends, StagedProgram("arms")
        self.arms = [build_arm_function(scene, limb) for limb in limbs]
        self.loads = [] if scene.massless else [build_load_function(scene, limb) for limb in limbs]
        self.chain = build_chain_function(scene.module)
        self.outputs: list[ca.MX] = []
        # Placement and velocity at the end of the last phase, and their variable entries
        self.last = (ca.MX(ca.DM(ends.start)), ca.MX.zeros(len(ends.start)))
        self.varied: tuple[int, ...] = ()
        self.is_first = True

    def add_phase(self, guess: PhaseTrajectory, cuts: Sequence[CollisionCut]) -> None:
        """Add one phase: motion of the box, and of the arms that hold it."""
        store, phase = self.store, guess.phase
        duration = store.variable("T", guess.duration, phase.shortest, phase.longest)
        step = duration / phase.intervals
        # A yaw that is constant in this phase is no variable
        variable_entries = [i for i in range(len(phase.lower)) if phase.upper[i] > phase.lower[i]]
        p, v, a = self._add_motion(guess, variable_entries, step)
        store.minimise("time", duration)
        continuous = sorted({*variable_entries, *self.varied})
        store.equal("box.kinematics", (p[0] - self.last[0])[continuous])
        store.equal("box.kinematics", (v[0] - self.last[1])[continuous])
        if phase.kind == "flight":
            gravity = ca.DM([0, 0, GRAVITY, 0][: len(phase.lower)])
            for acceleration in a:
                store.equal("box.dynamics", (acceleration + gravity)[variable_entries], "m/s^2")
        else:
            self._add_latch_limits(p, a)
            self._add_joint_limits(guess, p, v, step, cuts, self.is_first)
            if not self.scene.massless:
                self._add_loads(guess, p, v, a)
        self.last, self.varied, self.is_first = (p[-1], v[-1]), tuple(variable_entries), False
        self.outputs += [duration, *(ca.horzcat(*rows).T for rows in (p, v, a))]

    def _add_motion(
        self, guess: PhaseTrajectory, variable_entries: list[int], step: ca.MX
    ) -> tuple[list[ca.MX], list[ca.MX], list[ca.MX]]:
        """Add a chain of cubics whose control points are in the phase's free block.

        Args:
            guess: Initial trajectory of the phase.
            variable_entries: Entries of the box's placement that may change in the phase.
            step: Time between knots [s].

        Returns:
            Placement, velocity and acceleration of the box at each knot.
        """
        store, phase = self.store, guess.phase
        constants = phase.lower[len(variable_entries) :]
        knots = range(phase.intervals + 1)
        p = [
            self._append_constants(
                store.variable(
                    "p",
                    guess.position[k, variable_entries],
                    phase.lower[variable_entries],
                    phase.upper[variable_entries],
                ),
                constants,
            )
            for k in knots
        ]
        zero_rates = np.zeros(len(constants))
        v = [
            self._append_constants(
                store.variable("v", guess.velocity[k, variable_entries], -8.0, 8.0), zero_rates
            )
            for k in knots
        ]
        a = [
            self._append_constants(
                store.variable("a", guess.acceleration[k, variable_entries], -60.0, 60.0),
                zero_rates,
            )
            for k in knots
        ]
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(phase.intervals):
            # The chain of cubics, with its control points inside the free block
            velocity_error = v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2
            position_error = p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6
            store.equal("box.kinematics", velocity_error[variable_entries])
            store.equal("box.kinematics", position_error[variable_entries])
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.between("box.collision", (control - lower)[variable_entries], 0.0, unit="m")
                store.between("box.collision", (upper - control)[variable_entries], 0.0, unit="m")
            effort = ca.sumsqr((a[k] + a[k + 1])[:3] / 2) + _yaw_entry(a[k] + a[k + 1]) ** 2 / 4
            store.minimise("acceleration", 0.02 * step * effort)
        return p, v, a

    def finish(self, guess: Sequence[PhaseTrajectory]) -> None:
        """Add the goal, and enough time for latches where the motion may be too short."""
        store, ends, entries = self.store, self.ends, list(self.varied)
        dwell = self.scene.module.latch_dwell
        if sum(trace.duration for trace in guess if trace.phase.kind != "flight") < 3 * dwell:
            held_phases = zip(self.outputs[::4], guess, strict=True)
            held_time = sum(time for time, trace in held_phases if trace.phase.kind != "flight")
            store.between("latch.dwell", held_time, dwell + _DWELL_MARGIN, unit="s")
        p, v = self.last
        store.equal("goal.position", (p - ca.DM(ends.goal))[entries], "m")
        if ends.arrival_speed > 0:
            store.between("goal.speed", ca.sumsqr(v[:3]), 0.0, ends.arrival_speed**2)
            store.minimise("arrival", 0.5 * ca.sumsqr(v[:3]))
        else:
            store.equal("goal.speed", v[entries], "m/s")

    @staticmethod
    def _append_constants(variable: ca.MX, still: Array) -> ca.MX:
        """Return the variable with constant entries appended."""
        return ca.vertcat(variable, ca.DM(still)) if len(still) else variable

    def _compute_wrench(self, p: ca.MX, a: ca.MX) -> ca.MX:
        """Return the force on the box in its frame and the moment about the vertical (4), eq.
        (6.5).
        """
        mass = float(self.scene.box_mass[0])
        force = compute_box_frame(p).T @ (mass * (a[:3] + ca.DM([0, 0, GRAVITY])))
        inertia = inertia_about_vertical(mass, self.scene.box_size[0])
        return ca.vertcat(force, inertia * _yaw_entry(a))

    def _add_latch_limits(self, p: list[ca.MX], a: list[ca.MX]) -> None:
        """Add the dynamics, eq. (6.5), within the limits of the latches."""
        scene, module = self.scene, self.scene.module
        offsets = np.array([scene.side_offset(0, limb.side) for limb in self.limbs])
        num_latches = len(offsets)
        load_sharing = ca.DM(compute_load_sharing(offsets, module.max_force, module.latch_moment))
        limits = [FORCE_FRACTION * module.max_force] * num_latches + [
            FORCE_FRACTION * module.latch_moment
        ] * num_latches
        for placement, acceleration in zip(p, a, strict=True):
            loads = load_sharing @ self._compute_wrench(placement, acceleration)
            for i, limit in enumerate(limits):
                name = "force.limit" if i < num_latches else "latch.moment"
                utilisation = ca.sumsqr(loads[3 * i : 3 * i + 3]) / limit**2
                self.store.between(name, utilisation, 0.0, 1.0)

    def _add_loads(
        self, guess: PhaseTrajectory, p: list[ca.MX], v: list[ca.MX], a: list[ca.MX]
    ) -> None:
        """Add limits on joint torques and on the loads of anchors, with masses of arms.

        Latches on the box share its load as in `_add_latch_limits`. The checker shares it among all
        contacts, which may differ with several.
        """
        scene, module = self.scene, self.scene.module
        offsets = np.array([scene.side_offset(0, limb.side) for limb in self.limbs])
        num_latches = len(offsets)
        load_sharing = ca.DM(compute_load_sharing(offsets, module.max_force, module.latch_moment))
        for k in range(len(p)):
            loads, frame = load_sharing @ self._compute_wrench(p[k], a[k]), compute_box_frame(p[k])
            for i in range(num_latches):
                force = frame @ loads[3 * i : 3 * i + 3]
                moment = frame @ loads[3 * (num_latches + i) : 3 * (num_latches + i) + 3]
                reference = ca.DM(guess.angles[k, i])
                inverse_dynamics = self.loads[i](p[k], v[k], a[k], reference, force, moment)
                torque = inverse_dynamics[0] / module.max_torque
                self.store.between("load.torque", torque, -LOAD_FRACTION, LOAD_FRACTION)
                for name, value, limit in (
                    ("load.force", inverse_dynamics[1], module.max_force),
                    ("load.moment", inverse_dynamics[2], module.latch_moment),
                ):
                    utilisation = ca.sumsqr(value) / limit**2
                    self.store.between(name, utilisation, upper=LOAD_FRACTION**2)

    def _add_joint_limits(
        self,
        guess: PhaseTrajectory,
        p: list[ca.MX],
        v: list[ca.MX],
        step: ca.MX,
        cuts: Sequence[CollisionCut],
        is_first: bool,
    ) -> None:
        """Add joint ranges and speeds, distances from singularities, and cuts."""
        store, module = self.store, self.scene.module
        joint_range = np.array(module.joint_range) - RANGE_MARGIN
        limit = SPEED_FRACTION * module.max_joint_speed
        low, high = compute_margin_bounds(SINGULAR_MARGINS)
        for i, limb in enumerate(self.limbs):
            previous: ca.MX | None = None
            for k in range(len(p)):
                angles, rates, margins = self.arms[i](p[k], v[k], ca.DM(guess.angles[k, i]))
                # Where latches close, the approach along the normal needs additional range
                bound = joint_range - (APPROACH_MARGIN if is_first and k == 0 else 0.0)
                store.between("kinematics.joint_bounds", angles, -bound, bound, "rad")
                store.between("speed.limit", rates, -limit, limit, "rad/s")
                store.between("joint.branch", margins, low, high)
                if previous is not None:
                    change = angles - previous
                    store.between("speed.limit", change - limit * step, upper=0.0)
                    store.between("speed.limit", change + limit * step, 0.0)
                    store.minimise("turning", JOINT_SPEED_WEIGHT * ca.sumsqr(change) / step)
                previous = angles
                for cut in cuts:
                    if cut.limb == i and cut.knot == k:
                        self._add_cut(cut, limb, angles, p[k])

    def _add_cut(self, cut: CollisionCut, limb: SupportModule, angles: ca.MX, p: ca.MX) -> None:
        """Add a cutting plane for a point of a limb."""
        points, _, _ = self.chain(angles, ca.DM.zeros(6))
        frame = compute_box_frame(p)
        first, rotation = ca.MX(ca.DM(limb.fixed_position)), ca.MX(ca.DM(limb.other_rotation))
        if limb.box_end == 0:
            first = p[:3] + frame @ ca.DM(self.scene.side_offset(0, limb.side))
            rotation = frame @ ca.DM(limb.box_rotation)
        point = first + rotation @ points[:, cut.point]
        if cut.moves_with_box:
            point = frame.T @ (point - p[:3])
        self.store.between("collision.cut", ca.dot(ca.DM(cut.normal), point), cut.offset, unit="m")


def _yaw_entry(entries: ca.MX) -> ca.MX | float:
    """Return the yaw entry of a velocity or acceleration, 0 for a box that does not turn."""
    return entries[3] if entries.numel() == 4 else 0.0


def _read_trajectories(
    scene: ModuleScene,
    limbs: Sequence[SupportModule],
    values: Sequence[Array],
    guess: Sequence[PhaseTrajectory],
) -> tuple[PhaseTrajectory, ...]:
    """Return the solution phase by phase, with exact inverse kinematics so that chains close."""
    trajectories: list[PhaseTrajectory] = []
    for index, initial in enumerate(guess):
        duration, position, velocity, acceleration = values[4 * index : 4 * index + 4]
        angles = initial.angles
        if initial.phase.kind != "flight":
            angles = np.stack(
                [
                    _solve_angles(scene, limb, position, initial.angles[:, i])
                    for i, limb in enumerate(limbs)
                ],
                axis=1,
            )
        trajectories.append(
            replace(
                initial,
                duration=float(duration[0, 0]),
                position=position,
                velocity=velocity,
                acceleration=acceleration,
                angles=angles,
            )
        )
    return tuple(trajectories)


def _solve_angles(
    scene: ModuleScene, limb: SupportModule, position: Array, reference: Array
) -> Array:
    """Return the joint angles (K + 1, 6) of a limb near to reference angles."""
    first, last = compute_limb_frames(scene, limb, position, limb.fixed_position)
    angles = solve_inverse_kinematics(scene.module, first, last, limb.branch).angles
    unwrapped: Array = angles + np.round((reference - angles) / (2 * np.pi)) * 2 * np.pi
    return unwrapped
