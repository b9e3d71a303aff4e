"""The layout of variables and parameters of the posture NLP in IPOPT's vectors.

All arrays of a scene and of a start are addressed by name here, so that no other file counts
positions in a vector.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.program.layout import MatrixLayout
from climbplan.robots.symbolic_limbs import SymbolicLimbs


@dataclass(frozen=True)
class Moment:
    """A moment of a limb's move within a round at which its joint angles are variables."""

    name: str
    at_end: bool  # body at the end of the round, else where it is while the limb moves
    at_new_contact: bool  # toe on (or over) its new place, else its old one
    is_lifted: bool  # lifted off along the normal


MOMENTS = (
    Moment("end", at_end=True, at_new_contact=True, is_lifted=False),
    Moment("lift", at_end=False, at_new_contact=False, is_lifted=False),
    Moment("lifted", at_end=False, at_new_contact=False, is_lifted=True),
    Moment("lowered", at_end=False, at_new_contact=True, is_lifted=True),
    Moment("place", at_end=False, at_new_contact=True, is_lifted=False),
)


@dataclass(frozen=True)
class NlpStructure:
    """The structure of the program; everything else about a scene is a parameter."""

    num_rounds: int
    gait: tuple[int, ...]  # limbs in the order in which they move
    is_curved: bool  # toes on a tube instead of on fixed flat regions
    max_edges: int  # most edges of a contact region
    num_free_rows: int  # most rows of the free regions of a round
    num_hull_corners: int  # corners of the body
    num_obstacles: int  # solids that limbs keep clear of
    has_stance_ball: bool  # second workspace ball
    checks_during_round: bool  # workspace balls also while the body moves within a round
    has_com_min: bool  # lower bounds on steps
    has_toe_min: bool
    kinematics: SymbolicLimbs

    @property
    def links(self) -> int:
        """Return the number of straight pieces of a limb, from joint to joint and toe."""
        return self.kinematics.joints

    @property
    def limbs(self) -> int:
        """Return the number of limbs N."""
        return len(self.gait)


def build_variable_layout(n: int, joints: int) -> MatrixLayout:
    """Return the layout of one round's variables; the first three arrays are the posture itself."""
    angles = tuple((f"angles_{moment.name}", (joints, n)) for moment in MOMENTS)
    return MatrixLayout((("com", (3, 1)), ("rpy", (3, 1)), ("toes", (3, n)), *angles))


def build_posture_layout(n: int) -> MatrixLayout:
    """Return the layout of one posture: body pose and toes."""
    return MatrixLayout(build_variable_layout(n, 0).shapes[:3])


def build_pin_layout(shape: NlpStructure) -> MatrixLayout:
    """Return the layout of what is fixed per round before the NLP is solved.

    These are the region of each toe before and after the round, the body's free region, and at
    every moment the separating plane of each link of each limb and each obstacle. Columns are
    ordered obstacle by obstacle, limb by limb, link by link.
    """
    n, k, f = shape.limbs, shape.max_edges, shape.num_free_rows
    flat = (
        ("old_normal", (3, n)),
        ("normal", (3, n)),
        ("offset", (1, n)),
        ("edge_rows", (3, k * n)),
        ("edge_bounds", (k, n)),
    )
    free = (("free_rows", (3, f)), ("free_bounds", (1, f)))
    planes = tuple(
        (f"planes_{moment.name}", (4, shape.links * n * shape.num_obstacles)) for moment in MOMENTS
    )
    return MatrixLayout((*(() if shape.is_curved else flat), *free, *planes))


def build_number_layout(shape: NlpStructure) -> MatrixLayout:
    """Return the layout of the parameters of robot, terrain and planner, for all rounds."""
    n = shape.limbs
    per_limb = ("first_joint", "stance")
    scalars = (
        *("reach", "stance_radius", "lift", "clearance", "hull_radius", "limb_room"),
        *("com_max", "com_min", "toe_max", "toe_min", "rotation_max", "tolerance"),
        "rotation_tolerance",
        *("w_goal", "w_goal_com", "w_goal_rotation", "w_com", "w_toe", "w_rotation"),
    )
    return MatrixLayout(
        (
            *((name, (3, n)) for name in per_limb),
            *shape.kinematics.robot_parameter_shapes.items(),
            ("hull", (3, shape.num_hull_corners)),
            ("axis", (2, 1)),
            ("radius", (1, 1)),
            ("goal_com", (3, 1)),
            ("goal_rpy", (3, 1)),
            ("goal_toes", (3, n)),
            *((name, (1, 1)) for name in scalars),
        )
    )
