"""Checks on single values of a scene file: each takes what the file holds and gives it back as plain JSON, or refuses it."""

import math
from collections.abc import Callable, Mapping
from typing import Any

Check = Callable[[Any], Any]
LARGEST = 1e30  # no length, force or stiffness in any unit comes near, and its fourth power is still a number
LARGEST_WHOLE = 2**63 - 1  # what a vertex number or a seed is kept in
LONGEST = 80  # characters of a value worth repeating in a sentence


class RefusedError(ValueError):
    """A value that a key cannot take; the message, if any, says which part of it."""


def one_of(*names: str) -> Check:
    """One of a few names."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise RefusedError
        return value

    return check


def text(value: Any) -> str:
    """Text that is not empty and holds no character that a path cannot."""
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise RefusedError
    return value


def truth(value: Any) -> bool:
    """`true` or `false`."""
    if not isinstance(value, bool):
        raise RefusedError
    return value


def number(value: Any) -> float:
    """A finite number; `true` is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RefusedError
    try:
        plain = float(value)
    except OverflowError:
        raise RefusedError from None
    if not math.isfinite(plain):
        raise RefusedError
    if abs(plain) > LARGEST:
        raise RefusedError(f"beyond {LARGEST:g}")
    return plain


def nonzero(value: Any) -> float:
    """A finite number other than 0."""
    plain = number(value)
    if plain == 0:
        raise RefusedError
    return plain


def above(low: float, high: float = math.inf) -> Check:
    """A number above `low` and at most `high`."""

    def check(value: Any) -> float:
        plain = number(value)
        if not low < plain <= high:
            raise RefusedError
        return plain

    return check


def at_least(low: float, high: float = math.inf) -> Check:
    """A number from `low` to `high`, both included."""

    def check(value: Any) -> float:
        plain = number(value)
        if not low <= plain <= high:
            raise RefusedError
        return plain

    return check


def whole(value: Any) -> int:
    """A whole number from 0 up that fits in 64 bits."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise RefusedError
    if value > LARGEST_WHOLE:
        raise RefusedError(f"beyond {LARGEST_WHOLE:,}")
    return value


def list_of(check: Check, least: int = 0, most: int | None = None) -> Check:
    """A list whose entries each pass `check`, of `least` to `most` entries."""

    def check_list(value: Any) -> list[Any]:
        if not isinstance(value, list | tuple) or len(value) < least or (most is not None and len(value) > most):
            raise RefusedError
        plain = []
        for index, entry in enumerate(value):
            try:
                plain.append(check(entry))
            except RefusedError as refusal:
                raise RefusedError(_inside(f"entry {index}", entry, refusal)) from None
        return plain

    return check_list


def box(value: Any) -> list[list[float]]:
    """Lower left and upper right corner, [[x0, y0], [x1, y1]]."""
    low, high = plain = list_of(list_of(number, 2, 2), 2, 2)(value)
    if low[0] > high[0] or low[1] > high[1]:
        raise RefusedError("its second corner lies left of the first or below it: swap them")
    return plain


def table_of(required: Mapping[str, Check], optional: Mapping[str, tuple[Check, Any]] | None = None) -> Check:
    """A table with exactly these keys; optional ones come with their default."""
    optional = optional or {}

    def check(value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise RefusedError
        for name in value:
            if name not in required and name not in optional:
                raise RefusedError(f"{escaped(str(name))} is unknown in it")
        plain = {}
        for name, test in [*required.items(), *((name, test) for name, (test, _) in optional.items())]:
            if name not in value:
                if name in required:
                    raise RefusedError(f"{name} is missing in it")
                plain[name] = optional[name][1]
                continue
            try:
                plain[name] = test(value[name])
            except RefusedError as refusal:
                raise RefusedError(_inside(name, value[name], refusal)) from None
        return plain

    return check


def _inside(name: str, value: Any, refusal: RefusedError) -> str:
    """What is wrong with a part of a value: what is wrong within it, where that is known."""
    return f"{name}: {refusal}" if str(refusal) else f"{name} is {shown(value)}"


def either(*checks: Check) -> Check:
    """Whatever the first of `checks` that takes it makes of a value; the fullest refusal where none does."""

    def check(value: Any) -> Any:
        refusals = []
        for test in checks:
            try:
                return test(value)
            except RefusedError as refusal:
                refusals.append(str(refusal))
        raise RefusedError(max(refusals, key=len))

    return check


def escaped(text: str, most: int = LONGEST) -> str:
    """`text` on one line, without what a terminal would take for a command, cut where it is long."""
    plain = text[: most + 1].encode("unicode_escape").decode()
    return plain if len(plain) <= most else plain[: most - 3] + "..."


def shown(value: Any) -> str:
    """`value` the way a scene file would write it, cut where it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        plain = '"' + value[: LONGEST + 1].encode("unicode_escape").decode() + '"'
    elif isinstance(value, Mapping):
        plain = "{ " + ", ".join(f"{escaped(str(key))} = {shown(entry)}" for key, entry in value.items()) + " }"
    elif isinstance(value, list | tuple):
        plain = "[" + ", ".join(shown(entry) for entry in value[:LONGEST]) + "]"
    else:
        plain = str(value) if not isinstance(value, int) or value.bit_length() < LONGEST else "a whole number of over 20 digits"
    return plain if len(plain) <= LONGEST else plain[: LONGEST - 3] + "..."
