# SPDX-License-Identifier: BSD-3-Clause
"""How many damaged picture files are taken for whole ones, for each format and kind of damage.

    python benchmarks/damaged_pictures.py --count 100

A file counts if it is read without an error although its pixels differ visibly from those of the
whole file.
"""

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "features"))

from damaged_pictures import DAMAGES, damaged_files, looks_different, whole_files  # noqa: E402

from epi360.features import read_image  # noqa: E402


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="files of each kind of damage")
    parser.add_argument("--format", default="", help="only formats whose names begin like this")
    arguments = parser.parse_args()
    print(f"accepted although visibly different, of {arguments.count} each")
    print(f"{'':24}" + "".join(f"{damage:>15}" for damage in DAMAGES) + f"{'all':>9}")
    with tempfile.TemporaryDirectory(prefix="epi360-damaged-") as folder:
        for name, data in whole_files().items():
            if name.startswith(arguments.format):
                counts = [_accepted(data, damage, arguments.count, folder) for damage in DAMAGES]
                share = sum(counts) / arguments.count / len(counts)
                print(f"{name:24}" + "".join(f"{count:15}" for count in counts) + f"{share:9.1%}")
    return 0


def _accepted(data: bytes, damage: str, count: int, folder: str) -> int:
    path = Path(folder) / "picture"
    path.write_bytes(data)
    whole = read_image(path)
    number = 0
    for damaged in damaged_files(data, damage, count):
        path.write_bytes(damaged)
        try:
            number += looks_different(read_image(path), whole)
        except ValueError:
            continue
    return number


if __name__ == "__main__":
    sys.exit(main())
