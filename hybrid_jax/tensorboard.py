# SPDX-License-Identifier: MIT
"""Metrics of a run as TensorBoard reads them."""

from collections.abc import Callable
from pathlib import Path

from hybrid_jax.errors import HybridJaxError


def board(folder: Path) -> Callable[[str, dict], None]:
    """What a run tells its metrics to: called with the stage and the metrics of one step.

    Args:
        folder: of the event files.

    Raises:
        HybridJaxError: the package that writes them is not installed.
    """
    try:
        from tensorboardX import SummaryWriter  # noqa: PLC0415
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
