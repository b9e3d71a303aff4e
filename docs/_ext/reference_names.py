"""Sphinx domain of names that readers type into the search: spec keys, checks, solvers, scenes.

Generated pages declare the names (`name_declarations`). The search then lists the name itself, with
a link to its row, and not only the page that holds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Set
from typing import Any, ClassVar

from docutils import nodes
from name_declarations import KINDS, TITLED, make_anchor
from sphinx.domains import Domain, ObjType
from sphinx.util.docutils import ReferenceRole


class DeclarationRole(ReferenceRole):
    """Shows a name as a link to itself, and enters it into the index of names."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the link, which carries the anchor."""
        domain = self.env.domains["spec"]
        kind = self.name.rpartition(":")[2]
        anchor = make_anchor(kind, self.target)
        page = self.env.docname
        # Checks of several families have one name, and a row each
        while (kind, self.target, page, anchor) in domain.data["names"]:
            anchor += "-again"
        domain.data["names"].append((kind, self.target, page, anchor))
        link = nodes.reference("", "", internal=True, refid=anchor, ids=[anchor])
        shown = nodes.inline if kind in TITLED else nodes.literal
        link += shown(self.title, self.title)
        return [link], []


class SpecDomain(Domain):
    """Keys, checks, solvers, scenes and robots by name."""

    name = "spec"
    label = "Specs"
    object_types: ClassVar[dict[str, ObjType]] = {
        kind: ObjType(words, kind, searchprio=0) for kind, words in KINDS.items()
    }
    roles: ClassVar[dict[str, Any]] = {kind: DeclarationRole() for kind in KINDS}
    initial_data: ClassVar[dict[str, Any]] = {"names": []}

    def get_objects(self) -> Iterable[tuple[str, str, str, str, str, int]]:
        """Yield each name with its kind, page, anchor and priority in the search."""
        for kind, name, page, anchor in self.data["names"]:
            yield name, name, kind, page, anchor, 0

    def get_type_name(self, type: ObjType, primary: bool = False) -> str:
        """Return what a name is, as results of a search say it."""
        return type.lname

    def resolve_any_xref(self, *arguments: object) -> list[tuple[str, nodes.reference]]:
        """Return nothing: names are found by the search, pages link to each other by labels."""
        return []

    def clear_doc(self, docname: str) -> None:
        """Forget the names of a page that is read again."""
        self.data["names"] = [entry for entry in self.data["names"] if entry[2] != docname]

    def merge_domaindata(self, docnames: Set[str], otherdata: dict[str, Any]) -> None:
        """Take over the names of pages that another process has read."""
        self.data["names"] += [entry for entry in otherdata["names"] if entry[2] in docnames]
