"""ROS messages as rosbags defines them, with the defaults that rclpy's have; and the same as types of DDS."""

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
_PLAIN = {
    "string": str,
    "bool": bool,
    "float64": float,
    "float32": float,
    "byte": lambda: b"\0",
    "octet": lambda: b"\0",
}


@cache
def message_class(name: str) -> type:
    """The class of "geometry_msgs/msg/Pose": made without arguments or by name, as in rclpy."""
    fields = STORE.fielddefs[name][1]

    def init(self: Any, **values: Any) -> None:
        for field, (kind, of) in fields:
            setattr(self, field, values[field] if field in values else _default(kind, of))

    return type(name.rpartition("/")[2], (), {"__init__": init, "kind": name})


def _default(kind: Nodetype, of: Any) -> Any:
    if kind is Nodetype.BASE:
        return _PLAIN.get(of[0], int)()
    if kind is Nodetype.NAME:
        return message_class(of)()
    return [] if kind is Nodetype.SEQUENCE else [_default(*of[0]) for _ in range(of[1])]


@cache
def dds_class(name: str) -> Any:
    """The type of DDS that ROS 2 has for a message."""
    from cyclonedds.idl import make_idl_struct

    package, _, last = name.split("/")
    fields = {field: _dds_type(kind, of) for field, (kind, of) in STORE.fielddefs[name][1]}
    return make_idl_struct(f"{last}_", f"{package}::msg::dds_::{last}_", fields)


def _dds_type(kind: Nodetype, of: Any) -> Any:
    from cyclonedds.idl import types

    if kind is Nodetype.BASE:
        plain = {"string": str, "bool": bool, "byte": types.uint8, "octet": types.uint8}
        return plain.get(of[0]) or getattr(types, of[0])
    if kind is Nodetype.NAME:
        return dds_class(of)
    return types.sequence[_dds_type(*of[0])] if kind is Nodetype.SEQUENCE else types.array[_dds_type(*of[0]), of[1]]


def converted(message: Any, name: str, made: Any) -> Any:
    """A message with ``made`` of each class's name and its fields: of DDS, of rosbags, or of :func:`message_class`."""
    values = {
        field: _converted(getattr(message, field), kind, of, made) for field, (kind, of) in STORE.fielddefs[name][1]
    }
    return made(name, values)


def _converted(value: Any, kind: Nodetype, of: Any, made: Any) -> Any:
    if kind is Nodetype.NAME:
        return converted(value, of, made)
    if kind is Nodetype.BASE:
        return value[0] if isinstance(value, bytes) else value
    if of[0][0] is Nodetype.NAME:
        return [converted(one, of[0][1], made) for one in value]
    return list(value)


def to_dds(message: Any) -> Any:
    return converted(message, message.kind, lambda name, values: dds_class(name)(**values))


def from_dds(sample: Any, name: str) -> Any:
    def made(name: str, values: dict[str, Any]) -> Any:
        message = message_class(name)()
        vars(message).update(values)
        return message

    return converted(sample, name, made)
