from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The reference data that is kept beside the repository."""
    for folder in (ROOT.parent / "shared", ROOT / "shared"):
        if (folder / "data").is_dir():
            return folder
    pytest.skip("the reference data (../shared) is not here")
