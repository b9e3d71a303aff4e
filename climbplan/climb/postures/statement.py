"""The posture problem of chapter 5.1.3, stated once as a mixed-integer convex program.

Decision variables for rounds j = 1..M are the toes p_i[j], the body origin p_COM[j] and the
rotation Theta[j] = (roll, pitch, yaw). Round 0 is the given start.

    minimise    squared distances to the goal + squared steps of body, toes and rotation
    subject to  |steps| <= com_max, toe_max, rotation_max per round        A, B
                |p_i - p_COM - R v_i| <= radius_i                          C  workspace balls
                first joints within their bounds                           C  coxa wedges
                p_i in one contact region (one-of)                         D
                body corners in one free region per obstacle (one-of)      body.clearance
                limb beyond one face of every obstacle (one-of)            limbs.axis_collision
                goal within tolerance

Rotations are linearised by eq. (5.5) about the level body at the start's yaw psi, so that a rotated
world gives the same plan: R v = Rz(psi) (v + Theta' x v) with Theta' = Theta - (0, 0, psi). A body
that starts far from level, on a single wall, is linearised about its start. Constraint letters are
those of the complete formulation (Fig. 5.1 of the chapter).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.clearance.limbs import compute_standing_clearance
from climbplan.climb.postures.coxa_wedges import add_coxa_wedges
from climbplan.climb.postures.limb_shape import LimbKeyPoints, linearise_limb
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.program import Polytope, Program
from climbplan.program.affine_array import AffineArray
from climbplan.program.statement import Expression
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import FreeRegion, lies_on
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region

Entries = Any  # an AffineArray, which NumPy's signatures do not know
_PARALLEL_COSINE = 1 - 1e-9  # cosine between normals that are one
_KNEE_TOLERANCE = 3e-3  # [m] room for what the knee to first order is off, some mm at most


@dataclass(frozen=True)
class PostureMargins:
    """Tightening after a posture failed an exact check that the statement only approximates."""

    stance_radius: Array | None = None  # (N,) [m], the robot's own if None
    turn: Array | None = None  # (N,) [rad] that first joints keep within their bounds
    clearance: float = 0.0  # [m] beyond the spec's body clearance
    limbs: float = 0.0  # [m] beyond the spec's limb clearance
    knees: float = 0.0  # [m] the same for knees alone


@dataclass(frozen=True)
class LinearisedRotation:
    """Rotations to first order, eq. (5.5), about a reference: R v = R0 (v + Theta' x v).

    Theta' = rates (Theta - Theta0), where rates are the identity about a level body.
    """

    reference_rpy: tuple[float, float, float]  # Theta0: roll, pitch, yaw [rad]

    @classmethod
    def from_scene(cls, scene: ClimbScene) -> LinearisedRotation:
        """Linearise about the level body at the start's yaw, or about a start far from level."""
        roll, pitch, yaw = (float(angle) for angle in scene.start.rpy)
        limit = np.deg2rad(scene.spec.posture.rotation_limit_deg)
        is_tilted = max(abs(roll), abs(pitch)) > limit
        return cls((roll, pitch, yaw) if is_tilted else (0.0, 0.0, yaw))

    @property
    def reference(self) -> Array:
        """Return the reference rotation R0 (3, 3)."""
        return rotation_world_body(self.level)

    @property
    def level(self) -> Array:
        """Return the (roll, pitch, yaw) [rad] at which the first order is exact."""
        return np.array(self.reference_rpy)

    @property
    def rates(self) -> Array:
        """Return the map (3, 3) from small changes of roll, pitch and yaw to a body-frame rotation
        vector.
        """
        roll, pitch, _ = self.reference_rpy
        if roll == 0.0 and pitch == 0.0:
            return np.eye(3)
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        return np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])

    def apply(self, rpy: Entries, vector: Array) -> Entries:
        """Return R v (..., 3) for rpy (..., 3) and body vectors (..., 3), broadcast."""
        # R0 (v + Theta' x v) = u + (R0 Theta') x u with u = R0 v, and t x u = t [u]x for rows t
        u = vector @ self.reference.T
        x, y, z = np.moveaxis(u, -1, 0)
        zeros = np.zeros_like(x)
        skew = np.stack([zeros, -z, y, z, zeros, -x, -y, x, zeros], axis=-1)
        rotation_jacobian = (self.reference @ self.rates).T @ skew.reshape(*x.shape, 3, 3)
        rotated = (rpy - self.level).along(rotation_jacobian) + u
        return rotated


def build_region_polytope(region: Region) -> Polytope:
    """Return a contact region as rows in space: A_r p <= b_r and the equation of its plane."""
    return Polytope(
        name=region.name,
        A=region.A,
        b=region.b,
        C=region.normal[None],
        c=np.array([region.offset]),
        vertices=region.vertices,
    )


