# SPDX-License-Identifier: BSD-3-Clause
"""The scripts of the documentation are no package: they are found in their folders."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("docs/site", "docs/images", "tests/report")]
