# SPDX-License-Identifier: BSD-3-Clause
"""The experiments of a paper on one page: figures and tables, each with what to look at."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass

from epi360.report.html_page import Page, escaped
from epi360.report.markdown_html import html_of_markdown
from epi360.runs.whole_files import PathLike, write_file


@dataclass(frozen=True)
class ExperimentShown:
    """One experiment: its result as Markdown, its figure, and the words beside them."""

    name: str
    title: str  # with the paper's number of the figure or table
    caption: str  # what the paper shows there, and what to look at
    verdict: str  # what came out
    text: str  # Markdown without the title
    figure: bytes | None = None  # PNG
    is_diagram: bool = False  # may be inverted on a dark page, which no photograph is


def write_reproduction_report(
    path: PathLike, title: str, experiments: Sequence[ExperimentShown], overview: bytes | None
) -> None:
    """Write the page; ``overview`` is a PNG."""
    write_file(path, reproduction_page(title, experiments, overview).encode())


def reproduction_page(
    title: str, experiments: Sequence[ExperimentShown], overview: bytes | None = None
) -> Page:
    """Return the page of at least one experiment."""
    names = [f"part{number}" for number in range(1, len(experiments) + 1)]
    contents = "".join(
        f'<li><a href="#{name}">{escaped(each.title)}</a></li>'
        for name, each in zip(names, experiments, strict=True)
    )
    first = ""
    if overview is not None:
        first = _figure(overview, "All numbers that the paper prints beside ours", is_diagram=True)
    sections = "".join(_section(name, each) for name, each in zip(names, experiments, strict=True))
    body = f"""<h1>{escaped(title)}</h1>
<p>Errors are those of the paper's eq. 16, angles as a share of half a turn: 1e-3 is 0.18°. R is the
rotation, T the direction of the translation. In tables the paper's numbers stand beside ours.</p>
<nav><ul class="contents">{contents}</ul></nav>
{first}{sections}"""
    return Page(title, body, {}, ())


def _section(name: str, shown: ExperimentShown) -> str:
    figure = ""
    if shown.figure is not None:
        figure = _figure(shown.figure, shown.title, is_diagram=shown.is_diagram)
    words = f"<p>{escaped(shown.caption)}</p>"
    if shown.verdict:
        heading = "<b>What came out with the full counts:</b>"
        words += f'<p class="came-out">{heading} {escaped(shown.verdict)}</p>'
    return (
        f'<section id="{name}"><h2>{escaped(shown.title)}</h2>{words}{figure}'
        f"{html_of_markdown(shown.text)}</section>"
    )


def _figure(png: bytes, label: str, *, is_diagram: bool) -> str:
    address = "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    kind = "drawing diagram" if is_diagram else "drawing"
    return f'<figure class="{kind}"><img src="{address}" alt="{escaped(label)}"></figure>'
