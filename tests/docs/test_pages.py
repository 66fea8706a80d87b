# SPDX-License-Identifier: BSD-3-Clause
"""The pages of the documentation: no block escapes the tests, links and pictures are there."""

import re
from pathlib import Path

import documents
import pytest
from documents import BLOCK, ROOT, blocks_of, check_block, check_command, check_links, text_of
from make_pictures import FOLDER, pictures
from stage_pages import api_pages, site_pages, stage
from test_howtos import HOWTOS
from test_readme import DOCUMENTS

PAGES = sorted(site_pages().values())
RUN = {*DOCUMENTS, *(ROOT / "docs" / f"{name}.md" for name in HOWTOS)}
PROGRAMS = ("epi360 ", "python ", "pip ", "make ", "sudo ", "ns-train ", "import ", ".venv/")
MAX_BYTES = 1_500_000


def name_of(path):
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_of_commands_or_python_is_run_or_says_why_not(page):
    for block in blocks_of(page):
        if block["reason"]:
            assert len(block["reason"].split()) >= 3, f"no reason: {block['reason']}"
            check_block(block)
        elif block["language"] in ("bash", "python"):
            assert page in RUN, f"no test runs {block[0]}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_commands_hide_where_blocks_are_not_looked_for(page):
    text = text_of(page)
    assert len(re.findall(r"^ *(?:```|~~~)", text, re.M)) == 2 * len(blocks_of(page))
    assert all(block["language"] for block in blocks_of(page)), "a block without a language"
    for line in BLOCK.sub("", text).splitlines():
        assert not line.startswith(tuple(f"    {program}" for program in PROGRAMS)), line


@pytest.mark.parametrize("name", HOWTOS)
def test_each_howto_has_a_test_that_runs_it(name):
    assert f'run_document(DOCS / "{name}.md")' in text_of(ROOT / "tests" / "test_howtos.py")


@pytest.mark.parametrize(
    "words",
    [
        ["epi360", "pair", "--no-such-option"],
        ["make", "nothing"],
        ["pip", "install", ".[nothing]"],
        ["python", "benchmarks/nothing.py"],
        ["rm", "-r", "out"],
        ["ns-train", "splatfacto", "--orientation", "none"],
    ],
    ids=" ".join,
)
def test_a_command_that_cannot_be_typed_is_found(words):
    with pytest.raises(AssertionError):
        check_command(words)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files_and_titles(page):
    check_links(page)


def test_a_broken_link_and_a_missing_title_are_found(tmp_path):
    page = tmp_path / "page.md"
    for link in ("nothing.md", "page.md#nothing"):
        page.write_text(f"# Title\n\n[here]({link})\n", encoding="utf-8")
        with pytest.raises(AssertionError):
            check_links(page)
    page.write_text("# Title\n\n[here](#title)\n", encoding="utf-8")
    check_links(page)


def test_the_navigation_has_every_page_once():
    listed = re.findall(r": ([\w/.]+\.md)$", text_of(ROOT / "docs" / "site" / "mkdocs.yml"), re.M)
    assert sorted(listed) == sorted(site_pages())


def test_every_picture_is_drawn_by_the_script_and_shown_on_a_page():
    shown = {
        (page.parent / (first or second)).resolve()
        for page in PAGES
        for first, second in documents.LINK.findall(text_of(page))
        if (first or second).startswith(("images/", "docs/images/"))
    }
    drawn = {FOLDER / f"{name}.webp" for name in pictures()}
    there = {path for path in FOLDER.rglob("*") if path.suffix not in {".py", ".pyc", ""}}
    assert shown == drawn == there


def test_all_pictures_together_are_small():
    assert sum(path.stat().st_size for path in FOLDER.rglob("*.webp")) < MAX_BYTES


def test_links_of_the_staged_pages_lead_to_pages(tmp_path):
    stage(tmp_path)
    staged = sorted(tmp_path.rglob("*.md"))
    assert len(staged) > len(PAGES) + len(api_pages())
    for page in staged:
        for first, second in documents.LINK.findall(text_of(page)):
            link = first or second
            if not link.startswith(("https://", "#")):
                assert (page.parent / Path(link.partition("#")[0])).is_file(), f"{page}: {link}"
