# SPDX-License-Identifier: MIT
"""Structures of pytrees as JSON: which classes hold the arrays of a program's result.

Only tuples, lists, dictionaries and records of this package are described, so that reading a
description makes nothing else.
"""

import dataclasses
import importlib
import json
from typing import Any

import jax

_PACKAGE = __name__.partition(".")[0]


def describe(structure: Any) -> str:
    """Describe a structure, as `jax.tree.structure` makes it; `structure_of` reads it.

    Raises:
        TypeError: it holds a class that is none of this package's.
    """
    return json.dumps(_described(jax.tree.unflatten(structure, range(structure.num_leaves))))


def structure_of(description: str) -> Any:
    """The structure that was described.

    Raises:
        ValueError: it is no description of a structure, or of classes that are not there.
    """
    try:
        return jax.tree.structure(_made(json.loads(description)))
    except (KeyError, TypeError, AttributeError, ImportError, IndexError) as error:
        raise ValueError(f"no structure: {error}") from None


def _described(tree: Any) -> Any:
    kind = type(tree)
    if tree is None or kind is int:  # nothing, or the place of an array
        return tree
    if kind in (tuple, list):
        return [kind.__name__, [_described(part) for part in tree]]
    if kind is dict:
        return ["dict", {name: _described(part) for name, part in tree.items()}]
    if kind.__module__.partition(".")[0] != _PACKAGE:
        raise TypeError(f"{kind} is none of {_PACKAGE}")
    name = f"{kind.__module__}:{kind.__qualname__}"
    if isinstance(tree, tuple):
        return [name, {field: _described(getattr(tree, field)) for field in tree._fields}, {}]
    fields = dataclasses.fields(tree)
    static = {f.name for f in fields if not f.metadata.get("pytree_node", True)}
    parts = {f.name: _described(getattr(tree, f.name)) for f in fields if f.name not in static}
    return [name, parts, {field: getattr(tree, field) for field in static}]


def _made(described: Any) -> Any:
    if described is None or isinstance(described, int):
        return described
    name, parts, *static = described
    if name == "dict":
        return {key: _made(part) for key, part in parts.items()}
    if name in ("tuple", "list"):
        made = [_made(part) for part in parts]
        return tuple(made) if name == "tuple" else made
    module, _, qualname = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ValueError(f"{name} is none of {_PACKAGE}")
    kind = getattr(importlib.import_module(module), qualname)
    fixed = {field: _as_tuples(value) for field, value in static[0].items()}
    return kind(**{field: _made(part) for field, part in parts.items()}, **fixed)


def _as_tuples(value: Any) -> Any:
    """JSON lists as the tuples that they were."""
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
