from __future__ import annotations

import pytest

from pinn_cli.record.files import base


@pytest.fixture
def in_this_process(monkeypatch):
    """Files are read in this process, where what a bad one does to its reader is not what a test is about."""
    monkeypatch.setattr(base, "read_apart", lambda own, path, wanted: own.tables(path, wanted))
