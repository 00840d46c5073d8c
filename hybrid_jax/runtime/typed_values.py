# SPDX-License-Identifier: MIT
"""Does a value of a JSON or TOML file have the type that a field is annotated with?"""

import math
import types
from typing import Any, Literal, Union, get_args, get_origin

LARGEST = 1e300
"""Largest number that is accepted: beyond it nothing can be computed."""


def as_tuples(value: Any) -> Any:
    """A value of a file with its lists, at any depth, as tuples."""
    return tuple(map(as_tuples, value)) if isinstance(value, list) else value


def choices(hint: Any) -> tuple:
    """Types of a union; a single type is its own only choice."""
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def fits(value: Any, hint: Any) -> bool:
    """Is a value, with tuples for lists, what a field is annotated with?

    A whole number is a number, too. Numbers must be finite. True and false are no numbers.

    Args:
        value: of a file, see `as_tuples`.
        hint: `float`, `int`, `str`, `bool`, `None`, tuples, literals and unions of these.
    """
    if len(choices(hint)) > 1:
        return any(fits(value, choice) for choice in choices(hint))
    inner = get_args(hint)
    if get_origin(hint) is Literal:
        return value in inner
    if get_origin(hint) is tuple:
        if not isinstance(value, tuple):
            return False
        if inner[-1] is Ellipsis:
            return all(fits(item, inner[0]) for item in value)
        return len(value) == len(inner) and all(map(fits, value, inner))
    if hint is float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        # a whole number may be too large for any float
        return is_number and abs(value) <= LARGEST and math.isfinite(value)
    # bool is a subclass of int: types are compared exactly
    return value is None if hint in (None, type(None)) else type(value) is hint


def in_words(hint: Any) -> str:
    """What a field must be, for a message."""
    words = {
        float: "a finite number",
        str: "text",
        int: "a whole number",
        bool: "true or false",
        type(None): "nothing",
    }
    if len(choices(hint)) > 1:
        return " or ".join(map(in_words, choices(hint)))
    inner = get_args(hint)
    if get_origin(hint) is Literal:
        return f"one of: {', '.join(map(repr, inner))}"
    if get_origin(hint) is not tuple:
        return words.get(hint, getattr(hint, "__name__", str(hint)))
    if inner[-1] is Ellipsis:
        return f"a list, each item {in_words(inner[0])}"
    return f"a list of {len(inner)}, each item {in_words(inner[0])}"
