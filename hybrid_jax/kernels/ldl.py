# SPDX-License-Identifier: MIT
"""Small symmetric positive definite matrices by components, for whole batches.

Library routines treat one matrix after the other; by components every step is one long loop over
the batch. A matrix is its lower triangle: `matrix[i][j]` with j <= i, each an array `[...]` of the
batch's shape. Pivots are divided by without a test: callers add to the diagonal first.
"""

import jax.numpy as jnp


def gram(rows) -> list:
    """Lower triangle of `A A^T`, entries `[...]`, from the rows of A, each `[n, ...]`."""
    return [[jnp.sum(rows[i] * rows[j], axis=0) for j in range(i + 1)] for i in range(len(rows))]


def factor(matrix: list) -> tuple[list, list]:
    """Factor a matrix into `L D L^T` with a unit diagonal of L.

    Args:
        matrix: lower triangle, entries `[...]`.

    Returns:
        The strictly lower part of L and the pivots of D, entries `[...]`.
    """
    lower, pivots = [[] for _ in matrix], []
    for i, row in enumerate(matrix):
        for j in range(i):
            eliminated = sum(lower[i][k] * lower[j][k] * pivots[k] for k in range(j))
            lower[i].append((row[j] - eliminated) / pivots[j])
        pivots.append(row[i] - sum(lower[i][k] ** 2 * pivots[k] for k in range(i)))
    return lower, pivots


def solve(matrix: list, right) -> list:
    """Solve `matrix x = right`.

    Args:
        matrix: lower triangle, entries `[...]`.
        right: right-hand side by components, each `[...]`.

    Returns:
        Components of x, each `[...]`.
    """
    lower, pivots = factor(matrix)
    components, size = [], len(matrix)
    for i in range(size):
        components.append(right[i] - sum(lower[i][k] * components[k] for k in range(i)))
    # D and L^T in one pass: entries below i are final already
    for i in reversed(range(size)):
        eliminated = sum(lower[k][i] * components[k] for k in range(i + 1, size))
        components[i] = components[i] / pivots[i] - eliminated
    return components
