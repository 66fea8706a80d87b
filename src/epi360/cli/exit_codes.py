# SPDX-License-Identifier: BSD-3-Clause
"""Exit codes of the command; apart from the rest, which an interrupt may stop while it loads."""

SUCCESS, FAILURE, WRONG_USE, INTERRUPTED = 0, 1, 2, 130
