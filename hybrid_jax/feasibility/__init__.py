# SPDX-License-Identifier: MIT
"""The SE(3) feasibility map of a work cell (paper, section "Integrated Feasibility Map").

A grid of positions times a set of tool orientations. Each pose is feasible, with a feasible
configuration found, or not, with the reason. `grid` says which poses, `evaluation` judges attempts
at them, `flooding` spreads solutions over the grid, `building` does it block by block and can be
interrupted, `lookup` answers questions.
"""
