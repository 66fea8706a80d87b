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

from _client_commands import opensfm_rows  # noqa: E402
from _client_training import nerfstudio_rows, opensplat_rows  # noqa: E402
from client_files import Scene, write_scene  # noqa: E402
from client_readers import READERS, NotInstalledError, differences  # noqa: E402

PROGRAMS = ("opensfm", "opensplat", "ns-train")
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
    failed = any(row[1] == "failed" for row in rows)
    if options.program:
        failed |= _print_commands(options)
    return int(failed)


def _print_commands(options: argparse.Namespace) -> bool:
    """Print a second table, of programs' own commands; whether one of them failed."""
    failed = False
    print("\n| command | seconds | result |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name, program in options.program.items():
            if name == "opensfm":
                rows = opensfm_rows(program, folder)
            elif name == "opensplat":
                rows = opensplat_rows(program, folder, options.iterations)
            else:
                rows = nerfstudio_rows(program, folder, options.iterations)
            for row in rows:
                print("| " + " | ".join(row) + " |", flush=True)
                failed |= row.result.startswith(("failed", "no "))
    return failed


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
    parser.add_argument(
        "--program",
        metavar="NAME=FILE",
        action="append",
        default=[],
        help=f"also run a program's own commands; names: {', '.join(PROGRAMS)}",
    )
    parser.add_argument("--iterations", type=int, default=300, help="steps of training programs")
    parser.add_argument("--keep", type=Path, help="new folder for what the commands write")
    options = parser.parse_args()
    options.snapshot = _paths(parser, "--snapshot", options.snapshot, SOURCES)
    options.program = _paths(parser, "--program", options.program, PROGRAMS)
    return options


def _paths(
    parser: argparse.ArgumentParser, option: str, given: list[str], names: tuple[str, ...]
) -> dict[str, Path]:
    """Paths by name of NAME=PATH; the order is that of the command line."""
    paths = {}
    for each in given:
        name, _, path = each.partition("=")
        if name not in names or not Path(path).exists():
            parser.error(f"{option} must be NAME=PATH with {', '.join(names)}, got {each}")
        paths[name] = Path(path).absolute()
    return paths


if __name__ == "__main__":
    raise SystemExit(main())