def build_body_polytope(
    free: FreeRegion, hull: Array, clearance: float, rotation: LinearisedRotation
) -> Polytope:
    """Return body poses (com, Theta) before and after a round for which the hull is in a free
    region.

    A free region is convex, and every hull corner moves on a straight line between the two
    linearised poses, so that the corners of both poses are sufficient. Rows are in R^12: a (com +
    R0 (v + Theta' x v)) <= b becomes a com + (v x a') Theta' <= b - a' v with a' = R0' a.
    """
    rows, bounds = [], []
    for normal, offset in zip(free.A, free.b, strict=True):
        normal_body = rotation.reference.T @ normal
        arms = np.cross(hull, normal_body) @ rotation.rates
        rows.append(np.hstack([np.broadcast_to(normal, arms.shape), arms]))
        bounds.append(offset - clearance - hull @ normal_body + arms @ rotation.level)
    A, b = np.vstack(rows), np.concatenate(bounds)
    zero = np.zeros_like(A)
    both_poses = np.block([[A, zero], [zero, A]])
    return Polytope.halfspaces(free.name, both_poses, np.concatenate([b, b]))


def build_limb_polytopes(
    solid: Solid,
    limb: LimbKeyPoints,
    clearance: float,
    knee_clearance: float,
    rotation: LinearisedRotation,
    is_support_face: BoolArray | None = None,
) -> list[Polytope]:
    """Return, for each face of a solid, toes and body poses for which a limb is beyond the face.

    Points are (toe, com, Theta) before and after a round, in R^18. Toe, shoulder and knee are
    beyond the face; the knee is taken to first order about the nominal stance, and lifted too.
    Below a level face there is space for the knee anywhere, at most a femur above the shoulder.

    Args:
        solid: The obstacle.
        limb: Linearised kinematics of the limb.
        clearance: Distance of toe and shoulder from the face [m].
        knee_clearance: Distance of the knee from the face [m].
        rotation: Linearised rotation of the body.
        is_support_face: (F,) bool, faces that the toe may stand on and need not be beyond; None for
            no such face.
    """
    faces = []
    zero = np.zeros(3)
    for k, (normal, offset) in enumerate(zip(solid.A, solid.b, strict=True)):
        # Beyond the face: normal . p >= offset + keep for toe, shoulder and knee
        normal_body = rotation.reference.T @ normal
        shoulder = limb.shoulder
        arm = np.cross(shoulder, normal_body) @ rotation.rates
        knee_allowance = limb.max_knee_height * max(0.0, -float(normal[2]))
        rows = [[*-normal, *zero, *zero], [*zero, *-normal, *-arm]]
        bounds = [
            -clearance,
            shoulder @ normal_body - arm @ rotation.level - clearance - knee_allowance,
        ]
        if (knee := limb.knee) is not None:
            # knee = com + R k + G (toe - com - R s), G = R0 J R0'
            jacobian_normal = knee.toe_jacobian.T @ normal_body
            toe_row = rotation.reference @ jacobian_normal
            arm = np.cross(knee.position, normal_body) - np.cross(knee.stance, jacobian_normal)
            arm = arm @ rotation.rates
            min_lift_offset = float((knee.lift_offsets @ normal_body).min(initial=0.0))
            rows.append([*-toe_row, *(toe_row - normal), *-arm])
            nominal_term = knee.position @ normal_body - knee.stance @ jacobian_normal
            bounds.append(nominal_term - arm @ rotation.level - knee_clearance + min_lift_offset)
        if is_support_face is not None and is_support_face[k]:
            rows, bounds = rows[1:], bounds[1:]
        both_postures = np.asarray(np.kron(np.eye(2), np.array(rows)), np.float64)
        name = f"{solid.name} face {k}"
        bound = np.array(bounds) - offset
        faces.append(Polytope.halfspaces(name, both_postures, np.concatenate([bound, bound])))
    return faces


def _add_limb_clearance(
    p: Program, scene: ClimbScene, postures: Entries, margins: PostureMargins
) -> None:
    """Keep standing limbs beyond one face of every obstacle during a round.

    postures: (M, N, 18) toe, com and Theta before and after each round.
    """
    robot, terrain = scene.robot, scene.terrain
    clearance = compute_standing_clearance(scene) + margins.limbs
    knee_clearance = clearance + _KNEE_TOLERANCE + margins.knees
    rotation = LinearisedRotation.from_scene(scene)
    if not terrain.obstacles:
        return
    shapes = [linearise_limb(scene, i, rotation.reference) for i in range(robot.limb_count)]
    for index, solid in enumerate(terrain.obstacles):
        alternatives_by_limb = []
        for i in range(robot.limb_count):
            corners = np.concatenate(
                [terrain.regions[r].vertices for r in np.flatnonzero(terrain.allowed[i])]
            )
            is_usable = (corners @ solid.A.T - solid.b).max(
                axis=0
            ) >= clearance  # a toe may stand there
            is_support_face = _find_support_faces(scene, i, index)
            is_usable |= is_support_face
            faces = build_limb_polytopes(
                solid, shapes[i], clearance, knee_clearance, rotation, is_support_face
            )
            alternatives_by_limb.append(
                [f for f, is_face_usable in zip(faces, is_usable, strict=True) if is_face_usable]
            )
        p.one_of(
            f"limbs.axis_collision_{index}",
            postures,
            alternatives_by_limb * len(postures),
            unit="m",
        )


