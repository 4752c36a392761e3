"""Small pieces of Markdown."""

from collections.abc import Iterable, Sequence


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are Markdown already."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def text(plain: str) -> str:
    """Plain text, so that nothing in it is taken for markup."""
    return "".join(f"\\{letter}" if letter in "\\`*_[]<>$|{}" else letter for letter in plain)


def code(plain: str) -> str:
    """Code within a line."""
    return f"``{plain}``" if "`" not in plain else f"```{plain}```"
