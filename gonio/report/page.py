"""How does the report become one file?  Blocks of text, tables, figures, and the template around them.

The page needs no network and no other file: style and pictures are inside.  Text from the measured file
(titles, log messages, plans) is escaped by the template; captions and other `Markup` are ours.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from gonio import __version__
from gonio.errors import StoreError
from gonio.report import style

SCREEN_DPI = 108  # a figure of 10 inches fills the page's column
MISSING = "–"


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    html: str | Markup
    kind: str = "text"


@dataclass(frozen=True, slots=True)
class List:
    """A bulleted list."""

    items_html: Sequence[str | Markup]
    kind: str = "list"


@dataclass(frozen=True, slots=True)
class Table:
    """A table; `textual` aligns left and wraps the last column."""

    head: Sequence[str | Markup]
    rows: Sequence[Sequence[str | Markup]]
    note: str | Markup = ""
    textual: bool = False
    kind: str = "table"


@dataclass(frozen=True, slots=True)
class Details:
    """Preformatted text folded away under a line."""

    summary: str
    body: str
    kind: str = "details"


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure, ready for the page."""

    name: str
    title: str
    caption: Markup
    png: str
    width_px: int
    kind: str = "figure"


Block = Text | List | Table | Details | Picture


@dataclass(frozen=True, slots=True)
class Tile:
    """One number of the summary."""

    value: str | Markup
    label: str | Markup


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands under it."""

    anchor: str
    heading: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Page:
    """A whole report."""

    title: str
    lead: str
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    caveats: Sequence[str | Markup] = ()
    warnings: Sequence[str | Markup] = ()
    footer: str = field(default=f"Written by gonio {__version__}.")


def make_folder(out_dir: Path) -> Path:
    """Create the report's folders and return that of the figures; `StoreError` if that cannot be done."""
    figures = out_dir / "figures"
    try:
        figures.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"{out_dir}: the report's folder cannot be made ({error.strerror}); choose another with -o"
        ) from None
    return figures


def save_picture(drawing: style.Drawing, figures: Path) -> Picture:
    """Write a figure as PNG and SVG into the folder and return it for the page."""
    png = style.png_bytes(drawing.figure)
    write(figures / f"{drawing.name}.png", png)
    write(figures / f"{drawing.name}.svg", style.svg_bytes(drawing.figure))
    return Picture(
        name=drawing.name,
        title=drawing.title,
        caption=Markup(drawing.caption),
        png=base64.b64encode(png).decode("ascii"),
        width_px=round(drawing.figure.get_figwidth() * SCREEN_DPI),
    )


def write_page(page: Page, path: Path) -> Path:
    """Render the page into `path`, replacing an earlier one at once, and return the path."""
    template = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=False
    ).from_string(resources.files("gonio.report").joinpath("page.html.j2").read_text(encoding="utf-8"))
    text = template.render(
        program=f"gonio {__version__}",
        title=page.title,
        lead=page.lead,
        caveats=page.caveats,
        warnings=page.warnings,
        tiles=page.tiles,
        sections=[s for s in page.sections if s.blocks],
        footer=page.footer,
    )
    write(path, text.encode("utf-8"))
    return path


def write(path: Path, data: bytes) -> None:
    """Write a file in one step, so that no half of it is ever seen; `StoreError` if it cannot be written."""
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise StoreError(
            f"{path}: cannot be written ({error.strerror}); choose another folder with -o"
        ) from None


# -- numbers
# ----------------------------------------------------------------------------------------------------------


def number(value: float, digits: int = 4) -> str:
    """Return a number for a table; a dash where there is none."""
    return f"{value:.{digits}g}".replace("-", "−") if np.isfinite(value) else MISSING


def with_uncertainty(value: float, expanded: float) -> str:
    """Return ``72.13 ± 0.12``: the uncertainty with two significant digits, the value to the same decimal.

    Without a finite uncertainty the value stands with ``(no bound)``, without a value there is a dash.
    """
    if not np.isfinite(value):
        return MISSING
    if not np.isfinite(expanded):
        return f"{number(value)} (no bound)"
    if expanded <= 0:
        return number(value)
    decimals = int(np.clip(1 - np.floor(np.log10(expanded)), 0, 9))
    return f"{value:.{decimals}f} ± {expanded:.{decimals}f}".replace("-", "−")
