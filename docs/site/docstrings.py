# SPDX-License-Identifier: BSD-3-Clause
"""Docstrings as the site shows them: with links, shapes and defaults."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe

sys.path.insert(0, str(Path(__file__).resolve().parent))
from public_names import link_to  # noqa: E402

MENTION = re.compile(r"(?<!`)(`{1,2})([A-Za-z_][\w.]*)\1(?!`)")
# "ndarray, shape (N, 3)" would be read as a Python tuple of a name and a call.
SHAPE = re.compile(r"^(\s*[\w, ]+ : [^\n]*?), (shapes? \()", re.M)
# Of "low, high : int = 3" both would get the default of the first.
TOGETHER = re.compile(
    r"^(?P<names>\w+(?:, \w+)+)(?P<rest>(?: : [^\n]*)?\n(?:    [^\n]*\n|\n(?=    ))+)", re.M
)


class Docstrings(griffe.Extension):
    """What is done to each docstring before it is shown."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Change the docstrings of a package that was read."""
        for obj in _objects(pkg):
            if obj.docstring:
                text = SHAPE.sub(r"\1 of \2", obj.docstring.value + "\n")
                text = TOGETHER.sub(_split, text)
                obj.docstring.value = MENTION.sub(_link, text)
        _hide_modules(pkg)


def _objects(obj: griffe.Object) -> Iterator[griffe.Object]:
    yield obj
    for member in obj.members.values():
        if isinstance(member, griffe.Object):
            yield from _objects(member)


def _hide_modules(pkg: griffe.Module) -> None:
    """Let a function hide the module of its name that it is imported from, as in Python."""
    for package in [obj for obj in _objects(pkg) if isinstance(obj, griffe.Module)]:
        for name, module in list(package.modules.items()):
            if package.imports.get(name) == f"{module.path}.{name}":
                package.set_member(name, griffe.Alias(name, module[name], parent=package))


def _link(match: re.Match[str]) -> str:
    called = link_to(match[2])
    return f"[`{match[2]}`][{called}]" if called else match[0]


def _split(match: re.Match[str]) -> str:
    return "".join(f"{name}{match['rest']}" for name in match["names"].split(", "))
