# SPDX-License-Identifier: BSD-3-Clause
"""Posed panoramas to posed pinhole images."""
