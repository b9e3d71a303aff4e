"""How a robot may stand on ground, and how it may brace between walls.

Both are searched for on grids of toes about the first joints: how low the toes are, how far out,
and how far towards front and rear. Each leg takes the angles that inverse kinematics finds from the
best sampled posture nearby, mirrored legs alike. Of postures whose links are above the ground, out
of the body and inside the walls, the best has the most room about its toes with motors at the least
of their limits: the smallest product over legs counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_inverse import chain_inverse
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.holding import Lack, holding_share, lack_of
from climbplan.robots.urdf.proposal.quality import Quality, quality_of
from climbplan.robots.urdf.workspace import common_reach

_SAMPLES = 4000  # postures of every leg
_NEAREST = 40  # of these looked at for each toe
_LOW = np.arange(0.35, 0.93, 0.07)  # shares of reach that toes are below first joints
_OUT = np.array([0.0, 0.1, 0.2, 0.35, 0.5])  # that they are further out
_APART = np.array([-0.1, 0.0, 0.1, 0.25])  # and further to front or rear
_WIDE = np.arange(0.25, 0.96, 0.07)  # shares of reach that walls are from first joints
_BELOW = np.array([-0.2, 0.0, 0.15, 0.3, 0.45, 0.6])
_SPREAD = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
_HELD = 120  # of the roomiest braces whose forces are looked at
SHIFTED = (0.15, 0.22)  # of reach that the body may shift between walls; more if need be
_WEAK = 0.75  # share of the torque limits from which on there is need
ABOVE = 0.05  # of reach that links stay above toes on the ground
BESIDE = 0.02  # [m] that limbs of robots with arms keep from one another, as they stand
_ROUND_ZERO = 2.0  # [rad] that joints without bounds are bent at most
_HOLDING = 3  # legs that bear the weight
_ONE_BEND = 0.5  # [m] off the mirror image of the other leg, that counts as one metre of room
LEAST_ROOM = 0.01  # [m]
_NEAR = 0.2  # of a limb's length, within which it may be in the body's box


@dataclass(frozen=True)
class Posture:
    """One way to stand; N legs."""

    angles: Array  # (N, J) [rad]
    toes: Array  # (N, 3) frame of the chains [m]
    score: float  # least of the legs [m]
    room: float  # least ball about a toe, first order [m]
    use: float  # largest share of a torque limit
    gap: float = 0.0  # between walls [m]
    friction: float = 0.0  # of the walls
    shift: float = 0.0  # of the body over the legs that stay [m]


@dataclass(frozen=True)
class Legs:
    """What postures are searched for with; frame x right, y forward, z up."""

    chain: SerialChain
    lower: Array  # (N, J) [rad]
    upper: Array
    torque: Array  # [N m]
    reach: Array  # (N,) [m]
    weight: float  # [N]
    mirror: tuple[int | None, ...]  # the leg on the other side
    box: tuple[Array, Array]  # of the body, lower and upper corner [m]

    @property
    def hips(self) -> Array:
        """(N, 3) first joints."""
        return self.chain.joint_zero[:, 0]

    @property
    def away(self) -> BoolArray:
        """(N, P) joints and toe that have to be out of the body: not its first two, nor near."""
        points = self.chain.joint_points(np.zeros((1, *self.lower.shape)))[0]
        along = np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=-1), axis=1)
        along = np.concatenate([np.zeros((len(points), 1)), along], axis=1)
        far = along > _NEAR * along[:, -1:]
        far[:, :2] = False
        return np.asarray(far)

    @property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lower and upper bounds and torques."""
        return self.lower, self.upper, self.torque

    @property
    def outward(self) -> Array:
        """(N, 2) signs of right and forward, as seen from the middle of all first joints."""
        away = self.hips[:, :2] - self.hips[:, :2].mean(axis=0)
        return np.where(np.abs(away) < 1e-3, 0.0, np.sign(away))


