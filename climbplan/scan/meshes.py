"""Triangle meshes, read by trimesh."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.reading import ANY_ERROR, first_line, reading
from climbplan.scan.raw import RawScan, ScanError

MESHES = (".stl", ".obj", ".ply", ".glb", ".dae", ".off")
_COLLADA = "; DAE files need pycollada: pip install 'climbplan[scan]'"


def read_mesh(path: Path) -> RawScan:
    """Read all geometry of a file at its place in the scene; points where it has no triangles.

    Materials of an OBJ and colours of faces or vertices become labels.

    Raises:
        ScanError: trimesh cannot read the file.
    """
    import trimesh

    suffix = path.suffix.lower().removeprefix(".")
    expected = f"a {suffix.upper()} mesh"
    with reading(path, expected, ScanError, damage=ANY_ERROR), _silence_logger("trimesh"):
        with path.open("rb") as file:
            try:
                scene: Any = trimesh.load_scene(
                    file, file_type=suffix, process=False, maintain_order=True, allow_remote=False
                )
            except (ImportError, ValueError) as error:
                if suffix != "dae":
                    raise
                reason = f"({first_line(error)}){_COLLADA}"
                raise ScanError(f"{path}: not {expected} {reason}") from error
        geometries = list(scene.dump()) if hasattr(scene, "dump") else [scene]
    vertices: list[Array] = []
    triangles: list[IntArray] = []
    label: list[IntArray] = []
    labels: dict[str, int] = {"": 0}
    count = 0
    for geometry in geometries:
        points = np.asarray(getattr(geometry, "vertices", np.zeros((0, 3))), float).reshape(-1, 3)
        faces = np.asarray(getattr(geometry, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
            raise ScanError(f"{path}: a triangle names a corner that is not there")
        vertices.append(points)
        triangles.append(faces + count)
        with reading(path, expected, ScanError, damage=ANY_ERROR):
            label.append(_read_labels(geometry, len(faces), labels))
        count += len(points)
    if not count:
        raise ScanError(f"{path}: no geometry in it, expected triangles")
    return RawScan(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int64),
        np.concatenate(label),
        tuple(labels),
    )


@contextmanager
def _silence_logger(logger: str) -> Iterator[None]:
    """Keep a library from logging tracebacks of textures that it does not find: none is needed."""
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)


def _read_labels(geometry: Any, faces: int, labels: dict[str, int]) -> IntArray:
    """Return the material or colour of every triangle (T,), as numbers in `labels`."""
    visual: Any = getattr(geometry, "visual", None)
    kind = getattr(visual, "kind", None)
    if faces and kind in ("face", "vertex"):
        colors = np.asarray(visual.face_colors)[:, :3]
        distinct, inverse = np.unique(colors, axis=0, return_inverse=True)
        names = ["#" + "".join(f"{c:02x}" for c in color) for color in distinct.tolist()]
        numbers = [labels.setdefault(name, len(labels)) for name in names]
        return np.array(numbers, np.int64)[inverse.reshape(-1)]
    name = getattr(getattr(visual, "material", None), "name", None) or ""
    return np.full(faces, labels.setdefault(str(name), len(labels)), np.int64)
