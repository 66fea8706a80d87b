# SPDX-License-Identifier: BSD-3-Clause
"""``python -m epi360``: the command where its script is not on the path."""

import sys

from epi360.cli import main

if __name__ == "__main__":
    sys.exit(main())
