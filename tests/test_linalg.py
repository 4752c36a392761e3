"""A decomposition for which divide and conquer does not converge is made all the same."""

import numpy as np
import pytest

from stickslip_fit._linalg import svd


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
