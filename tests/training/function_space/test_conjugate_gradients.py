import torch

from pinn_cli.training.function_space.feature_system import conjugate_gradients


def system(size: int = 60, off: float = 1.0) -> torch.Tensor:
    """Of a condition of a million; eigenvalues are ``off`` by a factor that grows along them."""
    generator = torch.Generator().manual_seed(0)
    basis, _ = torch.linalg.qr(torch.randn(size, size, generator=generator, dtype=torch.float64))
    values = torch.logspace(0.0, 6.0, size, dtype=torch.float64) * torch.linspace(1.0, off, size, dtype=torch.float64)
    return (basis * values) @ basis.T


def right(size: int = 60) -> torch.Tensor:
    columns = torch.randn(size, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    columns[:, 1] = 0.0  # one that is solved before it begins
    return columns


def test_a_good_preconditioner_makes_few_iterations():
    matrix = system()
    rough = torch.linalg.inv(system(off=3.0))
    found, iterations, reached = conjugate_gradients(matrix.matmul, rough.matmul, right(), 1e-10, 60)
    torch.testing.assert_close(found, torch.linalg.solve(matrix, right()), rtol=1e-5, atol=1e-8)
    assert iterations < 30
    assert reached <= 1e-10


def test_it_says_how_far_it_got():
    matrix = system()
    _, iterations, reached = conjugate_gradients(matrix.matmul, lambda x: x, right(), 1e-10, 5)
    assert iterations == 5
    assert reached > 1e-3


def test_the_exact_inverse_takes_one_iteration():
    matrix = system()
    found, iterations, _ = conjugate_gradients(matrix.matmul, torch.linalg.inv(matrix).matmul, right(), 1e-6, 60)
    assert iterations == 1
    torch.testing.assert_close(matrix @ found, right(), rtol=1e-5, atol=1e-5)
