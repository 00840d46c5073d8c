# SPDX-License-Identifier: MIT
"""Shapes, distances, clearance and proven motions."""
