# SPDX-License-Identifier: MIT
"""What is done in a cell: scenes, key poses, and the kinds of tasks."""
