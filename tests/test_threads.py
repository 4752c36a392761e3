"""Threads of linear algebra: one within a diagnosis, as many as before after it."""

import inspect

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import stickslip_fit as ssf
from stickslip_fit._threads import one_blas_thread


def blas_threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_products_run_in_one_thread_also_where_a_function_fails():
    seen: list[int] = []

    @one_blas_thread
    def fail(number: int) -> None:
        seen.extend([number, *blas_threads()])
        raise ValueError("as asked")

    with threadpool_limits(2, "blas"):
        before = blas_threads()
        with pytest.raises(ValueError, match="as asked"):
            fail(3)
        assert set(before) == {2}
        assert seen == [3] + [1] * len(before)
        assert blas_threads() == before


@pytest.mark.parametrize(
    "function",
    [ssf.diagnose, ssf.diagnose_table, ssf.Diagnosis.measure_gain, ssf.analyze_variance, ssf.analyze_formula],
)
def test_what_has_many_small_matrices_is_limited_and_keeps_its_signature(function):
    assert function.__wrapped__.__name__ == function.__name__
    assert inspect.signature(function) == inspect.signature(function.__wrapped__)
