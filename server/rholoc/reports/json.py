"""Reports to JSON and back."""

import math
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import TypeAdapter, ValidationError

Report = TypeVar("Report")


def report_to_json(value: Any) -> Any:
    """A report, or a part of one, as what ``json.dumps`` takes.

    Members that are None are left out, unless they have no default: those are null. NumPy's numbers become Python's,
    numbers that are not finite become null.
    """
    match value:
        case _ if is_dataclass(value) and not isinstance(value, type):
            members = {field: getattr(value, field.name) for field in fields(value)}
            return {
                field.name: report_to_json(member)
                for field, member in members.items()
                if member is not None or (field.default is MISSING and field.default_factory is MISSING)
            }
        case dict():
            return {str(key): report_to_json(member) for key, member in value.items()}
        case list() | tuple():
            return [report_to_json(member) for member in value]
        case np.ndarray() | np.generic():
            return report_to_json(value.tolist())
        case float() if not math.isfinite(value):
            return None
        case _:
            return value


def report_from_json(kind: type[Report], value: Any) -> Report:
    """The report from which :func:`report_to_json` made this JSON; unknown members are ignored.

    Types are converted where pydantic does so, such as "5" to 5. Null, as written for NaN, is no number.

    Raises:
        ValueError: a member is missing or cannot be converted; names it.
    """
    try:
        report: Report = _adapter(cast("Any", kind)).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{'.'.join(map(str, first['loc'])) or kind.__name__}: {first['msg']}") from error
    return report


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Validator of a report's type, made once."""
    return TypeAdapter(kind)
