"""Problem P of chapter 5.2.1 on a climb's scene: the posture program with forces and balance.

One set of contact forces a round, for the posture with all limbs on the ground, each of which
carries at least `posture.least_load` of the weight: what makes it a contact. A limb's region and
its friction cone are one choice: (toe, force) lies in region times pyramid, so that a slippery
region costs force where it is chosen. Moments are taken about fixed points, where postures alone
put the body: forces add up to a known one, so that part of the moment is linear, and on a flat wall
across an axis two of the six products of a limb are with a constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import POSITION_SCALE
from climbplan.climb.envelopes.statement import cone_rows, cross
from climbplan.climb.postures.statement import (
    PostureMargins,
    posture_program,
    region_polytope,
    sum_of_squares,
)
from climbplan.climb.scene.climb_scene import ClimbScene, load_wrench
from climbplan.errors import NotProved
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Polytope, Program
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import Range
from climbplan.program.statement import Expression
from climbplan.solvers.highs.linear import LinearProgram, solve_linear
from climbplan.terrain.surfaces import Region

FORCE_LIMIT = 1.0  # of a force's components: they lie in [-1, 1], eq. (5.8) [weights]


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


def straight_way(scene: ClimbScene) -> Array:
    """Body origins of rounds 1..M evenly from start to goal, (M, 3) [m]."""
    share = np.arange(1, scene.spec.task.round_count + 1)[:, None] / scene.spec.task.round_count
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


def footed_region(region: Region, safety: float, radius: float) -> Polytope:
    """(toe, force, moment) in R^9: as `loaded_region`, and the moment about the toe of the force,
    which acts where a spherical foot of that radius [m] touches: -radius n x f."""
    loaded = loaded_region(region, safety)
    x, y, z = region.normal
    turned = radius * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    tied = np.hstack([np.zeros((3, 3)), turned, np.eye(3)])
    return Polytope(
        name=loaded.name,
        A=np.hstack([loaded.A, np.zeros((len(loaded.A), 3))]),
        b=loaded.b,
        C=np.vstack([np.hstack([loaded.C, np.zeros((len(loaded.C), 3))]), tied]),
        c=np.concatenate([loaded.c, np.zeros(3)]),
    )


def force_range(scene: ClimbScene) -> Range:
    """Bounds of one limb's force, (3,) each [weights]: eq. (5.8), and the least load."""
    low = np.array([-FORCE_LIMIT, -FORCE_LIMIT, scene.spec.posture.least_load])
    return Range(low, np.full(3, FORCE_LIMIT))


def loadable(scene: ClimbScene) -> ClimbScene:
    """The scene without regions on which no force of at least the least load is inside the cone.

    Such a choice has no solution, so nothing is lost. Raises NotProved for a limb with none left.
    """
    terrain, safety = scene.terrain, scene.spec.force.safety_friction
    given = force_range(scene)
    holds = np.ones(len(terrain.regions), bool)
    for k, surface in enumerate(terrain.regions):
        cone = cone_rows(surface.normal, np.asarray(surface.friction / safety))
        program = LinearProgram(
            np.zeros(3),
            given.lower,
            given.upper,
            sparse.csr_matrix(cone),
            np.full(len(cone), -np.inf),
            np.zeros(len(cone)),
        )
        holds[k] = solve_linear(program).x is not None
    allowed = terrain.allowed & holds
    lost = np.flatnonzero(terrain.allowed.any(axis=1) & ~allowed.any(axis=1))
    stuck = [scene.robot.limb_names[limb] for limb in lost]
    if stuck:
        raise NotProved(
            f"{', '.join(stuck)}: no region holds the load that each limb is to carry "
            f"(posture.least_load {scene.spec.posture.least_load:g} of the weight), at friction "
            f"mu / {safety:g} (S_mu)",
            because="that every limb carries a share is a bound of the coupled methods",
            stage="posture",
        )
    return replace(scene, terrain=replace(terrain, allowed=allowed))


def coupled_program(
    scene: ClimbScene, margins: PostureMargins, origin: Array | None = None
) -> Program:
    """Postures with forces and the balance of forces and moments.

    origin: (M, 3) points about which moments are taken, on the straight way if left out. They
    change how tight envelopes are, not which points are feasible.
    """
    load = scene_load(scene)
    origin = straight_way(scene) if origin is None else origin
    safety, given = scene.spec.force.safety_friction, force_range(scene)
    weight, foot = scene.spec.posture.weights.force, scene.robot.foot

    def state(p: Program, toe: Expression, com: Expression, regions: list[list[Region]]) -> None:
        m, n, _ = toe.shape
        # Forces in units of the weight, eq. (5.8)
        f = p.continuous("force", (m, n, 3), given.lower, given.upper, unit="weight")
        # Toes in one region each, eq. (5.6), and friction cones, eq. (5.15)
        both = np.concatenate([toe, f], axis=-1)
        if foot is None:
            per_limb = [[loaded_region(region, safety) for region in own] for own in regions]
            p.one_of("contact.region", both, per_limb * m, unit="m, weight")
        else:
            most = 2 * FORCE_LIMIT * foot.radius
            q = p.continuous("moment", (m, n, 3), -most, most, unit="weight m")
            both = np.concatenate([both, q], axis=-1)
            per_limb = [[footed_region(r, safety, foot.radius) for r in own] for own in regions]
            p.one_of("contact.region", both, per_limb * m, unit="m, weight, weight m")
        # Balance of forces, eq. (5.10)
        p.equal("coupled.force_balance", np.sum(f, axis=1) + load.force, unit="weight")
        # Balance of moments, eqs. (5.11), (5.13)
        arm, body = toe - origin[:, None], com - origin
        forces = np.broadcast_to(load.force, (m, 3))
        turned = np.sum(cross(arm, f), axis=1) + cross(body, forces) + load.moment
        if foot is not None:
            turned = turned + np.sum(q, axis=1)
        p.equal("coupled.moment_balance", turned, unit="weight m")
        if weight > 0:
            p.minimise("force", weight * sum_of_squares(f))

    return posture_program(scene, margins, state)


def envelope_range(
    program: Program, instance: Instance, envelope: Envelope, origin: Array
) -> Range:
    """The instance's bounds, those of toes and forces within the envelope about each origin."""
    lower, upper = instance.lower.copy(), instance.upper.copy()
    toe, force = program.variables["toe"], program.variables["force"]
    low, high = placed(envelope, origin)
    for block, ends in ((toe, slice(0, 3)), (force, slice(3, 6))):
        at = slice(block.start, block.stop)
        lower[at] = np.maximum(lower[at], low[..., ends].ravel())
        upper[at] = np.minimum(upper[at], high[..., ends].ravel())
    return Range(lower, upper)


def placed(envelope: Envelope, origin: Array) -> tuple[Array, Array]:
    """Lower and upper ends (M, N, 6) of toes, world frame [m], and forces [weights]."""
    scale = np.array([POSITION_SCALE] * 3 + [1.0] * 3)
    shift = np.concatenate([origin, np.zeros_like(origin)], axis=1)[:, None]
    return shift + scale * envelope.lower, shift + scale * envelope.upper
