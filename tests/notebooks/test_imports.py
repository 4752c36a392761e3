"""What the notebooks take from the package exists; by night they are run."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

TEXTS = sorted((Path(__file__).parents[2] / "notebooks").glob("[0-9][0-9]-*.md"))
CELL = re.compile(r"^```\{code-cell\}.*?\n(?::\w.*\n)*(.*?)^```", re.MULTILINE | re.DOTALL)


def taken(code):
    """Module and name of all that comes from the package, by `from ... import` or as an attribute of it."""
    tree = ast.parse(code)
    modules = {
        alias.asname or alias.name: alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
        if is_ours(alias.name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and is_ours(node.module):
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in modules:
            yield modules[ast.unparse(node.value)], node.attr


def is_ours(name):
    return (name or "").split(".")[0] == "stickslip_fit"


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_all_that_a_notebook_takes_from_the_package_is_there(path):
    names = set(taken("".join(CELL.findall(path.read_text("utf-8")))))
    assert names
    assert {(module, name) for module, name in names if not hasattr(import_module(module), name)} == set()
