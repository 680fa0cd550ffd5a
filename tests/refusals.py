"""What is refused says so in one line."""

from collections.abc import Callable
from typing import Any

import pytest

from pinn_cli.settings.errors import InputError


def refusal(call: Callable[..., Any], *arguments: Any, **settings: Any) -> str:
    """What a call says that refuses its input, in one line."""
    with pytest.raises(InputError) as error:
        call(*arguments, **settings)
    assert "\n" not in str(error.value)
    return str(error.value)