def _find_support_faces(scene: ClimbScene, limb: int, obstacle: int) -> BoolArray:
    """Return which faces (F,) of an obstacle carry a surface that a limb may stand on."""
    terrain = scene.terrain
    solid = terrain.obstacles[obstacle]
    is_support_face = np.zeros(len(solid.b), bool)
    if not terrain.stood_upon[limb, obstacle]:
        return is_support_face
    for r in np.flatnonzero(terrain.allowed[limb]):
        region = terrain.regions[r]
        if lies_on(region, solid):
            is_support_face |= (solid.A @ region.normal) > _PARALLEL_COSINE
    return is_support_face


def sum_of_squares(expression: Expression | AffineArray) -> Any:
    """Return the sum of the squares of all entries."""
    if isinstance(expression, AffineArray):
        return expression.sum_of_squares()
    return np.sum(expression**2)


# States that toes (M, N, 3) stand in one region each: program, toes, body origins (M, 3), regions
# by limb. Its choices are the program's first.
AddContacts = Callable[[Program, Expression, Expression, list[list[Region]]], None]


def add_contact_regions(
    p: Program, toe: Expression, com: Expression, regions: list[list[Region]]
) -> None:
    """Require every toe to be in one contact region, whatever its forces."""
    polytopes = {
        id(region): build_region_polytope(region)
        for limb_regions in regions
        for region in limb_regions
    }
    per_limb = [[polytopes[id(region)] for region in limb_regions] for limb_regions in regions]
    p.one_of("contact.region", toe, per_limb * len(toe), unit="m")


def build_posture_program(
    scene: ClimbScene,
    margins: PostureMargins | None = None,
    state_contacts: AddContacts = add_contact_regions,
) -> Program:
    """Build M rounds of postures for a scene with flat contact regions.

    Args:
        scene: The climb.
        margins: Tightening of the statement; None for no tightening.
        state_contacts: Adds the contact constraints; its choices are the program's first.
    """
    spec, robot, terrain = scene.spec.posture, scene.robot, scene.terrain
    margins = margins or PostureMargins()
    m, n = scene.spec.task.round_count, robot.limb_count
    steps, limit = spec.steps, np.deg2rad(spec.rotation_limit_deg)
    rotation = LinearisedRotation.from_scene(scene)

    p = Program("posture")
    toe_scalars = p.continuous("toe", (m, n, 3), unit="m")
    com_scalars = p.continuous("com", (m, 3), unit="m")
    p.continuous("rpy", (m, 3), rotation.level - limit, rotation.level + limit, "rad")
    start = scene.start
    variables = zip((start.toes, start.com, start.rpy), ("toe", "com", "rpy"), strict=True)
    postures = _Postures(*(np.concatenate([old[None], p.affine(name)]) for old, name in variables))
    toes, coms, turns = postures

    # A, B: body, toe and rotation steps between rounds
    p.ball("steps.com", np.diff(coms, axis=0), steps.com_max, unit="m")
    p.ball("steps.toe", np.diff(toes, axis=0), steps.toe_max, unit="m")
    turn = np.deg2rad(steps.rotation_max_deg)
    p.between("steps.rotation", np.diff(turns, axis=0), -turn, turn, unit="rad")

    _add_workspaces(p, scene, margins, rotation, postures)  # C

    # D: every toe in one contact region, H_ri => A_r p_i <= b_r
    if scene.by_round is None:
        regions_by_limb = [
            [scene.standing[r] for r in np.flatnonzero(terrain.allowed[i])] for i in range(n)
        ]
        state_contacts(p, toe_scalars, com_scalars, regions_by_limb)
    else:
        _add_regions_by_round(p, scene, toe_scalars)

    # The body's way through each round stays in one convex free region
    clearance = spec.body_clearance + margins.clearance
    poses = np.concatenate([coms[:-1], turns[:-1], coms[1:], turns[1:]], axis=-1)  # (M, 12)
    for index, choice in enumerate(terrain.free_choices):
        free = [build_body_polytope(r, robot.body_hull, clearance, rotation) for r in choice]
        p.one_of(f"body.clearance_{index}", poses, [free] * m, unit="m")

    # Standing limbs pass every obstacle on one side in each round
    coms_by_limb, turns_by_limb = (
        np.broadcast_to(x[:, None], (m + 1, n, 3)) for x in (coms, turns)
    )
    ends = [x[rounds] for rounds in (slice(-1), slice(1, None))
            for x in (toes, coms_by_limb, turns_by_limb)]  # fmt: skip
    _add_limb_clearance(p, scene, np.concatenate(ends, axis=-1), margins)
    _add_goal(p, scene, postures)
    return p


