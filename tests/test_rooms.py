"""Data flows downwards: a room imports only the rooms above it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "stickslip_fit"
ROOMS = (
    "errors", "files", "units", "_format", "_summary", "_toml", "machine", "logs", "laws", "causes",
    "simulate",
    "fit", "anova", "diagnose", "moves", "strategies", "capture", "report", "cli",
)  # fmt: skip


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_rooms(path: Path) -> set[str]:
    return rooms_in(ast.parse(path.read_text("utf-8")))


def rooms_in(tree: ast.AST) -> set[str]:
    """Rooms imported from; what draws an object may, late, look into the report."""
    found = rooms_of(tree).union(*map(rooms_in, ast.iter_child_nodes(tree)))
    return found - {"report"} if isinstance(tree, ast.FunctionDef) and shows(tree.name) else found


def shows(name: str) -> bool:
    return name.startswith("plot_")


def rooms_of(node: ast.AST) -> set[str]:
    """Rooms that a single statement imports from."""
    names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
    if isinstance(node, ast.ImportFrom) and node.module:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    found = {
        parts[1] for name in names if (parts := name.split("."))[0] == "stickslip_fit" and len(parts) > 1
    }
    return found - {"__version__"}


def test_every_room_imports_only_rooms_above_it():
    seen = set()
    for path in PACKAGE.rglob("*.py"):
        room = room_of(path)
        if room in ("__init__", "__main__"):
            continue
        seen.add(room)
        below = {other for other in imported_rooms(path) if ROOMS.index(other) > ROOMS.index(room)}
        assert not below, f"{path.relative_to(PACKAGE)} imports {below} from below"
    assert seen <= set(ROOMS)


@pytest.mark.parametrize(
    ("source", "seen"),
    [
        ("def _repr_html_(self):\n    from stickslip_fit.report.page import html", {"report"}),
        ("def plot_forest(self):\n    from stickslip_fit.report.figures.forest import draw", set()),
        ("def plot_forest(self):\n    from stickslip_fit.moves import steps", {"moves"}),
        ("def summary(self):\n    from stickslip_fit.report.text import text", {"report"}),
        ("def replot_(self):\n    from stickslip_fit.report.text import text", {"report"}),
        ("from stickslip_fit.report.figures.forest import draw\ndef plot_forest(self): pass", {"report"}),
    ],
)
def test_only_what_shows_an_object_may_look_below(tmp_path, source, seen):
    (tmp_path / "file.py").write_text(source)
    assert imported_rooms(tmp_path / "file.py") == seen


def test_the_command_line_starts_without_the_heavy_libraries():
    import subprocess
    import sys

    heavy = ("numpy", "pandas", "scipy", "matplotlib", "pyarrow", "jinja2", "pydantic")
    code = f"import sys, stickslip_fit.cli; print([name for name in {heavy} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
