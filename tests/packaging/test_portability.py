"""What would keep the package or its tests from being loaded where a system or a Python lacks something."""

import ast
import re
import tomllib
from pathlib import Path

import pytest
import yaml

CHECKOUT = Path(__file__).parents[2]
POSIX_ONLY = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
FILES = sorted(path for folder in ("stickslip_fit", "tests") for path in (CHECKOUT / folder).rglob("*.py"))


def loaded_with(text: str) -> set[str]:
    """The modules that are loaded as soon as a file with this text is."""
    names = set()
    for statement in ast.parse(text).body:
        match statement:
            case ast.Import():
                names |= {each.name.partition(".")[0] for each in statement.names}
            case ast.ImportFrom(module=str(module), level=0):
                names.add(module.partition(".")[0])
    return names


@pytest.mark.slow
def test_no_file_needs_a_posix_system_to_be_loaded():
    texts = {path: path.read_text("utf-8") for path in FILES}
    mentioning = [path for path, text in texts.items() if any(name in text for name in POSIX_ONLY)]
    assert not {path.name: found for path in mentioning if (found := loaded_with(texts[path]) & POSIX_ONLY)}


@pytest.mark.parametrize(
    "path", sorted((CHECKOUT / ".github" / "workflows").glob("*.yml")), ids=lambda path: path.name
)
def test_the_workflows_try_every_python_that_the_package_promises(path):
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]
    promised = {
        match[1] for name in project["classifiers"] if (match := re.fullmatch(r".*:: (3\.\d+)", name))
    }
    assert f">={min(promised, key=lambda name: int(name[2:]))}" == project["requires-python"]
    jobs = yaml.safe_load(path.read_text("utf-8"))["jobs"]
    for job in jobs.values():
        versions = job.get("strategy", {}).get("matrix", {}).get("python")
        assert versions is None or set(versions) == promised


def test_every_dependency_is_pinned_at_or_above_its_lower_bound():
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]
    lines = (CHECKOUT / "constraints.txt").read_text("utf-8").splitlines()
    pins = dict(line.lower().split("==") for line in lines if "==" in line)
    for requirement in project["dependencies"]:
        name, bound = re.fullmatch(r"([\w-]+)(?:\[\w+\])?>=([\d.]+)", requirement).groups()
        assert [int(part) for part in pins[name].split(".")[:3]] >= [
            int(part) for part in bound.split(".")
        ], name
