"""Tests of the code structure: no unused module, no import cycle, and imports of a package through its `__init__`."""

from __future__ import annotations

import ast
import gc
import importlib.util
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("daq", "bench", "ident", "mocks")
CODE = (*PARTS, "benchmarks", "docs", "tests")
OWN = tuple(f"seatrial.{part}" for part in PARTS)
# packages of independent files: their modules are imported directly, not through `__init__`
MODULES_NAMED = ("seatrial.ident.workflows", "seatrial.daq.importers")


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of a file's syntax tree.

    The result is kept, because garbage collection of the nodes takes longer than parsing.
    """
    gc.disable()
    try:
        return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    finally:
        gc.enable()


@cache
def files() -> list[Path]:
    """Return every Python file of the project."""
    # Each file once, so not through the links in seatrial/.
    face = [*(ROOT / "seatrial").glob("*.py"), *(ROOT / "seatrial/api").glob("*.py")]
    return sorted([*face, *(path for top in CODE for path in (ROOT / top).rglob("*.py"))])


def module_of(path: Path) -> str:
    """Return the dotted name by which a file is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("seatrial", *parts) if parts[0] in PARTS else parts).removesuffix(".__init__")


def package_of(module: str) -> str:
    """Return the package of a module, for example ``seatrial.ident.estimation`` of
    ``seatrial.ident.estimation.likelihood``.
    """
    return ".".join(module.split(".")[:3])


PRODUCT = {module_of(path): path for path in files() if path.relative_to(ROOT).parts[0] in PARTS}
WINGS = {module for module, path in PRODUCT.items() if path.name == "__init__.py" and module.count(".") == 2}


@cache
def imports(path: Path) -> list[tuple[str, str]]:
    """Return (module, name) of every import of our own modules, inside functions too."""
    return [
        (node.module, alias.name)
        for node in nodes_of(path)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(OWN)
        for alias in node.names
    ]


def public_names() -> dict[str, dict[str, str]]:
    """Return the public names of each package, and the module from which each name comes."""
    found: dict[str, dict[str, str]] = {}
    for wing in WINGS:
        stub = PRODUCT[wing].with_suffix(".pyi")
        tree = ast.parse(stub.read_text(encoding="utf-8")) if stub.exists() else ast.Module([], [])
        found[wing] = {
            alias.name: f"{wing}.{node.module or alias.name}"
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
    return found


def test_a_package_is_imported_through_its_init() -> None:
    beside = [
        f"{module} imports {target}.{name}"
        for module, path in PRODUCT.items()
        for target, name in imports(path)
        if package_of(target) in WINGS
        and target != package_of(target)
        and package_of(module) != package_of(target)
        and package_of(target) not in MODULES_NAMED
    ]
    assert not beside


def test_no_public_name_is_the_name_of_a_file() -> None:
    """After an import of the file, the name would refer to the module."""
    clash = [
        f"{wing}.{name}"
        for wing, names in public_names().items()
        for name, source in names.items()
        if f"{wing}.{name}" in PRODUCT and source != f"{wing}.{name}"
    ]
    assert not clash


def test_every_public_name_is_used_from_outside() -> None:
    used = {
        (target, name) for path in files() for target, name in imports(path) if package_of(module_of(path)) != target
    }
    documented = "\n".join(p.read_text(encoding="utf-8") for p in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])
    idle = [
        f"{wing}.{name}"
        for wing, names in public_names().items()
        for name in names
        if (wing, name) not in used and name not in documented
    ]
    assert not idle


def test_no_import_circle() -> None:
    """The cycle is searched among modules. Each name of a package is resolved to the module that defines it."""
    face = public_names()
    graph: dict[str, set[str]] = {module: set() for module in PRODUCT}
    for module, path in PRODUCT.items():
        for target, name in imports(path):
            source = face.get(target, {}).get(name) or (f"{target}.{name}" if f"{target}.{name}" in PRODUCT else target)
            if source in PRODUCT and source != module:
                graph[module].add(source)
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join((*path[path.index(module) :], module))
        if module not in done:
            for target in sorted(graph[module]):
                visit(target, (*path, module))
            done.add(module)

    for module in sorted(graph):
        visit(module, ())


# the import is in a program that a test runs
BARE = re.compile(rf"(?:-m |from |import )(?:{'|'.join(PARTS)})(?:\.\w+| import )")


def test_no_file_imports_a_part_by_a_name_that_is_not_installed() -> None:
    """Only `seatrial` is installed. In the project's folder `import daq` also works, and would load a module twice."""
    bare = []
    for path in files():
        for node in nodes_of(path):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                module = node.value.partition(":")[0]
                names = [module] if "." in module and f"seatrial.{module}" in PRODUCT else []
                names += ["daq"] if BARE.search(node.value) else []
            else:
                continue
            bare += [f"{path.relative_to(ROOT)}:{node.lineno}" for name in names if name.split(".")[0] in PARTS]
    assert not [place for place in bare if place.partition(":")[0] not in ("tests/test_house.py", "tests/test_site.py")]


