"""The variables and numbers of the posture NLP: how they lie in IPOPT's vectors.

All arrays of a scene and of a start are found by name here, so that no other file counts
positions in a vector.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.program.layout import Layout
from climbplan.robots.stated_limbs import StatedLimbs


@dataclass(frozen=True)
class Moment:
    """A moment in a limb's part of the round at which its joint angles are variables."""

    name: str
    at_end: bool  # body at the end of the round, else where it is while the limb moves
    new_place: bool  # toe on (or over) its new place, else its old one
    clear: bool  # lifted off along the normal


MOMENTS = (
    Moment("end", at_end=True, new_place=True, clear=False),
    Moment("lift", at_end=False, new_place=False, clear=False),
    Moment("lifted", at_end=False, new_place=False, clear=True),
    Moment("lowered", at_end=False, new_place=True, clear=True),
    Moment("place", at_end=False, new_place=True, clear=False),
)


@dataclass(frozen=True)
class Shape:
    """What decides the structure of the program; everything else is a number."""

    rounds: int
    gait: tuple[int, ...]  # limbs in the order in which they move
    curved: bool  # toes on a tube instead of on pinned flat regions
    edges: int  # most edges of a contact region
    free_rows: int  # most rows of the free regions of a round
    hull: int  # corners of the body
    obstacles: int  # solids that limbs keep clear of
    stance: bool  # second workspace ball
    intermediate: bool  # workspace balls also while the body moves within a round
    com_min: bool  # lower bounds on steps
    toe_min: bool
    stated: StatedLimbs

    @property
    def links(self) -> int:
        """Straight pieces of a limb, from joint to joint and toe."""
        return self.stated.joints

    @property
    def limbs(self) -> int:
        """N."""
        return len(self.gait)


def variable_layout(n: int, joints: int) -> Layout:
    """Variables of one round; the first three arrays are the posture itself."""
    angles = tuple((f"angles_{moment.name}", (joints, n)) for moment in MOMENTS)
    return Layout((("com", (3, 1)), ("rpy", (3, 1)), ("toes", (3, n)), *angles))


def posture_layout(n: int) -> Layout:
    """Body pose and toes."""
    return Layout(variable_layout(n, 0).shapes[:3])


def pin_layout(shape: Shape) -> Layout:
    """What is pinned per round.

    The region of each toe before and after, the body's free region, and at every moment the plane
    that parts each link of each limb from each obstacle (columns: obstacle by obstacle, limb by
    limb, link by link).
    """
    n, k, f = shape.limbs, shape.edges, shape.free_rows
    flat = (
        ("old_normal", (3, n)),
        ("normal", (3, n)),
        ("offset", (1, n)),
        ("edge_rows", (3, k * n)),
        ("edge_bounds", (k, n)),
    )
    free = (("free_rows", (3, f)), ("free_bounds", (1, f)))
    planes = tuple(
        (f"planes_{moment.name}", (4, shape.links * n * shape.obstacles)) for moment in MOMENTS
    )
    return Layout((*(() if shape.curved else flat), *free, *planes))


def number_layout(shape: Shape) -> Layout:
    """Numbers of robot, terrain and planner that hold for all rounds."""
    n = shape.limbs
    per_limb = ("first_joint", "stance")
    scalars = (
        *("reach", "stance_radius", "lift", "clearance", "hull_radius", "limb_room"),
        *("com_max", "com_min", "toe_max", "toe_min", "rotation_max", "tolerance"),
        "rotation_tolerance",
        *("w_goal", "w_goal_com", "w_goal_rotation", "w_com", "w_toe", "w_rotation"),
    )
    return Layout(
        (
            *((name, (3, n)) for name in per_limb),
            *shape.stated.numbers.items(),
            ("hull", (3, shape.hull)),
            ("axis", (2, 1)),
            ("radius", (1, 1)),
            ("goal_com", (3, 1)),
            ("goal_rpy", (3, 1)),
            ("goal_toes", (3, n)),
            *((name, (1, 1)) for name in scalars),
        )
    )
