# SPDX-License-Identifier: MIT
"""Demonstrations: recordings of a hand's motion, which are read, filtered, split and recorded."""
