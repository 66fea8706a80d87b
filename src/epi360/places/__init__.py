# SPDX-License-Identifier: BSD-3-Clause
"""What two panoramas with a pose show of one place."""
