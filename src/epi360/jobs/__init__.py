# SPDX-License-Identifier: BSD-3-Clause
"""Work on many images: match, map, and the poses of many pairs."""
