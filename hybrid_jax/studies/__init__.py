# SPDX-License-Identifier: MIT
"""Studies: methods compared on the same tasks of a cell, carried out in physics."""
