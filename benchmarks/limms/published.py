"""Table 6.3 of chapter 6: the published sizes and times, on another machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """A row of the table; times in minutes of Gurobi and IPOPT on an i7-7800X."""

    steps: int
    mip_variables: int
    mip_binaries: int
    mip_constraints: int
    nlp_variables: int
    nlp_constraints: int
    mip_minutes: float
    nlp_minutes: float
    minutes: float


TABLE = {
    "limms_throw": Published(10, 4857, 670, 3623, 1777, 5788, 0.88, 7.17, 8.05),
    "limms_jump": Published(15, 25917, 3150, 34545, 8787, 29611, 129, 24, 153),
    "limms_lift_light": Published(15, 25917, 3150, 3310, 8787, 30676, 41, 107, 148),
    "limms_lift_heavy": Published(10, 17277, 2100, 22032, 5857, 20311, 5, 50, 55),
    "limms_double_arm": Published(15, 25917, 3690, 35924, 8787, 31948, 19, 244, 263),
}
