"""What of the world and of the player may differ from the plan."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Conditions of one run in Drake."""

    gain_scale: float = 1.0  # on the P gains of the controller
    damping_scale: float = 1.0  # on its D gains
    friction_scale: float = 1.0  # on the friction coefficients of the terrain
    armature: float = 0.0  # [kg m^2] rotor inertia of every joint
    regulate: bool = True  # commands of the exported regulator; False: as exported
    urdf_toes: bool = True  # toes are what the URDF has there; False: spheres of the foot's radius
    time_step: float = 2e-3  # [s] of the engine
    control_period: float = 4e-3  # [s] of the controller
