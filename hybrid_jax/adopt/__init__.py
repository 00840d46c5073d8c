# SPDX-License-Identifier: MIT
"""A vendor's robot file made into a cell folder that every command takes."""
