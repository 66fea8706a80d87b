# SPDX-License-Identifier: BSD-3-Clause
"""Text of a calibration file to plain Python values, whatever the format."""

import json
import re
from pathlib import Path
from typing import Any

from epi360.runs.input_files import read_text

COLMAP_LINE = re.compile(r"\d+\s+[A-Z][A-Z0-9_]*\s+\d+\s+\d+(\s|$)")

LARGEST_FILE = 2**25  # bytes, enough for a cameras.txt with a camera for each of 300,000 images
_OPENCV_START, _OPENCV_MATRIX = "%YAML:", "tag:yaml.org,2002:opencv-matrix"
LONGEST_YAML = 2**18  # characters, which take half a second; a rig needs a thousandth of it


def read_document(path: Path) -> Any:
    """Return the lines of a COLMAP file, or the content of a YAML or JSON file."""
    try:
        text = read_text(path, largest=LARGEST_FILE)
    except FileNotFoundError:
        raise FileNotFoundError(f"calibration file {path} does not exist") from None
    except UnicodeDecodeError:  # for example a picture
        raise ValueError(f"calibration file {path} must be text, got binary data") from None
    except OSError:
        raise ValueError(f"calibration file {path} is a folder or may not be read") from None
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if lines and COLMAP_LINE.match(lines[0]):
        return lines
    try:
        return _json(text) if text.lstrip().startswith(("{", "[")) else _yaml(text)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"calibration file {path} must be YAML or JSON: {reason}") from None


def _json(text: str) -> Any:
    """Content of a JSON file, or of a YAML file that begins like one."""
    try:
        return json.loads(text)
    except ValueError:
        try:
            return _yaml(text)
        except ValueError:
            pass
        raise


def _yaml(text: str) -> Any:
    import yaml  # 20 ms that `import epi360` need not pay

    if len(text) > LONGEST_YAML:
        raise ValueError(f"YAML may have {LONGEST_YAML} characters, got {len(text)}")

    class Loader(yaml.SafeLoader):
        """Takes OpenCV's matrices as the mappings that they are, and no key twice."""

        def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
            node = super().compose_mapping_node(anchor)  # as written: what it merges comes later
            known: set[tuple[str, str]] = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode):
                    if (key.tag, key.value) in known:
                        raise ValueError(f"{key.value} is there twice")
                    known.add((key.tag, key.value))
            return node

    yaml.add_constructor(_OPENCV_MATRIX, yaml.SafeLoader.construct_yaml_map, Loader=Loader)
    if text.startswith(_OPENCV_START):  # no directive of YAML, but OpenCV begins like that
        text = text[text.index("\n") + 1 :] if "\n" in text else ""
    try:
        return yaml.load(text, Loader)  # noqa: S506 - a SafeLoader
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None
    except (AttributeError, IndexError, KeyError, TypeError):  # !!int "", !!bool maybe
        raise ValueError("a value is not of the type that its tag says") from None
