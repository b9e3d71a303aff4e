"""Problem P of chapter 5.2.1 on a climb's scene: the posture program with forces and balance.

One set of contact forces a round, for the posture with all limbs on the ground, each of which
carries at least `posture.min_load` of the weight: what makes it a contact. A limb's region and
its friction cone are one choice: (toe, force) lies in region times pyramid, so that a slippery
region costs force where it is chosen. Moments are taken about fixed points, where postures alone
put the body: forces add up to a known one, so that part of the moment is linear, and on a flat wall
across an axis two of the six products of a limb are with a constant.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.legs import POSITION_SCALE
from climbplan.climb.envelopes.statement import compute_cone_rows, compute_cross
from climbplan.climb.postures.statement import (
    PostureMargins,
    build_posture_program,
    build_region_polytope,
    sum_of_squares,
)
from climbplan.climb.scene.climb_scene import ClimbScene, compute_load_wrench
from climbplan.errors import Unresolved
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Polytope, Program
from climbplan.program.instance import Instance
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.program.statement import Expression
from climbplan.solvers.highs.linear import LinearProgram, solve_linear
from climbplan.terrain.surfaces import Region

FORCE_LIMIT = 1.0  # of a force's components: they lie in [-1, 1], eq. (5.8) [weights]


@dataclass(frozen=True)
class ExternalLoad:
    """External force [weights] and moment about the body origin [weights m]."""

    force: Array  # (3,)
    moment: Array  # (3,)


def compute_scene_load(scene: ClimbScene) -> ExternalLoad:
    """Compute weight, payload and external load in the start's orientation."""
    wrench = compute_load_wrench(scene.spec, scene.robot, scene.start.rpy)
    weight = scene.robot.weight
    return ExternalLoad(wrench[:3] / weight - [0.0, 0.0, 1.0], wrench[3:] / weight)


def interpolate_body_path(scene: ClimbScene) -> Array:
    """Interpolate body origins (M, 3) of rounds 1..M from start to goal [m]."""
    fractions = np.arange(1, scene.spec.task.round_count + 1)[:, None] / scene.spec.task.round_count
    return scene.start.com + fractions * (scene.goal.com - scene.start.com)


def build_loaded_region(region: Region, safety: float) -> Polytope:
    """Build (toe, force) in R^6: the toe in the region, the force in its pyramid at mu / safety."""
    place = build_region_polytope(region)
    cone = compute_cone_rows(region.normal, np.asarray(region.friction / safety))
    zero = np.zeros((len(place.A), 3))
    return Polytope(
        name=region.name,
        A=np.block([[place.A, zero], [np.zeros((len(cone), 3)), cone]]),
        b=np.concatenate([place.b, np.zeros(len(cone))]),
        C=np.hstack([place.C, np.zeros((len(place.C), 3))]),
        c=place.c,
    )


def build_footed_region(region: Region, safety: float, radius: float) -> Polytope:
    """(toe, force, moment) in R^9: as `loaded_region`, and the moment about the toe of the force,
    which acts where a spherical foot of that radius [m] touches: -radius n x f."""
    loaded = build_loaded_region(region, safety)
    x, y, z = region.normal
    moment_rows = radius * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    equality_rows = np.hstack([np.zeros((3, 3)), moment_rows, np.eye(3)])
    return Polytope(
        name=loaded.name,
        A=np.hstack([loaded.A, np.zeros((len(loaded.A), 3))]),
        b=loaded.b,
        C=np.vstack([np.hstack([loaded.C, np.zeros((len(loaded.C), 3))]), equality_rows]),
        c=np.concatenate([loaded.c, np.zeros(3)]),
    )


def compute_force_range(scene: ClimbScene) -> ElementwiseRange:
    """Compute bounds (3,) of one limb's force by eq. (5.8) and the minimum load [weights]."""
    low = np.array([-FORCE_LIMIT, -FORCE_LIMIT, scene.spec.posture.min_load])
    return ElementwiseRange(low, np.full(3, FORCE_LIMIT))


