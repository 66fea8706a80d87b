# SPDX-License-Identifier: BSD-3-Clause
"""Coloured points in PLY files: the vertices, whatever else such a file holds.

Source of the format: Turk, "The PLY Polygon File Format", 1994.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.runs.input_files import read_file
from epi360.runs.whole_files import write_file

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
POSITION, COLOR = ("x", "y", "z"), ("red", "green", "blue")
LONGEST_HEADER = 2**16


def read_ply_points(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the vertices (P, 3) of a PLY file and their colors (P, 3), black if it has none."""
    try:
        data = read_file(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist; it must hold the points as PLY") from None
    try:
        vertices = _vertices(data)
    except (KeyError, IndexError, OverflowError):
        raise ValueError(f"{path} must be a PLY file of points; its header is damaged") from None
    except ValueError as error:
        raise ValueError(f"{path} must be a PLY file of points: {error}") from None
    points = np.stack([vertices[name].astype(np.float64) for name in POSITION], axis=1)
    if not np.isfinite(points).all():
        raise ValueError(f"{path} must hold finite points, got NaN or infinity")
    colors = np.zeros((len(points), 3), np.uint8)
    if all(vertices.dtype.fields and name in vertices.dtype.fields for name in COLOR):
        given = np.stack([vertices[name].astype(np.float64) for name in COLOR], axis=1)
        if not ((given >= 0) & (given <= 255)).all():
            raise ValueError(f"{path} must hold colors from 0 to 255")
        colors = given.astype(np.uint8)
    return points, colors


def write_ply_points(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8]) -> None:
    """Write points (P, 3) and colors (P, 3) as a PLY of text, as nerfstudio itself writes it.

    Text keeps every digit under the type "float". Readers such as OpenSplat's take binary positions
    for single precision whatever the header says.
    """
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in POSITION]
    header += [f"property uchar {name}" for name in COLOR]
    rows = zip(points.tolist(), colors.tolist(), strict=True)
    lines = [f"{x!r} {y!r} {z!r} {red} {green} {blue}" for (x, y, z), (red, green, blue) in rows]
    write_file(path, "\n".join([*header, "end_header", *lines, ""]).encode())


def _vertices(data: bytes) -> NDArray[np.void]:
    """Structured array of the first element, which must be the vertices."""
    mark = data.find(b"end_header", 0, LONGEST_HEADER)
    start = data.find(b"\n", mark) + 1
    lines = [line.split() for line in data[: max(mark, 0)].decode("ascii").splitlines()]
    lines = [words for words in lines if words and words[0] not in ("comment", "obj_info")]
    if not start or mark < 0 or lines[0] != ["ply"] or lines[1][0] != "format":
        raise ValueError("it has no header")
    elements = [number for number, words in enumerate(lines) if words[0] == "element"]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ValueError("its first element is not the vertices")
    count, order = int(lines[elements[0]][2]), BYTE_ORDERS[lines[1][1]]
    properties = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    if count < 0 or any(len(words) != 3 for words in properties):
        raise ValueError("its vertices must be a number of rows of plain numbers")
    kinds = [(name, order + TYPES[kind]) for _, kind, name in properties]
    if not {"x", "y", "z"} <= {name for name, _ in kinds}:
        raise ValueError("its vertices have no x, y, z")
    if order != "=":
        if len(data) - start < count * np.dtype(kinds).itemsize:
            raise ValueError("it is cut off")
        return np.frombuffer(data, dtype=kinds, count=count, offset=start)
    rows = data[start:].decode("ascii").splitlines()[:count]
    cells = [tuple(map(float, row.split())) for row in rows]
    if len(rows) < count or any(len(row) != len(kinds) for row in cells):
        raise ValueError("it is cut off")
    return np.array(cells, dtype=[(name, "f8") for name, _ in kinds])
