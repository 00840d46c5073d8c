# SPDX-License-Identifier: MIT
"""Settings as plain values and back, as `config.json` keeps them.

Where a field may hold records of several classes, `kind` names the class.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hybrid_jax.errors import InputError, shortened
from hybrid_jax.runtime.typed_values import as_tuples, choices, fits, in_words

T = TypeVar("T")
KIND = "kind"
"""Field that names the class of a record where several may stand."""


def as_values(settings) -> dict:
    """A frozen dataclass of settings as dictionaries, lists, numbers and texts."""
    values = {}
    for name, hint in get_type_hints(type(settings)).items():
        value = getattr(settings, name)
        if is_dataclass(value):
            named = {KIND: type(value).__name__} if len(_records(hint)) > 1 else {}
            values[name] = named | as_values(value)
        else:
            values[name] = list(value) if isinstance(value, tuple) else value
    return values


def from_values(kind: type[T], values: Any, label: str) -> T:
    """Settings from plain values; the inverse of `as_values`.

    Args:
        kind: frozen dataclass.
        values: of all its fields.
        label: name of the settings in messages.

    Returns:
        An instance of `kind`.

    Raises:
        InputError: a field is missing, unknown, of another type, or refused by the settings
            themselves; the message names it.
    """
    if not isinstance(values, dict):
        raise InputError(f"{label} must be a table of settings, got {shortened(repr(values))}")
    hints = get_type_hints(kind)
    for name in sorted(set(values) ^ set(hints)):
        fault = "is missing" if name in hints else f"is unknown; there are: {', '.join(hints)}"
        raise InputError(f"{label}.{name} {fault}")
    fields_by_name = {n: _field(hints[n], values[n], f"{label}.{n}") for n in hints}
    try:
        return kind(**fields_by_name)
    except (ValueError, ArithmeticError) as error:
        raise InputError(f"{label}: {error}") from None


def differences(ours, others, label: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Fields in which two settings of one class differ: dotted name, first and second value."""
    for field in fields(ours):
        name, a, b = f"{label}{field.name}", getattr(ours, field.name), getattr(others, field.name)
        if is_dataclass(a) and type(a) is type(b):
            yield from differences(a, b, f"{name}.")
        elif a != b:
            yield name, a, b


def merged(values: dict, changes: Any, label: str) -> dict:
    """Values with some of them changed: `{"joint": {"rollouts": [8]}}` changes one.

    A record whose `kind` changes is replaced as a whole.

    Args:
        values: from `as_values`.
        changes: some of the same keys.
        label: name of the changes in messages.

    Raises:
        InputError: a key of the changes is unknown.
    """
    if not isinstance(changes, dict):
        raise InputError(f"{label} must be a table of settings, got {shortened(repr(changes))}")
    result = dict(values)
    for name, change in changes.items():
        if name not in values:
            raise InputError(f"{label}.{name} is unknown; there are: {', '.join(values)}")
        if _same_record(values[name], change):
            change = merged(values[name], change, f"{label}.{name}")
        result[name] = change
    return result


def _same_record(values, change) -> bool:
    if not isinstance(values, dict) or not isinstance(change, dict):
        return False
    return change.get(KIND, values.get(KIND)) == values.get(KIND)


def _records(hint) -> list[type]:
    """Dataclasses among the types that a field may hold."""
    return [choice for choice in choices(hint) if is_dataclass(choice)]


def _field(hint, value, label: str):
    """A value converted to the type of its field."""
    records = _records(hint)
    if records and isinstance(value, dict):
        return _record(records, value, label)
    value = as_tuples(value)
    plain_hints = [choice for choice in choices(hint) if choice not in records]
    if not any(fits(value, choice) for choice in plain_hints):
        raise InputError(f"{label} is {shortened(repr(value))}; it must be {in_words(hint)}")
    return _as_floats(value, hint)


def _as_floats(value, hint):
    """A value that fits, with floats where whole numbers stand for them."""
    hint = next((choice for choice in choices(hint) if fits(value, choice)), hint)
    if hint is float:
        return float(value)
    inner = get_args(hint)
    if get_origin(hint) is tuple:
        hints = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(map(_as_floats, value, hints))
    return value


def _record(records: list[type], value: dict, label: str):
    if len(records) == 1:
        return from_values(records[0], value, label)
    named = {record.__name__: record for record in records}
    if value.get(KIND) not in named:
        known = ", ".join(named)
        raise InputError(f"{label}.{KIND} is {value.get(KIND)!r}; it must be one of: {known}")
    inner_values = {name: inner for name, inner in value.items() if name != KIND}
    return from_values(named[value[KIND]], inner_values, label)
