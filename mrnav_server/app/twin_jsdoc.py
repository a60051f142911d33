"""The twin's messages as JSDoc types for the pages, made from their JSON Schema."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mrnav_server.app.twin_schema import twin_schema

FILE = Path("static/js/twin-types.js")
"""Where the pages look for the types, from a checkout's root."""
_HEAD = """\
/**
 * Messages of /ws/twin. Made from their JSON Schema by `make types`: change mrnav_server/app/twin_schema.py.
 * @module
 */
"""
_PLAIN = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean", "null": "null"}


def twin_types() -> str:
    """Return the JavaScript module with one typedef a message or part of one."""
    types = [_typedef(name, schema) for name, schema in sorted(twin_schema()["$defs"].items())]
    return "\n".join([_HEAD, *types, "export {};\n"])


def _typedef(name: str, schema: Mapping[str, Any]) -> str:
    about = _text(schema)
    if "properties" not in schema:
        lines = [f" * {about}"] if about else []
        return "\n".join(["/**", *lines, f" * @typedef {{{_type(schema)}}} {name}", " */", ""])
    lines = ["/**", *([f" * {about}"] if about else []), f" * @typedef {{object}} {name}"]
    for field, part in schema["properties"].items():
        shown = field if field in schema.get("required", ()) else f"[{field}]"
        lines.append(f" * @property {{{_type(part)}}} {shown} {_text(part)}".rstrip())
    return "\n".join([*lines, " */", ""])


def _type(schema: Mapping[str, Any]) -> str:
    """Return a schema as TypeScript writes types."""
    match schema:
        case {"$ref": ref}:
            return str(ref).rsplit("/", 1)[-1]
        case {"const": value}:
            return json.dumps(value)
        case {"enum": values}:
            return " | ".join(json.dumps(value) for value in values)
        case {"anyOf": choices} | {"oneOf": choices}:
            return " | ".join(_type(choice) for choice in choices)
        case {"prefixItems": items}:
            return f"[{', '.join(_type(item) for item in items)}]"
        case {"type": "array", "items": item}:
            inner = _type(item)
            return f"({inner})[]" if "|" in inner else f"{inner}[]"
        case {"type": "object", "additionalProperties": dict(value)}:
            return f"Record<string, {_type(value)}>"
        case {"type": "object"}:
            return "Record<string, unknown>"
        case {"type": kind} if kind in _PLAIN:
            return _PLAIN[kind]
    raise ValueError(f"this schema has no JSDoc type yet: {schema}")


def _text(schema: Mapping[str, Any]) -> str:
    return " ".join(str(schema.get("description", "")).split())
