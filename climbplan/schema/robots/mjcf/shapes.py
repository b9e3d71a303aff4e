"""Shapes of an MJCF file's bodies as <collision> and <visual> of a URDF.

What touches (`contype` or `conaffinity`) is collision geometry; what MuJoCo's viewer shows at first
(groups 0 to 2) is visual geometry. Meshes are named by their files; MuJoCo moves a mesh into its
own principal axes, which is taken back.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from climbplan.arrays import Array
from climbplan.schema.robots.mjcf.compiled import Mjcf
from climbplan.schema.robots.mjcf.places import (
    convert_quaternion,
    format_numbers,
    write_line_attribute,
    write_origin,
)
from climbplan.schema.robots.xml import UrdfFault

_SHOWN = 3  # groups of shapes that are seen, from the first
_READ = (".stl", ".obj", ".dae")  # meshes that Pinocchio reads


class Shapes:
    """Shapes of a compiled file, body by body."""

    def __init__(self, compiled_model: Mjcf, path: Path) -> None:
        self.found, self.path = compiled_model, path
        self.kinds = compiled_model.library.mjtGeom

    def of(self, body: int, origin: Array) -> str:
        """Return the elements of a body, about the origin (3,) of its link."""
        model, elements = self.found.model, []
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
            is_visible = int(model.geom_group[geom]) < _SHOWN
            for tag, is_written in (("collision", touches), ("visual", is_visible)):
                if is_written:
                    elements.append(self._element(tag, geom, origin, refused=touches))
        return "".join(elements)

    def _element(self, tag: str, geom: int, origin: Array, refused: bool) -> str:
        """Return one shape; empty for what cannot be drawn, and refused where it touches."""
        model = self.found.model
        name = model.geom(geom).name
        body = model.body(int(model.geom_bodyid[geom])).name
        line = self.found.line("geom", name) if name else self.found.line("body", body)
        try:
            shape, position, axes = self._shape(geom)
        except UrdfFault as fault:
            if not refused:
                return ""
            which = f"geom {name!r}" if name else f"a geom of body {body!r}"
            raise UrdfFault(f"{which}: {fault.message}", line) from None
        place = write_origin(position - origin, axes)
        return f"<{tag}{write_line_attribute(line)}>{place}<geometry>{shape}</geometry></{tag}>"

    def _shape(self, geom: int) -> tuple[str, Array, Array]:
        """Return the element of a shape, and its place and axes in the body."""
        model, kinds = self.found.model, self.kinds
        a, b, c = (float(value) for value in model.geom_size[geom])
        kind = int(model.geom_type[geom])
        position, axes = (
            np.array(model.geom_pos[geom]),
            convert_quaternion(self.found.library, model.geom_quat[geom]),
        )
        if kind == kinds.mjGEOM_SPHERE:
            return f'<sphere radius="{a!r}"/>', position, axes
        if kind == kinds.mjGEOM_CAPSULE:
            return f'<capsule radius="{a!r}" length="{2 * b!r}"/>', position, axes
        if kind == kinds.mjGEOM_CYLINDER:
            return f'<cylinder radius="{a!r}" length="{2 * b!r}"/>', position, axes
        if kind == kinds.mjGEOM_BOX:
            return f'<box size="{2 * a!r} {2 * b!r} {2 * c!r}"/>', position, axes
        if kind == kinds.mjGEOM_MESH:
            number = int(model.geom_dataid[geom])
            principal_axes = convert_quaternion(self.found.library, model.mesh_quat[number])
            mesh_axes = axes @ principal_axes.T  # MuJoCo turned the mesh into its principal axes
            return (
                self._mesh(number),
                position - mesh_axes @ np.array(model.mesh_pos[number]),
                mesh_axes,
            )
        name = kinds(kind).name.removeprefix("mjGEOM_").lower()
        raise UrdfFault(f"of type {name}; expected box, capsule, cylinder, sphere or mesh")

    def _mesh(self, number: int) -> str:
        spec, name = self.found.spec, self.found.model.mesh(number).name
        mesh = spec.mesh(name)
        if mesh is None or not mesh.file:
            raise UrdfFault(f"mesh {name!r} is written in the file itself; expected `file`")
        if any(mesh.refpos) or list(mesh.refquat) != [1.0, 0.0, 0.0, 0.0]:
            raise UrdfFault(f"mesh {name!r} has `refpos` or `refquat`; expected neither")
        file = Path(mesh.file)
        if file.suffix.lower() not in _READ:
            expected = ", ".join(_READ)
            raise UrdfFault(
                f"mesh {name!r} is {file.suffix or 'of no format'}; expected {expected}"
            )
        place = Path(file.name) if spec.strippath else file
        mesh_path = (Path(spec.meshdir) / place).as_posix()
        return f'<mesh filename={quoteattr(mesh_path)} scale="{format_numbers(mesh.scale)}"/>'
