"""The structure: imports point downwards, without a cycle; files of a size that one reads."""

import ast
import importlib
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path

import pytest

import stickslip_fit

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "stickslip_fit"
# From the bottom up; packages of one row do not import each other.
LAYERS = (
    ("errors", "_typing"),
    ("units",),
    ("_io", "_progress", "_threads", "_linalg", "_input", "_format", "_expression", "_function", "_rows"),
    ("_export", "_json"),
    ("_summary", "_toml"),
    ("step",),
    ("machine",),
    ("logs",),
    ("laws",),
    ("causes",),
    ("simulation",),
    ("estimation",),
    ("anova", "bayes"),
    ("diagnosis",),
    ("moves",),
    ("strategies",),
    ("capture", "studies", "changes", "law_comparison"),
    ("drive",),
    ("plotting",),
    ("reporting",),
    ("_workflow",),
    ("cli",),
)
LEVEL = {name: level for level, row in enumerate(LAYERS) for name in row}
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
FACES = {name for name, path in MODULES.items() if path.name == "__init__.py"}
MAX_LINES = 600


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(MODULES[module].read_text("utf-8"))


def imports_of(tree: ast.AST, plots: bool = False) -> list[tuple[str, bool]]:
    """Modules of the package that code imports, at whatever depth; and whether inside a method that plots."""
    found = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [(name if name in MODULES else node.module, plots) for name in names]
        if isinstance(node, ast.Import):
            found += [(alias.name, plots) for alias in node.names]
        is_plot = isinstance(node, ast.FunctionDef) and (node.name + "_").startswith("plot_")
        inside = plots or is_plot
        if not isinstance(node, ast.expr):
            found += imports_of(node, inside)
    return [(name, inside) for name, inside in found if name.startswith("stickslip_fit.")]


def layer_of(module: str) -> str:
    return module.split(".")[1]


def upward(module: str, tree: ast.AST) -> list[str]:
    own = layer_of(module)
    return [
        name
        for name, plots in imports_of(tree)
        if layer_of(name) != own
        and LEVEL[layer_of(name)] >= LEVEL[own]
        and not (plots and layer_of(name) == "plotting")
    ]


def test_imports_point_downwards():
    modules = [name for name in MODULES if "." in name and layer_of(name) != "__main__"]
    assert not {module: found for module in modules if (found := upward(module, tree_of(module)))}


@pytest.mark.parametrize(
    ("source", "seen"),
    [
        ("def plot_forest(self):\n    from stickslip_fit.plotting import parameters", []),
        (
            "def plot_forest(self):\n    from stickslip_fit.reporting import page",
            ["stickslip_fit.reporting.page"],
        ),
        (
            "def summary(self):\n    from stickslip_fit.plotting import parameters",
            ["stickslip_fit.plotting.parameters"],
        ),
        ("if TYPE_CHECKING:\n    from stickslip_fit.diagnosis import Diagnosis", ["stickslip_fit.diagnosis"]),
        ("from stickslip_fit.laws import StepLaw", []),
    ],
)
def test_only_what_plots_may_import_upwards(source, seen):
    assert upward("stickslip_fit.estimation.result", ast.parse(source)) == seen


def test_no_module_needs_itself():
    graph = defaultdict(set)
    for module in MODULES.keys() - FACES:
        for name, plots in imports_of(tree_of(module)):
            if name not in FACES and not plots and name != module:
                graph[module].add(name)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.parametrize("package", sorted(FACES - {"stickslip_fit"}))
def test_no_package_offers_a_name_that_one_of_its_modules_has(package):
    offered = set(getattr(importlib.import_module(package), "__all__", ()))
    assert not offered & {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == package}


def test_no_two_classes_have_one_name():
    places = defaultdict(list)
    for module in MODULES:
        for node in tree_of(module).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_a_file_is_what_one_reads():
    lines = {name: len(path.read_text("utf-8").splitlines()) for name, path in MODULES.items()}
    assert not {name: count for name, count in lines.items() if count > MAX_LINES}


def test_the_front_door_opens_on_names_that_exist():
    for name in stickslip_fit.__all__:
        assert getattr(stickslip_fit, name) is not None
    assert set(stickslip_fit.__all__) <= set(dir(stickslip_fit))
    with pytest.raises(AttributeError, match="no attribute 'speling'"):
        stickslip_fit.speling  # noqa: B018


HEAVY = ("numpy", "pandas", "scipy", "matplotlib", "pyarrow", "jinja2", "pydantic", "statsmodels")


@pytest.mark.parametrize("module", ["stickslip_fit", "stickslip_fit.cli"])
def test_what_starts_every_command_loads_no_heavy_library(module):
    code = f"import sys, {module}; print([name for name in {HEAVY} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_statistics_that_load_slowly_are_imported_where_they_are_used():
    """`scipy.stats` and its like take longer to load than most commands take to run."""
    slow = ("scipy.optimize", "scipy.stats", "statsmodels", "matplotlib.pyplot", "joblib")
    top = {module: [*chain(*map(imported_names, tree_of(module).body))] for module in MODULES}
    assert not {
        module: names for module, names in top.items() if any(name.startswith(slow) for name in names)
    }


def imported_names(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []
