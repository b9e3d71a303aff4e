"""Problem P of chapter 5.2.1 on a climb's scene: the posture program with forces and balance.

One set of contact forces a round, for the posture with all limbs on the ground. A limb's region and
its friction cone are one choice: (toe, force) lies in region times pyramid, so that a slippery
region costs force where it is chosen. Moments are taken about the straight way from start to goal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.climb.postures.statement import PostureMargins, posture_program, region_polytope
from climbplan.climb.scene import ClimbScene, load_wrench
from climbplan.coupled.statement import cone_rows, cross
from climbplan.errors import Infeasible
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Polytope, Program
from climbplan.program.box import Range
from climbplan.program.instance import Instance
from climbplan.program.polytope import Array
from climbplan.program.statement import Expression
from climbplan.solvers.linear import LinearProgram, solve_linear
from climbplan.terrain.surfaces import Region


@dataclass(frozen=True)
class Load:
    """External force [weights] and moment about the body origin [weights m]."""

    force: Array  # (3,)
    moment: Array  # (3,)


def scene_load(scene: ClimbScene) -> Load:
    """Weight, payload and external load in the start's orientation."""
    wrench = load_wrench(scene.spec, scene.robot, scene.start.rpy)
    weight = scene.robot.weight
    return Load(wrench[:3] / weight - [0.0, 0.0, 1.0], wrench[3:] / weight)


def reference(scene: ClimbScene) -> Array:
    """Points about which moments of rounds 1..M are taken, (M, 3) [m]."""
    share = np.arange(1, scene.spec.task.rounds + 1)[:, None] / scene.spec.task.rounds
    return scene.start.com + share * (scene.goal.com - scene.start.com)


def loaded_region(region: Region, safety: float) -> Polytope:
    """(toe, force) in R^6: the toe in the region, the force in its pyramid at mu / safety."""
    place = region_polytope(region)
    cone = cone_rows(region.normal, np.asarray(region.friction / safety))
    zero = np.zeros((len(place.A), 3))
    return Polytope(
        name=region.name,
        A=np.block([[place.A, zero], [np.zeros((len(cone), 3)), cone]]),
        b=np.concatenate([place.b, np.zeros(len(cone))]),
        C=np.hstack([place.C, np.zeros((len(place.C), 3))]),
        c=place.c,
    )


def loadable(scene: ClimbScene, envelope: Envelope) -> ClimbScene:
    """The scene without regions on which no force of a limb's envelope is inside the friction cone.

    Such a choice has no solution, so nothing is lost. Raises Infeasible for a limb with none left.
    """
    terrain, safety = scene.terrain, scene.spec.force.safety_friction
    allowed = terrain.allowed.copy()
    for limb, region in zip(*np.nonzero(allowed), strict=True):
        surface = terrain.regions[region]
        cone = cone_rows(surface.normal, np.asarray(surface.friction / safety))
        low, high = envelope.lower[limb, 3:], envelope.upper[limb, 3:]
        program = LinearProgram(
            np.zeros(3),
            low,
            high,
            sparse.csr_matrix(cone),
            np.full(len(cone), -np.inf),
            np.zeros(len(cone)),
        )
        allowed[limb, region] = solve_linear(program).x is not None
    lost = np.flatnonzero(terrain.allowed.any(axis=1) & ~allowed.any(axis=1))
    stuck = [scene.robot.limb_names[limb] for limb in lost]
    if stuck:
        raise Infeasible(
            f"{', '.join(stuck)}: no region holds the load that each limb is to carry, at friction "
            f"mu / {safety:g} (S_mu)"
        )
    return replace(scene, terrain=replace(terrain, allowed=allowed))


def coupled_program(scene: ClimbScene, margins: PostureMargins, envelope: Envelope) -> Program:
    """Postures with forces and the balance of forces and moments.

    envelope: boxes of toes [P] and forces [weights] of all N limbs, of which forces count here.
    """
    load, origin = scene_load(scene), reference(scene)
    safety = scene.spec.force.safety_friction

    def state(p: Program, toe: Expression, com: Expression, regions: list[list[Region]]) -> None:
        m, n, _ = toe.shape
        low, high = envelope.lower[:, 3:], envelope.upper[:, 3:]
        f = p.continuous("force", (m, n, 3), low, high, unit="weight")
        per_limb = [[loaded_region(region, safety) for region in own] for own in regions]
        both = np.concatenate([toe, f], axis=-1)
        p.one_of("posture.contact_region", both, per_limb * m, unit="m, weight")
        p.equal("coupled.force_balance", np.sum(f, axis=1) + load.force, unit="weight")
        arm, body = toe - origin[:, None], com - origin
        forces = np.broadcast_to(load.force, (m, 3))
        turned = np.sum(cross(arm, f), axis=1) + cross(body, forces) + load.moment
        p.equal("coupled.moment_balance", turned, unit="weight m")

    return posture_program(scene, margins, state)


def envelope_range(
    scene: ClimbScene, program: Program, instance: Instance, envelope: Envelope, length: float
) -> Range:
    """Bounds of toes and forces by the envelope about each round's point of reference."""
    lower, upper = instance.lower.copy(), instance.upper.copy()
    toe = program.variables["toe"]
    at = slice(toe.start, toe.stop)
    origin = reference(scene)[:, None]
    lower[at] = np.maximum(lower[at], (origin + length * envelope.lower[:, :3]).ravel())
    upper[at] = np.minimum(upper[at], (origin + length * envelope.upper[:, :3]).ravel())
    return Range(lower, upper)
