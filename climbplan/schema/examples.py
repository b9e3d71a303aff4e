"""The runnable example specs, wherever the package was installed from."""

from __future__ import annotations

import re
from importlib.resources import files
from importlib.resources.abc import Traversable

from climbplan.errors import UsageError
from climbplan.schema.fields import find_closest_name

# What `climbplan new KIND` writes; the most telling example of each kind.
FIRST_EXAMPLE = {
    "climb": "climb_tube",
    "transition": "transition_flat",
    "bookshelf": "bookshelf_scene",
    "mpc": "mpc_forward",
    "envelopes": "envelopes_wall3",
    "program": "cart_pole",
    "dataset": "dataset_bookshelf",
    "strategy": "strategy_bookshelf",
    "limms": "limms_throw",
    "robot": "silvia",
    "module": "limms",
}
# What only some examples show
ABOUT = {
    "climb_walker": "a robot from a URDF",
    "robot_walker": "from a URDF",
    "robot_hexapod": "a hexapod from a URDF",
    "robot_long_climber": "grippers that open 110 mm",
    "mpc_hexapod": "a hexapod from a URDF",
    "climb_telescope": "legs with joints that slide",
    "climb_biped": "flat feet",
    "climb_biped_stairs": "flat feet up stairs",
    "robot_telescope": "legs with joints that slide",
    "robot_biped": "flat feet",
    "mpc_telescope": "legs with joints that slide",
    "dataset_motions": "motions for learning, as NPZ files",
    "climb_single_wall": "grippers on one wall",
    "climb_rough_chimney": "between scanned walls",
    "mission_ground_to_top": "and on as a climb",
    "mission_rough_shaft": "the same in a scan",
}
# Files that an example reads, or that state its problem
_DATA = {
    "bookshelf_file": ("bookshelf_scenes.h5",),
    "cart_pole": ("cart_pole.py",),
    "strategy_bookshelf": ("bookshelf_scenes.h5",),
    "dataset_cart_pole": ("cart_pole.py",),
    "dataset_motions": ("climb_walker.yaml", "robot_walker.yaml", "walker.urdf"),
    "robot_walker": ("walker.urdf",),
    "robot_hexapod": ("hexapod.urdf",),
    "mpc_hexapod": ("robot_hexapod.yaml", "hexapod.urdf"),
    "robot_telescope": ("telescope.urdf",),
    "robot_biped": ("biped.urdf",),
    "climb_biped": ("robot_biped.yaml", "biped.urdf"),
    "climb_biped_stairs": ("robot_biped.yaml", "biped.urdf"),
    "climb_telescope": ("robot_telescope.yaml", "telescope.urdf"),
    "mpc_telescope": ("robot_telescope.yaml", "telescope.urdf"),
    "climb_rough_chimney": ("rough_chimney.stl",),
    "mission_rough_shaft": ("rough_shaft.stl",),
    "climb_walker": ("robot_walker.yaml", "walker.urdf"),
}


def list_example_names(kind: str) -> list[str]:
    """Return names of the example specs of one kind, sorted; empty for an unknown kind."""
    marker = re.compile(rf"^kind:\s*{re.escape(kind)}\s*(#.*)?$", re.MULTILINE)
    return sorted(
        name
        for name, file in _find_example_files().items()
        if marker.search(file.read_text(encoding="utf-8"))
    )


def read_example(name: str) -> str:
    """Return the YAML text of an example, comments included.

    Raises:
        UsageError: there is no such example.
    """
    examples = _find_example_files()
    if name not in examples:
        closest = find_closest_name(name, list(examples))
        hint = f" (did you mean {closest!r}?)" if closest else ""
        raise UsageError(f"no example {name!r}, there are {', '.join(sorted(examples))}{hint}")
    return examples[name].read_text(encoding="utf-8")


def read_example_data(name: str) -> dict[str, bytes]:
    """Return the files that an example reads, by name; they belong beside it."""
    folder = _locate_specs()
    return {data: folder.joinpath(data).read_bytes() for data in _DATA.get(name, ())}


def locate_example_resource(name: str) -> Traversable:
    """Return a file beside the examples, by its whole name."""
    return _locate_specs().joinpath(name)


def _locate_specs() -> Traversable:
    package = files("climbplan")
    specs = package.joinpath("example_specs")  # a wheel carries them inside the package
    return specs if specs.is_dir() else package.joinpath("..", "specs")  # a checkout beside it


def _find_example_files() -> dict[str, Traversable]:
    robots = files("climbplan").joinpath("robots")
    directories = [d for d in (_locate_specs(), robots, robots.joinpath("modules")) if d.is_dir()]
    return {
        entry.name.removesuffix(".yaml"): entry
        for directory in directories
        for entry in directory.iterdir()
        if entry.name.endswith(".yaml")
    }
