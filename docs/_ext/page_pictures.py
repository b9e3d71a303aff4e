"""Pages of reports as pictures: which, the commands that make them, the page of them all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

LOOKS = {
    "wide_light": "1400 pixels wide",
    "wide_dark": "the same, dark",
    "phone_light": "400 pixels wide",
    "phone_dark": "the same, dark",
    "print": "printed",
}


@dataclass(frozen=True)
class ReportPage:
    """One kind of report, by the commands that make it."""

    name: str
    about: str
    commands: tuple[str, ...]  # without the leading `climbplan`; specs/ is the repository's
    page: str = ""  # below the working folder, if not NAME/report.html

    @property
    def path(self) -> str:
        """Where the page is written, below the working folder."""
        return self.page or f"{self.name}/report.html"


PAGES = (
    ReportPage("climb", "A climb.", ("plan-climb specs/climb_steps.yaml --out climb",)),
    ReportPage(
        "region",
        "A climb with the feasible region about it, fragile at the edge of what is possible.",
        ("plan-climb specs/climb_region.yaml --out region",),
    ),
    ReportPage(
        "transition",
        "A transition, with its contact schedule and the sequences found.",
        ("plan-transition specs/transition_flat.yaml --out transition",),
    ),
    ReportPage(
        "mission",
        "A mission: a transition that goes on as a climb.",
        ("plan-transition specs/mission_ground_to_top.yaml --out mission",),
    ),
    ReportPage("walk", "A walk.", ("plan-mpc specs/mpc_forward.yaml --out walk",)),
    ReportPage("loop", "A walk in closed loop.", ("plan-mpc specs/mpc_recovery.yaml --out loop",)),
    ReportPage("modules", "Modules.", ("plan-limms specs/limms_throw.yaml --out modules",)),
    ReportPage(
        "bookshelf", "A book.", ("solve-bookshelf specs/bookshelf_five.yaml --out bookshelf",)
    ),
    ReportPage(
        "scenes",
        "Forty scenes of books.",
        ("solve-bookshelf specs/bookshelf_file.yaml --out scenes",),
    ),
    ReportPage(
        "dataset",
        "A dataset.",
        ("gen-data specs/dataset_bookshelf.yaml --set count=40 --out dataset",),
    ),
    ReportPage(
        "strategy", "A strategy.", ("fit-strategy specs/strategy_bookshelf.yaml --out strategy",)
    ),
    ReportPage(
        "envelopes",
        "Envelopes of bilinear terms, learned from random terrains.",
        ("fit-envelopes specs/envelopes_ground3.yaml --out envelopes",),
    ),
    ReportPage(
        "robot",
        "A robot from its URDF, as it was proposed.",
        ("new robot robot --package example-robot-data:a1",),
        page="robot/a1.html",
    ),
    ReportPage(
        "simulation",
        "The first climb in MuJoCo.",
        ("plan-climb specs/climb_steps.yaml --out climb", "simulate climb --out simulation"),
    ),
    ReportPage(
        "terrain",
        "A scan, here a corner of two plates.",
        ("fit-terrain corner.stl --out terrain",),
    ),
)


def picture(name: str, look: str) -> str:
    """The file name of a page's picture."""
    return f"{name}_{look}.webp"


def pictures_page(pictures: Path) -> str:
    """The page; a picture that is missing raises FileNotFoundError."""
    lines = [
        "# Pages of reports",
        "",
        "Each is one HTML file that needs nothing else and fetches nothing. Pictures are taken in",
        "Chromium by `python docs/make_page_pictures.py`: on a screen, dark, on a phone (the first",
        "screens of it), and printed.",
        "",
    ]
    for page in PAGES:
        lines += [f"## {page.name}", "", page.about, "", "```sh"]
        lines += [f"climbplan {command}" for command in page.commands] + ["```", ""]
        for look, words in LOOKS.items():
            name = picture(page.name, look)
            if not (pictures / name).exists():
                raise FileNotFoundError(
                    f"{pictures / name}: `python docs/make_page_pictures.py {page.name}`"
                )
            lines += [f"![{page.name}, {words}](../pages/{name})", ""]
    return "\n".join(lines)
