# SPDX-License-Identifier: BSD-3-Clause
"""Calibration files whose values are not what YAML's tags say they are."""

import pytest

from epi360.cameras import load_cameras

VALUES = [
    "!!bool q", '!!int ""', '!!int "-"', '!!int "0b"', '!!int "1:x"', '!!float ""', '!!float "-"',
    "!!timestamp abc", '!!timestamp "2001-13-45"', '!!timestamp "2001-01-01T00:00:00+99:99"',
    "2023-99-99", '!!binary "%"', "!!set 1", "!!omap 1", "!!pairs 1", "!!null x", "{[]: 1}",
    "&a [*a]", "{<<: [1]}", "!!python/object/apply:os.getcwd []", "9" * 5000, "0b" + "1" * 5000,
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES)
def test_a_value_that_is_not_of_its_type_is_refused_in_one_sentence(value, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(f"a: {{model: Pinhole, width: {value}, height: 4, fx: 1, fy: 1, cx: 1, cy: 1}}")
    path.write_text(f"cameras:\n  {path.read_text()}\n")
    with pytest.raises(ValueError, match="camera.yaml") as error:
        load_cameras(path)
    assert "\n" not in str(error.value) and len(str(error.value)) < 500


def test_a_key_that_is_there_twice_is_refused(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("model: Pinhole\nwidth: 8\nheight: 4\nfx: 140\nfy: 1\ncx: 1\ncy: 1\nfx: 70\n")
    with pytest.raises(ValueError, match=r"camera.yaml .* fx is there twice"):
        load_cameras(path)
