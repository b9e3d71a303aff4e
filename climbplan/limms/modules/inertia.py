"""Masses of a module's links: rods, a ball in each joint, a latch at each end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.schema.module import ENDS, JOINTS, ModuleSpec


class LinkBodies(NamedTuple):
    """The seven links as rigid bodies with rotational symmetry about their z axes."""

    mass: Array  # (7,) [kg]
    com: Array  # (7,) along the link from its first point [m]
    transverse_inertia: (
        Array  # (7,) moment of inertia about axes across the link through its COM [kg m^2]
    )
    axial_inertia: Array  # (7,) about its own axis [kg m^2]


def build_link_bodies(module: ModuleSpec) -> LinkBodies:
    """Build the links of a module; their masses add up to the module's.

    Each link is a solid rod with the drive of the joint at its far end; the first and last ones
    have a latch at their outer end. Drives are balls and latches are discs of the links' radius.
    """
    length = np.array(module.link_lengths)
    radius = module.radius
    rods = module.mass - JOINTS * module.joint_mass - ENDS * module.latch_mass
    # Rod, drive at the far end, latch at the outer end: (3, 7) masses, places, own inertias
    rod = rods * length / length.sum()
    drive = np.where(np.arange(7) < JOINTS, module.joint_mass, 0.0)
    latch = np.where(np.isin(np.arange(7), (0, 6)), module.latch_mass, 0.0)
    masses = np.stack([rod, drive, latch])
    places = np.stack([length / 2, length, np.where(np.arange(7) == 0, 0.0, length)])
    transverse = np.stack(
        [
            rod * (3 * radius**2 + length**2) / 12,
            0.4 * drive * radius**2,
            latch * radius**2 / 4,
        ]
    )
    axial = np.stack([rod * radius**2 / 2, 0.4 * drive * radius**2, latch * radius**2 / 2])
    mass = masses.sum(axis=0)
    com = (masses * places).sum(axis=0) / mass
    steiner = (masses * (places - com) ** 2).sum(axis=0)
    return LinkBodies(mass, com, transverse.sum(axis=0) + steiner, axial.sum(axis=0))
