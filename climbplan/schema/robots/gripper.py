"""Grippers: what they are (in the robot file), and how a climb uses them (in its spec)."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from climbplan.schema.base import Fault, Number, SpecModel, Vector, quantity, refuse


class GripperSpec(SpecModel):
    """Two-finger grippers, the same at the end of every limb, each on a spherical wrist.

    The toe of a limb with a gripper is the wrist's centre; the grip's centre lies `length` before
    it, against the surface. Wrist joints: 1 tilts sideways, 2 tilts in the limb's plane, 3 turns
    about the gripper's approach.
    """

    length: Number = quantity("m", "from the wrist's centre to the grip's", gt=0)
    finger_span: Number = quantity("m", "distance between the fingers on a hold", gt=0)
    max_force: Number = quantity("N", "largest gripping force, of each finger", ge=0)
    wrist_max_torque: Vector = quantity("N m", "torque limits of the three wrist joints")
    wrist_lower_deg: Vector = quantity("deg", "lower bounds of the wrist joints")
    wrist_upper_deg: Vector = quantity("deg", "upper bounds of the wrist joints")
    model: str = Field(
        default="spine_synthetic",
        min_length=1,
        description="shear force of the spines: a built-in model, or the path of a gripper.json "
        "that `fit-gripper` wrote, relative to the climb's spec",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = []
        if min(self.wrist_max_torque) <= 0:
            torques = list(self.wrist_max_torque)
            faults.append(Fault("wrist_max_torque", f"expected three numbers > 0, got {torques}"))
        faults += [
            Fault("wrist_lower_deg", f"joint {j}: expected less than {high:g}, got {low:g}")
            for j, (low, high) in enumerate(
                zip(self.wrist_lower_deg, self.wrist_upper_deg, strict=True), 1
            )
            if low >= high
        ]
        refuse(faults)
        return self


class GripSpec(SpecModel):
    """How a robot with grippers uses them; what is left out is the robot's own."""

    model: str | None = Field(
        default=None,
        min_length=1,
        description="another model of the spines' shear force: a built-in one, or the gripper.json "
        "of `fit-gripper`, relative to the spec",
    )
    risk: Number = quantity(
        "",
        "chance that a grip holds less shear force than is counted on: the planner uses the "
        "model's lower confidence bound",
        default=0.05,
        gt=0,
        lt=1,
    )
    max_force: Number | None = quantity(
        "N", "largest gripping force, of each finger; 0: grippers stay open", default=None, ge=0
    )
