"""Fitted envelopes that come with the package, one file a spec `envelopes_<name>.yaml`.

Each is what `climbplan fit-envelopes specs/envelopes_<name>.yaml` writes.
"""

from __future__ import annotations

from importlib.resources import as_file, files

from climbplan.climb.envelopes.file import StoredEnvelopes, read_envelopes
from climbplan.climb.envelopes.terrains import DISTRIBUTIONS
from climbplan.errors import UsageError

SHIPPED = DISTRIBUTIONS
# Of the fits in a file, the first there is: clustering meets more terrains, which planning needs
PREFERENCE = ("clustering", "genetic", "heuristic")


def read_shipped_envelopes(name: str) -> StoredEnvelopes:
    """Return envelopes of all methods for one distribution of terrains; UsageError for another
    name.
    """
    if name not in SHIPPED:
        raise UsageError(f"no envelopes {name!r} ship, there are {', '.join(SHIPPED)}")
    with as_file(files("climbplan.climb.envelopes").joinpath("fitted", f"{name}.h5")) as path:
        return read_envelopes(path)
