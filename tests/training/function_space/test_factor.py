"""Cholesky factors in panels."""

from __future__ import annotations

import pytest
import torch

from pinn_cli.training.function_space import system
from pinn_cli.training.function_space.system import cholesky


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "PANEL", 8)


def positive(size: int) -> torch.Tensor:
    root = torch.randn(size, size + 3, generator=torch.Generator().manual_seed(size), dtype=torch.float64)
    return root @ root.mT + torch.eye(size)


@pytest.mark.parametrize("size", [1, 31, 32, 40, 45])
def test_the_factor_is_that_of_the_library(size):
    matrix = positive(size)
    found = cholesky(matrix.tril())  # what stands above the diagonal is not read
    assert found is not None
    torch.testing.assert_close(found, torch.linalg.cholesky(matrix), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("size", [5, 45])
def test_an_indefinite_matrix_has_none(size):
    matrix = positive(size)
    matrix[-1, -1] = -1.0
    assert cholesky(matrix) is None
