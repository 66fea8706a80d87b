# SPDX-License-Identifier: BSD-3-Clause
"""What is installed: the libraries of the package's extras, and which version of the package."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any


def extra_library(name: str, *, extra: str, purpose: str) -> Any:
    """Module of a library that an extra brings; the ImportError says which command installs it."""
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise ImportError(
            f"{purpose} need {package}: pip install 'epi360[{extra}]'", name=package
        ) from None


def package_version() -> str:
    """Version of the installed package, or "unknown" in a source tree that is not installed."""
    try:
        return version("epi360")
    except PackageNotFoundError:
        return "unknown"
