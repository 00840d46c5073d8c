# SPDX-License-Identifier: MIT
"""Small symmetric positive definite matrices by components, for whole batches.

Library routines treat one matrix after the other; by components every step is one long loop. A
matrix is its lower triangle: `matrix[i][j]` with j <= i, each an array of the batch's shape.
"""

import jax.numpy as jnp


def gram(rows) -> list:
    """`A A^T` of a matrix given by its rows, each `[n, ...]`; the sum runs over n."""
    return [[jnp.sum(rows[i] * rows[j], axis=0) for j in range(i + 1)] for i in range(len(rows))]


def factor(matrix: list) -> tuple[list, list]:
    """`L D L^T`: the strictly lower part of L, and the pivots D."""
    lower, pivots = [[] for _ in matrix], []
    for i, row in enumerate(matrix):
        for j in range(i):
            known = sum(lower[i][k] * lower[j][k] * pivots[k] for k in range(j))
            lower[i].append((row[j] - known) / pivots[j])
        pivots.append(row[i] - sum(lower[i][k] ** 2 * pivots[k] for k in range(i)))
    return lower, pivots


def solve(matrix: list, right) -> list:
    """Solution of `matrix x = right`, by components."""
    lower, pivots = factor(matrix)
    found, size = [], len(matrix)
    for i in range(size):
        found.append(right[i] - sum(lower[i][k] * found[k] for k in range(i)))
    for i in reversed(range(size)):
        known = sum(lower[k][i] * found[k] for k in range(i + 1, size))
        found[i] = found[i] / pivots[i] - known
    return found
