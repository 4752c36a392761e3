"""Pages that the package writes about itself, made before Sphinx reads its sources.

What a docstring, the command line or the list of causes says is not written a second time by hand. Everything
goes to ``docs/generated/``, which is not committed.
"""

import json
from pathlib import Path
from typing import Any

import api
import causes_page
import columns_page
import command_line
import errata_page
import laws_page
import thesis_figures
import toml_page

HERE = Path(__file__).parents[1]
GENERATED = HERE / "generated"
NOTEBOOKS = HERE.parent / "notebooks"


def pages() -> dict[str, str]:
    """Every generated page by its path below ``docs/generated/``."""
    claims = thesis_figures.claims()
    return {
        "command-line.md": command_line.page(),
        "causes.md": causes_page.page(),
        "laws.md": laws_page.page(),
        "columns.md": columns_page.page(),
        "keys.md": toml_page.page(),
        "errata.md": errata_page.page(),
        **{f"schemas/{name}.json": text for name, text in toml_page.schemas().items()},
        "thesis-figures.md": thesis_figures.page(claims),
        **thesis_figures.pictures(claims),
        "notebooks.md": _list_of_notebooks(),
        **{f"api/{name}.md": text for name, text in api.pages().items()},
    }


def write(*_: Any) -> None:
    """Write the generated pages, and bring the notebooks in; what has not changed stays untouched."""
    wanted = {GENERATED / name: text.encode() for name, text in pages().items()}
    wanted |= {GENERATED / "notebooks" / path.name: _shown(path) for path in _notebooks()}
    for path in GENERATED.rglob("*.*"):
        if path.is_file() and path not in wanted:
            path.unlink()
    for path, content in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_bytes() != content:
            path.write_bytes(content)


def _list_of_notebooks() -> str:
    found = _notebooks()
    if not found:
        return "There are none in this copy."
    listed = "\n".join(f"generated/notebooks/{path.stem}" for path in found)
    return f"```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```"


def _shown(path: Path) -> bytes:
    """A notebook that says its cells are IPython's, in which `!command` is no mistake."""
    notebook = json.loads(path.read_text("utf-8"))
    notebook["metadata"]["language_info"] = {"name": "python", "pygments_lexer": "ipython3"}
    return json.dumps(notebook, ensure_ascii=False).encode()


def _notebooks() -> list[Path]:
    return sorted(NOTEBOOKS.glob("*.ipynb"))


def setup(app: Any) -> dict[str, bool]:
    """Write the pages as soon as Sphinx is ready to read."""
    app.connect("builder-inited", write, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
