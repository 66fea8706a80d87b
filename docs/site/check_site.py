# SPDX-License-Identifier: BSD-3-Clause
"""Check a built site: each link leads to a page and a place on it, nothing is loaded elsewhere."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from public_names import public_names

LOADED = {("img", "src"), ("script", "src"), ("link", "href"), ("iframe", "src"), ("source", "src")}
NOT_LOADED = {"canonical", "next", "prev"}  # links that a browser does not follow by itself


class _Page(HTMLParser):
    """Anchors of a page, its links, and what a browser loads with it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what one tag says."""
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        for name, value in values.items():
            if (tag, name) in LOADED and values.get("rel") not in NOT_LOADED:
                self.loaded.append(value)


def mistakes(site: Path) -> Iterator[str]:
    """Sentences on what is wrong with a built site."""
    pages = {file: _Page(file.read_text(encoding="utf-8")) for file in site.rglob("*.html")}
    if not pages:
        yield f"{site} has no pages"
    for file, page in pages.items():
        where = file.relative_to(site)
        for link in page.loaded:
            if urlsplit(link).scheme not in {"", "data"} or link.startswith("//"):
                yield f"{where} loads {link} from elsewhere"
            elif not urlsplit(link).scheme:
                yield from _missing(site, pages, file, link)
        for link in page.links:
            if urlsplit(link).scheme not in {"https", "http", "mailto"}:
                yield from _missing(site, pages, file, link)
    anchors = {anchor for page in pages.values() for anchor in page.anchors}
    for names in public_names().values():
        for one in names:
            if one.called not in anchors:
                yield f"no page explains {one.called}"


def _missing(site: Path, pages: dict[Path, _Page], file: Path, link: str) -> Iterator[str]:
    parts = urlsplit(link)
    folder = site if file.name == "404.html" else file.parent  # its links begin at the top
    target = (folder / unquote(parts.path).lstrip("/")).resolve() if parts.path else file
    target = target / "index.html" if target.is_dir() else target
    where = file.relative_to(site)
    if not target.is_file():
        yield f"{where} links to {link}, which is not there"
    elif parts.fragment and target in pages:
        anchor = unquote(parts.fragment)
        if anchor not in pages[target].anchors and anchor != "__codelineno":
            yield f"{where} links to {link}, but there is no such place on that page"
