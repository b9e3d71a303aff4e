"""Robot and terrain in Drake."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.errors import MissingSolver
from climbplan.simulation.drake.exported import ExportedContact, ExportedMotion
from climbplan.simulation.drake.settings import Settings
from climbplan.simulation.drake.terrain import TerrainSolid

STIFFNESS = 5e5  # [N/m] of a contact of a link with terrain
# Drake lets contacts that friction holds creep, in proportion to the force and time step of each
# pair of geometries: terrain that is there several times shares the force among as many
LAYERS = 8
DISSIPATION = 20.0  # [s/m] of Hunt and Crossley
STICTION = 1e-6  # [m/s] at most that contacts creep which friction holds
POINT_RADIUS = 5e-4  # [m] of the sphere at a toe without collision geometry
_ROUGH = 1e9  # friction coefficient of the robot, which leaves that of the terrain
_REACH = 1e-3  # [m] that a toe may be outside its link's geometry


def import_pydrake(module: str) -> Any:
    """Import a module of Drake's.

    Raises MissingSolver if Drake is not installed.
    """
    try:
        return importlib.import_module(f"pydrake.{module}")
    except ImportError as error:
        raise MissingSolver(
            "--engine drake needs Drake, which is not installed: pip install 'climbplan[drake]'"
        ) from error


@dataclass(frozen=True)
class Plant:
    """A robot in its terrain, in Drake's hands."""

    plant: Any  # MultibodyPlant
    scene: Any  # SceneGraph
    diagram: Any
    model: Any  # the robot's ModelInstanceIndex
    base: Any  # the URDF's root link
    joints: tuple[Any, ...]  # (J,) in the order of the exported columns
    toes: tuple[Any, ...]  # (C,) links of the toes
    toe_bodies: tuple[frozenset[int], ...]  # (C,) indices of the bodies fixed to these
    terrain: dict[Any, str]  # geometry -> name of the solid, of every layer
    first_layer: frozenset[Any]  # of these geometries the ones of one layer
    added_toes: tuple[str, ...]  # limbs with spheres in place of their links' geometry
    mass: float  # of the URDF [kg]
    urdf_warnings: tuple[str, ...]  # of Drake's parser, their first lines

    def create_context(self, motion: ExportedMotion, mass: float) -> Any:
        """Return the diagram's context with the robot at the plan's first sample.

        Args:
            motion: the plan.
            mass: of the whole robot [kg], to which the URDF's inertias are scaled.
        """
        root = self.diagram.CreateDefaultContext()
        context = self.plant.GetMyMutableContextFromRoot(root)
        spatial = import_pydrake("multibody.tree").SpatialInertia
        if abs(mass / self.mass - 1.0) > 1e-6:
            for index in self.plant.GetBodyIndices(self.model):
                body = self.plant.get_body(index)
                inertia = body.default_spatial_inertia()
                scaled = spatial(
                    inertia.get_mass() * mass / self.mass,
                    inertia.get_com(),
                    inertia.get_unit_inertia(),
                )
                body.SetSpatialInertiaInBodyFrame(context, scaled)
        for name, angle in motion.held.items():
            joint = self.plant.GetJointByName(name, self.model)
            joint.SetPositions(context, [angle])
            joint.Lock(context)
        self.place(context, motion, 0)
        return root

    def place(self, context: Any, motion: ExportedMotion, sample: int) -> None:
        """Put the robot where it is planned at a sample, at rest."""
        x, y, z, w = motion.base_quaternion[sample] / np.linalg.norm(motion.base_quaternion[sample])
        turn = import_pydrake("common.eigen_geometry").Quaternion(w, x, y, z)
        pose = import_pydrake("math").RigidTransform(turn, motion.base_position[sample])
        self.plant.SetFreeBodyPose(context, self.base, pose)
        positions = self.plant.GetPositions(context)
        for joint, angle in zip(self.joints, motion.angle[sample], strict=True):
            positions[joint.position_start()] = angle
        self.plant.SetPositions(context, positions)

    def penetrations(self, context: Any) -> Any:
        """Return Drake's pairs of geometries that overlap where the robot is."""
        return self._query(context).ComputePointPairPenetration()

    def body_of(self, context: Any, geometry: Any) -> Any:
        """Return the body that a geometry is fixed to."""
        inspector = self._query(context).inspector()
        return self.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))

    def ignore_overlaps(self, root: Any) -> tuple[str, ...]:
        """Let links pass through each other whose geometry overlaps now, and return their names."""
        context = self.plant.GetMyContextFromRoot(root)
        names = []
        declare = import_pydrake("geometry").CollisionFilterDeclaration
        geometry_set = import_pydrake("geometry").GeometrySet
        manager = self.scene.collision_filter_manager(self.scene.GetMyMutableContextFromRoot(root))
        for pair in self.penetrations(context):
            if pair.id_A in self.terrain or pair.id_B in self.terrain:
                continue
            manager.Apply(
                declare().ExcludeBetween(geometry_set(pair.id_A), geometry_set(pair.id_B))
            )
            ends = sorted(self.body_of(context, g).name() for g in (pair.id_A, pair.id_B))
            names.append(" and ".join(ends))
        return tuple(sorted(set(names)))

    def _query(self, context: Any) -> Any:
        return self.plant.get_geometry_query_input_port().Eval(context)


