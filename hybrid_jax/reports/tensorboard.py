# SPDX-License-Identifier: MIT
"""Metrics of a run as TensorBoard's event files."""

from collections.abc import Callable
from pathlib import Path

from hybrid_jax.errors import HybridJaxError


def board(folder: Path) -> Callable[[str, dict], None]:
    """Open event files for the metrics of a run.

    Args:
        folder: of the event files.

    Returns:
        A `Run.listener`: called with the stage and the metrics of one step.

    Raises:
        HybridJaxError: the package that writes them is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise HybridJaxError(
            "--tensorboard needs the package tensorboardX: pip install 'hybrid_jax[tensorboard]'"
        ) from None
    writer = SummaryWriter(str(folder), flush_secs=2)

    def listen(stage: str, values: dict) -> None:
        numbers = {k: v for k, v in values.items() if isinstance(v, int | float) and k != "step"}
        for name, value in numbers.items():
            writer.add_scalar(f"{stage}/{name}", value, values["step"])
        writer.flush()

    return listen
