# SPDX-License-Identifier: BSD-3-Clause
"""The Markdown that our own tables are written in as HTML: headings, tables, paragraphs, code."""

import re

from epi360.report.html_page import escaped

_LOWEST_HEADING = 4


def html_of_markdown(text: str, *, lowered: int = 0) -> str:
    """Return HTML; headings are ``lowered`` by so many levels."""
    blocks = re.split(r"\n\s*\n", text.strip())
    return "\n".join(
        _block(block.strip().splitlines(), lowered) for block in blocks if block.strip()
    )


def _block(lines: list[str], lowered: int) -> str:
    if lines[0].startswith("#"):
        marks, _, title = lines[0].partition(" ")
        level = min(len(marks) + lowered, _LOWEST_HEADING)
        heading = f"<h{level}>{_inline(title)}</h{level}>"
        return heading + (f"\n{_block(lines[1:], lowered)}" if lines[1:] else "")
    if lines[0].startswith("|"):
        return _table([_cells(line) for line in lines])
    return f"<p>{_inline(' '.join(lines))}</p>"


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _table(rows: list[list[str]]) -> str:
    heading, body = rows[0], rows[2:]
    ours = [cell.endswith(": ours") for cell in heading]
    head = "".join(f"<th>{_inline(cell)}</th>" for cell in heading)
    lines = []
    for row in body:
        cells = [
            f'<td class="ours">{_inline(cell)}</td>' if mine else f"<td>{_inline(cell)}</td>"
            for cell, mine in zip(row, ours, strict=True)
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="wide"><table class="numbers"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _inline(text: str) -> str:
    pieces = escaped(text).split("`")
    return "".join(
        f"<code>{piece}</code>" if i % 2 else re.sub(r"\*(\S[^*]*)\*", r"<em>\1</em>", piece)
        for i, piece in enumerate(pieces)
    )
