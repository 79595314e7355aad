"""Write docs/formats/result.md from the types of results: ``python docs/site/results.py``.

A table a type: its fields, what each holds, and the description in its annotation. What several results have in common
is told once, of the type that they extend.
"""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Any

from msgspec import inspect as types

from seatrial.ident.results import AnyResult, FitResult, Part, Result

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/formats/result.md"
BEGIN, END = "<!-- types: python docs/site/results.py -->", "<!-- end -->"
PLAIN = {types.StrType: "text", types.IntType: "integer", types.FloatType: "number", types.BoolType: "true or false"}


def kinds() -> list[type[Part]]:
    """The results, in the order of the types."""
    return list(AnyResult.__args__)


def tables() -> str:
    """Every type in Markdown: the results first, then what they are made of, in the order of need."""
    found: dict[type[Any], types.StructType] = {}
    for kind in (Result, FitResult, *kinds()):
        collect(types.type_info(kind), found)
    results = [info for cls, info in found.items() if info.tag is not None]
    parts = [info for cls, info in found.items() if info.tag is None]
    lines: list[str] = []
    for info in [*results, *parts]:
        lines += ["", *table(info)]
    return "\n".join(lines[1:])


def collect(one: types.Type, found: dict[type[Any], types.StructType]) -> None:
    """The types that a type is made of, each once."""
    if isinstance(one, types.Metadata):
        collect(one.type, found)
    elif isinstance(one, types.UnionType):
        for part in one.types:
            collect(part, found)
    elif isinstance(one, types.VarTupleType):
        collect(one.item_type, found)
    elif isinstance(one, types.TupleType):
        for part in one.item_types:
            collect(part, found)
    elif isinstance(one, types.DictType):
        collect(one.value_type, found)
    elif isinstance(one, types.StructType) and one.cls not in found:
        found[one.cls] = one
        for field in one.fields:
            collect(field.type, found)


def table(info: types.StructType) -> list[str]:
    """One type: its docstring, and a row a field."""
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


def value(one: types.Type) -> str:
    """What a field holds, in few words."""
    if isinstance(one, types.Metadata):
        return value(one.type)
    if isinstance(one, types.UnionType):
        return " or ".join(["null" if isinstance(part, types.NoneType) else value(part) for part in one.types])
    if isinstance(one, types.VarTupleType):
        return f"list of {value(one.item_type)}"
    if isinstance(one, types.TupleType):
        return f"list of {len(one.item_types)}: {', '.join(value(part) for part in one.item_types)}"
    if isinstance(one, types.DictType):
        return f"name -> {value(one.value_type)}"
    if isinstance(one, types.StructType):
        return link(one.cls)
    if isinstance(one, types.LiteralType):
        return ", ".join(f'`"{word}"`' for word in one.values)
    if isinstance(one, types.CustomType):
        return "numbers"
    return PLAIN[type(one)]


def link(cls: type[Any]) -> str:
    """To the table of a type."""
    return f"[{cls.__name__}](#{cls.__name__.lower()})"


def description(one: types.Type) -> str:
    """What the annotation says of a field."""
    extra = one.extra_json_schema if isinstance(one, types.Metadata) else None
    return str((extra or {}).get("description", "")).replace("|", "\\|")


def page(text: str) -> str:
    """The page with the tables between its marks made anew."""
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