def test_texts_for_users_name_no_file_of_the_repository() -> None:
    """Messages, helps and files that are written name a page of the documentation, which an installed user has too."""
    found = []
    for path in (p for p in files() if p.relative_to(ROOT).parts[0] in (*PARTS, "seatrial")):
        docstrings = {
            id(node.body[0].value)
            for node in nodes_of(path)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and isinstance(node.body[0], ast.Expr)
            and not any(
                "command" in ast.unparse(d) for d in getattr(node, "decorator_list", ())
            )  # the help of a command
        }
        for node in nodes_of(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                found += [f"{path}:{node.lineno}: {text}" for text in re.findall(r"docs/\S+|ident/\S+\.py", node.value)]
    assert found == []


def test_no_function_has_more_than_eight_parameters() -> None:
    """Commands are excepted, because their parameters are their options."""
    wide = []
    for module, path in PRODUCT.items():
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                command = any("command" in ast.unparse(d) or "option" in ast.unparse(d) for d in node.decorator_list)
                n = (
                    len(node.args.args)
                    + len(node.args.kwonlyargs)
                    - (bool(node.args.args) and node.args.args[0].arg == "self")
                )
                if n > 8 and not command:
                    wide.append(f"{module}.{node.name}: {n}")
    assert not wide


@pytest.mark.parametrize("command", ["seatrial ident vehicle", "seatrial ident diagnose"])
def test_a_workflow_enters_no_file_twice(command: str) -> None:
    """From log to result, all calls into one file stand together."""
    spec = importlib.util.spec_from_file_location("architecture", ROOT / "docs/site/architecture.py")
    assert spec is not None
    assert spec.loader is not None
    architecture = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = architecture
    spec.loader.exec_module(architecture)
    entered = [step.module for step in architecture.call_path(*architecture.WORKFLOWS[command])]
    assert entered[0] == "seatrial.ident.data.loading"
    assert entered[-1] == "seatrial.ident.workflows.output"
    once = [module for k, module in enumerate(entered) if k == 0 or entered[k - 1] != module]
    assert [module for module in set(once) if once.count(module) > 1] == []


def mentioned(path: Path) -> Iterator[str]:
    """Return the modules that a file imports, or that a text in it names as "module" or "module:attribute"."""
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value.partition(":")[0]


def test_every_module_is_used_by_another() -> None:
    """A module that only its own tests use is dead code."""
    used = {path: set(mentioned(path)) for path in files()}
    behind = {source for names in public_names().values() for source in names.values()}
    dead = []
    for module, path in PRODUCT.items():
        catalogue = module.startswith("seatrial.ident.effects.")  # all modules of the folder are loaded
        if catalogue or path.stem in ("__init__", "__main__"):
            continue
        own_test = f"test_{path.stem}"
        if module not in behind and not any(module in names for user, names in used.items() if user.stem != own_test):
            dead.append(module)
    assert not dead


# Files that write without `seatrial.daq.files`, and the reason.
WRITERS = {
    "seatrial.daq.importers.dataflash": "/dev/null",
    "seatrial.daq.log.recovery": "a scratch file of the writer",
    "seatrial.daq.tools.export": "a scratch file of the writer",
    "seatrial.daq.tools.ros_export": "into a folder that it has just made",
    "seatrial.daq.transport.ftdi_latency": "a setting of the kernel",
    "seatrial.daq.view.live_process": "a setting of the kernel",
    "seatrial.ident.engine.jit": "a cache of our own",
    "seatrial.mocks.cli": "follows no link",
    "seatrial.mocks.ports.pty": "a lock",
}


def test_outputs_are_written_by_seatrial_daq_files() -> None:
    """`seatrial.daq.files` follows no link and leaves no partial file; a plain `write_text` does both."""
    writes = {
        module
        for module, path in PRODUCT.items()
        for node in nodes_of(path)
        if isinstance(node, ast.Call) and _writes(node)
    }
    assert writes == set(WRITERS)


def _writes(call: ast.Call) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    texts = [
        argument.value
        for argument in call.args
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]
    mode = any(len(text) < 4 and set(text) & set("wxa") for text in texts)
    return name in ("write_text", "write_bytes") or (name == "open" and mode)


@pytest.mark.parametrize(
    ("subject", "accepted"),
    [
        ("fit: ignore the predicted gain of a failed BFGS step", True),
        ("ident/export: bring the units into the header", True),
        (f"fit: {'x' * 67}", True),
        (f"fit: {'x' * 68}", False),
        ("ignore the predicted gain", False),
        ("fit: ", False),
        ("fit: Ignore the predicted gain", False),
        ("fit: ignoring the predicted gain", False),
        ("fit: ignore the predicted gain.", False),
        ("Merge branch 'fit'", True),
        ("", False),
    ],
)
def test_the_commit_hook_accepts_subjects_of_the_documented_form(subject: str, accepted: bool) -> None:
    """The hook searches the message with these flags of `re` (pygrep --multiline)."""
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    (hook,) = [hook for hook in local["hooks"] if hook.get("stages") == ["commit-msg"]]
    found = re.search(hook["entry"], f"{subject}\n\nThe reason.\n", re.MULTILINE | re.DOTALL)
    assert (found is not None) == accepted
