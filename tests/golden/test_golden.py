"""What the command line makes of one log: every number is the one that was kept.

`log.csv` is simulated from `plan.toml` and the reference law with a warm-up of 3 % and 60 min. A change that
means to change a number says so, and keeps the new file: `stickslip-fit` with the arguments below.
"""

import csv
import json
from pathlib import Path

import pytest

HERE = Path(__file__).parent
OF_A_RUN = {"versions", "command", "seconds", "checksum"}
ROUNDING = 1e-11  # a residual is the difference of two logarithms near 10


def leaves(value, path=""):
    """Every number and word of a result with its path, but for what differs from run to run."""
    if isinstance(value, dict):
        for key in value.keys() - OF_A_RUN:
            yield from leaves(value[key], f"{path}.{key}")
    elif isinstance(value, list):
        yield f"{path}, length", len(value)
        for place, item in enumerate(value):
            yield from leaves(item, f"{path}[{place}]")
    else:
        yield path, value


def cell(text):
    try:
        return float(text)
    except ValueError:
        return text


def content(path):
    if path.suffix == ".json":
        return dict(leaves(json.loads(path.read_text("utf-8"))))
    with path.open(encoding="utf-8", newline="") as file:
        rows = [{name: cell(text) for name, text in row.items()} for row in csv.DictReader(file)]
    return dict(leaves(rows))


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def differences(path, kept, rtol):
    new, old = content(path), content(kept)
    assert new.keys() == old.keys()
    for key, value in old.items():
        if is_number(value) and is_number(new[key]):
            if new[key] != pytest.approx(value, rel=rtol, abs=ROUNDING, nan_ok=True):
                yield f"{key}: {value!r} -> {new[key]!r}"
        elif new[key] != value:
            yield f"{key}: {value!r} -> {new[key]!r}"


@pytest.mark.parametrize(
    ("arguments", "file", "rtol"),
    [
        pytest.param("fit log.csv --cause thermal-warm-up --json new.json", "fit.json", 1e-6, id="fit"),
        pytest.param("fit log.csv --json new.json", "plain_fit.json", 1e-9, id="plain fit"),
        pytest.param("anova log.csv --json new.json", "anova.json", 1e-9, id="anova"),
        pytest.param("diagnose log.csv --json new.json", "diagnosis.json", 1e-6, id="diagnose"),
        pytest.param("compare log.csv --numbers .", "accuracy.csv", 1e-6, id="compare"),
        pytest.param("predict fit.json plan.toml -o new.csv", "predict.csv", 1e-9, id="predict"),
    ],
)
def test_the_numbers_are_those_kept(run, tmp_path, monkeypatch, arguments, file, rtol):
    for name in ("log.csv", "plan.toml", "fit.json"):
        (tmp_path / name).write_bytes((HERE / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    status, _, complained = run(*arguments.split())
    assert status == 0, complained
    written = (tmp_path / name for name in ("new.json", "new.csv", file))
    new = next(path for path in written if path.exists())
    assert not list(differences(new, HERE / file, rtol))
