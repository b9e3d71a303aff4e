"""Search for standing postures on level ground and for bracing postures between two walls.

Both searches enumerate a grid of toe positions relative to the first joints: how far below, how far
outward, and how far towards front or rear. For standing, inverse kinematics starts from the best
sampled posture nearby and mirrored legs bend alike. For bracing it starts from the standing one.
A candidate is feasible if its links stay above the ground, outside of the body and between walls.
Candidates are ranked by their worst leg: the margin about its toe, first order, times the unused
fraction of its torque limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from climbplan.arrays import Array, BoolArray
from climbplan.robots.chain_inverse import chain_inverse
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.lift_torque import (
    BracedStance,
    TorqueDemand,
    compute_torque_utilisation,
    find_overloaded_joint,
)
from climbplan.robots.urdf.proposal.posture_quality import PostureQuality, evaluate_postures
from climbplan.robots.urdf.workspace import select_common_reach

_NUM_SAMPLES = 4000  # postures of every leg
_NUM_NEIGHBOURS = 40  # of these, compared for each toe
# Fractions of a leg's reach:
_LOWERINGS = np.arange(0.35, 0.93, 0.07)  # toes below first joints
_OUTWARD_OFFSETS = np.array([0.0, 0.1, 0.2, 0.35, 0.5])
_FORE_AFT_OFFSETS = np.array([-0.1, 0.0, 0.1, 0.25])  # towards front or rear, away from the middle
_WALL_DISTANCES = np.arange(0.25, 0.96, 0.07)  # of walls from first joints
_BRACE_LOWERINGS = np.array([-0.2, 0.0, 0.15, 0.3, 0.45, 0.6])
_BRACE_OFFSETS = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
MAX_SHIFT_RATIOS = (0.15, 0.22)  # shift of the body between walls; the second where need be
MIN_LINK_HEIGHT = 0.05  # of links above toes on the ground
_MAX_FORCE_CHECKS = 120  # best braces whose forces are computed
_NUM_BEST_BRACES = 16  # that hold, after which those that cannot be better are left out
_WEAK_UTILISATION = 0.75  # from which on the larger shift is tried
MIN_LIMB_CLEARANCE = 0.02  # [m] between limbs of standing robots with arms
_UNBOUNDED_RANGE = 2.0  # [rad] either way in which joints without bounds are sampled
_NUM_SUPPORTING = 3  # legs that bear the weight
_SYMMETRY_SCALE = 0.5  # [m] off the mirror image of the other leg, per metre of score
MIN_REACH_MARGIN = 0.01  # [m]
_BOUND_MARGIN = np.deg2rad(1.0)  # [rad] of postures from joint bounds
_MAX_BOUND_FRACTION = 0.02  # of a joint's range, that this margin takes at most
_NEAR_BODY = 0.2  # of a limb's length, within which it may be in the body's box
_MAX_BOUND_DIFFERENCE = np.deg2rad(
    3.0
)  # [rad] between a bound and the mirror image of the other one
_MIN_ALIGNMENT = 0.95  # cosine between an axis and the mirror image of the other one
_MAX_LISTED = 3  # joints that are named


@dataclass(frozen=True)
class LeggedPosture:
    """One posture of N legs on ground or between walls."""

    angles: Array  # (N, J) [rad]
    toes: Array  # (N, 3) frame of the chains [m]
    score: float  # of the worst leg [m]
    reach_margin: float  # radius of the smallest reachable ball about a toe, first order [m]
    utilisation: float  # largest fraction of a torque limit
    gap: float = 0.0  # between walls [m]
    friction: float = 0.0  # of the walls
    shift: float = 0.0  # of the body over the standing legs [m]
    sway_clearance: float = np.inf  # of links from body and other limbs while the body sways [m]


@dataclass(frozen=True)
class LegModel:
    """Kinematics and limits of N legs with J joints; frame x right, y forward, z up."""

    chain: SerialChain
    lower: Array  # (N, J) [rad]
    upper: Array  # (N, J) [rad]
    torque: Array  # (N, J) [N m]
    reach: Array  # (N,) [m]
    weight: float  # [N]
    mirrored_legs: tuple[int | None, ...]  # the leg on the other side
    body_box: tuple[Array, Array]  # lower and upper corner [m]

    @property
    def hips(self) -> Array:
        """First joints, (N, 3) [m]."""
        return self.chain.joint_zero[:, 0]

    @property
    def must_clear_body(self) -> BoolArray:
        """Joints and toe, (N, P), that have to be outside of the body's box.

        The first two points and those near them may be inside.
        """
        points = self.chain.joint_points(np.zeros((1, *self.lower.shape)))[0]
        length = np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=-1), axis=1)
        length = np.concatenate([np.zeros((len(points), 1)), length], axis=1)
        far = length > _NEAR_BODY * length[:, -1:]
        far[:, :2] = False
        return np.asarray(far)

    @property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lower and upper joint bounds [rad] and torque limits [N m], each (N, J)."""
        return self.lower, self.upper, self.torque

    @property
    def outward_signs(self) -> Array:
        """Signs of right and forward, (N, 2), from the middle of all first joints to each."""
        offset = self.hips[:, :2] - self.hips[:, :2].mean(axis=0)
        return np.where(np.abs(offset) < 1e-3, 0.0, np.sign(offset))

    @property
    def wall_sides(self) -> Array:
        """The wall of each leg, (N,): 1 on the right, -1 on the left."""
        signs = self.outward_signs[:, 0]
        return np.where(signs == 0, 1.0, signs)

    def build_wall_normals(self) -> Array:
        """Return unit normals (N, 3) of the walls on which the toes are, away from the walls."""
        normal = np.zeros((len(self.hips), 3))
        normal[:, 0] = -self.wall_sides
        return normal

    def build_stance(
        self, angles: Array, toes: Array, normal: Array, friction: float, max_shift: float
    ) -> BracedStance:
        """Return the contacts of a posture.

        Args:
            angles: Joint angles (N, J) [rad].
            toes: Toes (N, 3) from the centre of mass [m].
            normal: Unit normals (N, 3) away from the surfaces.
            friction: Coefficient that may be used.
            max_shift: Largest shift of the body [m].
        """
        jacobian = self.chain.jacobian(angles)
        return BracedStance(toes, normal, jacobian, self.torque, self.weight, friction, max_shift)


