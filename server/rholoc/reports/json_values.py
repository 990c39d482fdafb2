"""Check clients' JSON before it is stored: only values that every JSON reader and writer can handle."""

import math

MAX_DEPTH = 16
MAX_VALUES = 100_000
_MAX_INTEGER = 2**53  # larger ones are not exact in JavaScript, and beyond 2**1024 overflow a float


def check_json_value(value: object, max_values: int = MAX_VALUES) -> None:
    """Check a value made of dicts, lists, text, numbers, true, false and null.

    Raises:
        ValueError: it is nested more than 16 deep, holds more than ``max_values`` values, a number that is not finite
            or an integer beyond 2⁵³, text with an unpaired surrogate, or a type that JSON lacks; one line says which.
    """
    waiting: list[tuple[object, int]] = [(value, 0)]
    seen = 0
    while waiting:
        one, depth = waiting.pop()
        seen += 1
        if depth > MAX_DEPTH:
            raise ValueError(f"nested more than {MAX_DEPTH} deep")
        if seen > max_values:
            raise ValueError(f"more than {max_values} values")
        if isinstance(one, dict):
            waiting.extend((part, depth + 1) for pair in one.items() for part in pair)
        elif isinstance(one, list | tuple):
            waiting.extend((part, depth + 1) for part in one)
        else:
            _check_scalar(one)


def _check_scalar(value: object) -> None:
    """Raise ValueError for what JSON readers disagree on: surrogates, large integers, numbers that are not finite."""
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            raise ValueError("text with an unpaired surrogate") from None
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError("a number that is not finite")
    elif isinstance(value, int):
        if abs(value) > _MAX_INTEGER:
            raise ValueError("an integer beyond 2⁵³")
    elif value is not None:
        raise ValueError(f"a {type(value).__name__}")
