# SPDX-License-Identifier: MIT
"""Ask a server for a plan. Nothing of JAX is imported: that alone would take two seconds."""

import json
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

from hybrid_jax.errors import HybridJaxError, InputError, TaskError
from hybrid_jax.runtime.input_files import read_text

TIMEOUT = 600.0
"""Longest time to wait for an answer [s]: a server may still compile."""


class ServerError(HybridJaxError):
    """No server answers there, or it refuses."""


def ask_for_plan(server: str, task: Path, file: str, seed: int) -> dict:
    """Let a server plan a task.

    Args:
        server: its address, such as http://127.0.0.1:8321.
        task: file of the task.
        file: name of the file to be written; its ending selects the format.
        seed: of IK and rollouts.

    Returns:
        The plan without its points, and `text`, the content of the file; None where there is none.

    Raises:
        TaskError: the file is no JSON object.
        InputError: it is no address of a server.
        ServerError: no server answers, or it refuses; the sentence says why.
    """
    if urllib.parse.urlsplit(server).scheme not in ("http", "https"):
        raise InputError(f"--server must be like http://127.0.0.1:8321, got {server!r}")
    try:
        values = json.loads(read_text(task, TaskError))
    except (ValueError, RecursionError) as error:
        raise TaskError(f"{task}: {error}") from None
    if not isinstance(values, dict):
        raise TaskError(f"{task}: must hold an object of JSON")
    address = f"{server.rstrip('/')}/plan?{urllib.parse.urlencode({'file': file})}"
    content = json.dumps(values | {"seed": seed}).encode()
    request = urllib.request.Request(address, content, {"Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as reply:
            return json.load(reply)
    except urllib.error.HTTPError as error:
        raise ServerError(_sentence(server, error)) from None
    except (OSError, ValueError) as error:  # refused, cut off, or no JSON
        reason = getattr(error, "reason", None) or error
        raise ServerError(
            f"no server answers at {server} ({reason}); "
            "start one with: python -m hybrid_jax.serve --run DIR"
        ) from None


def _sentence(server: str, error: urllib.error.HTTPError) -> str:
    """What a server's refusal says."""
    try:
        values = json.load(error)
        return f"{server} refuses: {values['error']}: {values['detail']}"
    except (ValueError, KeyError, TypeError, OSError):
        return f"{server} answers with {error.code} {error.reason}: it is no server of hybrid_jax"
