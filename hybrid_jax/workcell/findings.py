# SPDX-License-Identifier: MIT
"""Sentences about a model: what makes planning impossible, and what is doubtful."""

from collections.abc import Callable
from dataclasses import dataclass

from hybrid_jax.errors import HybridJaxError

WRONG, DOUBTFUL = "wrong", "doubtful"


@dataclass(frozen=True)
class Finding:
    """One sentence about a model."""

    level: str
    """`wrong`: nothing can be planned; `doubtful`: it can, but perhaps not what you want."""
    text: str
    mended: bool = False
    """Is it something that `hybrid_jax.adopt` adds to the model?"""


def tried(found: list[Finding], action: Callable):
    """What an action returns; where it raises, None, and its error is added to `found`."""
    try:
        return action()
    except HybridJaxError as error:
        found.append(Finding(WRONG, str(error)))
    except ValueError:  # MuJoCo's own error: `read_model` has reported it
        pass
    return None