def keep_off_bounds(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return joint bounds within which postures are searched for, each (N, J) [rad].

    They lie 1 degree inside the given ones, or a small part of a narrow range. The deflection of
    joints and a step of the body otherwise take commands past the bounds of the robot.
    """
    span = np.where(np.isfinite(upper - lower), upper - lower, np.inf)
    margin = np.clip(_MAX_BOUND_FRACTION * span, 0.0, _BOUND_MARGIN)
    return lower + margin, upper - margin


def search_standing_postures(legs: LegModel, count: int) -> list[LeggedPosture]:
    """Return up to `count` postures on level ground, best first."""
    low, out, fore = (
        x.ravel()
        for x in np.meshgrid(_LOWERINGS, _OUTWARD_OFFSETS, _FORE_AFT_OFFSETS, indexing="ij")
    )
    reach, hips, sign = legs.reach, legs.hips, legs.outward_signs
    toes = np.empty((len(low), len(hips), 3))
    toes[..., 0] = hips[:, 0] + sign[:, 0] * out[:, None] * reach
    toes[..., 1] = hips[:, 1] + sign[:, 1] * fore[:, None] * reach
    # All on one level: that of the shortest leg
    level = (hips[:, 2] - low[:, None] * reach).max(axis=1)
    toes[..., 2] = level[:, None]
    force = np.zeros((len(hips), 3))
    force[:, 2] = legs.weight / min(_NUM_SUPPORTING, len(hips))
    angles, reached = solve_toe_positions(legs, toes, force)
    quality = evaluate_postures(legs.chain, angles, force, legs.limits)
    height = quality.points[..., :-1, 2].min(axis=-1) - toes[..., 2]
    feasible = (
        reached & are_clear_of_body(legs, quality.points) & (height > MIN_LINK_HEIGHT * reach)
    )
    return select_best_postures(quality, angles, toes, feasible, count)


def search_bracing_postures(
    legs: LegModel,
    standing: Array,
    clearance: float,
    friction: float,
    select_clear: Callable[[Array, Array], BoolArray] | None = None,
) -> tuple[list[LeggedPosture], TorqueDemand]:
    """Search for postures that hold the robot between two walls at equal distances.

    Args:
        legs: The legs, in a frame about the centre of mass.
        standing: Angles (N, J) from which inverse kinematics starts, as when the robot is planned
            with [rad].
        clearance: Distance of the body and its links from the walls [m].
        friction: Coefficient that may be used.
        select_clear: Whether links as thick as in planning keep off walls and other links, (C,), at
            angles (C, N, J) [rad] between walls at half distances (C,) [m]; None for all.

    Returns:
        Postures that hold with any one leg lifted, best first, and the smallest utilisation of any
        posture.
    """
    toes, half = _enumerate_wall_toes(legs, clearance)
    chain = SerialChain(
        legs.chain.names,
        legs.chain.joint_zero,
        legs.chain.axis_zero,
        legs.chain.toe_zero,
        standing,
    )
    solution = chain.inverse(toes, legs.lower, legs.upper)
    reached = solution.valid
    angles = np.where(reached[..., None], solution.best(), standing)
    quality = evaluate_postures(chain, angles, np.zeros((len(legs.hips), 3)), legs.limits)
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - clearance
    feasible = reached & within & are_clear_of_body(legs, quality.points)
    if select_clear is not None:
        complete = np.flatnonzero(feasible.all(axis=1))
        clear = select_clear(angles[complete], half[complete])
        feasible[complete[~clear]] = False
    candidates = select_best_postures(quality, angles, toes, feasible, _MAX_FORCE_CHECKS, 2 * half)
    braces, demand = _select_holding_braces(replace(legs, chain=chain), candidates, friction)
    any_feasible = bool(feasible.all(axis=1).any())
    return braces, demand if any_feasible else TorqueDemand()


def _enumerate_wall_toes(legs: LegModel, clearance: float) -> tuple[Array, Array]:
    """Return a grid of toes (C, N, 3) on two walls, and half of their distances (C,) [m]."""
    reach, hips, sign = legs.reach, legs.hips, legs.outward_signs
    wide, below, fore = (
        x.ravel()
        for x in np.meshgrid(_WALL_DISTANCES, _BRACE_LOWERINGS, _BRACE_OFFSETS, indexing="ij")
    )
    half = np.abs(hips[:, 0]).max() + wide * float(reach.min())
    body_half = np.maximum(-legs.body_box[0][0], legs.body_box[1][0]) + clearance
    keep = half > body_half
    half, below, fore = half[keep], below[keep], fore[keep]
    toes = np.empty((len(half), len(hips), 3))
    toes[..., 0] = legs.wall_sides * half[:, None]
    toes[..., 1] = hips[:, 1] + sign[:, 1] * fore[:, None] * reach
    toes[..., 2] = hips[:, 2] - below[:, None] * np.minimum(reach, select_common_reach(reach))
    return toes, half


def _select_holding_braces(
    legs: LegModel, candidates: list[LeggedPosture], friction: float
) -> tuple[list[LeggedPosture], TorqueDemand]:
    """Return candidates that hold with any one leg lifted, best first, and the least demand."""
    normal = legs.build_wall_normals()
    braces: list[LeggedPosture] = []
    demand = TorqueDemand(np.inf)
    for ratio in MAX_SHIFT_RATIOS:
        if demand.utilisation <= _WEAK_UTILISATION:
            break
        braces, max_shift = [], ratio * float(legs.reach.min())
        for brace in candidates:  # by falling reach margin, which no score exceeds
            if brace.reach_margin < _compute_nth_score(braces, _NUM_BEST_BRACES):
                break
            stance = legs.build_stance(brace.angles, brace.toes, normal, friction, max_shift)
            utilisation, shift = compute_torque_utilisation(stance)
            if utilisation < demand.utilisation:
                demand = TorqueDemand(utilisation)
                if utilisation >= 1:
                    demand = find_overloaded_joint(utilisation, stance)
            if utilisation < 1:
                braces.append(rate_brace(brace, utilisation, shift))
    return sorted(braces, key=lambda brace: -brace.score), demand


def _compute_nth_score(braces: list[LeggedPosture], count: int) -> float:
    """Return the score of the nth best of some braces; -inf where there are fewer."""
    scores = sorted((brace.score for brace in braces), reverse=True)
    return scores[count - 1] if len(scores) >= count else -np.inf


def rate_brace(posture: LeggedPosture, utilisation: float, shift: float) -> LeggedPosture:
    """Return the posture with its utilisation and shift [m], and the score that follows."""
    score = posture.reach_margin * (1 - utilisation)
    return replace(posture, utilisation=utilisation, shift=shift, score=score)


def solve_toe_positions(
    legs: LegModel, toes: Array, force: Array, knees_above_toes: BoolArray | None = None
) -> tuple[Array, BoolArray]:
    """Solve the inverse kinematics of toes, mirrored legs bent alike.

    Each leg starts from the sampled posture with the best score near its toe.

    Args:
        legs: The legs.
        toes: Positions (C, N, 3), frame of the chains [m].
        force: Force on each toe (N, 3) [N], for the scores of samples.
        knees_above_toes: (N,) limbs whose joints have to be above their toes; None for all.

    Returns:
        Angles (C, N, J) [rad], and whether each toe is reached, (C, N).
    """
    chain, count = legs.chain, toes.shape[1]
    samples, quality, score = _sample_leg_postures(legs, force, knees_above_toes)
    angles = np.zeros((*toes.shape[:2], legs.lower.shape[1]))
    done: set[int] = set()
    for limb in range(count):
        rows = np.flatnonzero(np.isfinite(score[:, limb]))
        if not len(rows):
            rows = np.arange(_NUM_SAMPLES)
        tips = quality.points[rows, limb, -1]
        nearest = cKDTree(tips).query(toes[:, limb], k=min(_NUM_NEIGHBOURS, len(rows)))[1]
        nearest = rows[np.atleast_2d(nearest.T).T]  # (C, K)
        value = score[nearest, limb]
        twin = legs.mirrored_legs[limb]
        if twin in done:
            # Bent as the leg on the other side is
            image = chain.joint_points(angles)[:, twin] * [-1.0, 1.0, 1.0]  # (C, P, 3)
            offset = quality.points[nearest, limb] - image[:, None]
            value = -np.linalg.norm(offset, axis=-1).sum(-1) / _SYMMETRY_SCALE
        else:
            tips = quality.points[nearest, limb, -1]
            value = value - np.linalg.norm(tips - toes[:, None, limb], axis=-1)
        start = nearest[np.arange(len(toes)), np.argmax(value, axis=1)]
        leg = np.full(len(toes), limb)
        solution = chain_inverse(
            chain.zero.rows(leg),
            samples[start, limb],
            np.arange(len(toes)),
            toes[:, limb],
            legs.lower[leg],
            legs.upper[leg],
        )
        angles[:, limb] = solution.angles
        done.add(limb)
    reached = np.linalg.norm(chain.joint_points(angles)[..., -1, :] - toes, axis=-1) < 1e-6
    return angles, reached


def _sample_leg_postures(
    legs: LegModel, force: Array, knees_above_toes: BoolArray | None
) -> tuple[Array, PostureQuality, Array]:
    """Return sampled angles (F, N, J) [rad], their quality, and scores (F, N), -inf if invalid."""
    # Bounds of more than a turn say nothing: samples lie round zero then
    widest = np.where(legs.upper - legs.lower > 2 * np.pi, _UNBOUNDED_RANGE, np.pi)
    low, high = np.clip(legs.lower, -widest, widest), np.clip(legs.upper, -widest, widest)
    fraction = np.random.default_rng(0).random((_NUM_SAMPLES, *legs.lower.shape))
    samples = low + fraction * (high - low)
    quality = evaluate_postures(legs.chain, samples, force, legs.limits)
    # Knees above their toes, and links out of the body
    height = quality.points[..., :-1, 2].min(axis=-1) - quality.points[..., -1, 2]
    anywhere = False if knees_above_toes is None else ~knees_above_toes
    valid = are_clear_of_body(legs, quality.points) & (
        (height > MIN_LINK_HEIGHT * legs.reach) | anywhere
    )
    return samples, quality, np.where(valid, quality.score, -np.inf)


def are_clear_of_body(legs: LegModel, points: Array) -> BoolArray:
    """Return whether joints and toe (F, N, P, 3) of each leg are outside the body's box, (F, N).

    Links at the first joints may be inside.
    """
    low, high = legs.body_box
    inside = ((points > low) & (points < high)).all(axis=-1)  # (F, N, P)
    return np.asarray(~(inside & legs.must_clear_body).any(axis=-1))


def select_best_postures(
    quality: PostureQuality,
    angles: Array,
    toes: Array,
    feasible: BoolArray,
    count: int,
    gap: Array | None = None,
) -> list[LeggedPosture]:
    """Return up to `count` candidates by the score of their worst leg, best first.

    Args:
        quality: Of C candidates of N legs.
        angles: (C, N, J) [rad].
        toes: (C, N, 3) [m].
        feasible: (C, N); a candidate counts if all of its legs are feasible.
        count: How many to return at most.
        gap: Distance between walls (C,) [m]; None on ground.
    """
    valid = feasible & (quality.reach_margin > MIN_REACH_MARGIN)
    score = np.where(valid, quality.score, -np.inf).min(axis=1)
    order = [int(i) for i in np.argsort(-score, kind="stable") if score[i] > 0]
    return [
        LeggedPosture(
            angles[i],
            toes[i],
            float(score[i]),
            float(quality.reach_margin[i].min()),
            float(quality.utilisation[i].max()),
            0.0 if gap is None else float(gap[i]),
        )
        for i in order[:count]
    ]


def describe_unmirrored_bounds(legs: LegModel) -> list[str]:
    """Return a note on joints whose bounds are no mirror image of the other leg's; none if all are.

    The mirror image of a rotation about an axis (x, y, z), with x to the right, is one by the same
    angle about (x, -y, -z). Bounds of the other leg are therefore the same where its axis is that
    one, and negated and swapped where its axis is the opposite.

    Args:
        legs: Pairs of legs with the bounds of the URDF, or bounds as far inside of these.
    """
    lower, upper = (np.clip(bound, -np.pi, np.pi) for bound in (legs.lower, legs.upper))
    axes = legs.chain.axis_zero
    pairs = []
    for leg, twin in enumerate(legs.mirrored_legs):
        if twin is None or twin <= leg:
            continue
        for joint, (name, twin_name) in enumerate(
            zip(legs.chain.names[leg], legs.chain.names[twin], strict=True)
        ):
            alignment = float((axes[leg, joint] * [1.0, -1.0, -1.0]) @ axes[twin, joint])
            if not name or not twin_name or abs(alignment) < _MIN_ALIGNMENT:
                continue
            expected = np.array([lower[leg, joint], upper[leg, joint]])
            if alignment < 0:
                expected = -expected[::-1]
            bounds = np.array([lower[twin, joint], upper[twin, joint]])
            if np.abs(bounds - expected).max() > _MAX_BOUND_DIFFERENCE:
                actual, mirrored = (_format_bounds(values) for values in (bounds, expected))
                pairs.append(
                    f"{twin_name} turns by {actual}, as the mirror image of {name} {mirrored}"
                )
    if not pairs:
        return []
    more = f" and {len(pairs) - _MAX_LISTED} more" if len(pairs) > _MAX_LISTED else ""
    listed = "; ".join(pairs[:_MAX_LISTED])
    return [f"joint bounds are not mirrored between left and right [deg]: {listed}{more}"]


def _format_bounds(bounds: Array) -> str:
    """Return bounds (2,) [rad] in degrees."""
    low, high = np.rad2deg(bounds)
    return f"{low:.0f} to {high:.0f}"
