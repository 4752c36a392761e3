"""Decompositions are made where others do not converge; those of few rows are those of the whole matrix."""

import numpy as np
import pytest

from stickslip_fit._linalg import ridge_inverse, square_root, svd


@pytest.fixture
def failing(monkeypatch):
    def fail(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fail)


@pytest.mark.parametrize("shape", [(7, 4), (4, 7), (3, 6, 2), (2, 3, 5, 5)])
def test_the_other_algorithm_takes_its_place(failing, shape):
    matrices = np.random.default_rng(1).standard_normal(shape)
    left, singular, right = svd(matrices)
    k = min(shape[-2:])
    assert (left.shape[-1], singular.shape, right.shape[-2]) == (k, (*shape[:-2], k), k)
    assert left * singular[..., None, :] @ right == pytest.approx(matrices, abs=1e-13)
    assert left.swapaxes(-1, -2) @ left == pytest.approx(
        np.broadcast_to(np.eye(k), (*shape[:-2], k, k)), abs=1e-13
    )
    assert np.all(np.diff(singular) <= 0)


def test_what_is_no_number_is_no_matrix(failing):
    with pytest.raises(np.linalg.LinAlgError):
        svd(np.array([[1.0, np.nan]]))


@pytest.mark.parametrize("n", [1, 6, 25])
def test_the_inverse_by_rows_is_that_of_the_whole_matrix(n):
    rng = np.random.default_rng(n)
    rows, precision = rng.standard_normal((n, 30)) * rng.uniform(0.1, 10, 30), rng.uniform(0.5, 50.0, 30)
    inverse = ridge_inverse(rows, precision, 1e-9)
    assert inverse == pytest.approx(np.linalg.inv(rows.T @ rows + np.diag(precision)), rel=1e-8, abs=1e-12)


def test_no_inverse_by_rows_where_a_pseudo_inverse_would_leave_out_a_direction():
    rng = np.random.default_rng(2)
    rows, precision = 1e3 * rng.standard_normal((4, 9)), np.ones(9)
    matrix = rows.T @ rows + np.diag(precision)
    size = np.sqrt(np.diag(matrix))
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(size, size))
    share = eigenvalues[0] / eigenvalues[-1]
    assert ridge_inverse(rows, precision, 2.0 * share) is None
    assert ridge_inverse(rows, precision, share / 1e3) is not None


@pytest.mark.parametrize(("n", "q"), [(3, 8), (8, 3), (5, 5)])
def test_a_square_root_by_rows_or_columns(n, q):
    rng = np.random.default_rng(n)
    rows, root = rng.standard_normal((n, q)), rng.standard_normal((q, max(q - 1, 1)))
    found = square_root(rows, root @ root.T)
    assert found.shape == (n, min(n, q))
    assert found @ found.T == pytest.approx(rows @ root @ root.T @ rows.T, abs=1e-12)
