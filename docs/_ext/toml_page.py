"""The keys of every TOML file, from the models that read them."""

import json
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from markdown import code, table, text

from stickslip_fit._toml import TomlTable
from stickslip_fit.causes.law_file import FormulaFile
from stickslip_fit.logs.plan_reader import PlanFile
from stickslip_fit.machine.machine_file import JointsFile, MachineFile
from stickslip_fit.simulation.truth import LawFile
from stickslip_fit.step.stage_file import StageFile
from stickslip_fit.studies.plan import StudyFile

FILES: dict[str, type[TomlTable]] = {
    "plan": PlanFile,
    "law": LawFile,
    "study": StudyFile,
    "stage": StageFile,
    "machine": MachineFile,
    "joints": JointsFile,
    "formula": FormulaFile,
}
Row = tuple[str, str, str, str, str]


def schemas() -> dict[str, str]:
    """The JSON schema of each file."""
    return {name: json.dumps(model.model_json_schema(), indent=1) for name, model in FILES.items()}


def page() -> str:
    """A table of keys for each file."""
    return "\n\n".join(_section(name, model.model_json_schema()) for name, model in FILES.items())


def _section(name: str, schema: dict[str, Any]) -> str:
    rows = []
    # One row for all units that a key may have.
    for _, same in groupby(_rows(schema, schema.get("$defs", {})), lambda row: (row[0], row[4] or row[1])):
        rows_of_field = list(same)
        place, _, without, advice, meaning = rows_of_field[0]
        keys = ", ".join(code(row[1]) for row in rows_of_field)
        rows.append((place, keys, without, f"{_sentence(meaning)} {text(_sentence(advice))}".strip()))
    listed = table(["table", "key", "without it", "meaning"], rows)
    return (
        f"## Keys of a {name} file\n\n{listed}\n\n{{download}}`JSON schema </generated/schemas/{name}.json>`"
    )


def _rows(schema: dict[str, Any], tables: dict[str, Any], place: str = "") -> Iterator[Row]:
    needed = {key for rule in schema.get("allOf", ()) for one in rule["oneOf"] for key in one["required"]}
    for key, entry in schema["properties"].items():
        items = entry.get("items", entry)
        kinds = [kind["$ref"].rpartition("/")[2] for kind in items.get("anyOf", [items]) if "$ref" in kind]
        if kinds:
            inside = f"{place}.{key}".strip(".")
            listed = [list(_rows(tables[kind], tables, inside)) for kind in kinds]
            shown = f"[[{inside}]]" if "items" in entry else f"[{inside}]"
            for row in dict.fromkeys(row for rows in listed for row in rows):
                label, names = _name_variants(kinds, tables)
                of = [name for name, rows in zip(names, listed, strict=True) if row in rows]
                mark = "" if len(of) == len(listed) else f", {label}{' and '.join(of)}"
                yield (row[0] or code(shown) + mark, *row[1:])
        else:
            usual = json.dumps(entry.get("default"), ensure_ascii=False)
            without = "" if usual in ("null", '""', "[]") else code(usual)
            meaning = entry.get("description", "")
            yield "", key, "must be given" if key in needed else without, entry["title"], meaning


def _name_variants(names: list[str], tables: dict[str, Any]) -> tuple[str, list[str]]:
    """What tells the variants of a table apart: the kind that each is for, or the joint."""
    kinds = [tables[name]["properties"].get("kind", {}).get("const") for name in names]
    return ("", kinds) if all(kinds) else ("joint ", [str(number) for number in range(1, len(names) + 1)])


def _sentence(phrase: str) -> str:
    return "" if phrase in ("", "give a text in quotes") else f"{phrase[0].upper()}{phrase[1:].rstrip('.')}."
