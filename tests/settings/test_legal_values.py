import math

import numpy as np
import pytest

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    entries,
    finite_number,
    fraction,
    non_negative_number,
    one_of,
    positive_number,
    true_or_false,
    whole_number,
)


def choice(setting, value):
    return one_of(setting, value, ("a", "b"))


@pytest.mark.parametrize(
    ("check", "legal", "refused"),
    [
        (whole_number, [0, 3, np.int64(3)], [True, 3.0, "3", None, -1, math.inf, 2**63]),
        (finite_number, [-1, 0.5, np.float32(0.5)], [True, "3", None, math.nan, math.inf, 1e31, 10**400]),
        (positive_number, [1e-30, np.float32(0.5)], [0, -1, 1e-31, math.nan, True]),
        (non_negative_number, [0, 2.5], [-1, math.nan, "0"]),
        (fraction, [0.25], [0, 1.0, -0.5, 2, math.nan, True]),
        (true_or_false, [False, True], ["true", 1, None]),
        (choice, ["a"], ["c", None]),
    ],
)
def test_what_is_legal_and_what_is_named(check, legal, refused):
    for value in legal:
        assert check("x", value) == value
    for value in refused:
        with pytest.raises(InputError, match=r"^x=.*: must be"):
            check("x", value)


def test_a_text_has_no_entries():
    assert entries((1, 2)) == [1, 2]
    assert entries("12") == entries(None) == []
