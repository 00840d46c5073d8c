# SPDX-License-Identifier: MIT
"""Benchmarks: `python -m benchmarks.NAME --json FILE`."""
