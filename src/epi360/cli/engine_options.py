# SPDX-License-Identifier: BSD-3-Clause
"""The options of the commands that run on this machine or on Ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cyclopts import Group, Parameter


@Parameter(name="*", group=Group("Engine", sort_key=4))
@dataclass(frozen=True)
class EngineOptions:
    """Where the work is done."""

    engine: Literal["local", "ray"] = "local"
    """Run on threads of this machine, or on Ray (local by default)."""
    address: str | None = None
    """With Ray: address of a cluster."""

    def check(self, num_threads: int | None) -> None:
        """Raise ``ValueError`` for an option that goes with the other engine."""
        if self.address is not None and self.engine != "ray":
            raise ValueError("--address goes with --engine ray")
        if num_threads is not None and self.engine != "local":
            raise ValueError(
                "--num-threads goes with --engine local; Ray takes all cores it is given"
            )


LOCAL_ENGINE = EngineOptions()
