"""The notebooks run as they stand, and are what their sources say."""

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"
SOURCES = sorted(FOLDER.glob("*.py"))


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_a_notebook_runs(source):
    jupytext = pytest.importorskip("jupytext", reason="jupytext is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    written, notebook = (jupytext.read(path) for path in (source, source.with_suffix(".ipynb")))
    cells = [[(cell.cell_type, cell.source) for cell in one.cells] for one in (written, notebook)]
    assert cells[0] == cells[1], "jupytext --to ipynb notebooks/*.py"
    assert not any(cell.get("outputs") for cell in notebook.cells)
    nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": FOLDER}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 1
    # nothing of this machine, no warning in what a reader sees
    said = "".join(output.get("text", "") for output in outputs)
    assert not re.search("Warning|Traceback", said), said
    print(f"\n{source.stem}:\n{said}", end="")
