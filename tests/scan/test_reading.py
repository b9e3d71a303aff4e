"""Files of every kind, sound and broken."""

from __future__ import annotations

import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from known_surfaces import block, plate
from PIL import Image, TiffImagePlugin

from climbplan.errors import ExitCode
from climbplan.scan.cleaning import compute_areas
from climbplan.scan.raw import ScanError
from climbplan.scan.reading import read_scan
from climbplan.schema.terrain.scan import ScanSpec

HEADER = (
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n"
)


def read(path: Path, **keys):
    return read_scan(ScanSpec(file=path.name, **keys), path.parent)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb", "off"])
def test_meshes_come_back_as_they_were(tmp_path: Path, kind: str) -> None:
    raw = block().raw
    path = tmp_path / f"block.{kind}"
    trimesh.Trimesh(raw.vertices, raw.triangles, process=False).export(path)
    found = read(path)
    assert len(found.triangles) == 12
    assert compute_areas(found).sum() == pytest.approx(compute_areas(raw).sum(), rel=1e-5)


def test_scale_up_transform_and_crop(tmp_path: Path) -> None:
    raw = block().raw
    path = tmp_path / "block.stl"
    trimesh.Trimesh(1000 * raw.vertices, raw.triangles, process=False).export(path)
    found = read(path, scale=0.001, up="y", transform={"move": [1, 0, 0], "rpy_deg": [0, 0, 90]})
    # 0.5 x 0.4 x 0.3 with y up: (x, -z, y), then a quarter turn: (z, x, y), then moved
    np.testing.assert_allclose(found.vertices.min(axis=0), [1.0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(found.vertices.max(axis=0), [1.3, 0.5, 0.4], atol=1e-6)
    part = read(path, scale=0.001, crop={"lower": [0.1, 0.1, 0.29], "upper": [0.2, 0.2, 0.5]})
    assert len(part.triangles) == 2


def points_of_a_plate(count: int = 900) -> np.ndarray:
    side = round(np.sqrt(count))
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    return np.column_stack([u.ravel(), v.ravel(), 0.01 * np.sin(9 * u.ravel())])


@pytest.mark.parametrize("kind", ["xyz", "npy", "pcd ascii", "pcd binary", "ply"])
def test_clouds_become_surfaces(tmp_path: Path, kind: str) -> None:
    points = points_of_a_plate().astype(np.float32)
    path = tmp_path / f"cloud.{kind.split()[0]}"
    if kind == "xyz":
        np.savetxt(path, points)
    elif kind == "npy":
        np.save(path, points)
    elif kind == "ply":
        trimesh.PointCloud(points).export(path)
    else:
        head = HEADER.format(n=len(points), kind=kind.split()[1]).encode()
        text = "\n".join(" ".join(map(str, p)) for p in points).encode()
        path.write_bytes(head + (text if "ascii" in kind else points.tobytes()))
    found = read(path)
    assert compute_areas(found).sum() == pytest.approx(1.0, rel=0.02)
    assert any("as a relief that faces" in note for note in found.notes)


@pytest.mark.parametrize("kind", ["npy", "csv", "png", "tif", "geotif"])
def test_height_maps_stand_upright(tmp_path: Path, kind: str) -> None:
    heights = np.add.outer(np.arange(5.0), 2 * np.arange(4.0))  # 1 a row, 2 a column
    path = tmp_path / f"map.{kind.removeprefix('geo')}"
    keys: dict[str, object] = {"cell": 0.5, "height": 0.1}
    if kind == "npy":
        np.save(path, heights)
    elif kind == "csv":
        np.savetxt(path, heights, delimiter=",")
    elif kind == "png":
        Image.fromarray(heights.astype(np.uint8)).save(path)
    else:
        tags = TiffImagePlugin.ImageFileDirectory_v2()
        if kind == "geotif":
            del keys["cell"]
            tags[33550], tags.tagtype[33550] = (0.5, 0.5, 0.0), 12
            tags[33922], tags.tagtype[33922] = (0.0, 0, 0, 10.0, 20.0, 0), 12
        Image.fromarray(heights.astype(np.float32)).save(path, tiffinfo=tags)
    found = read(path, **keys)
    assert len(found.triangles) == 2 * 4 * 3
    corners = found.corners
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    low = found.vertices[np.argmin(found.vertices[:, 2])]
    first = {"png": (0, 2.0), "tif": (0, 2.0), "geotif": (10, 20)}.get(kind, (0, 0))
    np.testing.assert_allclose(low, [*first, 0], atol=1e-6)
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), [1.5, 2.0, 1.0], atol=1e-6)


def test_missing_heights_are_holes(tmp_path: Path) -> None:
    heights = np.zeros((4, 4))
    heights[1, 1] = np.nan
    np.save(tmp_path / "map.npy", heights)
    found = read(tmp_path / "map.npy", cell=0.1)
    assert len(found.triangles) == 18 - 6
    assert any("1 of 16 heights missing" in note for note in found.notes)


