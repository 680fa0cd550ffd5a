"""State-parameter estimation: the motion of every DOF and the parameters that nobody knows (paper, section 4.2)."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import torch

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import FREE, GAUSSIAN_PROCESS
from pinn_cli.scheme.scheme import Beginning, EstimationScheme, Sensors, Through, UnknownForce, check_given
from pinn_cli.scheme.starts import AUTO, Start, Starts, calibrated, checked_starts
from pinn_cli.scheme.unknowns import (
    believed_parameters,
    check_used,
    checked_positive,
    checked_uncertainty,
    initial_values,
    positive_kinds,
    unknown_parameters,
)
from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.building import damped
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

# A ratio for each mode couples all coordinates: of more than so many damping is taken to be Rayleigh's, which does not.
MOST_RATIOS = 30


class StateParameter(EstimationScheme):
    """States and unknown parameters from sparse sensors.

    Args:
        unobserved_fraction, unobserved: See :func:`pinn_cli.scheme.scheme.unobserved_dofs`.
        sensors: What an observed DOF of a simulated record has sensors for.
        unknown: See :func:`pinn_cli.scheme.unknowns.unknown_parameters`.
        initial: What is said about unknown parameters, by kind, name or pattern, see :mod:`pinn_cli.scheme.starts`; of
            a measured structure what is prescribed for the others, of a simulated one nothing: that is the truth.
        starts: ``auto``, or the number of starts at most, of which the most probable solution is kept; ``given``:
            exactly where ``initial`` says.
        positive: Kinds of parameters that cannot be negative; None: see :func:`positive_kinds`.
        prior_width: Prior standard deviation of an unknown parameter over its scale, which is where it starts, or what
            its law says: wide enough to leave the answer to the record.
        parameter_uncertainty: Relative prior standard deviation of every other parameter but the masses; 0 holds them
            fixed, as the paper does.
        acceleration_through, initial_motion, unknown_force: See :class:`pinn_cli.scheme.scheme.EstimationScheme`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "state_parameter"
    has_windows = True

    def __init__(
        self,
        unobserved_fraction: float = 0.4,
        unobserved: str | Sequence[int] | None = (2, 4),
        sensors: Mapping[str, bool] | None = None,
        unknown: str | Sequence[str] | None = None,
        initial: Mapping[str, float | None] | None = None,
        starts: str | int = AUTO,
        positive: Sequence[str] | None = None,
        prior_width: float = 10.0,
        parameter_uncertainty: float = 0.075,
        acceleration_through: Through = "derivative",
        initial_motion: Beginning = FREE,
        unknown_force: UnknownForce = GAUSSIAN_PROCESS,
    ) -> None:
        chosen = Sensors.chosen(sensors, unobserved_fraction, unobserved)
        super().__init__(chosen, acceleration_through, initial_motion, unknown_force)
        self.unknown, self.initial = unknown, initial
        self.starts = checked_starts(starts)
        self.positive = checked_positive(positive)
        self.prior_width = positive_number("scheme.prior_width", prior_width)
        self.parameter_uncertainty = checked_uncertainty(parameter_uncertainty)

    def damped(self, prescribed: Structure, records: Sequence[Record]) -> Structure:
        """See :meth:`Scheme.damped`: an unknown ratio for each mode in the band; modes beyond have the last.

        Where all dampers of a measured structure are missing, or of a finite-element model those of its coordinates,
        and none of them is asked for. Beside supports that move such damping is not of the masses alone: there is none.
        """
        dampers, whole = prescribed.parameters["c"], prescribed.coordinates <= MOST_RATIOS
        split = prescribed.groups[0].incidence.shape[0] if prescribed.is_modal else len(dampers)
        given = prescribed.is_damped_as_whole or prescribed.supports > 0 or not bool(dampers[:split].isnan().all())
        if given or records[0].simulated:
            return prescribed
        if self.unknown is not None and any(p.kind == "c" for p in self._chosen(prescribed, records)):
            return prescribed
        undamped = prescribed.with_parameters(c=torch.cat([torch.zeros_like(dampers[:split]), dampers[split:]]))
        if not whole:
            log.warning("nothing is said of damping: Rayleigh's is unknown, a_0 and a_1 (system.damping)")
            return damped(undamped, {"rayleigh": [None, None]})
        start = self.pose(damped(undamped, {"ratio": None}), records).structure
        modes = NaturalModes.of(start)
        frequencies = np.zeros(1) if modes is None else modes.frequencies
        count = max(1, int((frequencies <= max(map(record_band, records))).sum()))
        names = "zeta" if count == 1 else f"zeta_1 to zeta_{count}"
        log.warning(
            "nothing is said of damping: a ratio for each mode in the band is unknown, %s (system.damping)", names
        )
        return damped(undamped, {"ratio": [None] * count})

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`."""
        record = records[0]
        chosen = self._chosen(prescribed, records)
        check_given(prescribed, chosen)
        positive = positive_kinds(prescribed, self.positive)
        check_used(prescribed, chosen, self.initial, self.positive)
        believed = believed_parameters(prescribed, self.parameter_uncertainty, but=chosen)
        order = {kind: i for i, kind in enumerate(prescribed.parameters)}
        given = self._given(prescribed, record, chosen, positive)

        def posed(start: Mapping[Parameter, Start]) -> JointProblem:
            unknown = [
                self._unknown(replace(p, positive=p.kind in positive), start[p], given.get(p, math.nan)) for p in chosen
            ]
            uncertain = tuple(sorted((*unknown, *believed), key=lambda p: (order[p.kind], p.index)))
            structure = prescribed.with_values({p: p.prescribed for p in unknown})
            return JointProblem.of_records(structure, calibrated(records, start), uncertain, *self.settings)

        starts = Starts(prescribed, records, chosen, given, self.starts)
        first, *others = map(posed, starts)
        elsewhere = cache(lambda: tuple(map(posed, starts.elsewhere())))
        return replace(first, other_starts=tuple(others), elsewhere=elsewhere, compared=starts.compared)

    def _chosen(self, prescribed: Structure, records: Sequence[Record]) -> list[Parameter]:
        return unknown_parameters(prescribed, records, self.unknown, self.unknown_force == FREE)

    def with_record(self, problem: JointProblem, prescribed: Structure, record: Record) -> JointProblem:
        """See :meth:`Scheme.with_record`: by default it is the sensors that say what is unknown."""
        again = copy(self)
        structural = problem.structure.parameters
        again.unknown = [p.name for p in problem.first.uncertain if p.unknown and p.kind in structural]
        return again.pose(prescribed, [record])

    def _given(
        self, prescribed: Structure, record: Record, unknown: Collection[Parameter], positive: Sequence[str]
    ) -> dict[Parameter, float]:
        """What the user says about the unknown parameters."""
        given = initial_values(prescribed, self.initial, positive)
        if not record.simulated:
            given = {p: p.prescribed for p in unknown if math.isfinite(p.prescribed)} | given
        return {parameter: value for parameter, value in given.items() if parameter in unknown}

    def _unknown(self, parameter: Parameter, start: Start, said: float) -> Parameter:
        return replace(
            parameter,
            prescribed=start.value,
            prior_std=self.prior_width * (start.prior_scale or start.scale),
            scale=start.scale,
            said=said,
            unknown=True,
        )
