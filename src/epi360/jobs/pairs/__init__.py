# SPDX-License-Identifier: BSD-3-Clause
"""Which images are matched with which: by name, by position, by what they show."""
