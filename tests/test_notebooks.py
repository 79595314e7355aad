"""Tests that run the notebooks of the documentation in a kernel of their own, as a reader would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.quick_kernels import quick_environment

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
# Part of the text that the notebook has to print or show.
SHOWS = {
    "log-to-plot": ("<Log run1.mcap: 60.0 s", "strongest left turn", "0 faults, 0 warnings"),
    "fit-validate-compare": ("better: with mismatch", "log score is +"),
    "own-model-to-diagnosis": ("'wind':", "% smaller than that"),
    "many-logs-on-a-cluster": ("fitted to 6 of 7 logs, 1 failed.", "standard errors in m_u, m_r", "day7"),
}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_is_stored_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) > 4
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    page = (ROOT / "docs/notebooks/README.md").read_text(encoding="utf-8")
    assert f"]({path.name})" in page


@pytest.mark.pages
@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the client of the kernel has warnings of its own
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PYTHONPATH", quick_environment(tmp_path / "quick", every=True)["PYTHONPATH"])
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=240, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    shown = "\n".join(text for cell in notebook.cells for output in cell.get("outputs", ()) for text in texts(output))
    missing = [words for words in SHOWS[path.stem] if words not in shown]
    assert not missing, shown
    assert "Traceback" not in shown


def texts(output: Any) -> list[str]:
    """Return the texts of one output of a cell: what it prints, or what the notebook shows of its value."""
    return [str(output.get("text", "")), *(str(v) for v in output.get("data", {}).values() if isinstance(v, str))]
