"""Tests of docs/schemas: the JSON Schemas for editors accept and reject what the readers accept and reject."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from docs.site import schemas
from seatrial.daq.errors import SeatrialError

ROOT = Path(__file__).resolve().parents[1]
TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
}
KEYWORDS = {
    *("$schema", "title", "description", "default", "type", "properties", "additionalProperties", "required", "enum"),
    *("items", "minItems", "maxItems", "minimum", "maximum", "exclusiveMinimum", "pattern", "anyOf", "oneOf"),
}
UNKNOWN = "unknown_key"


def is_type(value: object, name: str) -> bool:
    """Return whether a value has a type of JSON Schema. True and false are no numbers."""
    return isinstance(value, TYPES[name]) and (name == "boolean" or not isinstance(value, bool))


def is_valid(schema: dict[str, Any], value: Any) -> bool:
    """Return whether a value is valid by a schema of draft 4. Only the keywords of docs/schemas are allowed."""
    assert schema.keys() <= KEYWORDS
    if "type" in schema and not is_type(value, schema["type"]):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if "anyOf" in schema and not any(is_valid(s, value) for s in schema["anyOf"]):
        return False
    if "oneOf" in schema and sum(is_valid(s, value) for s in schema["oneOf"]) != 1:
        return False
    if isinstance(value, str):
        return re.search(schema.get("pattern", ""), value) is not None
    if isinstance(value, (int, float)):
        low, high = schema.get("minimum", value), schema.get("maximum", value)
        return bool(low <= value <= high and not (schema.get("exclusiveMinimum") and value == low))
    if isinstance(value, list):
        right_length = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value))
        return right_length and all(is_valid(schema.get("items", {}), item) for item in value)
    if isinstance(value, dict):
        known, others = schema.get("properties", {}), schema.get("additionalProperties", {})
        if not all(key in value for key in schema.get("required", ())):
            return False
        return all(
            is_valid(known[key], item) if key in known else isinstance(others, dict) and is_valid(others, item)
            for key, item in value.items()
        )
    return True


@cache
def published(kind: str) -> dict[str, Any]:
    """Return a schema from docs/schemas."""
    loaded: dict[str, Any] = json.loads((schemas.FOLDER / f"{kind}.schema.json").read_text(encoding="utf-8"))
    return loaded


def is_read(kind: str, content: dict[str, Any]) -> bool:
    """Return whether the reader accepts a file with this content."""
    try:
        schemas.FILES[kind][3](tomlkit.dumps(content))
    except SeatrialError:
        return False
    return True


def tables(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a table and all tables below it."""
    yield content
    for value in content.values():
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, dict):
                yield from tables(item)


def examples(kind: str) -> list[dict[str, Any]]:
    """Return the examples of a format, which together have every documented key."""
    return [tomllib.loads(text) for text in schemas.FILES[kind][2]()]


def changed(content: dict[str, Any], number: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a copy of a file, and in it the table with a number."""
    whole = copy.deepcopy(content)
    return whole, list(tables(whole))[number]


@pytest.mark.parametrize("kind", schemas.FILES)
def test_the_published_schemas_equal_the_schemas_of_the_readers(kind: str) -> None:
    text = (schemas.FOLDER / f"{kind}.schema.json").read_text(encoding="utf-8")
    assert text == schemas.dump(kind), "run `python docs/site/schemas.py`"


@pytest.mark.parametrize("kind", schemas.FILES)
def test_every_example_is_valid(kind: str) -> None:
    named = {"rig": "seatrial-rig", "mission": "seatrial-mission", "import": "seatrial-import"}[kind]
    files = [tomllib.loads(path.read_text(encoding="utf-8")) for path in (ROOT / "docs/examples").rglob("*.toml")]
    files = [content for content in files if str(content.get("format", "")).startswith(named)]
    assert files or kind == "mission"
    for content in (*files, *examples(kind)):
        assert is_read(kind, content)
        assert is_valid(published(kind), content)


@pytest.mark.parametrize("kind", schemas.FILES)
def test_an_unknown_key_is_refused_in_every_table(kind: str) -> None:
    for content in examples(kind):
        for number, table in enumerate(tables(content)):
            if table and all(is_type(value, "number") for value in table.values()) and "m_u" in table:
                continue  # [vehicle], with names of the user
            whole, inner = changed(content, number)
            inner[UNKNOWN] = "text"
            assert not is_read(kind, whole)
            assert not is_valid(published(kind), whole)


@pytest.mark.parametrize("kind", schemas.FILES)
def test_a_value_of_a_wrong_type_is_refused_for_every_key(kind: str) -> None:
    for content in examples(kind):
        for number, table in enumerate(tables(content)):
            for key, value in table.items():
                whole, inner = changed(content, number)
                inner[key] = 1.5 if isinstance(value, (dict, list, str)) else "text"
                if key == "node" and isinstance(value, int) and "message" in table:
                    inner[key] = 1.5  # a text would be the name of a signal
                assert not is_read(kind, whole), key
                assert not is_valid(published(kind), whole), key


@pytest.mark.parametrize("kind", schemas.FILES)
def test_the_reader_needs_every_key_that_the_schema_requires(kind: str) -> None:
    n_required = 0
    for content in examples(kind):
        for number, table in enumerate(tables(content)):
            for key in table:
                whole, inner = changed(content, number)
                del inner[key]
                if not is_valid(published(kind), whole):
                    n_required += 1
                    assert not is_read(kind, whole), key
    assert n_required > 5


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"vectornav"', '"vectornaw"'),
        ("speed = 20.0", "speed = 0.0"),
        ("n_max = 1.0", "n_max = 1.5"),
        ("[-0.55, -0.15, 0.0]", "[-0.55, -0.15]"),
        ('name = "gnss"', 'name = "G/1"'),
        ("baud = 38400", "baud = 38400\nbitrate = 500000"),  # a key of another protocol
        ("timeout_s = 0.3", "timeout_s = 30.0"),
    ],
)
def test_the_schema_rejects_a_rig_with_a_mistake(old: str, new: str) -> None:
    text = schemas.rigs()[0]
    assert old in text
    content = tomllib.loads(text.replace(old, new, 1))
    assert not is_read("rig", content)
    assert not is_valid(published("rig"), content)
