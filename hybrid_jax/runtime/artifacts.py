# SPDX-License-Identifier: MIT
"""One file format for maps, skills, policies and checkpoints: `.npz` arrays and a JSON header.

Nothing in a file is executed when it is read. The header names the kind of its content and the
work cell that it belongs to.
"""

import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import serialization, traverse_util

from hybrid_jax.errors import RunFolderError
from hybrid_jax.runtime.input_files import read_arrays
from hybrid_jax.runtime.output_files import named_error

FORMAT = 1
_HEADER = "__header__"


def save(path: Path, kind: str, digest: str, tree: Any, **header) -> None:
    """Write a pytree of arrays; an existing file is replaced only once the new one is complete.

    Args:
        path: file to write, ending in `.npz`.
        kind: of the content, checked on loading.
        digest: hash of the work cell that it belongs to.
        tree: any pytree that flax can serialise.
        header: further JSON values.
    """
    state = serialization.to_state_dict(jax.device_get(tree))
    flat = traverse_util.flatten_dict(state, keep_empty_nodes=True, sep="/")
    # an optimiser's state has branches without arrays, which loading must find again
    empty = [k for k, v in flat.items() if v is traverse_util.empty_node]
    none_keys = [k for k, v in flat.items() if v is None]
    flat = {k: np.asarray(v) for k, v in flat.items() if k not in empty and v is not None}
    head = {
        "format": FORMAT,
        "kind": kind,
        "workcell": digest,
        "empty": empty,
        "nothing": none_keys,
        **header,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial.npz")
    try:
        np.savez_compressed(partial, **{_HEADER: np.array(json.dumps(head))}, **flat)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)  # on a full disk it takes the space of other files
        raise named_error(error, path) from None


def load(path: Path, kind: str, digest: str | None) -> tuple[dict, dict]:
    """Read a file written by `save`.

    Args:
        path: of the file.
        kind: that it must be of.
        digest: hash of the work cell that it must belong to; any if None.

    Returns:
        Its header, and a nested dictionary of arrays.

    Raises:
        RunFolderError: missing, damaged, of another kind, or of another work cell.
    """
    if not path.is_file():
        raise RunFolderError(f"{path} is missing")
    try:
        header, flat = _parts(path)
    except RunFolderError:
        raise
    except Exception as error:
        raise RunFolderError(f"{path} is damaged or not one of our files: {error}") from None
    if header.get("format") != FORMAT or header.get("kind") != kind:
        raise RunFolderError(
            f"{path} holds {header.get('kind')!r} of format {header.get('format')}, "
            f"not {kind!r} of format {FORMAT}"
        )
    if digest is not None and header["workcell"] != digest:
        raise RunFolderError(
            f"{path} belongs to another work cell ({header['workcell'][:12]}, not {digest[:12]})"
        )
    return header, flat


def _parts(path: Path) -> tuple[dict, dict]:
    """Header and nested arrays of a file; a damaged one raises errors of many classes."""
    flat = read_arrays(path, RunFolderError)
    header = json.loads(str(flat.pop(_HEADER)))
    if not isinstance(header.get("workcell"), str):
        raise ValueError("its header names no work cell")
    flat |= dict.fromkeys(header.get("empty", ()), traverse_util.empty_node)
    flat |= dict.fromkeys(header.get("nothing", ()))
    return header, traverse_util.unflatten_dict(flat, sep="/")


def restore(template: Any, state: dict, what: str, *, batched: bool = False) -> Any:
    """Put loaded arrays into the structure of `template`.

    Args:
        template: a pytree of arrays with the structure and shapes of the saved one.
        state: from `load`.
        what: the file, for the message.
        batched: were the arrays saved with further axes in front?

    Returns:
        A pytree like `template`, with the loaded arrays.

    Raises:
        RunFolderError: an array is missing, unknown, of another shape, or holds no numbers.
    """
    try:
        restored = serialization.from_state_dict(template, state)
        pairs = zip(jax.tree.leaves(template), jax.tree.leaves(restored), strict=True)
        shapes = [(np.shape(a), np.shape(b)) for a, b in pairs]
        if not all(np.asarray(a).dtype.kind in "biuf" for a in jax.tree.leaves(restored)):
            raise ValueError("they are no real numbers")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RunFolderError(f"{what} holds other arrays than it should: {error}") from None
    for expected, shape in shapes:
        if expected != (shape[len(shape) - len(expected) :] if batched else shape):
            raise RunFolderError(f"{what} holds an array of shape {shape} where {expected} is due")
    return restored
