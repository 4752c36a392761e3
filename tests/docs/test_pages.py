"""Every command and snippet of README, CONTRIBUTING and docs is run, page by page and in order."""

import ast
import doctest
import inspect
import json
import re
import shutil
import tomllib
from collections.abc import Callable
from functools import partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

import stickslip_fit as ssf
from tests.docs.commands import ROOT, lines, obey
from tests.docs.fences import Fence, fences
from tests.docs.files import make_files
from tests.docs.remembered import Remembered, remember

Run = Callable[..., tuple[int, str, str]]
LOOSELY = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
INLINE_CALL = re.compile(r"(?<!`)`(ssf\.[^`]+\))`(?!`)")
NOT_OURS = ("generated", "_build")
MAKES_LOG = re.compile(r"stickslip-fit simulate .* -o my-log\.csv")  # which replaces no log that is there
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if not {*page.parts} & {*NOT_OURS}),
]
SLOW = (
    "stickslip_fit.diagnosis.diagnose",
    "stickslip_fit.strategies.compare_strategies",
    "stickslip_fit.reporting.page.report",
)
MADE_ANYWAY = {"report": "diagnosis"}  # the pages give a report the diagnosis that it would make
# The same functions under the names that another module imported them by.
COPIES = {
    "stickslip_fit.reporting.page.diagnose": "stickslip_fit.diagnosis.diagnose",
    "stickslip_fit.reporting.page.compare_strategies": "stickslip_fit.strategies.compare_strategies",
}
# Slow: each of these fits, diagnoses or drives what no other page does.
LONG = (
    "a-law-of-your-own.md",
    "add-a-cause.md",
    "add-a-strategy.md",
    "calibrate-today.md",
    "capture.md",
    "compare-strategies.md",
    "drive-by-hand.md",
    "extend-the-law.md",
    "find-out-what-is-wrong.md",
    "laws-and-causes-as-formulas.md",
    "plan-the-next-experiment.md",
    "predict-and-move.md",
    "see-which-factors-matter.md",
    "simulate-a-stage.md",
    "use-it-from-python.md",
    "which-law.md",
    "your-own-instrument.md",
    "your-own-manipulator.md",
)
WITH_CODE = [
    pytest.param(page, marks=pytest.mark.slow if page.name in LONG else ())
    for page in PAGES
    if any(fences(page))
]


@pytest.fixture(scope="session")
def files(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    make_files(folder)
    return folder


@pytest.fixture
def desk(files, tmp_path, monkeypatch) -> Path:
    """A folder like the one that a reader is in."""
    shutil.copytree(files, tmp_path, symlinks=True, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "agg"}):
        yield tmp_path


@pytest.fixture(scope="session")
def remembered() -> Remembered:
    return Remembered()


@pytest.fixture(scope="session")
def once() -> dict[str, Any]:
    """The analyses that take long, each of which is made once for equal arguments."""
    made = {}
    for place in SLOW:
        module, _, name = place.rpartition(".")
        made[place] = remember(getattr(import_module(module), name), MADE_ANYWAY.get(name, ""))
    return made | {copy: made[place] for copy, place in COPIES.items()}


@pytest.fixture(autouse=True)
def analyses_once(once, monkeypatch) -> None:
    for place, function in once.items():
        monkeypatch.setattr(place, function)


@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_does_what_it_says(page: Path, desk: Path, run: Run, remembered: Remembered) -> None:
    run = partial(remembered.run, run)
    found = list(fences(page))
    for fence in found:
        if fence.shows:
            (desk / fence.shows).write_text(fence.text, "utf-8")
    if any(MAKES_LOG.search(fence.text) for fence in found):
        (desk / "my-log.csv").unlink()
    names: dict[str, Any] = {"__name__": page.stem}
    for fence in found:
        reader = READERS.get(fence.language)
        assert reader is not None, f"{page}:{fence.line}: no test knows what to do with {fence.language!r}"
        reader(fence, page, names, run)


def _python(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    # Empty lines before it, so that a traceback names the page's own line.
    exec(compile("\n" * (fence.line - 1) + fence.text, str(page), "exec"), names)


def _doctest(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    test = doctest.DocTestParser().get_doctest(fence.text, names, page.name, str(page), fence.line - 1)
    failed: list[str] = []
    doctest.DocTestRunner(optionflags=LOOSELY).run(test, out=failed.append, clear_globs=False)
    names.update(test.globs)
    assert not failed, "".join(failed)


def _shell(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    for line in lines(fence.text, fence.line):
        try:
            obey(line, run)
        except Exception as error:
            pytest.fail(f"{page}:{line.number}: {line.text}\n{error}")


def _console(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    """Commands after ``$``, each with what it prints; ``refused`` where that is why it is refused."""
    for number, command, shown in _dialogue(fence):
        if "refused" in fence.words:
            status, _, said = run(*command.split()[1:])
            assert status == 2, f"{page}:{number}: {command}: ends with status {status}, not 2"
        else:
            (line,) = lines(command, number)
            try:
                said = obey(line, run)
            except AssertionError as error:
                pytest.fail(f"{page}:{number}: {command}\n{error}")
        fine = doctest.OutputChecker().check_output(shown, said, LOOSELY)
        assert fine, f"{page}:{number}: {command}\nthe page shows\n{shown}\nit prints\n{said}"


def _dialogue(fence: Fence) -> list[tuple[int, str, str]]:
    found: list[tuple[int, str, str]] = []
    for number, line in enumerate(fence.text.splitlines(), start=fence.line):
        if line.startswith("$ "):
            found.append((number, line[2:], ""))
        else:
            place, command, shown = found[-1]
            found[-1] = (place, command, f"{shown}{line}\n")
    return found


def _toml(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    tomllib.loads(fence.text)


def _json(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    json.loads(fence.text)


def _csv(fence: Fence, page: Path, names: dict[str, Any], run: Run) -> None:
    widths = {line.count(",") for line in fence.text.splitlines()}
    assert len(widths) == 1, f"{page}:{fence.line}: rows of different length"


READERS = {
    "python": _python,
    "pycon": _doctest,
    "sh": _shell,
    "console": _console,
    "toml": _toml,
    "json": _json,
    "csv": _csv,
    "text": lambda *_: None,
}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_call_within_a_sentence_has_arguments_that_the_function_takes(page: Path) -> None:
    """What is in no block is not run, so that its names are at least looked up."""
    for code in INLINE_CALL.findall(page.read_text("utf-8")):
        for call in (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)):
            name = ast.unparse(call.func)
            if re.fullmatch(r"ssf(\.\w+)+", name):
                function = attrgetter(name.removeprefix("ssf."))(ssf)
                given = {one.arg: one.value for one in call.keywords if one.arg}
                try:
                    inspect.signature(function).bind_partial(*call.args, **given)
                except TypeError as error:
                    pytest.fail(f"{page}: {code}: {error}")


def test_every_package_of_the_api_has_its_place_in_the_contents():
    source = (ROOT / "docs" / "_ext" / "api.py").read_text("utf-8")
    (modules,) = (
        node.value
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MODULES"
    )
    contents = (ROOT / "docs" / "reference" / "api.md").read_text("utf-8")
    listed = re.findall(r"^\.\./generated/api/(\w+)$", contents, re.MULTILINE)
    assert set(listed) == set(ast.literal_eval(modules))
