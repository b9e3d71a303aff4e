"""The program of a contact sequence of a quadruped, for IPOPT through CasADi.

Variables: durations; position, velocity and acceleration of the box at knots; footholds; forces at
knots; joint splines of feet in the air. Standing legs are closed forms of these.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.footholds import PATCH_MARGIN
from climbplan.limms.legs.joint_splines import rate_weights, spline_weights
from climbplan.limms.legs.statement import (
    CONTROLS,
    BoxCut,
    LegCut,
    LegEnds,
    LegPhase,
    LegSample,
    LegTrace,
)
from climbplan.limms.legs.symbols import leg_function, limits_of
from climbplan.limms.modules.chain_symbols import chain_function
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, Scene
from climbplan.limms.scene.phases import Limb
from climbplan.program.trajectory import Trajectory

SPEED_SHARE = 0.95  # of the joint speed limit
FORCE_SHARE = 0.985
CONE_SHARE = 0.96
# With masses legs have no rows for their own loads: feet that all stand bear hardly more of the box
# than an even share each, others no more than it weighs, and so it moves calmly
EVEN = 1.2
RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] further where latches close: a module still has to get there
OWN_SIDE = 0.02  # [m] of a foot ahead of its face of the box
KEEPING = 2.0  # [s/m^2] for footholds away from those of the guess, which were found clear
LEAST_SHARE = 0.04  # of the box's weight on a foot that stands: room for what knots leave out
LIFTED = 0.015  # [m] of a foot in the air over the lower of both grounds, between its ends
SHARES = (0.2, 0.4, 0.6, 0.8)  # of a swing where that holds
MAX_BOX_SPEED = 8.0  # [m/s]
HARDEST = 60.0  # [m/s^2]


class LegProgram:
    """Adds phase after phase."""

    def __init__(self, scene: Scene, limbs: Sequence[Limb], has_steps: bool) -> None:
        """has_steps: whether feet leave the ground."""
        self.scene, self.limbs, self.store = scene, limbs, Trajectory("legs")
        calm = scene.weight * (1.0 if has_steps else EVEN / len(limbs))
        held = scene.module.max_force
        self.most = FORCE_SHARE * (held if scene.massless else min(held, calm))  # of a foot [N]
        self.chain = chain_function(scene.module)
        self.leg = [leg_function(scene.module, limb, scene.box_size[0]) for limb in limbs]
        self.outputs: list[ca.MX] = []
        self.feet: list[ca.MX] = []
        self.end: tuple[ca.MX, ca.MX] | None = None
        self.begin: tuple[ca.MX, ca.MX] | None = None

    def phase(
        self,
        guess: LegTrace,
        samples: Sequence[LegSample],
        cuts: Sequence[LegCut | BoxCut],
        ends: LegEnds,
    ) -> None:
        """One phase: motion, feet, legs, forces."""
        store, phase = self.store, guess.phase
        is_first = self.begin is None
        if is_first:
            self.feet = [self._foothold(phase, i, guess.before[i]) for i in range(len(self.limbs))]
            if ends.feet is not None:
                for foot, given in zip(self.feet, ends.feet, strict=True):
                    store.equal("ground.feet", foot[:2] - ca.DM(given[:2]), "m")
        shortest = phase.shortest / (self.scene.pace if phase.swing else 1.0)
        duration = store.variable("T", guess.duration, shortest, phase.longest)
        p, v, a = self._motion(guess, duration)
        before = self.feet
        after = [
            self._foothold(phase, i, guess.after[i]) if i in phase.swing else before[i]
            for i in range(len(self.limbs))
        ]
        self.feet = after
        standing = [i for i in range(len(self.limbs)) if i not in phase.swing]
        count = phase.intervals
        path = _Path(p, v, a, duration)
        shares = [(k / count, i) for k in range(count + 1) for i in standing]
        shares += [(s.share, s.limb) for s in samples if s.limb in standing]
        for share, i in shares:
            at, speed = path.at(share)
            closing = is_first and share == 0.0
            self._stands(i, at, speed, before[i], closing)
        controls = [
            self._swings(i, guess, path, before[i], after[i]) if i in phase.swing else None
            for i in range(len(self.limbs))
        ]
        for cut in cuts:
            if isinstance(cut, BoxCut):
                place = ca.dot(ca.DM(cut.normal), path.at(cut.share)[0])
                store.between("clear.cut", place, cut.offset, unit="m")
            else:
                self._cut(cut, path, before[cut.limb], controls[cut.limb])
        force = self._forces(guess, p, a, before, standing)
        if self.end is not None:
            store.equal("box.motion", p[0] - self.end[0])
            store.equal("box.motion", v[0] - self.end[1])
        self.begin = self.begin or (p[0], v[0])
        self.end = (p[-1], v[-1])
        nothing = ca.MX.zeros(CONTROLS, 6)
        self.outputs += [
            duration,
            ca.horzcat(*p).T,
            ca.horzcat(*v).T,
            ca.horzcat(*a).T,
            ca.horzcat(*before).T,
            ca.horzcat(*after).T,
            ca.vertcat(*(nothing if c is None else ca.horzcat(*c).T for c in controls)),
            ca.horzcat(*(ca.vertcat(*row) for row in force)).T,
        ]

    def finish(self, ends: LegEnds) -> None:
        """Rest at both ends."""
        assert self.begin is not None
        assert self.end is not None
        for (p, v), where, name in (
            (self.begin, ends.start, "start"),
            (self.end, ends.goal, "goal"),
        ):
            self.store.equal(f"{name}.reached", p - ca.DM(where), "m")
            self.store.equal(f"{name}.speed", v, "m/s")

    def _foothold(self, phase: LegPhase, limb: int, start: Array) -> ca.MX:
        ground = self.scene.patches[phase.patches[limb]]
        margin = PATCH_MARGIN
        flat = self.store.variable("F", start[:2], ground.lower + margin, ground.upper - margin)
        self.store.minimise("footholds", KEEPING * ca.sumsqr(flat - ca.DM(start[:2])))
        return ca.vertcat(flat, ground.height)

    def _motion(
        self, guess: LegTrace, duration: ca.MX
    ) -> tuple[list[ca.MX], list[ca.MX], list[ca.MX]]:
        """A chain of cubics whose control points are in the phase's free block."""
        store, phase = self.store, guess.phase
        knots = range(phase.intervals + 1)
        p = [store.variable("p", guess.position[k], phase.lower, phase.upper) for k in knots]
        v = [store.variable("v", guess.velocity[k], -MAX_BOX_SPEED, MAX_BOX_SPEED) for k in knots]
        a = [store.variable("a", guess.acceleration[k], -HARDEST, HARDEST) for k in knots]
        step = duration / phase.intervals
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(phase.intervals):
            store.equal("box.motion", v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2)
            store.equal(
                "box.motion", p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6
            )
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.between("clear.box", control - lower, 0.0, unit="m")
                store.between("clear.box", upper - control, 0.0, unit="m")
            store.minimise("acceleration", 0.02 * step * ca.sumsqr((a[k] + a[k + 1]) / 2))
        store.minimise("time", duration)
        return p, v, a

    def _stands(self, i: int, at: ca.MX, speed: ca.MX, foot: ca.MX, closing: bool) -> None:
        """Reach, ranges and speeds of a standing leg; its foot on its own side (chapter 6.3)."""
        store, module = self.store, self.scene.module
        _, speeds, limits = self.leg[i](at - foot, speed)
        bounds = limits_of(module, RANGE_MARGIN + (APPROACH_MARGIN if closing else 0.0))
        store.between("joint.range", limits, bounds.lower, bounds.upper)
        speeds = speeds / module.max_joint_speed
        store.between("joint.speed", speeds, -SPEED_SHARE, SPEED_SHARE)
        normal = SIDE_NORMALS[self.limbs[i].side]
        half = float(abs(normal) @ self.scene.box_size[0] / 2)
        ahead = ca.dot(ca.DM(normal), foot - at)
        store.between("support.sides", ahead, half + OWN_SIDE, unit="m")

    def _swings(
        self, i: int, guess: LegTrace, path: _Path, before: ca.MX, after: ca.MX
    ) -> list[ca.MX]:
        """Joint spline of a foot in the air, from the leg's pose before to that after it."""
        store, module = self.store, self.scene.module
        bound = np.array(module.joint_range) - RANGE_MARGIN
        controls = [
            store.variable("c", guess.controls[i, j], -bound, bound) for j in range(CONTROLS)
        ]
        ends = rate_weights(CONTROLS)[[0, -1]]
        for share, control, foot, weights in (
            (0.0, controls[0], before, ends[0]),
            (1.0, controls[-1], after, ends[1]),
        ):
            at, moving = path.at(share)
            angles, speeds, _ = self.leg[i](at - foot, moving)
            store.equal("swing.ends", ca.sin(control - angles))  # up to whole turns of the guess
            store.between("swing.ends", ca.cos(control - angles), 0.5)
            if not self.scene.massless:  # nothing turns what has mass faster at once
                rate = sum(w * c for w, c in zip(weights, controls, strict=True) if w)
                store.equal("swing.blow", (rate - path.duration * speeds) / 10.0, "10 rad")
        limit = SPEED_SHARE * module.max_joint_speed
        for row in rate_weights(CONTROLS):
            rate = sum(w * c for w, c in zip(row, controls, strict=True) if w)
            store.between("joint.speed", rate - limit * path.duration, upper=0.0)
            store.between("joint.speed", rate + limit * path.duration, 0.0)
            store.minimise("turning", 0.005 * ca.sumsqr(rate) / path.duration / len(controls))
        ground = ca.fmin(before[2], after[2])
        for share in SHARES:
            points = self._points_in_air(i, share, path, controls)
            store.between("swing.lift", points[2, 0] - ground, LIFTED, unit="m")
        return controls

    def _points_in_air(self, i: int, share: float, path: _Path, controls: list[ca.MX]) -> ca.MX:
        """All points (3, 8) of a leg whose foot is in the air."""
        weights = spline_weights(CONTROLS, np.array([share]))[0]
        q = sum(w * c for w, c in zip(weights, controls, strict=True) if w)
        points, rotation, _ = self.chain(q, ca.DM.zeros(6))
        limb = self.limbs[i]
        foot = ca.DM(limb.box_rotation) @ rotation.T  # rotation of the first end
        last = path.at(share)[0] + ca.DM(self.scene.side_offset(0, limb.side))
        return ca.repmat(last - foot @ points[:, 7], 1, 8) + foot @ points

    def _cut(self, cut: LegCut, path: _Path, foot: ca.MX, controls: list[ca.MX] | None) -> None:
        at, _ = path.at(cut.share)
        if controls is not None:
            points = self._points_in_air(cut.limb, cut.share, path, controls)
        else:
            angles, _, _ = self.leg[cut.limb](at - foot, ca.DM.zeros(3))
            points, _, _ = self.chain(angles, ca.DM.zeros(6))
            points = ca.repmat(foot, 1, 8) + points
        point = points[:, cut.point]
        if cut.point == 0:  # the middle of the foot's end, one radius up its link
            module = self.scene.module
            share = module.radius / sum(module.link_lengths[:2])
            point = point + share * (points[:, 2] - point)
        if cut.moves_with_box:
            point = point - at
        self.store.between("clear.cut", ca.dot(ca.DM(cut.normal), point), cut.offset, unit="m")

    def _forces(
        self,
        guess: LegTrace,
        p: list[ca.MX],
        a: list[ca.MX],
        feet: list[ca.MX],
        standing: Sequence[int],
    ) -> list[list[ca.MX]]:
        """Dynamics, eq. (6.5), moment balance, eq. (6.6), friction, eq. (6.8)."""
        store, scene = self.store, self.scene
        mass, most = float(scene.box_mass[0]), self.most
        friction = CONE_SHARE * scene.friction
        up = ca.DM([0, 0, GRAVITY])
        rows = []
        for k in range(len(a)):
            total, moment = ca.MX.zeros(3), ca.MX.zeros(3)
            row = [ca.MX.zeros(3)] * len(self.limbs)
            for i in standing:
                low = np.array([-1.0, -1.0, LEAST_SHARE * scene.weight / most])
                unit = store.variable("f", guess.force[k, i] / most, low, 1.0)
                store.between("force.limit", ca.sumsqr(unit), 0.0, 1.0)
                cone = (friction * unit[2]) ** 2 - unit[0] ** 2 - unit[1] ** 2
                store.between("force.friction", cone, 0.0)
                row[i] = most * unit
                total += row[i]
                moment += ca.cross(feet[i] - p[k], row[i])
                store.minimise("force", 0.01 * ca.sumsqr(unit))
            store.equal("box.dynamics", (mass * (a[k] + up) - total) / 10.0, "10 N")
            if standing:
                store.equal("box.moment", moment / 10.0, "10 N m")
            rows.append(row)
        return rows

    def traces(self, read: Sequence[Array], guess: Sequence[LegTrace]) -> tuple[LegTrace, ...]:
        """The answer, phase by phase."""
        n = len(self.limbs)
        found = []
        for number, old in enumerate(guess):
            duration, p, v, a, before, after, controls, force = read[8 * number : 8 * number + 8]
            found.append(
                LegTrace(
                    old.phase,
                    float(duration[0, 0]),
                    p,
                    v,
                    a,
                    before,
                    after,
                    controls.reshape(n, CONTROLS, 6),
                    force.reshape(-1, n, 3),
                )
            )
        return tuple(found)


class _Path:
    """A box's chain of cubics in symbols."""

    def __init__(self, p: list[ca.MX], v: list[ca.MX], a: list[ca.MX], duration: ca.MX) -> None:
        self.p, self.v, self.a, self.duration = p, v, a, duration

    def at(self, share: float) -> tuple[ca.MX, ca.MX]:
        """Position and velocity at a share of the time."""
        count = len(self.p) - 1
        k = min(int(share * count + 1e-9), count)
        rest = share * count - k
        if rest < 1e-9:
            return self.p[k], self.v[k]
        step = self.duration / count
        t = rest * step
        bend = rest * (self.a[k + 1] - self.a[k])
        return (
            self.p[k] + t * self.v[k] + t**2 * (self.a[k] / 2 + bend / 6),
            self.v[k] + t * (self.a[k] + bend / 2),
        )
