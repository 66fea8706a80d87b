# SPDX-License-Identifier: BSD-3-Clause
"""What is installed: the libraries of the package's extras, and which version of the package."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any


def extra_library(name: str, *, extra: str, purpose: str) -> Any:
    """Module of a library that an extra brings; the ImportError says which command installs it.

    A library that is there, but cannot be loaded, says why itself.
    """
    package = name.partition(".")[0]
    try:
        return import_module(name)
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and error.name in (package, name):
            reason, cause = f"{purpose} need {package}: pip install 'epi360[{extra}]'", None
        else:
            reason = f"{purpose} need {package}, which is there but cannot be loaded: {error}"
            cause = error
        raise ImportError(reason, name=package) from cause


def package_version() -> str:
    """Version of the installed package, or "unknown" in a source tree that is not installed."""
    try:
        return version("epi360")
    except PackageNotFoundError:
        return "unknown"
