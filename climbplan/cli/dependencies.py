"""What climbplan runs on, examined without importing any of it."""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Part:
    """A library or program that climbplan uses."""

    name: str
    package: str  # as `pip install` knows it; "" for a program
    module: str  # as Python imports it, or the program's names separated by spaces
    purpose: str
    required: bool = True
    install: str = ""  # how, if not simply `pip install PACKAGE`
    wrong_versions: tuple[tuple[str, str], ...] = ()  # version, what is wrong with it


PARTS = (
    Part("trimesh", "trimesh", "trimesh", "meshes and clouds of `terrain.scan`"),
    Part("shapely", "shapely", "shapely", "contact regions of scans"),
    Part("Pillow", "pillow", "PIL", "pictures, height maps as PNG"),
    Part("DAQP", "daqp", "daqp", "posture nodes, force problems (default)"),
    Part("Clarabel", "clarabel", "clarabel", "force problems with exact cones"),
    Part("OSQP", "osqp", "osqp", "force problems, the published choice"),
    Part(
        "HiGHS",
        "highspy",
        "highspy",
        "mixed-integer linear form of stated programs",
        wrong_versions=(("1.14.0", "its presolve gives wrong answers"),),
    ),
    Part("SCIP", "PySCIPOpt", "pyscipopt", "independent mixed-integer oracle (--solver scip)"),
    Part("CasADi", "casadi", "casadi", "exact derivatives for --method nlp"),
    Part("IPOPT", "", "casadi/libcasadi_nlpsol_ipopt", "--method nlp; comes with CasADi"),
    Part("numpy", "numpy", "numpy", "arrays"),
    Part("scipy", "scipy", "scipy", "sparse matrices, hulls"),
    Part("h5py", "h5py", "h5py", "plan files"),
    Part("pydantic", "pydantic", "pydantic", "specs"),
    Part("PyYAML", "PyYAML", "yaml", "specs"),
    Part("typer", "typer", "typer", "command line"),
    Part("rich", "rich", "rich", "progress"),
    Part("numba", "numba", "numba", "compiled search of the bookshelf"),
    Part("scikit-learn", "scikit-learn", "sklearn", "training of strategies (fit-strategy)"),
    Part("joblib", "joblib", "joblib", "parallel studies (--jobs)"),
    Part("matplotlib", "matplotlib", "matplotlib", "figures"),
    Part("plotly", "plotly", "plotly", "interactive report"),
    Part("Jinja2", "jinja2", "jinja2", "pages of reports"),
    Part(
        "Gurobi",
        "gurobipy",
        "gurobipy",
        "posture problem (--solver gurobi); needs a licence, which is not looked for here",
        required=False,
        install="pip install 'climbplan[gurobi]'",
    ),
    Part("Knitro", "knitro", "knitro", "no command of this version uses it", required=False),
    Part(
        "CVXPY",
        "cvxpy",
        "cvxpy",
        "baseline of `python -m benchmarks force` and `coupled`, in a clone",
        required=False,
        install="pip install 'climbplan[bench]'",
    ),
    Part(
        "Pinocchio",
        "pin",
        "pinocchio",
        "robots from URDF files",
        required=False,
        install="pip install 'climbplan[urdf]'",
    ),
    Part(
        "fast-simplification",
        "fast-simplification",
        "fast_simplification",
        "shapes of robots from URDF files",
        required=False,
        install="pip install 'climbplan[urdf]'",
    ),
    Part(
        "pymunk",
        "pymunk",
        "pymunk",
        "physical bookshelf scenes of `gen-data`",
        required=False,
        install="pip install 'climbplan[data]'",
    ),
    Part(
        "Dask",
        "distributed",
        "distributed",
        "`gen-data --scheduler`",
        required=False,
        install="pip install 'climbplan[cluster]'",
    ),
    Part(
        "pyarrow",
        "pyarrow",
        "pyarrow",
        "Parquet of `data export`",
        required=False,
        install="pip install 'climbplan[data]'",
    ),
    Part(
        "MuJoCo",
        "mujoco",
        "mujoco",
        "physics of `simulate`, pictures of `report --film`",
        required=False,
        install="pip install 'climbplan[simulate]'",
    ),
    Part(
        "Drake",
        "drake",
        "pydrake",
        "`simulate --engine drake`",
        required=False,
        install="pip install 'climbplan[drake]'",
    ),
    Part(
        "rosbags",
        "rosbags",
        "rosbags",
        "`export --format mcap`, `ros2`",
        required=False,
        install="pip install 'climbplan[ros]'",
    ),
    Part(
        "OpenUSD",
        "usd-core",
        "pxr",
        "`export --format usd`",
        required=False,
        install="pip install 'climbplan[usd]'",
    ),
    Part(
        "imageio-ffmpeg",
        "imageio-ffmpeg",
        "imageio_ffmpeg",
        "`report --film FILE.mp4`",
        required=False,
        install="pip install 'climbplan[film]'",
    ),
    Part(
        "viser",
        "viser",
        "viser",
        "`view`",
        required=False,
        install="pip install 'climbplan[view]'",
    ),
    Part(
        "Chromium",
        "",
        "chromium chromium-browser google-chrome google-chrome-stable chrome",
        "test of report.html",
        required=False,
        install="from your system's packages",
    ),
)


@dataclass(frozen=True)
class Finding:
    """What is there of one part."""

    name: str
    version: str | None
    state: str  # "present", "missing", "missing, optional", "wrong version"
    purpose: str
    required: bool
    usable: bool
    advice: str  # what to do about it, "" if nothing

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)


def examine() -> list[Finding]:
    """Look for every part."""
    return [_examine(part) for part in PARTS]


def _examine(part: Part) -> Finding:
    found, number = _find(part)
    fault = dict(part.wrong_versions).get(number or "")
    if fault:
        state = "wrong version"
        advice = f"{fault}; pip install '{part.package}!={number}'"
    elif found:
        state, advice = "present", ""
    else:
        state = "missing" if part.required else "missing, optional"
        how = part.install or (
            f"pip install {part.package}" if part.package else "reinstall CasADi"
        )
        advice = f"install with: {how}"
    usable = found and not fault
    return Finding(part.name, number, state, part.purpose, part.required, usable, advice)


def _find(part: Part) -> tuple[bool, str | None]:
    """Whether a part is there, and its version if that can be told without running it."""
    if "/" in part.module:
        module, stem = part.module.split("/")
        spec = find_spec(module)
        places = (spec.submodule_search_locations or []) if spec is not None else []
        return any(list(Path(place).glob(f"{stem}*")) for place in places), None
    if not part.package:
        return any(shutil.which(name) for name in part.module.split()), None
    try:
        number = version(part.package)
    except PackageNotFoundError:
        return find_spec(part.module) is not None, None
    return find_spec(part.module) is not None, number
