from __future__ import annotations

import math

import numpy as np
import pytest

from pinn_cli.errors import InputError
from pinn_cli.legal_values import entries, finite_number, one_of, positive_number, whole_number


@pytest.mark.parametrize("value", [3, np.int64(3)])
def test_whole_numbers_of_python_and_numpy_pass(value):
    assert whole_number("x", value) == 3


@pytest.mark.parametrize("value", [True, 3.0, "3", None, -1, math.inf])
def test_what_is_no_whole_number_is_named(value):
    with pytest.raises(InputError, match="^x="):
        whole_number("x", value)


@pytest.mark.parametrize("value", [True, "3", None, math.nan, math.inf])
def test_what_is_no_finite_number_is_named(value):
    for check in (finite_number, positive_number):
        with pytest.raises(InputError, match="^x="):
            check("x", value)


def test_positive_excludes_zero():
    assert positive_number("x", np.float32(0.5)) == 0.5
    with pytest.raises(InputError, match="> 0"):
        positive_number("x", 0)


def test_a_text_has_no_entries():
    assert entries((1, 2)) == [1, 2]
    assert entries("12") == []
    assert entries(None) == []


def test_choices_are_listed():
    assert one_of("x", "a", ("a", "b")) == "a"
    with pytest.raises(InputError, match="one of a, b"):
        one_of("x", "c", ("a", "b"))
