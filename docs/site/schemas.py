"""Generator of the JSON Schemas in docs/schemas: ``python docs/site/schemas.py``.

The readers of rig.toml, mission.toml and import maps are the only definition of the keys. This program lets them read
the examples of docs/formats, and records each key that a reader requests, with its type, bounds and choices. The
comments of the examples become the descriptions. The result is a JSON Schema of draft 4, the draft that the TOML
language server Taplo supports.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
# Before the import of the project: the schemas must describe the tree of this file, not an installed package.
sys.path.insert(0, str(ROOT))

from seatrial.daq.config import TomlTable, parse_mission, parse_rig  # noqa: E402
from seatrial.daq.importers.import_map import load_import_map  # noqa: E402
from seatrial.daq.protocol import BUILT_IN, CAN  # noqa: E402
from seatrial.daq.rig import NAME, OTHER_RATES, RATES  # noqa: E402

FOLDER = ROOT / "docs/schemas"
DRAFT = "http://json-schema.org/draft-04/schema#"
Schema = dict[str, Any]
READERS = (  # methods of TomlTable that read a key, or check whether it is present
    *("has", "text", "line", "flag", "integer", "number", "ratio", "scalar", "maybe_number", "numbers", "texts"),
    *("table", "tables", "named_numbers"),
)
# Lists and tables that a reader refuses to be without, by path of their table, "" for the root.
REQUIRED = {"rig": [("", "device"), ("device[]", "signal")], "mission": [("", "segment"), ("", "end")], "import": []}
# Lists whose length the reader takes from another list of the file.
FREE_LENGTHS = ("segment[].n", "prediction.x", "prediction.y", "prediction.radius")
LARGEST = 1e18  # a default of this size stands for "no bound"
NAMES = ("device[].name", "thruster[].name", "signal[].name")  # keys whose value becomes a part of a topic
HEAD = 'format = "seatrial-rig 1"\nname = "r"\n'
# Keys of a map that exclude keys of the examples.
OTHER_MAP = """
format = "seatrial-import 1"
time = { rate_hz = 10.0 }
scale = { SCALE }
geometry = { y_left = -0.2, y_left_sd = 0.1, y_right = 0.2, y_right_sd = 0.1, length = 1.2, length_sd = 0.1 }
signal = [
    { name = "x", make = "north", topic = "fix", fields = ["lat", "lon"] },
    { name = "n_left", column = "n", unit = "1", role = "input", timeout = 0.1 },
]
"""

SCALES = (  # both forms of the thrust
    "c1 = 12.0, c1_sd = 0.6, c2 = 0.4, c2_sd = 0.1",
    "ahead = 12.4, ahead_sd = 0.6, astern = 11.6, astern_sd = 0.6",
)


def blocks(page: str) -> list[str]:
    """Return the examples in TOML of a page of docs/formats, in order."""
    text = (ROOT / "docs/formats" / page).read_text(encoding="utf-8")
    return re.findall(r"```toml\n(.*?)```", text, re.DOTALL)


def rigs() -> list[str]:
    """Return rig files that together have every key: those of the page, and one device of each other protocol."""
    whole, dbc, autopilot = blocks("rig.md")
    rates = "\n".join(f"{name} = 1.0" for name in (*RATES, *OTHER_RATES))
    autopilot = re.sub(r"(?<=\[device\.rates\]).*?(?=\[\[thruster)", f"\n{rates}\n", autopilot, flags=re.DOTALL)
    found = [whole, HEAD + dbc, HEAD + re.sub(r'node = "\w+"', "node = 1", dbc), HEAD + autopilot]
    for name, row in BUILT_IN.items():
        port = "socketcan:can0" if row.bus == CAN else "port"
        if name not in ("dbc", "mavlink"):
            found.append(f'{HEAD}[[device]]\nname = "d"\nprotocol = "{name}"\nport = "{port}"\nrate_hz = 1.0\n')
    return found


def maps() -> list[str]:
    """Return import maps that together have every key."""
    return [*blocks("import.md"), *(OTHER_MAP.replace("SCALE", scale) for scale in SCALES)]


def load_map_text(text: str) -> object:
    """Read the text of an import map."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, Path(folder).name)  # another name for each text, because it is a default
        path.write_text(text, encoding="utf-8")
        return load_import_map(path)


# Name of the schema -> title, page of its examples, texts that have every key, and reader.
FILES: dict[str, tuple[str, str, Callable[[], list[str]], Callable[[str], object]]] = {
    "rig": ("rig.toml", "rig.md", rigs, lambda text: parse_rig(text, "rig.toml")),
    "mission": ("mission.toml", "mission.md", lambda: blocks("mission.md"), lambda text: parse_mission(text, "-")),
    "import": ("map of an import", "import.md", maps, load_map_text),
}


