"""Every notebook runs, and still says what is stored beside it."""

import re

import pytest

nbformat = pytest.importorskip("nbformat", reason="Jupyter is not installed (the extra lab)")
pytest.importorskip("jupytext", reason="jupytext is not installed (the extra lab)")

from notebooks.run import HERE, TEXTS, execute, read_text

LARGEST = 600_000  # bytes
NUMBER = re.compile(r"\b[0-9a-f]{12,}\b|[-−+]?\d[\d.,]*(?:e[-+]?\d+)?|[⁰¹²³⁴⁵⁶⁷⁸⁹]+")
OF_A_MACHINE = re.compile(r"/(?:home|root|tmp|usr|var|work|Users)/")

each_notebook = pytest.mark.parametrize("path", TEXTS, ids=[path.stem for path in TEXTS])


def stored(path):
    return nbformat.read(path.with_suffix(".ipynb"), as_version=4)


def words(text):
    """What is said, whatever the numbers: a conclusion that changes changes its words."""
    return " ".join(NUMBER.sub("#", text).split())


def told(cell):
    """What a cell prints and shows, one line for each output; of pictures, that there is one."""
    for output in cell.get("outputs", []):
        if output.output_type == "stream":
            yield f"{output.name}: {words(output.text)}"
        for kind, content in sorted(output.get("data", {}).items()):
            yield kind if kind.startswith("image/") else f"{kind}: {words(content)}"


@pytest.mark.nightly
@each_notebook
def test_it_runs_and_says_what_it_said(path):
    fresh, kept = execute(read_text(path)), stored(path)
    for place, (cell, before) in enumerate(zip(fresh.cells, kept.cells, strict=True)):
        assert list(told(cell)) == list(told(before)), f"cell {place} of {path.name}; python -m notebooks.run"


@each_notebook
def test_text_and_notebook_have_the_same_cells(path):
    text, notebook = read_text(path), stored(path)
    assert [(cell.cell_type, cell.source) for cell in text.cells] == [
        (cell.cell_type, cell.source) for cell in notebook.cells
    ]
    assert notebook.metadata.kernelspec.name == "python3"


@each_notebook
def test_what_is_stored_is_whole_small_and_of_no_machine(path):
    notebook, content = stored(path), path.with_suffix(".ipynb").read_text("utf-8")
    assert len(content) < LARGEST
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output.text for output in outputs if output.get("name") == "stderr"]
    assert not [line for cell in code for line in told(cell) if OF_A_MACHINE.search(line)]
    assert "iopub" not in content, "times of execution"
    nbformat.validate(notebook)


def test_each_text_has_its_notebook_and_they_are_numbered():
    assert [path.stem for path in TEXTS] == [path.stem for path in sorted(HERE.glob("*.ipynb"))]
    assert [int(path.name[:2]) for path in TEXTS] == list(range(1, len(TEXTS) + 1))
