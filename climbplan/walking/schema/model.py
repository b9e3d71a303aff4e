"""MPC spec (`kind: mpc`): a walking robot that chooses footsteps, gait and forces (8.2)."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, SpecModel, quantity, refuse
from climbplan.walking.schema.loop import WalkLoopSpec
from climbplan.walking.schema.solver import WalkLibrarySpec, WalkSolverSpec
from climbplan.walking.schema.task import WalkTaskSpec, WalkWeightsSpec
from climbplan.walking.schema.terrain import WalkTerrainSpec


class MpcSpec(SpecModel):
    """Footsteps, gait, body motion and contact forces of a walking robot, chosen together."""

    kind: Literal["mpc"] = Field(description="always `mpc`")
    title: str = Field(default="", description="one line for reports")
    robot: str = Field(
        default="scaler",
        min_length=1,
        description="built-in rigid body (`scaler`), or path of a rigid-body YAML file or of a "
        "robot file of a URDF (`climbplan new robot`)",
    )
    forward: Literal["x", "y"] = Field(
        default="x",
        description="world axis that points forward. `y`: positions, velocities, angles and "
        "terrain are those of climbs (x right, y forward), and so is the plan; `x`: x forward, y "
        "to the left",
    )
    terrain: WalkTerrainSpec = WalkTerrainSpec()
    """The ground."""
    task: WalkTaskSpec = WalkTaskSpec()
    """Horizon, start and reference."""
    weights: WalkWeightsSpec = WalkWeightsSpec()
    """The objective."""
    solver: WalkSolverSpec = WalkSolverSpec()
    """Method and limits."""
    library: WalkLibrarySpec = WalkLibrarySpec()
    """What `online` takes its integers from."""
    loop: WalkLoopSpec = WalkLoopSpec()
    """The closed loop of `online`."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _online_can(self) -> Self:
        faults = []
        if self.solver.method == "online":
            faults += self._online_ground()
            if self.task.goal is not None:
                faults.append(
                    Fault(
                        "task.goal",
                        "expected none with `online`, which follows the reference velocity",
                    )
                )
            if self.task.integrator != "mean":
                message = "`online` runs in continuous time, which needs `integrator: mean`"
                faults.append(Fault("task.integrator", message))
        if self.solver.method == "spatial-branch-and-bound":
            message = (
                "`spatial-branch-and-bound` takes level regions only; `gait-search` and `mpcc` "
                "take slopes"
            )
            faults += [
                Fault(f"terrain.regions.{k}", message)
                for k, region in enumerate(self.terrain.regions)
                if any(region.plane.slope)
            ]
            faults += self._friction_faults()
        refuse(faults)
        return self

    def _online_ground(self) -> list[Fault]:
        """Return faults of keys that `online` does not support on terrain."""
        if not self.terrain.has_footholds:
            return []
        faults = self._friction_faults()
        if self.loop.estimation == "ekf":
            message = (
                "with `ekf` nothing measures where the robot is among its regions, and its place "
                "drifts by centimetres a second: `none` walks on them"
            )
            faults.append(Fault("loop.estimation", message))
        if self.solver.formulation == "published":
            message = "`published` knows flat ground only"
            faults.append(Fault("solver.formulation", message))
        return faults

    def _friction_faults(self) -> list[Fault]:
        """Return faults of regions with a friction coefficient, for methods that know one only."""
        terrain = self.terrain
        stated = [(f"regions.{k}", r.friction) for k, r in enumerate(terrain.regions)]
        stated += [(f"boxes.{k}", box.friction) for k, box in enumerate(terrain.boxes)]
        stated += [("ground", terrain.ground.friction)] if terrain.ground is not None else []
        message = (
            f"`{self.solver.method}` knows one friction coefficient: expected `terrain.friction` "
            "alone; `gait-search` and `mpcc` take one of each region"
        )
        return [
            Fault(f"terrain.{key}.friction", message)
            for key, friction in stated
            if friction is not None
        ]
