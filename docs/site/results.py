"""Generator of docs/formats/result.md from the types of the results: ``python docs/site/results.py``.

The page has one table for each type, with the name, the type and the description of each field. Fields that several
results have in common are listed once, in the table of their base type.
"""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Any

from msgspec import inspect as types

ROOT = Path(__file__).resolve().parents[2]
# Before the import of the project: the page must describe the tree of this file, not an installed package.
sys.path.insert(0, str(ROOT))

from seatrial.ident.results import AnyResult, FitResult, Part, Result  # noqa: E402

PAGE = ROOT / "docs/formats/result.md"
BEGIN, END = "<!-- types: python docs/site/results.py -->", "<!-- end -->"
PLAIN = {types.StrType: "text", types.IntType: "integer", types.FloatType: "number", types.BoolType: "true or false"}


def kinds() -> list[type[Part]]:
    """Return the types of the results, in the order of their definition in `AnyResult`."""
    return list(AnyResult.__args__)


def tables() -> str:
    """Return the tables of all types in Markdown. The results come first, then the types of their fields."""
    found: dict[type[Any], types.StructType] = {}
    for kind in (Result, FitResult, *kinds()):
        collect(types.type_info(kind), found)
    results = [info for cls, info in found.items() if info.tag is not None]
    parts = [info for cls, info in found.items() if info.tag is None]
    lines: list[str] = []
    for info in [*results, *parts]:
        lines += ["", *table(info)]
    return "\n".join(lines[1:])


def collect(kind: types.Type, found: dict[type[Any], types.StructType]) -> None:
    """Add a type and the types of its fields to ``found``, each once."""
    if isinstance(kind, types.Metadata):
        collect(kind.type, found)
    elif isinstance(kind, types.UnionType):
        for part in kind.types:
            collect(part, found)
    elif isinstance(kind, types.VarTupleType):
        collect(kind.item_type, found)
    elif isinstance(kind, types.TupleType):
        for part in kind.item_types:
            collect(part, found)
    elif isinstance(kind, types.DictType):
        collect(kind.value_type, found)
    elif isinstance(kind, types.StructType) and kind.cls not in found:
        found[kind.cls] = kind
        for field in kind.fields:
            collect(field.type, found)


def table(info: types.StructType) -> list[str]:
    """Return the section of one type: its heading, its docstring, and a table with one row for each field."""
    name = f"`{info.tag}`" if info.tag is not None else info.cls.__name__
    base = info.cls.__base__ if info.cls.__base__ in (Result, FitResult) else None
    more = "" if base is None else f" It has the keys of {link(base)}, and:"
    lines = [f"{'##' if info.tag is not None else '###'} {name}", "", f"{inspect.getdoc(info.cls)}{more}", ""]
    lines += ["| key | value | content |", "|---|---|---|"]
    if info.tag is not None:
        lines.append(f'| `{info.tag_field}` | `"{info.tag}"` | |')
    own = [f for f in info.fields if base is None or f.name not in base.__struct_fields__]
    lines += [f"| `{f.encode_name}` | {value(f.type)} | {description(f.type)} |" for f in own]
    return lines


def value(kind: types.Type) -> str:
    """Return the name of a field's type in words of JSON."""
    if isinstance(kind, types.Metadata):
        return value(kind.type)
    if isinstance(kind, types.UnionType):
        return " or ".join(["null" if isinstance(part, types.NoneType) else value(part) for part in kind.types])
    if isinstance(kind, types.VarTupleType):
        return f"list of {value(kind.item_type)}"
    if isinstance(kind, types.TupleType):
        return f"list of {len(kind.item_types)}: {', '.join(value(part) for part in kind.item_types)}"
    if isinstance(kind, types.DictType):
        return f"name -> {value(kind.value_type)}"
    if isinstance(kind, types.StructType):
        return link(kind.cls)
    if isinstance(kind, types.LiteralType):
        return ", ".join(f'`"{word}"`' for word in kind.values)
    if isinstance(kind, types.CustomType):  # the only custom type of the results is an array
        return "numbers"
    return PLAIN[type(kind)]


def link(cls: type[Any]) -> str:
    """Return a link to the table of a type."""
    return f"[{cls.__name__}](#{cls.__name__.lower()})"


def description(kind: types.Type) -> str:
    """Return the description in the annotation of a field; empty if it has none."""
    extra = kind.extra_json_schema if isinstance(kind, types.Metadata) else None
    return str((extra or {}).get("description", "")).replace("|", "\\|")


def page(text: str) -> str:
    """Return the page with new tables between its marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{tables()}\n\n{END}{after}"


def main() -> int:
    """Write the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