def remove_unloadable_regions(scene: ClimbScene) -> ClimbScene:
    """Remove regions whose friction cone contains no force with the minimum load.

    Such a choice has no solution, so nothing is lost. Raises Unresolved for a limb without regions.
    """
    terrain, safety = scene.terrain, scene.spec.force.safety_friction
    force_bounds = compute_force_range(scene)
    is_loadable = np.ones(len(terrain.regions), bool)
    for k, surface in enumerate(terrain.regions):
        cone = compute_cone_rows(surface.normal, np.asarray(surface.friction / safety))
        program = LinearProgram(
            np.zeros(3),
            force_bounds.lower,
            force_bounds.upper,
            sparse.csr_matrix(cone),
            np.full(len(cone), -np.inf),
            np.zeros(len(cone)),
        )
        is_loadable[k] = solve_linear(program).x is not None
    allowed = terrain.allowed & is_loadable
    lost = np.flatnonzero(terrain.allowed.any(axis=1) & ~allowed.any(axis=1))
    stuck = [scene.robot.limb_names[limb] for limb in lost]
    if stuck:
        raise Unresolved(
            f"no region holds the load that each limb has to carry, for {', '.join(stuck)}: "
            f"posture.min_load is {scene.spec.posture.min_load:g} of the weight, friction is "
            f"mu / {safety:g} (S_mu); expected a smaller posture.min_load or more friction",
            because="the coupled methods require that every limb carries a share of the weight",
            stage="posture",
        )
    return replace(scene, terrain=replace(terrain, allowed=allowed))


def formulate_coupled_program(
    scene: ClimbScene, margins: PostureMargins, origin: Array | None = None
) -> Program:
    """State postures with forces and the balance of forces and moments.

    origin: (M, 3) points about which moments are taken; None takes the straight path. They change
    the tightness of envelopes, but not the feasible points.
    """
    load = compute_scene_load(scene)
    origin = interpolate_body_path(scene) if origin is None else origin
    safety, force_bounds = scene.spec.force.safety_friction, compute_force_range(scene)
    weight, foot = scene.spec.posture.weights.force, scene.robot.foot

    def state(p: Program, toe: Expression, com: Expression, regions: list[list[Region]]) -> None:
        m, n, _ = toe.shape
        # Forces in units of the weight, eq. (5.8)
        f = p.continuous("force", (m, n, 3), force_bounds.lower, force_bounds.upper, unit="weight")
        # Toes in one region each, eq. (5.6), and friction cones, eq. (5.15)
        both = np.concatenate([toe, f], axis=-1)
        if foot is None:
            per_limb = [
                [build_loaded_region(region, safety) for region in regions_of_limb]
                for regions_of_limb in regions
            ]
            p.one_of("contact.region", both, per_limb * m, unit="m, weight")
        else:
            max_moment = 2 * FORCE_LIMIT * foot.radius
            q = p.continuous("moment", (m, n, 3), -max_moment, max_moment, unit="weight m")
            both = np.concatenate([both, q], axis=-1)
            per_limb = [
                [build_footed_region(r, safety, foot.radius) for r in regions_of_limb]
                for regions_of_limb in regions
            ]
            p.one_of("contact.region", both, per_limb * m, unit="m, weight, weight m")
        # Balance of forces, eq. (5.10)
        p.equal("coupled.force_balance", np.sum(f, axis=1) + load.force, unit="weight")
        # Balance of moments, eqs. (5.11), (5.13)
        arm, body = toe - origin[:, None], com - origin
        forces = np.broadcast_to(load.force, (m, 3))
        moment = np.sum(compute_cross(arm, f), axis=1) + compute_cross(body, forces) + load.moment
        if foot is not None:
            moment = moment + np.sum(q, axis=1)
        p.equal("coupled.moment_balance", moment, unit="weight m")
        if weight > 0:
            p.minimise("force", weight * sum_of_squares(f))

    return build_posture_program(scene, margins, state)


def compute_envelope_range(
    program: Program, instance: Instance, envelope: Envelope, origin: Array
) -> ElementwiseRange:
    """Compute the instance's bounds, with toes and forces in the envelope about each origin."""
    lower, upper = instance.lower.copy(), instance.upper.copy()
    toe, force = program.variables["toe"], program.variables["force"]
    low, high = place_envelope(envelope, origin)
    for block, ends in ((toe, slice(0, 3)), (force, slice(3, 6))):
        columns = slice(block.start, block.stop)
        lower[columns] = np.maximum(lower[columns], low[..., ends].ravel())
        upper[columns] = np.minimum(upper[columns], high[..., ends].ravel())
    return ElementwiseRange(lower, upper)


def place_envelope(envelope: Envelope, origin: Array) -> tuple[Array, Array]:
    """Place an envelope: bounds (M, N, 6) of toes, world frame [m], and forces [weights]."""
    scale = np.array([POSITION_SCALE] * 3 + [1.0] * 3)
    shift = np.concatenate([origin, np.zeros_like(origin)], axis=1)[:, None]
    return shift + scale * envelope.lower, shift + scale * envelope.upper
