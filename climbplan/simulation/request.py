"""The options of a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from climbplan.simulation.conditions import Conditions

Engine = Literal["mujoco", "statics"]


@dataclass(frozen=True)
class SimulationRequest:
    """A request for the nominal run, and for what is to be simulated in addition to it."""

    conditions: Conditions
    runs: int = 0  # in random worlds, of each swept value
    sweep_key: str = ""
    sweep_values: tuple[float, ...] = ()
    max_backlash: float = 0.0  # [rad] of random worlds
    seed: int = 0
    jobs: int = 1
    pictures: bool = True
    worlds: int = 0  # of the plan's uncertainty, in which falls are counted
    engine: Engine = "mujoco"  # of these
    # Pushes of a whole robot that walks: when [s], and what its momentum is worth [m/s]
    pushes: tuple[tuple[float, tuple[float, float, float]], ...] = ()
    rare: bool = False  # whether they are split instead, by the quasi-static engine
