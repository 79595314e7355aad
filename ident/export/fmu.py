"""Export to FMI 2.0: a functional mock-up unit (FMU) for co-simulation, with its source and a binary."""

from __future__ import annotations

import hashlib
import html
import io
import os
import platform
import shutil
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.ident.export import c
from seatrial.ident.export.codegen import C, Content, header
from seatrial.ident.export.fmu_source import HEAD, SOURCE
from seatrial.ident.export.model_description import STEP_S, model_description, parameter_bounds, variables

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-DFMI2_OVERRIDE_FUNCTION_PREFIX")
TIMEOUT_S = 300.0
DATE = (1980, 1, 1, 0, 0, 0)  # of all files in the FMU, so that the same model gives the same bytes


def write(content: Content, *, source_only: bool = False) -> bytes:
    """Return the bytes of the FMU of a model: a zip file with description, C source, documentation and a binary.

    Parameters
    ----------
    content : Content
        Collected content of the model.
    source_only : bool
        Whether to leave out the binary. No compiler is needed then.

    Raises
    ------
    SeatrialError
        If there is no C compiler, if it fails, or if FMI 2.0 has no name for this platform.
    ValueError
        If the model uses an operation that the export lacks.
    """
    sources = {f"{content.name}.h": c.write(content)}
    made_by = version("seatrial")
    template = model_description(content, "", made_by)
    digest = hashlib.sha256(template + sources[f"{content.name}.h"].encode() + (HEAD + SOURCE).encode())
    guid = f"{{{uuid.UUID(bytes=digest.digest()[:16], version=5)}}}"
    sources[f"{content.name}_fmu.c"] = source(content, guid)
    files = {"modelDescription.xml": model_description(content, guid, made_by)}
    files |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    files["documentation/index.html"] = _documentation(content).encode()
    if not source_only:
        folder, suffix = target_platform()
        files[f"binaries/{folder}/{content.name}{suffix}"] = compiled(sources, f"{content.name}_fmu.c")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name, DATE)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
    return packed.getvalue()


def source(content: Content, guid: str) -> str:
    """Return the text of the C file with the functions of FMI 2.0, for a model and the identifier of its FMU."""
    bounds = [parameter_bounds(p) for p in content.exported_parameters]
    positive = [int(p.transform == "log") for p in content.exported_parameters]
    tables = [
        f'#define GUID "{guid}"',
        f"#define DEFAULT_DT {STEP_S!r} /* s */",
        _table("char *const names", [f'"{v.name}"' for v in variables(content)], '""'),
        _table("double lower", [C.number(low) for low, _ in bounds], "0.0"),
        _table("double upper", [C.number(high) for _, high in bounds], "0.0"),
        _table("int positive", [str(flag) for flag in positive], "0"),
    ]
    text = HEAD + "\n" + "\n".join(tables) + SOURCE
    return text.replace("NAME_", f"{content.name}_").replace("NAME.h", f"{content.name}.h")


def _table(declaration: str, items: Sequence[str], empty: str) -> str:
    """Return the line of a constant C array; C has no arrays without elements, so an empty one gets ``empty``."""
    return f"static const {declaration}[] = {{{', '.join(items) or empty}}};"


def _documentation(content: Content) -> str:
    """Return the page of the FMU: the header of the exported file, as preformatted text in HTML."""
    words = "\n".join(
        [
            *header(content, "FMI 2.0 (co-simulation)", "fmi2DoStep"),
            "",
            "Variables: inputs and states by their names; sensor.NAME: output of a sensor; p.NAME: parameter;",
            "start.NAME: state at the start; before.NAME: input before the start. Inputs are held in a step.",
        ]
    )
    title = html.escape(content.name)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{title}</title></head>\n'
        f"<body><pre>\n{html.escape(words)}\n</pre></body>\n</html>\n"
    )


def target_platform() -> tuple[str, str]:
    """Return the folder of binaries for this computer in an FMU, and the suffix of shared libraries.

    Raises
    ------
    SeatrialError
        If FMI 2.0 has no name for this platform.
    """
    bits = "64" if sys.maxsize > 2**32 else "32"
    for system, folder, suffix in (("linux", "linux", ".so"), ("darwin", "darwin", ".dylib"), ("win", "win", ".dll")):
        if sys.platform.startswith(system):
            return folder + bits, suffix
    raise SeatrialError(
        f"FMI 2.0 has no binaries for {platform.system() or sys.platform}; write the source alone with --source-only"
    )


def compiled(sources: dict[str, str], main: str) -> bytes:
    """Compile C files to a shared library, and return its bytes.

    Parameters
    ----------
    sources : dict of str to str
        Texts of the files by name.
    main : str
        Name of the file to compile; the others are headers.

    Raises
    ------
    SeatrialError
        If there is no C compiler (the variable CC, or cc, gcc or clang on the PATH), or if it fails.
    """
    command = os.environ.get("CC", "").split() or [next((x for x in COMPILERS if shutil.which(x)), "")]
    if not shutil.which(command[0]):
        missing = f"the compiler {command[0]} (CC) is not on the PATH" if command[0] else "no C compiler was found"
        raise SeatrialError(
            f"{missing}: install one (Debian: apt install gcc, macOS: xcode-select --install), or write the FMU "
            "without a binary with --source-only"
        )
    shared = ["-dynamiclib", "-arch", "arm64", "-arch", "x86_64"] if sys.platform == "darwin" else ["-shared"]
    with TemporaryDirectory() as folder:
        for name, text in sources.items():
            write_output(Path(folder) / name, text)
        words = [*command, *FLAGS, *shared, main, "-o", "model", "-lm"]
        try:
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SeatrialError(
                f"{command[0]}: cannot compile the FMU: {error}; check the compiler, or use --source-only"
            ) from error
        if done.returncode:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
            reason = lines[0] if lines else f"exit status {done.returncode}"
            raise SeatrialError(
                f"{command[0]}: cannot compile the FMU: {reason}; check the compiler, or use --source-only"
            )
        return (Path(folder) / "model").read_bytes()
