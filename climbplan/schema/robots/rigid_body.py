"""Rigid-body spec (`kind: rigid-body`): a robot as one body with boxes that its toes reach."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, Vector, quantity, refuse
from climbplan.schema.robots.leg_pairs import LEG_COUNTS, order_in_pairs


class RigidBodySpec(SpecModel):
    """A legged robot as a single rigid body (`robots/bodies/scaler.yaml`)."""

    kind: Literal["rigid-body"] = Field(description="always `rigid-body`")
    name: str = Field(min_length=1, description="name used in reports")
    mass: Number = quantity("kg", "total mass", gt=0)
    inertia: tuple[Vector, Vector, Vector] = quantity(
        "kg m^2", "about the centre of mass, body frame (x forward, y left, z up)"
    )
    gravity: Number = quantity("m/s^2", "along -z", default=9.81, gt=0)
    standing_height: Number = quantity(
        "m", "of the centre of mass above the ground, where a spec says nothing", default=0.2, gt=0
    )
    force_limit: Number = quantity("N", "largest component of a contact force", gt=0)
    toe_half: Vector = quantity("m", "half extents of the toes' workspace boxes")
    legs: dict[str, Vector] = quantity(
        "m",
        "middle of each leg's box, body frame: four, six or eight, pairs from "
        "front to hind, of each the left leg first: left front, right front, ..., right hind",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = []
        if len(self.legs) not in LEG_COUNTS:
            message = f"expected four, six or eight legs, got {len(self.legs)}"
            faults.append(Fault("legs", message))
        elif (order := order_in_pairs(list(self.legs.values()))) is None:
            message = "expected pairs, a leg on either side, one pair behind the other"
            faults.append(Fault("legs", message))
        elif order != sorted(order):
            names = list(self.legs)
            message = f"expected the order {', '.join(names[leg] for leg in order)}"
            faults.append(Fault("legs", message))
        if min(self.toe_half) <= 0:
            message = f"expected three numbers > 0, got {list(self.toe_half)}"
            faults.append(Fault("toe_half", message))
        rows = self.inertia
        if any(abs(rows[i][j] - rows[j][i]) > 1e-9 for i in range(3) for j in range(i)):
            faults.append(Fault("inertia", "expected a symmetric matrix"))
        elif not _positive_definite(rows):
            faults.append(Fault("inertia", "expected a positive definite matrix"))
        refuse(faults)
        return self


def _positive_definite(m: tuple[Vector, Vector, Vector]) -> bool:
    two = m[0][0] * m[1][1] - m[0][1] * m[1][0]
    three = (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )
    return m[0][0] > 0 and two > 0 and three > 0
