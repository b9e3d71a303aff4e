"""Small whole files of every other kind that commands read, to make mutants of.

Scans in every format, learned models, certificates, envelopes and instance files.
"""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
from learned_rows import made_up, stored_model
from PIL import Image, TiffImagePlugin

import climbplan
from climbplan.cli.app import run
from climbplan.learning.model import FitOptions, fit_strategy
from climbplan.learning.model_file import write_model

PACKAGE = Path(climbplan.__file__).parent
_STATEMENT = """
import numpy as np
from climbplan.program import Problem, Program

p = Program("hop")
goal = p.parameter("goal", (2,))
x = p.continuous("x", (3, 2), -3.0, 3.0)
z = p.binary("z", (3,))
p.between("start", x[0], 0.0, 0.0)
for k in range(2):
    p.ball(f"step{k}", (x[k + 1] - x[k])[None, :], 1.2)
    p.when(f"low{k}", z[k], x[k + 1][:1], -3.0, 0.5)
p.exactly_one("one", z)
p.minimise("far", np.sum((x[2] - goal) ** 2))
p.minimise("fixed", np.array([0.1, 0.2, 0.4]) @ z)
problem = Problem("hop", p)
"""
_SPEC = "kind: program\ntheta:\n  - goal: [1.7, 0.1]\n  - goal: [-0.2, 0.0]\nsolver: {gap: 1e-4}\n"
_MPS = """NAME small
ROWS
 N COST
 L row0
 E row1
COLUMNS
 MARKER 'MARKER' 'INTORG'
 x0 COST 1 row0 1
 x0 row1 2
 MARKER 'MARKER' 'INTEND'
 x1 COST -1 row0 3
 x1 row1 1
RHS
 RHS row0 4 row1 2
BOUNDS
 BV BND x0
 UP BND x1 5
ENDATA
"""
_HEIGHTS = 12  # rows and columns
HEIGHT_MAPS = ("map.npy", "map.png", "map.tif", "map.csv")
CLOUDS = ("cloud.npy", "cloud.xyz", "ascii.pcd", "binary.pcd")
MESHES = ("mesh.stl", "mesh.obj", "mesh.ply", "mesh.off", "mesh.glb")
INSTANCES = ("small.mps", "hop.nl")


def made_sources(folder: Path) -> None:
    """Write all of them into a folder, which may hold them already."""
    if (folder / "whole").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    _scans(folder)
    shutil.copy(next((PACKAGE / "robots" / "grippers").glob("*.json")), folder / "gripper.json")
    shutil.copy(PACKAGE / "climb" / "envelopes" / "fitted" / "wall3.h5", folder / "envelopes.h5")
    options = FitOptions(kind="forest", trees=5, depth=6, cluster_trees=5)
    write_model(
        stored_model(fit_strategy(made_up(80), options, np.array([0, 1]))), folder / "model.h5"
    )
    (folder / "hop.py").write_text(_STATEMENT)
    (folder / "hop.yaml").write_text(_SPEC)
    command = ["solve", str(folder / "hop.yaml"), "--problem", f"{folder / 'hop.py'}:problem", "-q"]
    files = ["--certificate", str(folder / "proof.h5"), "--save-model", str(folder / "hop.nl")]
    assert run([*command, *files, "-o", str(folder / "out"), "--force"]) == 0
    (folder / "small.mps").write_text(_MPS)
    (folder / "small.sol").write_text("x0 1\nx1 0\n")
    names = (folder / "hop.col").read_text().split()
    (folder / "hop.sol").write_text("".join(f"{name} 0\n" for name in names))
    (folder / "whole").touch()


def _scans(folder: Path) -> None:
    import trimesh

    across = np.linspace(0.0, 1.1, _HEIGHTS)
    x, y = np.meshgrid(across, across, indexing="ij")
    z = np.where(x > 0.5, 0.3, 0.0)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    number = np.arange(_HEIGHTS**2).reshape(_HEIGHTS, _HEIGHTS)
    a, b, c, d = (
        number[i : _HEIGHTS - 1 + i, j : _HEIGHTS - 1 + j].ravel()
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = trimesh.Trimesh(points, faces, process=False)
    for name in MESHES:
        mesh.export(folder / name)
    np.save(folder / "cloud.npy", points)
    np.save(folder / "map.npy", z)
    np.savetxt(folder / "cloud.xyz", points, fmt="%.4f")
    np.savetxt(folder / "map.csv", z, fmt="%.3f", delimiter=",")
    header = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\n"
        f"HEIGHT 1\nPOINTS {len(points)}\nDATA "
    )
    text = "".join("{:.4f} {:.4f} {:.4f}\n".format(*point) for point in points)
    (folder / "ascii.pcd").write_text(f"{header}ascii\n{text}")
    (folder / "binary.pcd").write_bytes(
        f"{header}binary\n".encode() + points.astype("<f4").tobytes()
    )
    Image.fromarray((1000 * z).astype(np.uint16)).save(folder / "map.png")
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags.tagtype[33550], tags[33550] = 12, (0.1, 0.1, 0.0)
    tags.tagtype[33922], tags[33922] = 12, (0.0, 0.0, 0.0, 5.0, 6.0, 0.0)
    Image.fromarray(z.astype(np.float32)).save(folder / "map.tif", tiffinfo=tags)


def png_of_size(width: int, height: int, content: bytes) -> bytes:
    """Return a picture in grey that claims a size, with whole check sums."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    size = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(content, 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def npy_of_shape(shape: tuple[int, ...], kind: str) -> bytes:
    """Return a NumPy file that claims a shape and holds no numbers."""
    words = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    words = words.ljust(-(-(len(words) + 11) // 64) * 64 - 11) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(words)) + words
