"""Execute the text notebooks, and write the paired ``.ipynb`` with outputs: ``python -m notebooks.run``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

HERE = Path(__file__).parent
TEXTS = sorted(HERE.glob("[0-9][0-9]-*.md"))
SECONDS = 300  # for a cell
WIDGET = "application/vnd.jupyter.widget-view+json"
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}
ONE_CORE = {"OMP_NUM_THREADS": "1", "LOKY_MAX_CPU_COUNT": "1"}  # numbers and time do not hang on the machine


def read_text(path: Path) -> NotebookNode:
    """A text notebook, without outputs; cells are named by their place, so that a run changes no name."""
    notebook = jupytext.read(path)
    notebook.metadata = NotebookNode(
        kernelspec=KERNEL, jupytext={"formats": "ipynb,md:myst"}, language_info={"name": "python"}
    )
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    for place, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{place:02d}", NotebookNode(tags=cell.metadata.get("tags", []))
        if not cell.metadata.tags:
            del cell.metadata["tags"]
    return notebook


def execute(notebook: NotebookNode) -> NotebookNode:
    """Run all cells in the notebooks' folder; outputs hold what does not change from run to run."""
    os.environ |= ONE_CORE
    client = NotebookClient(
        notebook,
        timeout=SECONDS,
        record_timing=False,
        coalesce_streams=True,  # in how many pieces a text arrives is chance
        resources={"metadata": {"path": str(HERE)}},
        extra_arguments=["--log-level=ERROR"],  # no word on how the kernel is reached
    )
    client.execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.metadata.pop("execution", None)
            cell.outputs = [each for each in cell.outputs if WIDGET not in each.get("data", {})]
    notebook.metadata.pop("widgets", None)
    notebook.metadata["language_info"] = NotebookNode(name="python")
    return notebook


def main(names: list[str]) -> None:
    """Execute the notebooks whose names begin so, or all, and write the pairs."""
    for path in TEXTS:
        if not names or path.name.startswith(tuple(names)):
            print(path.stem, flush=True)
            nbformat.write(execute(read_text(path)), path.with_suffix(".ipynb"))


if __name__ == "__main__":
    main(sys.argv[1:])
