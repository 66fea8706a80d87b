# SPDX-License-Identifier: BSD-3-Clause
"""What other programs' own readers make of the files that epi360 writes, as a table.

``python benchmarks/clients.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "clients"))

from client_files import Scene, write_scene  # noqa: E402
from client_readers import READERS, NotInstalledError, differences  # noqa: E402

SOURCES = ("gsplat", "3dgs", "hloc", "nerfstudio", "opensfm")
COLUMNS = ("program, file", "version", "images", "rotation", "centre", "points", "remarks")


def main() -> int:
    """Print the table; exit code 1 if a program that is there does not read a file."""
    options = _parse_options()
    with tempfile.TemporaryDirectory() as scratch:
        scene = write_scene(Path(scratch))
        rows = [_row(client, scene, options.snapshot) for client in READERS]
    print("| " + " | ".join(COLUMNS) + " |")
    print("| " + " | ".join("---" for _ in COLUMNS) + " |")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return int(any(row[1] == "failed" for row in rows))


def _row(client: str, scene: Scene, snapshots: dict[str, Path]) -> tuple[str, ...]:
    nothing = ("",) * (len(COLUMNS) - 3)
    try:
        loaded = READERS[client](scene, snapshots)
        turn, centre, point = differences(loaded, scene)
    except NotInstalledError as error:
        return (client, "not installed", *nothing, str(error))
    except Exception as error:  # a program's own error is a result
        return (client, "failed", *nothing, " ".join(f"{type(error).__name__}: {error}".split()))
    cells = (_number(turn, " deg"), _number(centre), _number(point))
    count = str(len(loaded.poses) or "")
    return (client, loaded.version, count, *cells, ", ".join(loaded.remarks))


def _number(value: float, unit: str = "") -> str:
    return "" if np.isnan(value) else "0" if value == 0 else f"{value:.0e}{unit}"


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--snapshot",
        metavar="NAME=FOLDER",
        action="append",
        default=[],
        help=f"source of a program that is not installed; names: {', '.join(SOURCES)}",
    )
    options = parser.parse_args()
    snapshots = {}
    for given in options.snapshot:
        name, _, folder = given.partition("=")
        if name not in SOURCES or not Path(folder).is_dir():
            parser.error(f"--snapshot must be NAME=FOLDER with {', '.join(SOURCES)}, got {given}")
        snapshots[name] = Path(folder).resolve()
    options.snapshot = snapshots
    return options


if __name__ == "__main__":
    raise SystemExit(main())