def test_colours_of_faces_tell_materials_apart(tmp_path: Path) -> None:
    raw = block().raw
    colors = np.tile(np.array([200, 10, 10, 255], np.uint8), (12, 1))
    colors[:2] = [0, 0, 255, 255]
    path = tmp_path / "block.ply"
    trimesh.Trimesh(raw.vertices, raw.triangles, face_colors=colors, process=False).export(path)
    found = read(path)
    assert {found.labels[k] for k in found.label} == {"#c80a0a", "#0000ff"}


def stl(triangles: np.ndarray) -> bytes:
    out = b"\0" * 80 + struct.pack("<I", len(triangles))
    for t in triangles:
        out += struct.pack("<12fH", *([0.0] * 3), *t.ravel().tolist(), 0)
    return out


PLATE = plate().raw
SOUND = stl(PLATE.vertices[PLATE.triangles])
NAN = stl(np.full((4, 3, 3), np.nan))
POINT = stl(np.zeros((4, 3, 3)))
PCD = HEADER.format(n=5, kind="binary").encode()


class Harm:
    """What a pickle could run."""

    def __reduce__(self):
        return (print, ("a pickle was opened",))


BROKEN: dict[str, tuple[str, bytes | None]] = {
    "no file": ("a.stl", None),
    "empty stl": ("a.stl", b""),
    "empty obj": ("a.obj", b""),
    "empty ply": ("a.ply", b""),
    "empty pcd": ("a.pcd", b""),
    "empty npy": ("a.npy", b""),
    "empty png": ("a.png", b""),
    "empty csv": ("a.csv", b""),
    "empty xyz": ("a.xyz", b""),
    "no suffix": ("a", SOUND),
    "unknown suffix": ("a.docx", SOUND),
    "a spec": ("a.yaml", b"kind: climb"),
    "stl cut in its header": ("a.stl", SOUND[:60]),
    "stl cut in a triangle": ("a.stl", SOUND[:300]),
    "stl of words": ("a.stl", b"this is no mesh at all, but a letter"),
    "stl of zeros": ("a.stl", b"\0" * 500),
    "stl without triangles": ("a.stl", stl(np.zeros((0, 3, 3)))),
    "stl that is not a number": ("a.stl", NAN),
    "stl of one point": ("a.stl", POINT),
    "stl of another unit": ("a.stl", stl(5000 * PLATE.vertices[PLATE.triangles])),
    "stl too small": ("a.stl", stl(1e-3 * PLATE.vertices[PLATE.triangles])),
    "obj of words": ("a.obj", b"hello\nworld\n"),
    "obj with corners alone": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
    "obj that names no corner": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "obj without numbers": ("a.obj", b"v a b c\nv d e f\nv g h i\nf 1 2 3\n"),
    "ply of words": ("a.ply", b"ply? no"),
    "ply cut off": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 90\nproperty float x\n"),
    "glb of words": ("a.glb", b"glTF but not really, no no no no"),
    "dae of words": ("a.dae", b"<COLLADA>not closed"),
    "off of words": ("a.off", b"OFF\n3 1 0\n0 0\n"),
    "pcd without fields": ("a.pcd", b"VERSION .7\nDATA ascii\n"),
    "pcd of words": ("a.pcd", b"nothing of the kind"),
    "pcd cut off": ("a.pcd", PCD + b"\0" * 20),
    "pcd with a wrong count": ("a.pcd", PCD.replace(b"POINTS 5", b"POINTS -5")),
    "pcd compressed": ("a.pcd", PCD.replace(b"DATA binary", b"DATA binary_compressed")),
    "pcd without types": ("a.pcd", PCD.replace(b"TYPE F F F\n", b"")),
    "pcd with words": ("a.pcd", HEADER.format(n=1, kind="ascii").encode() + b"a b c\n"),
    "npy of words": ("a.npy", b"this is no array"),
    "npy that is a pickle": ("a.npy", pickle.dumps(Harm())),
    "xyz of words": ("a.xyz", b"one two three\nfour five six\n"),
    "xyz of two columns": ("a.xyz", b"1 2\n3 4\n"),
    "xyz of three points": ("a.xyz", b"0 0 0\n1 0 0\n0 1 0\n"),
    "xyz of uneven rows": ("a.xyz", b"0 0 0\n1 0\n"),
    "csv without a cell": ("a.csv", b"1,2\n3,4\n"),
    "png of words": ("a.png", b"\x89PNG\r\n but no picture"),
    "tiff of words": ("a.tif", b"II*\0 no picture"),
    "las of words": ("a.las", b"LASF but no cloud"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_say_what_was_expected(tmp_path: Path, name: str, capfd) -> None:
    file, content = BROKEN[name]
    path = tmp_path / file
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(Exception, match=r".") as caught:
        read(path)
    assert getattr(caught.value, "exit_code", None) == ExitCode.USAGE
    words = str(caught.value)
    assert file in words
    assert any(w in words for w in ("expected", "Expected", "not a", "pip install")), words
    assert "pickle was opened" not in capfd.readouterr().out


def test_a_wrong_unit_is_told_with_its_size(tmp_path: Path) -> None:
    path = tmp_path / "chimney.stl"
    path.write_bytes(stl(2000 * PLATE.vertices[PLATE.triangles]))
    with pytest.raises(ScanError, match=r"2000 m across.*scale: 0.001"):
        read(path)


def test_more_than_forty_broken_files() -> None:
    assert len(BROKEN) >= 40
