# SPDX-License-Identifier: BSD-3-Clause
"""The page about the demo: its links lead somewhere, and it names options that exist."""

import re

from documents import ROOT, check_links, text_of

from epi360 import cli

DOCUMENT = ROOT / "docs" / "demo.md"


def test_links_lead_somewhere():
    check_links(DOCUMENT)


def test_every_option_that_is_named_exists_with_the_default_that_is_named(capsys):
    assert cli.main(["demo", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    named = re.findall(r"`(--[a-z-]+)(?: ([\d.]+|demo\.example\.org))?`", text_of(DOCUMENT))
    assert len(named) >= 6
    for option, value in named:
        assert option in shown
        if option.startswith(("--max", "--time")):
            assert re.search(rf"{option}.*?default: {value}(\.0)?\]", shown), option
