"""The move of one limb: the exact checks of plans, applied while footholds are chosen.

Before a limb is lifted the body goes to the pose of the move, shifted over the limbs that stand.
On the way all limbs stand; then the limb swings to its foothold while the body rests. Reach, room
between links, body and terrain, contact forces and the path of the swing are checked as for any
plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.clearance.body import compute_poses_shortfall
from climbplan.climb.clearance.limb_pairs import compute_self_shortfall, find_standing_overlap
from climbplan.climb.clearance.limbs import INTERPOLATION_MARGIN, find_closest_link
from climbplan.climb.clearance.raw_surface import THE_SCAN, ToeContacts, find_nearest_raw
from climbplan.climb.clearance.swing import LimbSwing, plan_swing_path
from climbplan.climb.contact_search.footholds import BodyPose, Foothold
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import build_force_statement
from climbplan.climb.gait.balance import find_balancing_shifts
from climbplan.climb.gait.instants import build_instants
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import NoPlanFound, Remedy
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import standing_inverse
from climbplan.robots.rotations import rotation_world_body

_NUM_POSES = 8  # checked along the way of the body between two moves
_BETWEEN_POSES = 1e-3  # [m] of room between links beyond that at the start, for poses between
_TOLERANCE = 1e-9  # [m]
_ENLARGEMENT = 1.5  # of a value that may help


@dataclass(frozen=True)
class Standing:
    """The robot with all limbs on the terrain."""

    pose: BodyPose
    toes: Array  # (N, 3) [m]
    region: IntArray  # (N,)

    def replace_toe(self, limb: int, foothold: Foothold) -> Standing:
        """Return the robot with one toe on another foothold."""
        toes, region = self.toes.copy(), self.region.copy()
        toes[limb], region[limb] = foothold.point, foothold.region
        return replace(self, toes=toes, region=region)


@dataclass(frozen=True)
class LimbMove:
    """A move that passed all checks."""

    lifted: Instants  # one instant, the limb in the air
    swing: Array  # (P, 3) way points of the toe [m]
    after: Standing


class MoveRejected(Exception):
    """A move failed a check; the message says what stopped it, `remedies` what may help."""

    def __init__(
        self,
        reason: str,
        remedies: tuple[Remedy, ...] = (),
        *,
        whatever_foothold: bool = False,
        by_limb: int | None = None,
    ) -> None:
        super().__init__(reason)
        self.remedies = remedies
        self.whatever_foothold = whatever_foothold  # no other foothold of the moved limb helps
        self.by_limb = by_limb  # the standing limb that failed; another foothold of it may help


class MoveChecker:
    """Checks moves of limbs in a scene."""

    def __init__(self, scene: ClimbScene) -> None:
        self.scene = scene
        self.normals = np.array([region.normal for region in scene.standing])
        self.names = scene.robot.limb_names
        shifts = scene.spec.posture.steps.com_shift_max > 0
        # (N, 3) of the body at each limb's last move [m]: what to expect at its next
        self.shifts = np.zeros((len(self.names), 3))
        start = scene.start
        standing = Standing(BodyPose(start.com, start.rpy), start.toes, start.region)
        for limb in range(len(self.names)) if shifts else ():
            lifted = self._lift(standing, limb, standing.pose, 1)
            self.shifts[limb] = find_balancing_shifts(scene, lifted)[0]

    def check(
        self, standing: Standing, limb: int, foothold: Foothold, pose: BodyPose, number: int
    ) -> LimbMove:
        """Check the move of a limb to a foothold, and return it.

        Args:
            standing: The robot before the body goes to the pose of the move.
            limb: The limb that moves.
            foothold: Where it is placed.
            pose: The body's pose on its path, without a shift over the standing limbs.
            number: Number of the round, from 1 on.

        Raises:
            MoveRejected: A check failed.
        """
        scene = self.scene
        lift = scene.spec.trajectory.swing_clearance
        normal = self.normals[foothold.region]
        lifted = self._lift(standing, limb, pose, number)
        if scene.spec.posture.steps.com_shift_max > 0:
            toes, normals = lifted.toes.copy(), lifted.normal.copy()
            toes[0, limb], normals[0, limb] = foothold.point + lift * normal, normal
            over_foothold = replace(lifted, toes=toes, normal=normals)
            shift = find_balancing_shifts(scene, lifted, places=over_foothold)[0]
            self.shifts[limb] = shift
            pose = replace(pose, com=pose.com + shift)
            lifted = self._lift(standing, limb, pose, number)
        what = f"before {self.names[limb]} is lifted"
        try:
            self.check_way(standing, pose)
        except MoveRejected as rejected:
            raise MoveRejected(
                f"{rejected} {what}",
                rejected.remedies,
                whatever_foothold=True,
                by_limb=rejected.by_limb,
            ) from None
        after = replace(standing.replace_toe(limb, foothold), pose=pose)
        instants = self._compute_angles(lifted, after, limb, foothold.point + lift * normal)
        overlap = find_standing_overlap(scene, instants)
        if overlap is not None:
            raise MoveRejected(overlap[0].describe(scene.robot))
        self._require_forces(instants, limb)
        path = self._plan_swing(standing, limb, foothold, pose, lifted)
        first = Instants(**{name: value[:1] for name, value in vars(instants).items()})
        return LimbMove(first, path, after)

    def _plan_swing(
        self, standing: Standing, limb: int, foothold: Foothold, pose: BodyPose, lifted: Instants
    ) -> Array:
        """Plan the way points (P, 3) of a swing; raise MoveRejected where all ways are blocked."""
        normals = [self.normals[region] for region in (standing.region[limb], foothold.region)]
        swing = LimbSwing(
            limb=limb,
            com=pose.com,
            rpy=pose.rpy,
            old=standing.toes[limb],
            new=foothold.point,
            normals=np.stack(normals),
            where=lifted.label(0, self.names),
            toes=standing.toes,
            still=~lifted.lifted[0],
            under=lifted.normal[0],
        )
        try:
            return plan_swing_path(self.scene, swing)
        except NoPlanFound as error:
            conflicts = "; ".join(str(conflict) for conflict in error.conflicts)
            clearance = self.scene.spec.trajectory.swing_clearance
            higher = self._enlarge("trajectory.swing_clearance", clearance, "m")
            reason = f"swing of {self.names[limb]}: {conflicts or error}"
            raise MoveRejected(reason, (higher,)) from None

    def check_way(self, standing: Standing, pose: BodyPose) -> None:
        """Check the way of the body to a pose while all limbs stand.

        Raises:
            MoveRejected: A limb does not reach, links overlap, or something is too close to the
                terrain.
        """
        scene = self.scene
        fraction = np.linspace(0.0, 1.0, _NUM_POSES)[:, None]
        com = standing.pose.com + fraction * (pose.com - standing.pose.com)
        rpy = standing.pose.rpy + fraction * (pose.rpy - standing.pose.rpy)
        toes = np.broadcast_to(standing.toes, (len(com), *standing.toes.shape))
        normals = np.broadcast_to(self.normals[standing.region], toes.shape)
        solution = standing_inverse(scene.robot, com, rpy, toes, normals)
        if not solution.valid.all():
            limb = int(np.flatnonzero(~solution.valid.all(axis=0))[0])
            raise MoveRejected(f"{self.names[limb]} does not reach its toe", by_limb=limb)
        body = float(compute_poses_shortfall(scene, com[None], rpy[None]).max(initial=0.0))
        if body > _TOLERANCE:
            raise MoveRejected(f"the body comes {1e3 * body:.1f} mm too close to the terrain")
        links = limb_capsules(scene.robot, solution.best())
        overlap = compute_self_shortfall(scene.robot, links)
        if overlap.missing > -_BETWEEN_POSES:
            first = replace(links, starts=links.starts[:1], ends=links.ends[:1])
            at_start = compute_self_shortfall(scene.robot, first).missing
            if overlap.missing > max(min(at_start, _TOLERANCE), -_BETWEEN_POSES) + _TOLERANCE:
                raise MoveRejected(overlap.describe(scene.robot), by_limb=overlap.limb)
        links = links.to_world(com, rotation_world_body(rpy))
        if scene.terrain.scan is not None:
            contacts = ToeContacts(toes[..., None, :], normals[..., None, :])
            raw = find_nearest_raw(scene.terrain.scan, links, contacts, INTERPOLATION_MARGIN)
            if raw.missing > _TOLERANCE:
                self._reject_link(raw.index[-1], raw.link, raw.missing, THE_SCAN)
        if scene.terrain.link_solids:
            closest = find_closest_link(scene, links)
            missing = INTERPOLATION_MARGIN - closest.distance
            if missing > _TOLERANCE:
                solid = scene.terrain.link_solids[closest.solid].name
                self._reject_link(closest.index[-1], closest.link, missing, solid)

    def _reject_link(self, limb: int, link: int, missing: float, obstacle: str) -> None:
        name = self.scene.robot.joint_name(limb, link)
        raise MoveRejected(
            f"{self.names[limb]}'s {name} comes {1e3 * missing:.1f} mm too close to {obstacle!r}",
            by_limb=limb,
        )

    def _lift(self, standing: Standing, limb: int, pose: BodyPose, number: int) -> Instants:
        """Return the instant with a limb lifted, without joint angles."""
        lifted = np.zeros((1, len(standing.toes)), bool)
        lifted[0, limb] = True
        return build_instants(
            self.scene,
            rounds=np.array([number]),
            com=pose.com[None],
            rpy=pose.rpy[None],
            toes=standing.toes[None],
            region=standing.region[None],
            lifted=lifted,
        )

    def _compute_angles(
        self, lifted: Instants, after: Standing, limb: int, hover: Array
    ) -> Instants:
        """Return the instants with the limb lifted and placed, with joint angles.

        Raises:
            MoveRejected: A limb does not reach, with the moving limb above either foothold too.
        """
        robot = self.scene.robot
        placed = build_instants(
            self.scene,
            rounds=lifted.round,
            com=lifted.com,
            rpy=lifted.rpy,
            toes=after.toes[None],
            region=after.region[None],
            lifted=np.zeros_like(lifted.lifted),
        )
        above = placed.toes.copy()
        above[0, limb] = hover
        toes = np.concatenate([lifted.toes, placed.toes, above])
        normals = np.concatenate([lifted.normal, placed.normal, placed.normal])
        com, rpy = (np.repeat(values, 3, axis=0) for values in (lifted.com, lifted.rpy))
        solution = standing_inverse(robot, com, rpy, toes, normals)
        if not solution.valid.all():
            unreached = self.names[int(np.flatnonzero(~solution.valid.all(axis=0))[0])]
            raise MoveRejected(f"{unreached} does not reach its toe while {self.names[limb]} moves")
        angles = solution.best()
        return join_instants(
            [
                replace(lifted, joint_angles=angles[:1]),
                replace(placed, joint_angles=angles[1:2]),
            ]
        )

    def _require_forces(self, instants: Instants, limb: int) -> None:
        """Raise MoveRejected where no forces support the robot; margins are left to later."""
        spec = self.scene.spec
        statement = build_force_statement(self.scene, instants)
        solved = solve_forces(statement, spec.solver.force_solver, spec.force.facets)
        if len(solved.missing) or len(solved.unbalanced):
            shift = spec.posture.steps.com_shift_max
            remedies = (self._enlarge("posture.steps.com_shift_max", shift, "m"),)
            reason = f"no contact forces support the robot with {self.names[limb]} lifted"
            raise MoveRejected(reason, remedies if shift > 0 else ())

    def _enlarge(self, key: str, value: float, unit: str) -> Remedy:
        """Return the remedy of a larger value of a key."""
        larger = round(_ENLARGEMENT * value, 3)
        return Remedy(f"{key} of {larger:g} {unit}", key, larger)


def join_instants(instants: list[Instants]) -> Instants:
    """Join instants in order."""
    return Instants(
        **{
            name: np.concatenate([vars(entry)[name] for entry in instants])
            for name in vars(instants[0])
        }
    )
