# SPDX-License-Identifier: MIT
"""A browser page of a run: cell, map, skills, tasks to build and plan, learning curves."""
