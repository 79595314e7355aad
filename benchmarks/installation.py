"""Size and start-up time of installations from the wheel: `python -m benchmarks.installation` (needs a network).

Each installation gets a new environment with the locked versions. The size is that of site-packages with byte code and
without pip. casadi contains some libraries twice (casadi issue 3976); the size of the duplicates is printed as well.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("", "mavlink", "ident", "ros2", "all")
N_STARTS = 5
MB = 1e6


class Installed(NamedTuple):
    """Measurements of one installation.

    Attributes
    ----------
    size : float
        Size of site-packages without pip [MB].
    twice : float
        Size of large libraries that have the content of another file [MB].
    import_s : float
        Wall time of `import seatrial` without the start of the interpreter [s].
    help_s : float
        Wall time of `seatrial --help` [s].
    problems : str
        Output of `pip check`; empty if it found no problem.
    """

    size: float
    twice: float
    import_s: float
    help_s: float
    problems: str


def run(*words: str | Path) -> str:
    """Run the command line ``words`` and return its standard output.

    If the program fails, raise SystemExit with the command line and the output of the program as the message.
    """
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}")
    return done.stdout


def build_wheel(folder: Path) -> Path:
    """Build the wheel of this source tree into a folder and return its path."""
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(folder)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def locked_versions(folder: Path) -> Path:
    """Write the locked versions without their hashes to a file for the option -c of pip. Return its path."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    path = folder / "versions.txt"
    path.write_text("\n".join(line.removesuffix("\\").strip() for line in lines if re.match(r"\w", line)) + "\n")
    return path


def duplicated(site: Path) -> float:
    """Return the total size [MB] of shared libraries above 1 MB in ``site`` that repeat the content of another one.

    The first file with a content does not count. Symbolic links are ignored.
    """
    seen: set[str] = set()
    total = 0
    for path in sorted(site.rglob("*.so*")):
        if path.is_symlink() or path.stat().st_size < MB:
            continue
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        total += path.stat().st_size * (digest in seen)
        seen.add(digest)
    return total / MB


def seconds(*words: str | Path) -> float:
    """Return the shortest wall time [s] of the command line ``words`` in five runs (N_STARTS)."""
    times = []
    for _ in range(N_STARTS):
        start = time.perf_counter()
        run(*words)
        times.append(time.perf_counter() - start)
    return min(times)


def measure(wheel: Path, versions: Path, extra: str, folder: Path) -> Installed:
    """Install the wheel into a new environment and measure the installation.

    Parameters
    ----------
    wheel : Path
        The wheel.
    versions : Path
        Locked versions, for the option -c of pip.
    extra : str
        Extra to install, such as "ident"; empty for the default installation.
    folder : Path
        Folder of the new environment, which stays.
    """
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "-c", versions, f"{wheel}[{extra}]" if extra else wheel)
    (site,) = folder.glob("lib/python*/site-packages")
    own = [
        path for path in site.iterdir() if not re.match(r"(pip|setuptools|pkg_resources|_distutils_hack)\b", path.name)
    ]
    size = sum(file.lstat().st_size for path in own for file in (path.rglob("*") if path.is_dir() else [path]))
    check = subprocess.run([python, "-m", "pip", "check"], capture_output=True, text=True, check=False).stdout.strip()
    empty = seconds(python, "-c", "pass")
    return Installed(
        size / MB,
        duplicated(site),
        seconds(python, "-c", "import seatrial") - empty,
        seconds(folder / "bin" / "seatrial", "--help"),
        "" if check.startswith("No broken") else check,
    )


def main() -> None:
    """Build the wheel, install it with each extra of the command line, and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--extras",
        default=",".join(EXTRAS),
        help="extras, separated by commas; an empty name is the default installation",
    )
    extras = parser.parse_args().extras.split(",")
    with tempfile.TemporaryDirectory(prefix="seatrial-installation-") as name:
        folder = Path(name)
        wheel, versions = build_wheel(folder), locked_versions(folder)
        print(f"wheel {wheel.stat().st_size / MB:.1f} MB")
        print("| installation | size, MB | duplicates, MB | import seatrial, s | seatrial --help, s | pip check |")
        print("|---|---|---|---|---|---|")
        for k, extra in enumerate(extras):
            found = measure(wheel, versions, extra, folder / f"environment-{k}")
            print(
                f"| {f'`[{extra}]`' if extra else 'default'} | {found.size:.0f} | {found.twice:.0f} "
                f"| {found.import_s:.3f} | {found.help_s:.2f} | {found.problems or 'clean'} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
