"""one_blas_thread: linear algebra in one thread, for computations with many small matrices."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps


def one_blas_thread[**Given, Result](function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Have a function's matrix products run in one thread each.

    Threads within a product of small matrices wait for each other most of the time: beside other programs a
    diagnosis takes several times as long with them. What runs in other threads of the program meanwhile has
    one, too.
    """

    @wraps(function)
    def limited(*args: Given.args, **options: Given.kwargs) -> Result:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **options)

    return limited
