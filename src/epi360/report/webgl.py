# SPDX-License-Identifier: BSD-3-Clause
"""The 3D library that a page can carry: three.js, from the package of an extra."""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

# NiceGUI ships three.js with its controls as one ECMAScript module, which it serves to its own
# pages. We read the file; NiceGUI itself is not imported.
_PACKAGE = "nicegui"
_MODULE = Path("elements", "scene", "dist", "index.js")
MISSING = (
    "There is no 3D view in this page. pip install 'epi360[report]' brings the library for it."
)


@dataclass(frozen=True)
class WebGLLibrary:
    """An ECMAScript module that exports ``THREE`` and ``OrbitControls``, and whose it is."""

    source: str
    credit: str


def find_webgl_library() -> WebGLLibrary | None:
    """Return three.js where the extra [report] is installed, None where it is not."""
    try:
        spec = find_spec(_PACKAGE)
        number = version(_PACKAGE)
    except (ImportError, ValueError, PackageNotFoundError):
        return None
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        path = Path(folder) / _MODULE
        if path.is_file():
            source = path.read_text(encoding="utf-8")
            if "OrbitControls" in source and "THREE" in source:
                return WebGLLibrary(source, _credit(number))
    return None


def _credit(number: str) -> str:
    return (
        f"The 3D view uses three.js (MIT licence, the three.js authors) in the build that NiceGUI "
        f"{number} ships (MIT licence, Zauberzeug GmbH)."
    )