def build_plant(
    motion: ExportedMotion,
    document: Path,
    solids: tuple[TerrainSolid, ...],
    gravity: float,
    settings: Settings,
) -> Plant:
    """Build the robot of a URDF document among solids, its motors under P and D control.

    Toes whose links have no collision geometry there, or all where `settings.urdf_toes` says so,
    are spheres.
    """
    everything = frozenset(range(len(motion.contacts)))
    if not settings.urdf_toes:
        return _build(motion, document, solids, gravity, settings, everything)
    plant = _build(motion, document, solids, gravity, settings, frozenset())
    context = plant.plant.GetMyContextFromRoot(plant.create_context(motion, plant.mass))
    bare_toes = frozenset(c for c in everything if _is_bare(plant, context, motion.contacts[c], c))
    return _build(motion, document, solids, gravity, settings, bare_toes) if bare_toes else plant


def _is_bare(plant: Plant, context: Any, contact: ExportedContact, index: int) -> bool:
    """Return whether the geometry fixed to a toe's link ends farther off than it is to touch."""
    body = plant.toes[index]
    point = body.EvalPoseInWorld(context).multiply(np.array(contact.offset))
    query = plant.plant.get_geometry_query_input_port().Eval(context)
    distances = query.ComputeSignedDistanceToPoint(point, contact.radius + 1.0)
    toe_distances = [
        distance.distance
        for distance in distances
        if int(plant.body_of(context, distance.id_G).index()) in plant.toe_bodies[index]
    ]
    return not toe_distances or min(toe_distances) + contact.radius > _REACH


def _build(
    motion: ExportedMotion,
    document: Path,
    solids: tuple[TerrainSolid, ...],
    gravity: float,
    settings: Settings,
    spheres: frozenset[int],
) -> Plant:
    """Build it with spheres at the toes of the limbs that are named by their numbers."""
    builder = import_pydrake("systems.framework").DiagramBuilder()
    plants = import_pydrake("multibody.plant")
    config = plants.MultibodyPlantConfig(
        time_step=settings.time_step,
        contact_model="point",
        discrete_contact_approximation="lagged",
        stiction_tolerance=STICTION,
    )
    plant, scene = plants.AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
    with _collect_parser_warnings() as warnings:
        (model,) = import_pydrake("multibody.parsing").Parser(plant).AddModels(str(document))
    toes = tuple(plant.GetBodyByName(contact.link, model) for contact in motion.contacts)
    groups = tuple(frozenset(int(b.index()) for b in plant.GetBodiesWeldedTo(toe)) for toe in toes)
    _let_neighbours_overlap(plant, scene, model)
    robot_properties = _build_properties(_ROUGH, 2 * STIFFNESS)
    for index in plant.GetBodyIndices(model):
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(index)):
            replace = import_pydrake("geometry").RoleAssign.kReplace
            scene.AssignRole(plant.get_source_id(), geometry, robot_properties, replace)
    layers = [
        {_add_solid(plant, solid, settings.friction_scale): solid.name for solid in solids}
        for _ in range(LAYERS)
    ]
    terrain = {geometry: name for layer in layers for geometry, name in layer.items()}
    for index in sorted(spheres):
        _let_through(plant, scene, groups[index], terrain)
        _add_toe(plant, toes[index], motion.contacts[index])
    joints = tuple(plant.GetJointByName(joint.name, model) for joint in motion.joints)
    for joint, exported_joint in zip(joints, motion.joints, strict=True):
        actuator = plant.AddJointActuator(exported_joint.name, joint, exported_joint.max_torque)
        gains = import_pydrake("multibody.tree").PdControllerGains
        stiffness, damping = (
            exported_joint.gain * settings.gain_scale,
            exported_joint.damping * settings.damping_scale,
        )
        actuator.set_controller_gains(gains(p=stiffness, d=damping))
        actuator.set_default_rotor_inertia(settings.armature)
    plant.Finalize()
    base = plant.GetBodyByName(motion.base_link, model)
    diagram = builder.Build()
    mass = plant.CalcTotalMass(plant.CreateDefaultContext(), [model])
    names = tuple(motion.contacts[index].name for index in sorted(spheres))
    return Plant(
        plant, scene, diagram, model, base, joints, toes, groups, terrain, frozenset(layers[0]),
        names, mass, tuple(warnings),
    )  # fmt: skip