class Table:
    """Keys that a reader has requested from one table.

    Attributes
    ----------
    path
        Full name of the table without numbers, such as `device[].calibration`; "" for the root.
    protocol
        Protocol of a [[device]]; empty for other tables.
    reads
        Name of the method and its arguments, by key. The key of an item of a list is `key[]`.
    optional
        Keys whose presence the reader has checked.
    numbers
        Whether the table is read as numbers with names that the user chooses.
    """

    def __init__(self, path: str, protocol: str) -> None:
        self.path, self.protocol = path, protocol
        self.reads: dict[str, tuple[str, dict[str, Any]]] = {}
        self.optional: set[str] = set()
        self.numbers = False


@contextlib.contextmanager
def recording() -> Iterator[list[Table]]:
    """Yield a list of tables, to which each table is added that a reader reads within the block."""
    found: dict[int, tuple[TomlTable, Table]] = {}  # the TomlTable is kept, so that no other one gets its id
    nested = False

    def record(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        signature = inspect.signature(original)

        def read(table: TomlTable, *args: Any, **kwargs: Any) -> Any:
            nonlocal nested
            if nested:  # a method that calls another one, as line calls text
                return original(table, *args, **kwargs)
            if id(table) not in found:
                path = re.sub(r"\[\d+\]", "[]", table.where)
                # Tables of a [[file]] of a map are those of a map without it.
                path = path.removeprefix("file[].")
                protocol = table.values.get("protocol", "") if path == "device[]" else ""
                found[id(table)] = table, Table(path, protocol)
            mine = found[id(table)][1]
            arguments = signature.bind(table, *args, **kwargs)
            arguments.apply_defaults()
            if name == "named_numbers":
                mine.numbers = True
            elif name == "has":
                mine.optional.add(arguments.arguments["key"])
            else:
                mine.reads[re.sub(r"\[\d+\]", "[]", arguments.arguments["key"])] = name, arguments.arguments
            nested = True
            try:
                return original(table, *args, **kwargs)
            finally:
                nested = False

        return read

    originals = {name: getattr(TomlTable, name) for name in READERS}
    tables: list[Table] = []
    try:
        for name, original in originals.items():
            setattr(TomlTable, name, record(name, original))
        yield tables
    finally:
        for name, original in originals.items():
            setattr(TomlTable, name, original)
        tables += [mine for _, mine in found.values()]


def comments(page: str) -> dict[str, str]:
    """Return the comments in the examples of a page, by full name of the key or table without brackets.

    The first occurrence of a key counts. A comment goes on in the next lines if they begin with blanks.
    """
    found: dict[str, str] = {}
    for text in blocks(page):
        where, current = "", ""  # table with a final dot; key whose comment may go on in the next line
        for line in text.splitlines():
            # The comment begins at the first "#" that is not in quotes.
            code = re.match(r"""(?:[^#"']|"[^"]*"|'[^']*')*""", line)
            assert code is not None
            before, comment = code[0].strip(), line[code.end() :].lstrip("# ").strip()
            key = ""
            if hidden := re.fullmatch(r"(\w+) = [^#]*(?:# (.*))?", comment) if not before else None:
                key, comment = f"{where}{hidden[1]}", hidden[2] or ""  # `# key = value`: an optional key
            elif header := re.match(r"\[+(?:file\.)?([\w.]+)\]+", before):
                where, key = f"{header[1]}.", header[1]
            elif named := re.match(r"(\w+) =", before):
                key = f"{where}{named[1]}"
            elif not before and line.startswith(" ") and current:
                found[current] = f"{found[current]} {comment}".strip()
                continue
            elif before:
                continue  # a further line of a value
            current = key if key not in found else ""
            if current:
                found[key] = comment
    return found


def value_schema(name: str, arguments: dict[str, Any]) -> Schema:
    """Return the schema of a value from the method that reads it, and its arguments."""
    low, high = arguments.get("low"), arguments.get("high")
    bounds: Schema = {} if low is None else {"minimum": low}
    bounds |= {} if high is None else {"maximum": high}
    if arguments.get("positive"):
        bounds |= {"minimum": 0, "exclusiveMinimum": True}
    length = arguments.get("length")
    sized: Schema = {} if length is None else {"minItems": length, "maxItems": length}
    schemas: dict[str, Schema] = {
        "text": {"type": "string"},
        "line": {"type": "string"},
        "flag": {"type": "boolean"},
        "integer": {"type": "integer", **bounds},
        "number": {"type": "number", **bounds},
        "maybe_number": {"type": "number", **bounds},
        "ratio": {"anyOf": [{"type": "number"}, {"type": "string", "pattern": "^[^/]+/[^/]+$"}]},
        "scalar": {"type": ["string", "number", "boolean"]},
        "numbers": {"type": "array", "items": {"type": "number"}, **sized},
        "texts": {"type": "array", "items": {"type": "string"}},
    }
    schema = schemas[name]
    if arguments.get("choices"):
        schema = {"enum": list(arguments["choices"])}
    default = arguments.get("default")
    no_bound = isinstance(default, float) and abs(default) >= LARGEST
    if isinstance(default, (bool, int, float, str)) and default != "" and not no_bound:
        schema = {**schema, "default": default}
    return schema


def merged(schemas: list[Schema]) -> Schema:
    """Return one schema for a key that is read in several ways. A default counts only if it is always the same."""
    if any(schema.get("default") != schemas[0].get("default") for schema in schemas):
        schemas = [{name: value for name, value in schema.items() if name != "default"} for schema in schemas]
    each = list({json.dumps(schema): schema for schema in schemas}.values())
    return each[0] if len(each) == 1 else {"anyOf": each}


def object_schema(tables: list[Table], path: str, kind: str, about: dict[str, str]) -> Schema:
    """Return the schema of the tables with a path, from all records of a file format.

    Parameters
    ----------
    tables
        All records.
    path
        Full name of the table without numbers; "" for the root.
    kind
        Name of the schema, a key of FILES.
    about
        Descriptions by full name of the key or table.
    """
    mine = [table for table in tables if table.path == path]
    assert mine, f"no example has the table {path}"
    variants = {table.protocol: [t for t in mine if t.protocol == table.protocol] for table in mine}
    # Protocols with the same keys share one schema.
    shared: dict[str, list[str]] = {}
    for protocol, records in variants.items():
        text = json.dumps(keys_schema(records, tables, path, kind, about))
        shared.setdefault(text, []).append(protocol)
    found: list[Schema] = []
    for text, protocols in shared.items():
        schema = json.loads(text)
        if protocols != [""]:
            schema["properties"]["protocol"]["enum"] = protocols
        found.append(schema)
    return found[0] if len(found) == 1 else {"oneOf": found}


def keys_schema(records: list[Table], tables: list[Table], path: str, kind: str, about: dict[str, str]) -> Schema:
    """Return the schema of tables with the same path and protocol; the other parameters are those of `object_schema`.

    A key is required if the reader of every such table reads it without a default, and has not checked its presence.
    """
    if any(table.numbers for table in records):
        return {"type": "object", "additionalProperties": {"type": "number"}}
    properties: Schema = {}
    required: list[str] = []
    whole = [table for table in records if not any(key.endswith("[]") for key in table.reads)]
    for item in dict.fromkeys(key for table in records for key in table.reads):
        key = item.removesuffix("[]")
        full = f"{path}.{key}".removeprefix(".")
        reads = [table.reads[item] for table in records if item in table.reads]
        method = reads[0][0]
        below = full.removeprefix("file[].")
        if method == "table":
            schema = object_schema(tables, below, kind, about)
        elif method == "tables":
            schema = {"type": "array", "items": object_schema(tables, f"{below}[]", kind, about)}
            schema |= {"minItems": 1} if (path, key) in REQUIRED[kind] else {}
        else:
            schema = merged([value_schema(*read) for read in reads])
            if full in FREE_LENGTHS:
                schema = {name: value for name, value in schema.items() if name not in ("minItems", "maxItems")}
            if full in NAMES:
                schema["pattern"] = f"^{NAME.pattern}$"
        if item != key:
            schema = {"type": "array", "items": schema, "minItems": 1}
        text = about.get(full.replace("[]", "")) or about.get(below.replace("[]", ""))
        properties[key] = {"description": text, **schema} if text else schema
        always = item != key or all(item in table.reads and key not in table.optional for table in whole)
        always &= path != "device[].rates"  # the reader goes through the keys that are present
        missing = inspect.signature(TomlTable.text).parameters["default"].default
        by_reader = method not in ("table", "tables") and all(r.get("default") is missing for _, r in reads)
        if (always and by_reader and method != "maybe_number") or (path, key) in REQUIRED[kind]:
            required.append(key)
    schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**schema, "required": required} if required else schema


def schema_of(kind: str) -> Schema:
    """Return the JSON Schema of a file format, a key of FILES."""
    title, page, texts, read = FILES[kind]
    with recording() as tables:
        for text in texts():
            read(text)
    content = object_schema(tables, "", kind, comments(page))
    return {"$schema": DRAFT, "title": title, "description": f"docs/formats/{page}", **content}


def dump(kind: str) -> str:
    """Return the text of the file of a schema."""
    return json.dumps(schema_of(kind), indent=2, ensure_ascii=False) + "\n"


def main() -> int:
    """Write the schemas."""
    FOLDER.mkdir(exist_ok=True)
    for kind in FILES:
        path = FOLDER / f"{kind}.schema.json"
        path.write_text(dump(kind), encoding="utf-8")
        print(f"written: {path.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
