# SPDX-License-Identifier: MIT
"""A run is a folder: its presets, stages, checkpoints, and the planner that is loaded from it."""
