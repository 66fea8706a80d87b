# SPDX-License-Identifier: BSD-3-Clause
"""What is printed of a result; the arrays of its matches would fill the screen."""

from typing import ClassVar


class ShortRepr:
    """Prints the attributes that a person reads."""

    _SHOWN: ClassVar[tuple[str, ...]]

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={getattr(self, name)!r}" for name in self._SHOWN)
        return f"{type(self).__name__}({shown}, ...)"
