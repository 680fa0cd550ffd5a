"""Prediction: what an identified structure will do under a force or ground motion, without any response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pinn_cli.model.knowledge import Model
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import FREE, REST
from pinn_cli.scheme.scheme import Scheme
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, true_or_false, whole_number
from pinn_cli.system.structure import Structure

STARTS_ALLOWED = "rest, or {displacement: [...], velocity: [...]} with a number for each DOF"


class Predict(Scheme):
    """A free run of an identified structure.

    Args:
        model: The finished run.
        start: ``rest``, or displacement (m) and velocity (m/s) of every DOF at the first sample; one that is left out
            is zero.
        draws: How many structures are simulated for the bands.
        measured_input: Whether the force and the ground's motion have noise: what their spectra show, else that of the
            run's sensors as far as their spectra allow.

    Raises:
        InputError: A setting outside its range, or no model.
    """

    name = "predict"
    predicts = True

    def __init__(
        self,
        model: Model | None,
        start: str | Mapping[str, Sequence[float]] = REST,
        draws: int = 200,
        measured_input: bool = True,
    ) -> None:
        self.model = self.given(model)
        self.start = _checked_start(start, self.model.structure)
        self.draws = whole_number("scheme.draws", draws, least=20, most=100_000)
        self.measured_input = true_or_false("scheme.measured_input", measured_input)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`: the force alone."""
        blank = {quantity: np.full_like(getattr(record, quantity), np.nan) for quantity in RESPONSE_QUANTITIES}
        return replace(record, **blank, calibrated=(), responds=False)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`.

        Raises:
            InputError: A response was measured; or something acts that nobody knows.
        """
        record = self.only_one(records)
        if record.observed.any() or record.calibrated:
            hint = "scheme.predict sees no response: data.holdout scores against a column"
            raise InputError("data", "columns of a response", "forces and the ground alone with scheme=predict", hint)
        if record.unmeasured:
            hint = f"a free run needs {record.unmeasured}"
            raise InputError("data.force", "null", "columns of all that acts with scheme=predict", hint)
        if record.unforced.all() and record.measured_ground is None and not record.supports:
            raise InputError("data.force", "{}", "a column, or data.ground_acceleration", "nothing moves the structure")
        known, misfit = self.model.known, self.model.misfit
        if misfit is not None:  # of it the parameters hide no more than there is at their frequencies
            known = replace(known, told=misfit.at_motion * known.told)
        return JointProblem.of_model(replace(self.model, known=known), record, False, "derivative", FREE, FREE)


def _checked_start(start: Any, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity (n,) of the coordinates."""
    zeros = np.zeros(structure.coordinates)
    if start == REST:
        return zeros, zeros
    if not isinstance(start, Mapping) or not start or not set(start) <= {"displacement", "velocity"}:
        raise InputError("scheme.start", start, STARTS_ALLOWED)
    if structure.is_modal:
        raise InputError("scheme.start", dict(start), "rest with a finite-element model", "its coordinates are modes")
    states = []
    for name in ("displacement", "velocity"):
        values = entries(start.get(name, zeros.tolist()))
        if len(values) != len(zeros) or not all(is_finite_number(value) for value in values):
            raise InputError(f"scheme.start.{name}", values, f"a list of {len(zeros)} numbers, one for each DOF")
        states.append(np.array(values, dtype=float))
    return states[0], states[1]