@contextmanager
def _collect_parser_warnings() -> Iterator[list[str]]:
    """Collect the first lines of what Drake logs, in place of printing it."""
    first_lines: list[str] = []

    def keep(record: logging.LogRecord) -> bool:
        line = record.getMessage().splitlines()[0]
        first_lines.append(line.partition(": warning: ")[2].rstrip(":") or line)
        return False

    logger = logging.getLogger("drake")
    logger.addFilter(keep)
    try:
        yield first_lines
    finally:
        logger.removeFilter(keep)


def _build_properties(friction: float, stiffness: float) -> Any:
    geometry, plants = import_pydrake("geometry"), import_pydrake("multibody.plant")
    properties = geometry.ProximityProperties()
    geometry.AddContactMaterial(
        DISSIPATION, stiffness, plants.CoulombFriction(friction, friction), properties
    )
    return properties


def _add_solid(plant: Any, solid: TerrainSolid, friction_scale: float) -> Any:
    """Return the geometry of a solid fixed to the world; a box where it is one."""
    shapes, transform = import_pydrake("geometry"), import_pydrake("math").RigidTransform
    # Drake has 2 m1 m2 / (m1 + m2) between two coefficients: twice the lesser beside a huge one
    # and k1 k2 / (k1 + k2) of two stiffnesses
    layer_stiffness = STIFFNESS / LAYERS
    stiffness = 1.0 / (1.0 / layer_stiffness - 0.5 / STIFFNESS)
    properties = _build_properties(solid.friction * friction_scale / 2, stiffness)
    pose, shape = transform(), None
    if (box := solid.as_box()) is not None:
        axes, middle, size = box
        pose = transform(import_pydrake("math").RotationMatrix(axes), middle)
        shape = shapes.Box(*size)
    else:
        shape = shapes.Convex(points=solid.corners.T, label=solid.name)
    count = len(plant.GetCollisionGeometriesForBody(plant.world_body()))
    name = f"{solid.name} {count}"
    return plant.RegisterCollisionGeometry(plant.world_body(), pose, shape, name, properties)


def _let_neighbours_overlap(plant: Any, scene: Any, model: Any) -> None:
    """Let links overlap that one joint connects, with whatever is fixed to them."""
    geometry = import_pydrake("geometry")
    for index in plant.GetJointIndices(model):
        joint = plant.get_joint(index)
        sides = [
            [
                geometry_id
                for body in plant.GetBodiesWeldedTo(link)
                for geometry_id in plant.GetCollisionGeometriesForBody(body)
            ]
            for link in (joint.parent_body(), joint.child_body())
        ]
        if joint.num_velocities() == 1 and all(sides):
            declaration = geometry.CollisionFilterDeclaration().ExcludeBetween(
                *(geometry.GeometrySet(side) for side in sides)
            )
            scene.collision_filter_manager().Apply(declaration)


def _let_through(plant: Any, scene: Any, bodies: frozenset[int], terrain: dict[Any, str]) -> None:
    """Let the geometry of a toe's bodies through the terrain."""
    geometry = import_pydrake("geometry")
    toe_geometries = [
        geometry_id
        for index in bodies
        for geometry_id in plant.GetCollisionGeometriesForBody(
            plant.get_body(import_pydrake("multibody.tree").BodyIndex(index))
        )
    ]
    if toe_geometries:
        declaration = geometry.CollisionFilterDeclaration().ExcludeBetween(
            geometry.GeometrySet(toe_geometries), geometry.GeometrySet(list(terrain))
        )
        scene.collision_filter_manager().Apply(declaration)


def _add_toe(plant: Any, link: Any, contact: ExportedContact) -> None:
    transform = import_pydrake("math").RigidTransform(np.array(contact.offset))
    shape = import_pydrake("geometry").Sphere(contact.radius or POINT_RADIUS)
    properties = _build_properties(_ROUGH, 2 * STIFFNESS)
    name = f"toe of {contact.name}"
    plant.RegisterCollisionGeometry(link, transform, shape, name, properties)