def _add_regions_by_round(p: Program, scene: ClimbScene, toe: Expression) -> None:
    """Require every toe in one of the regions that its limb may use in its round."""
    polytopes = {
        int(r): build_region_polytope(scene.standing[r])
        for r in np.flatnonzero(scene.terrain.allowed.any(axis=0))
    }
    alternatives = [[polytopes[int(r)] for r in each] for row in scene.alternatives for each in row]
    p.one_of("contact.region", toe, alternatives, unit="m")


class _Postures(NamedTuple):
    """Postures of rounds 0 to M: the start and the variables."""

    toes: Entries  # (M + 1, N, 3)
    coms: Entries  # (M + 1, 3) body origins
    turns: Entries  # (M + 1, 3) roll, pitch, yaw


def _add_workspaces(
    p: Program,
    scene: ClimbScene,
    margins: PostureMargins,
    rotation: LinearisedRotation,
    postures: _Postures,
) -> None:
    """Require toes in the limbs' workspace balls, and first joints within their bounds (C).

    The balls are about the shoulder and about the nominal stance.
    """
    spec, robot = scene.spec.posture, scene.robot
    toes, coms, turns = postures
    m, n = len(coms) - 1, robot.limb_count
    stance_radius = margins.stance_radius
    if stance_radius is None:
        stance_radius = np.full(n, robot.stance_radius)
    balls = [("reach", robot.shoulder_body, np.full(n, robot.reach))]
    if spec.stance_workspace:
        balls.append(("stance", robot.stance_body, stance_radius))
    # The k-th limb to move does so when the body has covered k / N of its way: it leaves its old
    # place and reaches its new one from there.
    fraction = np.empty(n)
    fraction[list(scene.gait)] = np.arange(n) / n
    poses_at_move = [
        x[:-1, None] + fraction[:, None] * np.diff(x, axis=0)[:, None] for x in (coms, turns)
    ]
    for label, origin, radius in balls:
        arm = toes[1:] - coms[1:, None] - rotation.apply(turns[1:, None], origin)
        p.ball(f"workspace.{label}", arm, np.tile(radius, (m, 1)), unit="m")
        if spec.check_reach_during_round:
            for event, feet in (("lift", toes[:-1]), ("place", toes[1:])):
                arm = feet - poses_at_move[0] - rotation.apply(poses_at_move[1], origin)
                radii = np.tile(radius, (m, 1))
                if label == "stance" and event == "lift":
                    # Where the start's toes stand no tightening changes
                    radii[0] = np.maximum(radius, robot.stance_radius)
                p.ball(f"workspace.{label}_{event}", arm, radii, unit="m")

    if spec.stance_workspace:
        add_coxa_wedges(
            p,
            robot,
            stance_radius,
            margins.turn,
            start=(scene.start.com, scene.start.rpy, scene.start.toes),
            frame=(rotation.reference, rotation.rates, rotation.level),
            postures=postures,
            moving=(poses_at_move[0], poses_at_move[1]),
        )


def _add_goal(p: Program, scene: ClimbScene, postures: _Postures) -> None:
    """Require the goal within tolerance, and minimise distances to it and steps."""
    goal, weights = scene.goal, scene.spec.posture.weights
    toes, coms, turns = postures
    tolerance = scene.spec.task.goal.tolerance
    p.ball("goal.com", coms[-1] - goal.com, tolerance, unit="m")
    p.ball("goal.toes", toes[-1] - goal.toes, tolerance, unit="m")
    rotation_tolerance = np.deg2rad(scene.spec.task.goal.rotation_tolerance_deg)
    p.between(
        "goal.rotation", turns[-1] - goal.rpy, -rotation_tolerance, rotation_tolerance, unit="rad"
    )
    p.minimise("goal", weights.goal * sum_of_squares(toes[-1] - goal.toes))
    p.minimise("goal_com", weights.goal_com * sum_of_squares(coms[-1] - goal.com))
    p.minimise("goal_rotation", weights.goal_rotation * sum_of_squares(turns[-1] - goal.rpy))
    p.minimise("com_step", weights.com * sum_of_squares(np.diff(coms, axis=0)))
    p.minimise("toe_step", weights.toe * sum_of_squares(np.diff(toes, axis=0)))
    p.minimise("rotation_step", weights.rotation * sum_of_squares(np.diff(turns, axis=0)))
