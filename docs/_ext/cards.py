"""Grids of cards in Markdown: a picture, a name, a line, a command and links."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Card:
    """One card of a grid; paths and links are those of the page that shows it."""

    title: str  # Markdown
    text: str
    picture: str = ""
    alternative: str = ""  # what the picture shows, for readers who do not see it
    link: str = ""  # of the picture
    command: str = ""
    links: str = ""  # Markdown, the last line
    is_figure: bool = False  # a drawing, shown whole
    label: str = ""  # that links of other pages lead to
    film: str = ""  # shown in place of the picture where a reader does not mind motion

    def lines(self) -> list[str]:
        """Return the card's Markdown."""
        lines = [f"({self.label})=", ""] if self.label else []
        lines += [f":::{{container}} card{' film' if self.film else ''}", ""]
        if self.picture:
            style = "{.figure}" if self.is_figure else ""
            image = f"![{self.alternative}]({self.picture}){style}"
            if self.film:
                image = f"![{self.alternative}]({self.film}){{.moving}} {image}{{.still}}"
            lines += [f"[{image}]({self.link})" if self.link else image, ""]
        lines += [f"**{self.title}**", "", self.text, ""]
        if self.command:
            lines += ["```sh", self.command, "```", ""]
        if self.links:
            lines += [self.links, ""]
        return [*lines, ":::", ""]


def write_cards(cards: Iterable[Card], style: str = "") -> str:
    """Return a grid of cards; the style is a class of the style sheet, such as `small`."""
    lines = [f"::::{{container}} cards {style}".rstrip(), ""]
    for card in cards:
        lines += card.lines()
    return "\n".join([*lines, "::::", ""])


def write_film(film: str, still: str, shows: str) -> str:
    """Return the Markdown of a moving picture, with the still for those who want no motion."""
    return (
        ":::{container} film\n\n"
        f"![{shows}]({film}){{.moving}} ![{shows}]({still}){{.still}}\n\n:::\n"
    )


def join_links(links: Sequence[str]) -> str:
    """Return the links that are not empty, side by side."""
    return " · ".join(link for link in links if link)
