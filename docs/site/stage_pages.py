# SPDX-License-Identifier: BSD-3-Clause
"""Put the pages of the site into one folder, with their links turned to each other."""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from public_names import TOP, PublicName, description, link_to, public_names

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
ASSETS = Path(__file__).resolve().parent / "assets"
# Pages of the site that are files of the repository outside docs/.
OTHERS = {
    "index.md": ROOT / "README.md",
    "benchmarks.md": ROOT / "benchmarks" / "README.md",
    "changelog.md": ROOT / "CHANGELOG.md",
    "contributing.md": ROOT / "CONTRIBUTING.md",
    "security.md": ROOT / "SECURITY.md",
}
LANGUAGES = {".py": "python", ".cpp": "cpp", ".hpp": "cpp", ".cff": "yaml", ".yml": "yaml"}
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)
LINK = re.compile(
    r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<link>[^)\s]+)\)|src=\"(?P<source>[^\"]+)\""
)
MENTION = re.compile(r"(?<!\[)`([A-Za-z_][\w.]*)`")
PICTURE = re.compile(r"<img src=\"(?P<source>[^\"]+)\"[^>]*>")


def site_pages() -> dict[str, Path]:
    """The pages that are files of the repository, by their names on the site."""
    return {file.name: file for file in sorted(DOCS.glob("*.md"))} | OTHERS


def stage(folder: Path) -> None:
    """Write every page, picture, linked source file and page of the API into a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ASSETS, folder / "assets")
    for name, file in site_pages().items():
        text = file.read_text(encoding="utf-8")
        (folder / name).write_text(_turned(text, name, file.parent, folder), encoding="utf-8")
    (folder / "api").mkdir()
    for name, text in api_pages().items():
        (folder / name).write_text(text, encoding="utf-8")


def _turned(text: str, page: str, home: Path, folder: Path) -> str:
    """Text of a page whose links lead where the things are on the site."""

    def turned(match: re.Match[str]) -> str:
        link = match["link"] or match["source"]
        if link.startswith(("https://", "#")):
            return match[0]
        name, _, anchor = link.partition("#")
        target = (home / name).resolve()
        if not target.exists():
            raise SystemExit(f"{page} links to {link}, which is not there")
        there = _on_site(target, folder)
        if there is None:
            return match["text"]
        relative = os.path.relpath(there, Path(page).parent).replace(os.sep, "/")
        return match[0].replace(link, f"{relative}#{anchor}" if anchor else relative)

    return "".join(
        part if is_code else _with_names(PICTURE.sub(_opened, LINK.sub(turned, part)))
        for is_code, part in _parts(text)
    )


def _with_names(text: str) -> str:
    """Text in which public names lead to the API, but for titles and what is a link already."""
    return "".join(
        line if line.startswith("#") else MENTION.sub(_named, line)
        for line in text.splitlines(keepends=True)
    )


def _named(mention: re.Match[str]) -> str:
    called = link_to(mention[1])
    return f"[`{mention[1]}`][{called}]" if called else mention[0]


def _opened(picture: re.Match[str]) -> str:
    """A picture that opens alone when it is clicked, so that a phone can magnify it."""
    return f'<a href="{picture["source"]}">{picture[0]}</a>'


def _parts(text: str) -> Iterator[tuple[bool, str]]:
    """Pieces of a page, and whether each is a block of code."""
    start = 0
    for fence in FENCE.finditer(text):
        yield False, text[start : fence.start()]
        yield True, fence[0]
        start = fence.end()
    yield False, text[start:]


def _on_site(target: Path, folder: Path) -> str | None:
    """Where a file of the repository is on the site, which it is copied to; None if nowhere."""
    for name, file in site_pages().items():
        if file == target:
            return name
    if target.is_dir():
        package = ".".join(target.relative_to(ROOT / "src").parts)
        return f"api/{package}.md" if package in public_names() else None
    if target.suffix in {".png", ".webp", ".svg"}:
        name = target.relative_to(DOCS).as_posix()
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(target, folder / name)
        return name
    return _source_page(target, folder)


def _source_page(target: Path, folder: Path) -> str:
    path = target.relative_to(ROOT).as_posix()
    page = folder / "source" / f"{path}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    code = target.read_text(encoding="utf-8")
    language = LANGUAGES.get(target.suffix, "text")
    page.write_text(f"# {path}\n\n```{language}\n{code}```\n", encoding="utf-8")
    return f"source/{path}.md"


def api_pages() -> dict[str, str]:
    """The text of the pages of the API, by their names on the site."""
    names = public_names()
    pages = {f"api/{package}.md": _api_page(package, names[package]) for package in names}
    return {"api/index.md": _api_index(names), **pages}


def _api_index(names: dict[str, list[PublicName]]) -> str:
    lines = [
        "# API",
        "",
        f"What `import {TOP}` offers comes first; the other packages have more. What is not on "
        "these pages may change without notice.",
        "",
        *_table(one for page in names.values() for one in page if one.called.count(".") == 1
                and one.called.startswith(f"{TOP}.")),
    ]  # fmt: skip
    for package, page in names.items():
        more = [one for one in page if one.called.startswith(f"{package}.")]
        lines += ["", f"## [`{package}`]({package}.md)", "", description(package), ""]
        lines += _table(more) if more else []
    return "\n".join(lines) + "\n"


def _table(names: Iterator[PublicName] | list[PublicName]) -> list[str]:
    rows = [f"| [`{one.called}`][{one.called}] | {one.summary} |" for one in names]
    return ["| name | what it is |", "| --- | --- |", *sorted(rows, key=str.lower)]


def _api_page(package: str, names: list[PublicName]) -> str:
    blocks = [f"::: {one.called}\n{_OPTIONS if not one.summary else ''}" for one in names]
    return "\n".join([f"# {package}", "", description(package), "", *blocks])


_OPTIONS = "    options:\n      show_if_no_docstring: true\n"
