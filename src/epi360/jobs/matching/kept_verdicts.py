# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on the pairs of a folder that are kept, for a run that asks for the same once more.

To judge the pairs of a folder by all that is known of it takes as long as to match them. Who has
matched a folder and wants its page, or the map, does not want to wait for that again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from epi360.estimation import Explanations
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.folder_verdicts import FolderVerdicts
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.jobs.records.match_store import (
    IMPLIED_PAIRS,
    VERDICTS,
    Keys,
    Verdict,
    keys_by_part,
    read_part,
)
from epi360.poses import Pose
from epi360.runs.made_from import code_fingerprint, fingerprint, read_record
from epi360.runs.remote_path import AnyPath
from epi360.runs.whole_files import write_file

AnyVerdict = TypeVar("AnyVerdict", bound=Verdict)


@dataclass(frozen=True, eq=False)
class KeptVerdicts:
    """A file for the verdicts of the last run, which count while it would ask for the same.

    ``made_from`` is a hash of all that they depend on besides the options of the output folder,
    see `made_from`.
    """

    output: AnyPath
    made_from: str

    def read(self, keys: Sequence[Keys | None]) -> FolderVerdicts | None:
        """Verdicts on the pairs with these keys; None where none are kept that count."""
        try:
            record = read_record(self.output / VERDICTS, remedy="")
            if record is None or record["made_from"] != self.made_from:
                return None
            return _folder_verdicts(self.output, record, keys)
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):  # damaged
            return None

    def write(self, judged: FolderVerdicts, other_poses: str) -> None:
        """Keep verdicts; ``other_poses`` is the part in which those are, "" without any."""
        settled = sorted(judged.settled)
        record = {
            "made_from": self.made_from,
            "level": None if judged.level is None else vars(judged.level),
            "looked_around": judged.looked_around,
            "num_gained": judged.num_gained,
            "num_lost": judged.num_lost,
            "num_not_compared": judged.num_not_compared,
            "num_other_poses": len(judged.other_poses),
            "other_poses": other_poses,
            "verdicts": _table(judged.verdicts),
            "settled_keys": settled,
            "settled": _table([judged.settled[keys] for keys in settled]),
        }
        write_file(self.output / VERDICTS, json.dumps(record).encode())


def made_from(
    names: Sequence[tuple[str, str]],
    keys: Sequence[Keys | None],
    finished: Mapping[Keys, Verdict],
    **options: bool,
) -> str:
    """Hash of what `judge_folder` is asked: pairs, by the names and keys of their images.

    ``finished`` are the verdicts of the pairs by their own matches.
    """
    verdicts = [None if each is None else _row(finished[each]) for each in keys]
    asked = json.dumps([options, names, keys, verdicts])  # numbers of NumPy have other names
    return fingerprint(code_fingerprint(), asked.encode())


def _folder_verdicts(
    output: AnyPath, record: Mapping[str, Any], keys: Sequence[Keys | None]
) -> FolderVerdicts | None:
    part = record["other_poses"]
    others = read_part(output, part, IMPLIED_PAIRS) if part else []
    level = None if record["level"] is None else Level(**record["level"])
    names = [(key1, key2) for key1, key2 in record["settled_keys"]]
    settled = dict(zip(names, _verdicts(Verdict, record["settled"]), strict=True))
    if len(others) != record["num_other_poses"] or not _are_there(output, level, settled):
        return None
    return FolderVerdicts(
        keys,
        tuple(_verdicts(PairVerdict, record["verdicts"])),
        level,
        settled,
        {each.keys: each for each in others},
        looked_around=record["looked_around"],
        num_gained=record["num_gained"],
        num_lost=record["num_lost"],
        num_not_compared=record["num_not_compared"],
    )


def _are_there(output: AnyPath, level: Level | None, settled: Mapping[Keys, Verdict]) -> bool:
    """Whether the pairs whose verdicts have the prior of a level folder are in whole parts."""
    if level is None:
        return True
    there = {keys for _, some in keys_by_part(output, level.store) for keys in some}
    return there >= {keys for keys, told in settled.items() if told.prior == level.prior}


def _table(verdicts: Sequence[Verdict]) -> list[list[Any]]:
    """Verdicts for JSON: the names of their values, and a row for each."""
    return [list(vars(verdicts[0])) if verdicts else [], *map(_row, verdicts)]


def _row(verdict: Verdict) -> list[Any]:
    return [_plain(value) for value in vars(verdict).values()]


def _plain(value: object) -> object:
    if isinstance(value, Pose):
        return value.matrix()[:3].tolist()
    return list(vars(value).values()) if isinstance(value, Explanations) else value


def _verdicts(kind: type[AnyVerdict], table: Sequence[Sequence[Any]]) -> list[AnyVerdict]:
    """Verdicts of a `_table`."""
    names, *rows = table
    return [kind(**_values(dict(zip(names, row, strict=True)))) for row in rows]


def _values(row: Mapping[str, Any]) -> dict[str, Any]:
    values = {**row, "explanations": Explanations(*row["explanations"])}
    for name in ("cam2_from_cam1", "doubted"):
        matrix = np.array(row[name])
        values[name] = Pose(matrix[:, :3], matrix[:, 3])
    values["warnings"] = tuple(row["warnings"])
    if "contradicted_by" in row:
        values["contradicted_by"] = tuple(map(tuple, row["contradicted_by"]))
    return values
