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
                "`spatial-branch-and-bound` takes level rectangles only; `gait-search` and `mpcc` "
                "take slopes and polygons"
            )
            regions = self.terrain.regions
            faults += [
                Fault(f"terrain.regions.{k}", message)
                for k, region in enumerate(regions)
                if region.corners or any(region.slope)
            ]
            if self.terrain.stones is not None and self.terrain.stones.turn_deg > 0:
                faults.append(Fault("terrain.stones.turn_deg", message))
        refuse(faults)
        return self

    def _online_ground(self) -> list[Fault]:
        """Return faults of keys that `online` does not support on terrain."""
        terrain = self.terrain
        if not terrain.regions and terrain.stones is None:
            return []
        faults = []
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
