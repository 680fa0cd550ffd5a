"""A solver that makes results up."""

from __future__ import annotations

import pytest
from fake_solver import FakeSolver


@pytest.fixture
def solver() -> FakeSolver:
    return FakeSolver()


@pytest.fixture(autouse=True)
def quick_digests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Composing a configuration takes a tenth of a second; true digests have tests of their own."""
    monkeypatch.setattr("pinn_cli.paper.robustness.scored._settings_digest", "".join)
