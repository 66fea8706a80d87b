# SPDX-License-Identifier: BSD-3-Clause
"""Text of a calibration file to plain Python values, whatever the format."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

COLMAP_LINE = re.compile(r"\d+\s+[A-Z][A-Z0-9_]*\s+\d+\s+\d+(\s|$)")


def read_document(path: Path) -> Any:
    """Content of a file: the lines of a COLMAP file, else what YAML or JSON make of it."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"calibration file {path} does not exist") from None
    except UnicodeDecodeError:
        raise ValueError(f"calibration file {path} must be text, got binary data") from None
    except OSError:
        raise ValueError(f"calibration file {path} is a folder or may not be read") from None
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if lines and COLMAP_LINE.match(lines[0]):
        return lines
    try:
        return json.loads(text) if text.lstrip().startswith(("{", "[")) else _yaml(text)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"calibration file {path} must be YAML or JSON: {reason}") from None


def _yaml(text: str) -> Any:
    import yaml  # 20 ms that `import epi360` need not pay

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None
