"""Commands that several pages give: the same one on the same files is run once, and remembered."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

Run = Callable[..., tuple[int, str, str]]
Answer = tuple[int, str, str]


class Remembered:
    """What commands answered, and the files that they left."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[Answer, dict[str, bytes]]] = {}

    def run(self, run: Run, *words: str) -> Answer:
        """Run a command in the current folder, or put in place what it left there before."""
        before = _files()
        key = (words, *((word, before[word][1]) for word in words if word in before))
        if key not in self._known:
            answer = run(*words)
            left = {
                name: Path(name).read_bytes() for name, now in _files().items() if before.get(name) != now
            }
            self._known[key] = (answer, left)
        answer, left = self._known[key]
        for name, content in left.items():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_bytes(content)
        return answer


def _files() -> dict[str, tuple[int, str]]:
    """Every file below the current folder: when it was written, and its hash."""
    found = [path for path in Path().rglob("*") if path.is_file()]
    return {str(each): (each.stat().st_mtime_ns, sha256(each.read_bytes()).hexdigest()) for each in found}
