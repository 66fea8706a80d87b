# SPDX-License-Identifier: BSD-3-Clause
"""Public names of the packages, read from their sources without importing them."""

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[2] / "src"
TOP = "epi360"
# The command has pages of its own, and the readers of calibrations are exported one folder above.
WITHOUT_PAGE = {"epi360.cli", "epi360.cameras.calibration"}
# Other words in backticks, such as `scene`, may be parameters or plain words.
LIKE_A_NAME = re.compile(r"[A-Z_]")


@dataclass(frozen=True)
class PublicName:
    """A name that users import, and where it is defined.

    Attributes
    ----------
    name : str
    package : str
        The package or module whose page explains it.
    called : str
        The dotted name that users should write: the shortest one.
    summary : str
        First sentence of its docstring; empty for constants.
    """

    name: str
    package: str
    called: str
    summary: str


def public_names() -> dict[str, list[PublicName]]:
    """The public names of each package and module that has a page, in the order of the pages."""
    top = _imports(_tree(TOP))
    pages: dict[str, list[PublicName]] = {}
    for name in _exported(TOP):
        home = top[name][0]
        if home != TOP:  # epi360.epipolar is a module
            pages.setdefault(home, []).append(_public(name, home, f"{TOP}.{name}"))
    for package in _packages():
        known = {one.name for one in pages.get(package, [])}
        more = [name for name in _exported(package) if name not in known]
        pages.setdefault(package, []).extend(
            _public(name, package, f"{package}.{name}") for name in more
        )
    return dict(sorted(pages.items()))


def _packages() -> list[str]:
    """Packages that say with __all__ what is public, but for the front page."""
    files = sorted(SOURCES.glob("*/**/__init__.py"))
    packages = [".".join(file.parent.relative_to(SOURCES).parts) for file in files]
    return [one for one in packages if one not in {TOP, *WITHOUT_PAGE} and _exported(one)]


def _public(name: str, home: str, called: str) -> PublicName:
    return PublicName(name, home, called, _summary(home, name))


def _summary(module: str, name: str) -> str:
    """First sentence of the docstring of a name that a module defines or imports."""
    tree = _tree(module)
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return (ast.get_docstring(node) or "").split("\n\n")[0].replace("\n", " ")
    imported = _imports(tree).get(name)
    if imported is None or not imported[0].startswith(TOP):
        return ""
    return _summary(*imported)


def _exported(module: str) -> list[str]:
    for node in _tree(module).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def _imports(tree: ast.Module) -> dict[str, tuple[str, str]]:
    """Module and name there of each ``from module import name``, also under TYPE_CHECKING."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {
        alias.asname or alias.name: (str(node.module), alias.name)
        for node in nodes
        for alias in node.names
    }


@cache
def _tree(module: str) -> ast.Module:
    path = SOURCES.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def description(module: str) -> str:
    """First sentence of the docstring of a module."""
    return (ast.get_docstring(_tree(module)) or "").split("\n\n")[0].replace("\n", " ")


def link_to(mention: str) -> str | None:
    """How the API calls what a text in backticks names: ``Pose`` or ``epi360.Pose``."""
    return _mentions().get(mention) if LIKE_A_NAME.search(mention) else None


@cache
def _mentions() -> dict[str, str]:
    """Short and full names; where two packages have a name, the short one is that of epi360."""
    names = [one for page in public_names().values() for one in page]
    names.sort(key=lambda one: one.called.count("."), reverse=True)
    return {key: one.called for one in names for key in (one.name, one.called)}
