# SPDX-License-Identifier: BSD-3-Clause
"""What every run that can be stopped needs: whole files, locks, and records of the options."""
