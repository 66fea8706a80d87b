# SPDX-License-Identifier: BSD-3-Clause
"""Tables 1 to 3 on tracks that are there already: what is written, and that it does not change."""

import csv
import re

import cv2
import numpy as np
import pytest
from measured import is_timing

from epi360.progress import no_progress
from epi360.synthetic import two_view_scene
from epi360_paper import load_experiment, table1, table2, table3
from epi360_paper.method_rows import agreement_line, pair_rows, rendered_cell, with_pairs
from epi360_paper.methods import METHODS
from epi360_paper.options import ReproduceOptions
from epi360_paper.parts import Trials
from epi360_paper.rendered import PAIRS_PER_SEQUENCE, RenderedTracks
from epi360_paper.tracks import BearingPair
from epi360_paper.trials import Trial

NUM_SEQUENCES = 2
PAIRS = 2  # of each sequence


@pytest.fixture
def out(tmp_path, monkeypatch):
    """Folder of results with the tracks of two sequences, not rendered but made of landmarks."""

    def landmarks(self, scene, scene_seed, path_seed):
        pairs = []
        for index in range(PAIRS):
            made = two_view_scene(scene_seed % 1000 + index, num_matches=60, outlier_ratio=0.1)
            pose = made.cam2_from_cam1
            pairs.append(BearingPair(index, index + 7, made.bearings1, made.bearings2, pose))
        return pairs

    monkeypatch.setattr(RenderedTracks, "_render", landmarks)
    fill(tmp_path)
    monkeypatch.setattr(RenderedTracks, "_render", lambda *_: pytest.fail("rendered"))
    return tmp_path


def fill(out):
    for lens in ("360", "fisheye"):
        source = rendered_cell(lens, ReproduceOptions(out=out)).source
        for index in range(NUM_SEQUENCES):
            source.pairs(Trial(0, "any", 0, index))


def reproduce(name, out, progress=no_progress, **options):
    count = NUM_SEQUENCES * PAIRS_PER_SEQUENCE
    given = ReproduceOptions(**{"out": out, "jobs": 1, "trials": count, **options})
    return load_experiment(name)(given, progress)


def rows_of(outcome):
    with outcome.files[0].open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def numbers_of(outcome):
    return [
        {name: value for name, value in row.items() if not is_timing(name)}
        for row in rows_of(outcome)
    ]


@pytest.mark.parametrize(
    ("name", "methods"), [("table1", table1.PRINTED), ("table2", table2.PRINTED)]
)
def test_each_method_has_a_row_with_papers_and_our_numbers(out, name, methods):
    outcome = reproduce(name, out)
    assert "nan" not in outcome.summary
    for method, printed in methods.items():
        (line,) = (row for row in outcome.summary.splitlines() if f"| {printed.title} |" in row)
        assert f"| {printed.rotation:.3f} |" in line
        found = [float(r["rotation_error"]) for r in rows_of(outcome) if r["method"] == method]
        assert len(found) == NUM_SEQUENCES * PAIRS
        assert f"| {1e3 * np.median(found):.3f} |" in line
    assert f"{NUM_SEQUENCES * PAIRS} pairs of {NUM_SEQUENCES} rendered sequences" in outcome.summary


def test_table1_measures_stability_in_the_domain_of_each_method(out):
    rows = rows_of(reproduce("table1", out, protocol="printed"))
    first = {row["method"]: row for row in rows if row["trial"] == row["pair"] == "0"}
    plain, whitened = first["8pa"], first["8pa_non_isotropic"]
    assert 0 < float(plain["sigma_8_over_sigma_1"]) < 1
    # Whitened bearings of 60 matches are a factor sqrt(20) shorter, and sigma_8 has two of them.
    assert float(whitened["sigma_8"]) < 0.2 * float(plain["sigma_8"])
    assert all(0 < float(row["alpha_rad"]) < np.pi for row in first.values())


