"""The nonlinear program of a contact sequence of a quadruped, for IPOPT through CasADi.

The program minimises durations, accelerations, forces and joint motion. Variables are durations;
position, velocity and acceleration of the box at knots; footholds; forces at knots; and joint
splines of swing feet. Standing legs are closed forms of these. Constraints are dynamics, eqs. (6.5)
and (6.6), friction, free blocks, joint ranges and speeds, and cuts.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.footholds import PATCH_MARGIN
from climbplan.limms.legs.joint_splines import compute_rate_weights, compute_spline_weights
from climbplan.limms.legs.leg_phases import (
    CONTROLS,
    BoxCut,
    LegBoundary,
    LegCut,
    LegPhase,
    LegSample,
    LegTrajectory,
)
from climbplan.limms.legs.symbols import build_leg_function, compute_limit_bounds
from climbplan.limms.modules.chain_symbols import build_chain_function
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, ModuleScene
from climbplan.limms.scene.phases import SupportModule
from climbplan.program.staged_program import StagedProgram

SPEED_FRACTION = 0.95  # of the joint speed limit
FORCE_FRACTION = 0.985
CONE_FRACTION = 0.96
# With masses there are no rows for the loads of legs themselves. Limits on feet keep motion calm:
# little more than an even load where all feet stand, else at most the weight of the box
MAX_LOAD_RATIO = 1.2
RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] in addition where latches close, for the approach of the module
FACE_CLEARANCE = 0.02  # [m] of a foot in front of its face of the box
FOOTHOLD_WEIGHT = 2.0  # [s/m^2] of footholds around those of the guess, which are free of collision
MIN_LOAD_FRACTION = 0.04  # of the weight of the box on a standing foot, a margin between knots
SWING_CLEARANCE = 0.015  # [m] of a swing foot above the lower of both grounds
SWING_FRACTIONS = (0.2, 0.4, 0.6, 0.8)  # of a swing, where the clearance applies
MAX_BOX_SPEED = 8.0  # [m/s]
MAX_ACCELERATION = 60.0  # [m/s^2]


class LegProgram:
    """The program under construction, phase after phase."""

    def __init__(self, scene: ModuleScene, limbs: Sequence[SupportModule], has_steps: bool) -> None:
        """Initialise without phases.

        Args:
            scene: The scene.
            limbs: The legs.
            has_steps: Whether feet leave the ground.
        """
        self.scene, self.limbs, self.store = scene, limbs, StagedProgram("legs")
        load_limit = scene.weight * (1.0 if has_steps else MAX_LOAD_RATIO / len(limbs))
        max_latch_force = scene.module.max_force
        self.max_force = FORCE_FRACTION * (
            max_latch_force if scene.massless else min(max_latch_force, load_limit)
        )  # of a foot [N]
        self.chain = build_chain_function(scene.module)
        self.leg = [build_leg_function(scene.module, limb, scene.box_size[0]) for limb in limbs]
        self.outputs: list[ca.MX] = []
        self.feet: list[ca.MX] = []
        self.last_state: tuple[ca.MX, ca.MX] | None = None
        self.first_state: tuple[ca.MX, ca.MX] | None = None

    def add_phase(
        self,
        guess: LegTrajectory,
        samples: Sequence[LegSample],
        cuts: Sequence[LegCut | BoxCut],
        ends: LegBoundary,
    ) -> None:
        """Add one phase: motion, feet, legs, forces."""
        store, phase = self.store, guess.phase
        is_first = self.first_state is None
        if is_first:
            self._add_first_footholds(guess, ends)
        shortest = phase.shortest / (self.scene.pace if phase.swing else 1.0)
        duration = store.variable("T", guess.duration, shortest, phase.longest)
        p, v, a = self._add_motion(guess, duration)
        feet_before = self.feet
        feet_after = [
            self._add_foothold(phase, i, guess.after[i]) if i in phase.swing else feet_before[i]
            for i in range(len(self.limbs))
        ]
        self.feet = feet_after
        standing = [i for i in range(len(self.limbs)) if i not in phase.swing]
        num_intervals = phase.intervals
        path = _BoxSpline(p, v, a, duration)
        sampled = [(k / num_intervals, i) for k in range(num_intervals + 1) for i in standing]
        sampled += [(s.time_fraction, s.limb) for s in samples if s.limb in standing]
        for fraction, i in sampled:
            position, speed = path.evaluate(fraction)
            is_latching = is_first and fraction == 0.0
            self._add_stance(i, position, speed, feet_before[i], is_latching)
        controls = [
            self._add_swing(i, guess, path, feet_before[i], feet_after[i])
            if i in phase.swing
            else None
            for i in range(len(self.limbs))
        ]
        for cut in cuts:
            if isinstance(cut, BoxCut):
                projection = ca.dot(ca.DM(cut.normal), path.evaluate(cut.time_fraction)[0])
                store.between("collision.cut", projection, cut.offset, unit="m")
            else:
                self._add_cut(cut, path, feet_before[cut.limb], controls[cut.limb])
        force = self._add_forces(guess, p, a, feet_before, standing)
        if self.last_state is not None:
            store.equal("box.kinematics", p[0] - self.last_state[0])
            store.equal("box.kinematics", v[0] - self.last_state[1])
        self.first_state = self.first_state or (p[0], v[0])
        self.last_state = (p[-1], v[-1])
        no_controls = ca.MX.zeros(CONTROLS, 6)
        self.outputs += [
            duration,
            ca.horzcat(*p).T,
            ca.horzcat(*v).T,
            ca.horzcat(*a).T,
            ca.horzcat(*feet_before).T,
            ca.horzcat(*feet_after).T,
            ca.vertcat(*(no_controls if c is None else ca.horzcat(*c).T for c in controls)),
            ca.horzcat(*(ca.vertcat(*row) for row in force)).T,
        ]

    def finish(self, ends: LegBoundary) -> None:
        """Add rest at both ends."""
        assert self.first_state is not None
        assert self.last_state is not None
        for (p, v), target, name in (
            (self.first_state, ends.start, "start"),
            (self.last_state, ends.goal, "goal"),
        ):
            self.store.equal(f"{name}.position", p - ca.DM(target), "m")
            self.store.equal(f"{name}.speed", v, "m/s")

    def _add_first_footholds(self, guess: LegTrajectory, ends: LegBoundary) -> None:
        """Add the footholds of the first phase, at those of the boundary where it has some."""
        self.feet = [
            self._add_foothold(guess.phase, i, guess.before[i]) for i in range(len(self.limbs))
        ]
        if ends.feet is not None:
            for foot, foothold in zip(self.feet, ends.feet, strict=True):
                self.store.equal("ground.feet", foot[:2] - ca.DM(foothold[:2]), "m")

    def _add_foothold(self, phase: LegPhase, limb: int, start: Array) -> ca.MX:
        """Add a foothold on a patch, and return its position."""
        ground = self.scene.patches[phase.patches[limb]]
        margin = PATCH_MARGIN
        position = self.store.variable("F", start[:2], ground.lower + margin, ground.upper - margin)
        self.store.minimise("footholds", FOOTHOLD_WEIGHT * ca.sumsqr(position - ca.DM(start[:2])))
        return ca.vertcat(position, ground.height)

    def _add_motion(
        self, guess: LegTrajectory, duration: ca.MX
    ) -> tuple[list[ca.MX], list[ca.MX], list[ca.MX]]:
        """Add a chain of cubics whose control points are in the phase's free block."""
        store, phase = self.store, guess.phase
        knots = range(phase.intervals + 1)
        p = [store.variable("p", guess.position[k], phase.lower, phase.upper) for k in knots]
        v = [store.variable("v", guess.velocity[k], -MAX_BOX_SPEED, MAX_BOX_SPEED) for k in knots]
        a = [
            store.variable("a", guess.acceleration[k], -MAX_ACCELERATION, MAX_ACCELERATION)
            for k in knots
        ]
        step = duration / phase.intervals
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(phase.intervals):
            store.equal("box.kinematics", v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2)
            store.equal(
                "box.kinematics",
                p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6,
            )
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.between("box.collision", control - lower, 0.0, unit="m")
                store.between("box.collision", upper - control, 0.0, unit="m")
            store.minimise("acceleration", 0.02 * step * ca.sumsqr((a[k] + a[k + 1]) / 2))
        store.minimise("time", duration)
        return p, v, a

    def _add_stance(
        self, i: int, position: ca.MX, speed: ca.MX, foot: ca.MX, is_latching: bool
    ) -> None:
        """Add reach, ranges and speeds of a standing leg; its foot is on its side (chapter 6.3)."""
        store, module = self.store, self.scene.module
        _, speeds, limits = self.leg[i](position - foot, speed)
        bounds = compute_limit_bounds(
            module, RANGE_MARGIN + (APPROACH_MARGIN if is_latching else 0.0)
        )
        store.between("kinematics.joint_bounds", limits, bounds.lower, bounds.upper)
        speeds = speeds / module.max_joint_speed
        store.between("speed.limit", speeds, -SPEED_FRACTION, SPEED_FRACTION)
        normal = SIDE_NORMALS[self.limbs[i].side]
        half = float(abs(normal) @ self.scene.box_size[0] / 2)
        face_distance = ca.dot(ca.DM(normal), foot - position)
        store.between("support.sides", face_distance, half + FACE_CLEARANCE, unit="m")

    def _add_swing(
        self, i: int, guess: LegTrajectory, path: _BoxSpline, before: ca.MX, after: ca.MX
    ) -> list[ca.MX]:
        """Add the joint spline of a swing foot, from the leg's pose before to that after it."""
        store, module = self.store, self.scene.module
        bound = np.array(module.joint_range) - RANGE_MARGIN
        controls = [
            store.variable("c", guess.controls[i, j], -bound, bound) for j in range(CONTROLS)
        ]
        ends = compute_rate_weights(CONTROLS)[[0, -1]]
        for fraction, control, foot, weights in (
            (0.0, controls[0], before, ends[0]),
            (1.0, controls[-1], after, ends[1]),
        ):
            position, velocity = path.evaluate(fraction)
            angles, speeds, _ = self.leg[i](position - foot, velocity)
            store.equal("swing.ends", ca.sin(control - angles))  # up to the full turns of the guess
            store.between("swing.ends", ca.cos(control - angles), 0.5)
            if not self.scene.massless:  # links with mass cannot change speed at once
                rate = sum(w * c for w, c in zip(weights, controls, strict=True) if w)
                store.equal("swing.blow", (rate - path.duration * speeds) / 10.0, "10 rad")
        limit = SPEED_FRACTION * module.max_joint_speed
        for row in compute_rate_weights(CONTROLS):
            rate = sum(w * c for w, c in zip(row, controls, strict=True) if w)
            store.between("speed.limit", rate - limit * path.duration, upper=0.0)
            store.between("speed.limit", rate + limit * path.duration, 0.0)
            store.minimise("turning", 0.005 * ca.sumsqr(rate) / path.duration / len(controls))
        ground = ca.fmin(before[2], after[2])
        for fraction in SWING_FRACTIONS:
            points = self._swing_points(i, fraction, path, controls)
            store.between("swing.lift", points[2, 0] - ground, SWING_CLEARANCE, unit="m")
        return controls

    def _swing_points(
        self, i: int, fraction: float, path: _BoxSpline, controls: list[ca.MX]
    ) -> ca.MX:
        """Return all points (3, 8) of a leg in swing."""
        weights = compute_spline_weights(CONTROLS, np.array([fraction]))[0]
        q = sum(w * c for w, c in zip(weights, controls, strict=True) if w)
        points, rotation, _ = self.chain(q, ca.DM.zeros(6))
        limb = self.limbs[i]
        foot = ca.DM(limb.box_rotation) @ rotation.T  # rotation of the first end
        last = path.evaluate(fraction)[0] + ca.DM(self.scene.side_offset(0, limb.side))
        return ca.repmat(last - foot @ points[:, 7], 1, 8) + foot @ points

    def _add_cut(
        self, cut: LegCut, path: _BoxSpline, foot: ca.MX, controls: list[ca.MX] | None
    ) -> None:
        """Add a cutting plane for a point of a leg."""
        position, _ = path.evaluate(cut.time_fraction)
        if controls is not None:
            points = self._swing_points(cut.limb, cut.time_fraction, path, controls)
        else:
            angles, _, _ = self.leg[cut.limb](position - foot, ca.DM.zeros(3))
            points, _, _ = self.chain(angles, ca.DM.zeros(6))
            points = ca.repmat(foot, 1, 8) + points
        point = points[:, cut.point]
        if cut.point == 0:  # the centre of the foot, one radius up its link
            module = self.scene.module
            fraction = module.radius / sum(module.link_lengths[:2])
            point = point + fraction * (points[:, 2] - point)
        if cut.moves_with_box:
            point = point - position
        self.store.between("collision.cut", ca.dot(ca.DM(cut.normal), point), cut.offset, unit="m")

    def _add_forces(
        self,
        guess: LegTrajectory,
        p: list[ca.MX],
        a: list[ca.MX],
        feet: list[ca.MX],
        standing: Sequence[int],
    ) -> list[list[ca.MX]]:
        """Add dynamics, eq. (6.5), moment balance, eq. (6.6), and friction, eq. (6.8)."""
        store, scene = self.store, self.scene
        mass, max_force = float(scene.box_mass[0]), self.max_force
        friction = CONE_FRACTION * scene.friction
        gravity = ca.DM([0, 0, GRAVITY])
        rows = []
        for k in range(len(a)):
            total, moment = ca.MX.zeros(3), ca.MX.zeros(3)
            row = [ca.MX.zeros(3)] * len(self.limbs)
            for i in standing:
                low = np.array([-1.0, -1.0, MIN_LOAD_FRACTION * scene.weight / max_force])
                unit = store.variable("f", guess.force[k, i] / max_force, low, 1.0)
                store.between("force.limit", ca.sumsqr(unit), 0.0, 1.0)
                cone = (friction * unit[2]) ** 2 - unit[0] ** 2 - unit[1] ** 2
                store.between("force.friction", cone, 0.0)
                row[i] = max_force * unit
                total += row[i]
                moment += ca.cross(feet[i] - p[k], row[i])
                store.minimise("force", 0.01 * ca.sumsqr(unit))
            store.equal("box.dynamics", (mass * (a[k] + gravity) - total) / 10.0, "10 N")
            if standing:
                store.equal("box.moment", moment / 10.0, "10 N m")
            rows.append(row)
        return rows

    def read_trajectories(
        self, values: Sequence[Array], guess: Sequence[LegTrajectory]
    ) -> tuple[LegTrajectory, ...]:
        """Return the solution phase by phase."""
        num_limbs = len(self.limbs)
        trajectories = []
        for index, initial in enumerate(guess):
            duration, p, v, a, before, after, controls, force = values[8 * index : 8 * index + 8]
            trajectories.append(
                LegTrajectory(
                    initial.phase,
                    float(duration[0, 0]),
                    p,
                    v,
                    a,
                    before,
                    after,
                    controls.reshape(num_limbs, CONTROLS, 6),
                    force.reshape(-1, num_limbs, 3),
                )
            )
        return tuple(trajectories)


class _BoxSpline:
    """The box's chain of cubics in symbols."""

    def __init__(self, p: list[ca.MX], v: list[ca.MX], a: list[ca.MX], duration: ca.MX) -> None:
        self.p, self.v, self.a, self.duration = p, v, a, duration

    def evaluate(self, fraction: float) -> tuple[ca.MX, ca.MX]:
        """Return position and velocity at a fraction of the time."""
        num_intervals = len(self.p) - 1
        k = min(int(fraction * num_intervals + 1e-9), num_intervals)
        remainder = fraction * num_intervals - k
        if remainder < 1e-9:
            return self.p[k], self.v[k]
        step = self.duration / num_intervals
        t = remainder * step
        acceleration_change = remainder * (self.a[k + 1] - self.a[k])
        return (
            self.p[k] + t * self.v[k] + t**2 * (self.a[k] / 2 + acceleration_change / 6),
            self.v[k] + t * (self.a[k] + acceleration_change / 2),
        )
