"""URDFs that installed Python packages ship."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from climbplan.errors import UsageError


def package_urdf(package: str, robot: str | None = None) -> Path:
    """A URDF that an installed Python package ships: `example-robot-data` or `PACKAGE:ROBOT`.

    robot: part of the URDF's path, such as `anymal_c`. Raises UsageError, with what there is, where
    it is none or several.
    """
    package, _, part = package.partition(":")
    part = robot or part
    try:
        listed = distribution(package).files or []
    except (PackageNotFoundError, ValueError) as error:
        raise UsageError(f"no Python package {package!r} is installed") from error
    urdfs = [Path(str(f.locate())) for f in listed if f.name.endswith(".urdf")]
    urdfs = [path.resolve() for path in urdfs if path.is_file()]
    asked = part.lower().removesuffix(".urdf")
    named = [path for path in urdfs if any(asked in name for name in _names(path))]
    exact = [path for path in named if _is(path, asked)]
    if len(exact) == 1 or len(named) == 1:
        return (exact or named)[0]
    known = ", ".join(sorted(map(_listed, named or urdfs)))
    if not urdfs:
        raise UsageError(f"the package {package!r} ships no URDF")
    how = f"--package {package}:PART" if not named or not part else f"a longer part than {part!r}"
    raise UsageError(f"expected {how}, which names one URDF of: {known}")


def _is(path: Path, asked: str) -> bool:
    """Whether a part is a URDF's whole name, or its path from some folder on."""
    whole = path.with_suffix("").as_posix().lower()
    return asked == _listed(path).lower() or whole.endswith(f"/{asked}")


def _listed(path: Path) -> str:
    """How a URDF is called in a list: by its package of meshes and its own name."""
    return f"{path.parents[1].name}/{path.stem}"


def _names(path: Path) -> tuple[str, str]:
    """What a part of its name may be a part of."""
    return path.as_posix().lower(), _listed(path).lower()
