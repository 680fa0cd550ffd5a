from __future__ import annotations

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


@pytest.mark.parametrize("value", [3, np.int64(3)])
def test_whole_numbers_of_python_and_numpy_pass(value):
    assert whole_number("x", value) == 3


@pytest.mark.parametrize("value", [True, 3.0, "3", None, -1, math.inf])
def test_what_is_no_whole_number_is_named(value):
    with pytest.raises(InputError, match="^x="):
        whole_number("x", value)


@pytest.mark.parametrize("value", [True, "3", None, math.nan, math.inf])
def test_what_is_no_finite_number_is_named(value):
    for check in (finite_number, positive_number, non_negative_number, fraction):
        with pytest.raises(InputError, match="^x="):
            check("x", value)


def test_positive_excludes_zero():
    assert positive_number("x", np.float32(0.5)) == 0.5
    with pytest.raises(InputError, match="> 0"):
        positive_number("x", 0)


def test_non_negative_includes_zero():
    assert non_negative_number("x", 0) == 0.0
    with pytest.raises(InputError, match="x=-1: must be a finite number >= 0"):
        non_negative_number("x", -1)


@pytest.mark.parametrize("value", [0, 1.0, -0.5, 2])
def test_a_fraction_excludes_its_ends(value):
    assert fraction("x", 0.25) == 0.25
    with pytest.raises(InputError, match="must be a number between 0 and 1; 0.5 is usual"):
        fraction("x", value, "0.5 is usual")


@pytest.mark.parametrize("value", ["true", 1, None])
def test_true_or_false_is_nothing_else(value):
    assert true_or_false("x", False) is False
    with pytest.raises(InputError, match="must be true or false"):
        true_or_false("x", value)


def test_a_text_has_no_entries():
    assert entries((1, 2)) == [1, 2]
    assert entries("12") == []
    assert entries(None) == []


def test_choices_are_listed():
    assert one_of("x", "a", ("a", "b")) == "a"
    with pytest.raises(InputError, match="one of a, b"):
        one_of("x", "c", ("a", "b"))