def standing_postures(legs: Legs, count: int) -> list[Posture]:
    """The best postures on level ground, with clearly different toes, best first."""
    low, out, apart = (x.ravel() for x in np.meshgrid(_LOW, _OUT, _APART, indexing="ij"))
    reach, hips, sign = legs.reach, legs.hips, legs.outward
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = hips[:, 0] + sign[:, 0] * out[:, None] * reach
    toes[..., 1] = hips[:, 1] + sign[:, 1] * apart[:, None] * reach
    # All on one level: that of the shortest leg
    level = (hips[:, 2] - low[:, None] * reach).max(axis=1)
    toes[..., 2] = level[:, None]
    force = np.zeros((len(hips), 3))
    force[:, 2] = legs.weight / min(_HOLDING, len(hips))
    angles, reached = reached_angles(legs, toes, force)
    quality = quality_of(legs.chain, angles, force, legs.limits)
    above = quality.points[..., :-1, 2].min(axis=-1) - toes[..., 2]
    fine = reached & clear_of_body(legs, quality.points) & (above > ABOVE * reach)
    return best_of(quality, angles, toes, fine, count)


def bracing_postures(
    legs: Legs, standing: Array, clearance: float, mu: float
) -> tuple[list[Posture], Lack]:
    """Postures that hold between two walls, the same distance on both sides; best first.

    And the least share of the torque limits that any posture needs with one leg lifted.

    standing: (N, J) angles that legs start from, as when the robot is planned with. clearance: [m]
    of the body from the walls; mu: friction coefficient that may be used. Frame: the centre of
    mass.
    """
    reach, hips, sign = legs.reach, legs.hips, legs.outward
    sides = np.where(sign[:, 0] == 0, 1.0, sign[:, 0])
    wide, below, apart = (x.ravel() for x in np.meshgrid(_WIDE, _BELOW, _SPREAD, indexing="ij"))
    half = np.abs(hips[:, 0]).max() + wide * float(reach.min())
    room = np.maximum(-legs.box[0][0], legs.box[1][0]) + clearance
    keep = half > room
    half, below, apart = half[keep], below[keep], apart[keep]
    toes = np.empty((len(half), len(hips), 3))
    toes[..., 0] = sides * half[:, None]
    toes[..., 1] = hips[:, 1] + sign[:, 1] * apart[:, None] * reach
    toes[..., 2] = hips[:, 2] - below[:, None] * np.minimum(reach, common_reach(reach))
    chain = SerialChain(
        legs.chain.names,
        legs.chain.joint_zero,
        legs.chain.axis_zero,
        legs.chain.toe_zero,
        standing,
    )
    found = chain.inverse(toes, legs.lower, legs.upper)
    reached = found.valid
    angles = np.where(reached[..., None], found.best(), standing)
    quality = quality_of(chain, angles, np.zeros((len(hips), 3)), legs.limits)
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - clearance
    fine = reached & within & clear_of_body(legs, quality.points)
    normal = np.zeros((len(hips), 3))
    normal[:, 0] = -sides
    tried = best_of(quality, angles, toes, fine, _HELD, 2 * half)
    held: list[Posture] = []
    lack = Lack(np.inf)
    for share in SHIFTED:
        if lack.share <= _WEAK:
            break
        held, most = [], share * float(reach.min())
        for brace in tried:
            jacobian = chain.jacobian(brace.angles)
            use, shift = holding_share(
                brace.toes, normal, jacobian, legs.torque, legs.weight, mu, most
            )
            if use < lack.share:
                lack = Lack(use)
                if use >= 1:
                    own = brace.toes, normal, jacobian, legs.torque
                    lack = lack_of(use, *own, legs.weight, mu, most)
            if use < 1:
                score = brace.room * (1 - use)
                held.append(replace(brace, use=use, shift=shift, score=score))
    any_tried = bool(fine.all(axis=1).any())
    return sorted(held, key=lambda brace: -brace.score), lack if any_tried else Lack()