def test_table3_has_quartiles_of_both_lenses(out):
    outcome = reproduce("table3", out)
    summary = outcome.summary
    assert summary.count("| Q75 |") == 4
    assert all(
        f"### {table3.HEADINGS[f'rendered-{lens}']}" in summary for lens in ("360", "fisheye")
    )
    rows = [row for row in rows_of(outcome) if row["cell"] == "rendered-fisheye"]
    errors = [float(row["rotation_error"]) for row in rows if row["method"] == METHODS[0]]
    quartile = f"| Q25 | 15.512 | {1e3 * np.quantile(errors, 0.25):.3f} |"
    assert quartile in summary


def test_numbers_are_the_same_on_one_and_two_workers(out):
    one = numbers_of(reproduce("table3", out))
    for path in (out / "table3" / "parts").iterdir():
        path.unlink()
    assert numbers_of(reproduce("table3", out, jobs=2)) == one


def test_interrupted_run_goes_on_where_it_stopped(out):
    whole = numbers_of(reproduce("table1", out))
    parts = sorted((out / "table1" / "parts").iterdir())
    parts[1].unlink()
    kept = parts[0].read_bytes()

    def interrupt(stage, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce("table1", out, interrupt)
    assert numbers_of(reproduce("table1", out)) == whole
    assert parts[0].read_bytes() == kept  # its times too: it was not computed again


@pytest.mark.usefixtures("tiny_landmarks")
@pytest.mark.parametrize("name", ["table1", "table2"])
@pytest.mark.parametrize("protocol", ["authors", "corrected"])
def test_landmarks_take_the_place_of_tracks(tmp_path, name, protocol):
    outcome = reproduce(name, tmp_path, landmarks=True, trials=1, protocol=protocol)
    assert "1 pairs of 1 scenes; medians: 200 matches" in outcome.summary
    assert {row["cell"] for row in rows_of(outcome)} == {"landmarks"}
    assert outcome.files[0].parent == tmp_path / f"{name}-landmarks-{protocol}"


def test_trial_without_pairs_is_a_row_that_tables_leave_out():
    empty = pair_rows([], METHODS, "printed", measured=("sigma_8",))
    assert [row["pair"] for row in empty] == [-1]
    assert np.isnan(empty[0]["sigma_8"])
    columns = {name: np.array([value, value]) for name, value in empty[0].items()}
    with pytest.raises(ValueError, match="got none; take larger images"):
        with_pairs(Trials(columns))
    columns["pair"] = np.array([-1, 3])
    assert with_pairs(Trials(columns))["pair"].tolist() == [3]


def test_agreement_counts_pairs_of_methods_in_the_papers_order():
    paper = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 3.0}
    line = agreement_line("Rotation", paper, {"a": 5.0, "b": 4.0, "c": 6.0, "d": 7.0})
    assert "4 of 5 pairs" in line  # a and b are not; the paper does not order c and d
    assert line.endswith("b < a < c < d.")


def test_recorded_scenes_are_a_part_of_table3(out):
    write_recording(out / "data" / "scene")
    outcome = reproduce("table3", out, mp3d_vo=out / "data")
    assert re.search(r"### MP3D-VO\n\n\| Rot-e", outcome.summary)
    assert (out / "table3-mp3d_vo" / "trials.csv") in outcome.files


def test_wrong_folder_is_told_before_anything_is_computed(out):
    with pytest.raises(FileNotFoundError, match="TUM-VI folder .* does not exist"):
        reproduce("table3", out, tum_vi=out / "nowhere")
    assert not (out / "table3").exists()


def write_recording(scene):
    """Panorama that turns by three pixels a frame while the poses walk: tracks, but no truth."""
    noise = np.random.default_rng(0).uniform(0, 255, (128, 256, 3))
    around = cv2.GaussianBlur(np.tile(noise, (1, 3, 1)), (0, 0), 2.0).astype(np.uint8)
    panorama = around[:, 256:512]
    (scene / "rgb").mkdir(parents=True)
    rows = []
    for index in range(2):
        encoded = cv2.imencode(".png", np.roll(panorama, 3 * index, axis=1))[1].tobytes()
        (scene / "rgb" / f"{index + 1}.png").write_bytes(encoded)
        rows.append(f"{index} {0.6 * index} 0 0 0 0 0 1")
    (scene / "frm_ref.txt").write_text("\n".join(rows))
