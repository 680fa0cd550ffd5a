"""Problems whose structure and beliefs are those of a finished run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.model.knowledge import Model, ParameterKnowledge
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.inputs import inputs_of
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import FREE, JointPrior, Problem
from pinn_cli.settings.errors import InputError

MODEL_SETTING = "model"


def problem_of_model(
    model: Model, record: Record, updates: bool, acceleration_through: str, initial_motion: str, unknown_force: str
) -> JointProblem:
    """The problem of a new record of an identified structure.

    Args:
        model: What earlier records say.
        record: The new one.
        updates: Whether the parameters are to be known better afterwards. What the model leaves out then hides as much
            of them in this record as in those before, and bounds cut off what they do of all records' posterior; else
            misfit is one more reason for them to be off, and they are what the earlier run's table says.
        acceleration_through: See :class:`pinn_cli.scheme.problem.Problem`.
        initial_motion: Likewise.
        unknown_force: See :func:`pinn_cli.scheme.inputs.inputs_of`.

    Raises:
        InputError: The run's training did not say how uncertain its parameters are.
    """
    known, count = model.known, len(model.parameters)
    if not np.isfinite(known.covariance).all():
        allowed = "a run whose training gives standard deviations of the parameters, as gauss_newton does"
        raise InputError(MODEL_SETTING, model.directory, allowed)
    within = (known.most_probable(model.lower), known.covariance) if updates else known.within(model.lower)
    mean, covariance = within
    std = np.sqrt(np.diag(covariance))
    parameters = [
        replace(p, prescribed=float(m), prior_std=float(s), scale=None, unknown=updates and p.unknown)
        for p, m, s in zip(model.parameters, mean, std, strict=True)
    ]
    nothing = np.zeros(count)
    before = known if updates else ParameterKnowledge(mean, covariance, nothing, nothing, std)
    prior = JointPrior.of(before, model.levels)
    sensors = sensor_parameters(record)
    problem = Problem(
        model.structure.with_values({p: p.prescribed for p in parameters}),
        record,
        (*parameters, *sensors),
        acceleration_through,
        initial_motion,
        inputs=inputs_of(model.structure, record, unknown_force),
        prior=prior.with_independent([p.prior_std for p in sensors]),
    )
    return JointProblem.of(problem)


def problem_going_on(model: Model, record: Record, acceleration_through: str, unknown_force: str) -> JointProblem:
    """The problem of a record that goes on where another one handed over.

    Args:
        model: What is known there.
        record: Begins there.
        acceleration_through: See :class:`pinn_cli.scheme.problem.Problem`.
        unknown_force: See :func:`pinn_cli.scheme.inputs.inputs_of`.
    """
    problem = problem_of_model(model, record, True, acceleration_through, FREE, unknown_force)
    return JointProblem.of(replace(problem.alone, initial_state=model.end))


def given(model: Model | None, scheme: str) -> Model:
    """The model of a scheme that cannot do without.

    Raises:
        InputError: There is none.
    """
    if model is None:
        hint = f"pinn-run model=outputs/... scheme={scheme} data=..."
        raise InputError(MODEL_SETTING, None, f"the directory of a finished run with scheme={scheme}", hint)
    return model


def check_updatable(model: Model) -> None:
    """See that a model has parameters that a record can tell more of.

    Raises:
        InputError: Everything was held fixed.
    """
    if not model.parameters:
        hint = "everything in that run was held fixed (scheme.parameter_uncertainty=0)"
        raise InputError(MODEL_SETTING, model.directory, "a run with uncertain parameters where scheme=update", hint)