def reached_angles(
    legs: Legs, toes: Array, force: Array, grounded: BoolArray | None = None
) -> tuple[Array, BoolArray]:
    """Angles (C, N, J) for toes (C, N, 3), mirrored legs bent alike, and whether they get there.

    grounded: (N,) limbs whose joints have to be above their toes; all, if left out.
    """
    chain, count = legs.chain, toes.shape[1]
    # Bounds of more than a turn say nothing: postures are looked for round zero then
    most = np.where(legs.upper - legs.lower > 2 * np.pi, _ROUND_ZERO, np.pi)
    span = np.clip(legs.lower, -most, most), np.clip(legs.upper, -most, most)
    share = np.random.default_rng(0).random((_SAMPLES, *legs.lower.shape))
    drawn = span[0] + share * (span[1] - span[0])
    quality = quality_of(chain, drawn, force, legs.limits)
    # Knees above their toes, and links out of the body
    under = quality.points[..., :-1, 2].min(axis=-1) - quality.points[..., -1, 2]
    free = False if grounded is None else ~grounded
    good = clear_of_body(legs, quality.points) & ((under > ABOVE * legs.reach) | free)
    score = np.where(good, quality.score, -np.inf)
    angles = np.zeros((*toes.shape[:2], legs.lower.shape[1]))
    done: set[int] = set()
    for limb in range(count):
        fine = np.flatnonzero(np.isfinite(score[:, limb]))
        if not len(fine):
            fine = np.arange(_SAMPLES)
        places = quality.points[fine, limb, -1]
        nearest = cKDTree(places).query(toes[:, limb], k=min(_NEAREST, len(fine)))[1]
        nearest = fine[np.atleast_2d(nearest.T).T]  # (C, K)
        worth = score[nearest, limb]
        other = legs.mirror[limb]
        if other in done:
            # Bent as the leg on the other side is
            there = chain.joint_points(angles)[:, other] * [-1.0, 1.0, 1.0]  # (C, P, 3)
            off = np.linalg.norm(quality.points[nearest, limb] - there[:, None], axis=-1).sum(-1)
            worth = -off / _ONE_BEND
        else:
            ends = quality.points[nearest, limb, -1]
            worth = worth - np.linalg.norm(ends - toes[:, None, limb], axis=-1)
        pick = nearest[np.arange(len(toes)), np.argmax(worth, axis=1)]
        rows = np.full(len(toes), limb)
        found = chain_inverse(
            chain.zero.rows(rows),
            drawn[pick, limb],
            np.arange(len(toes)),
            toes[:, limb],
            legs.lower[rows],
            legs.upper[rows],
        )
        angles[:, limb] = found.angles
        done.add(limb)
    reached = np.linalg.norm(chain.joint_points(angles)[..., -1, :] - toes, axis=-1) < 1e-6
    return angles, reached


def clear_of_body(legs: Legs, points: Array) -> BoolArray:
    """(F, N) whether knees are outside the body's box; links at the first joints may not be."""
    low, high = legs.box
    inside = ((points > low) & (points < high)).all(axis=-1)  # (F, N, P)
    return np.asarray(~(inside & legs.away).any(axis=-1))


def best_of(
    quality: Quality,
    angles: Array,
    toes: Array,
    fine: BoolArray,
    count: int,
    gap: Array | None = None,
) -> list[Posture]:
    """The best candidates: every leg fine, and the least of their scores largest."""
    score = np.where(fine & (quality.room > LEAST_ROOM), quality.score, -np.inf).min(axis=1)
    order = [int(i) for i in np.argsort(-score, kind="stable") if score[i] > 0]
    return [
        Posture(
            angles[i],
            toes[i],
            float(score[i]),
            float(quality.room[i].min()),
            float(quality.use[i].max()),
            0.0 if gap is None else float(gap[i]),
        )
        for i in order[:count]
    ]
