"""Independent work side by side: numpy and pyarrow let go of the interpreter while they compute."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def together(tasks: dict[str, Callable[[], Any]]) -> dict[str, Any]:
    """Run all tasks, in threads, and return what each of them returns.

    Examples
    --------
    >>> together({"two": lambda: 1 + 1, "four": lambda: 2 + 2})
    {'two': 2, 'four': 4}
    """
    with ThreadPoolExecutor() as pool:
        running = {name: pool.submit(task) for name, task in tasks.items()}
        return {name: task.result() for name, task in running.items()}
