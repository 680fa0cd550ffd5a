"""What a training hands to the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.model.knowledge import EndState, HandOver, Misfit, ParameterKnowledge
from pinn_cli.record.response import Response
from pinn_cli.system.parameters import LINEAR_UNITS, Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.doubts.other_damping import DampingDoubt
from pinn_cli.training.noise_model import FoundNoise

if TYPE_CHECKING:
    from pinn_cli.runs.checkpoint import Checkpoints
    from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods


# Called with each row of a history as it comes; it must not change it.
Watch = Callable[[Mapping[str, float]], None]


def unwatched(row: Mapping[str, float]) -> None:
    """Nobody looks on."""


@dataclass(frozen=True, eq=False)
class ParameterEstimate:
    """One system parameter after training.

    Attributes:
        parameter: Which, and what was believed of it.
        estimate: The value that was found.
        std: Posterior standard deviation, NaN where the training gives none.
        lower_90, upper_90: The central 90 % interval.
        held: Whether its most probable value is the bound that it cannot pass; the estimate may lie above, being a
            mean.
    """

    parameter: Parameter
    estimate: float
    std: float = math.nan
    lower_90: float = math.nan
    upper_90: float = math.nan
    held: bool = False

    @property
    def name(self) -> str:
        """Of the parameter, ``k_2``."""
        return self.parameter.name

    @property
    def kind(self) -> str:
        """Of the parameter, ``k``."""
        return self.parameter.kind

    @property
    def unknown(self) -> bool:
        """Whether it was identified from the record alone; otherwise it was prescribed and merely uncertain."""
        return self.parameter.unknown

    @property
    def prescribed(self) -> float:
        """The value that the estimator was given: believed, or where an unknown one started (:attr:`start`)."""
        return self.parameter.prescribed

    @property
    def prior_std(self) -> float:
        """Prior standard deviation, NaN where there was none."""
        return self.parameter.prior_std

    @property
    def start(self) -> float:
        """Where the search for an unknown one started; NaN of one that was prescribed."""
        return self.prescribed if self.unknown else math.nan

    @property
    def believed(self) -> float:
        """What was prescribed; NaN of an unknown one, of which nothing was."""
        return math.nan if self.unknown else self.prescribed


@dataclass(frozen=True)
class Rival:
    """Another solution that explains a record as well as the one that is reported.

    Attributes:
        values: Name of every unknown parameter of the structure to its value there.
        log_odds: Natural logarithm of how many times as probable it is.
    """

    values: dict[str, float]
    log_odds: float


@dataclass(frozen=True, eq=False)
class Story:
    """A way in which a record came about that the model does not quite explain, and how well it predicts the record.

    Attributes:
        name: Where the error is: a ``force`` that the model leaves out, white or a ``smooth force``, or in the response
            of a ``free run``.
        parameters: What they are then.
        free_run: NMSE, %, of a simulation from the estimated state at the first sample, mean over the response sensors;
            infinite where there is none.
        segments: The same of many short ones, each from the estimated state at its own first sample.
        force_std, correlation_time: Of a smooth force on a DOF, N, and s; NaN of others.
        place: The DOF that it acts on alone; "" where it is any.
    """

    name: str
    parameters: tuple[ParameterEstimate, ...]
    free_run: float
    segments: float
    force_std: float = math.nan
    correlation_time: float = math.nan
    place: str = ""


@dataclass(frozen=True)
class Disagreement:
    """How far one of several records pulls their common parameters from where all of them together ended.

    Attributes:
        square: Sum of squares of the pull, over its variance if all records measured one structure.
        freedom: Over so many directions: what ``square`` then is on average.
        alone: Name of every parameter to what the record by itself says.
    """

    square: float
    freedom: int
    alone: dict[str, float]


@dataclass(frozen=True)
class Change:
    """A parameter that is not what the records before say.

    Attributes:
        parameter: Which; ``prescribed`` is what they say.
        by: How far it moved, in its unit, if nothing else did but what is found as well.
        std: Of that.
        chance: Probability that uncertainty alone makes so much of it, among all parameters that were looked at.
        share: Probability that it is this parameter and no other one, given that one changed.
    """

    parameter: Parameter
    by: float
    std: float
    chance: float
    share: float


@dataclass(frozen=True, eq=False)
class Changes:
    """What a record says against those before it.

    Attributes:
        parameters: That were compared, p of them.
        found: What changed, the most certain one first.
        chance: Probability that uncertainty alone makes them differ so much as a whole, after these changes.
        improbable: Below which that is no chance.
        before: (p,), what the earlier records say of every parameter, and ``before_std``.
        alone: (p,), what the record says by itself, and ``alone_std``; NaN where it says nothing.
    """

    parameters: tuple[Parameter, ...]
    found: tuple[Change, ...]
    chance: float
    improbable: float
    before: np.ndarray
    before_std: np.ndarray
    alone: np.ndarray
    alone_std: np.ndarray


@dataclass(frozen=True)
class Doubt:
    """A number that the model does not have, and with which the record is far more probable.

    Attributes:
        kind: What it is: ``friction``, ``cubic term``, ``tilt``, ``high_pass``, ``m``, ...
        of: Whose, for people: ``connection 2``, ``acceleration of DOF 3``.
        value: Of it; how much more of a mass, the corner of a filter.
        std: Standard deviation.
        unit: Of both.
        log_odds: Natural logarithm of how many times as probable the record is, those before it freed as well.
        moves: Standard deviations by which what is reported moves if all doubts that are told are freed, of what moves
            most.
        moved: What that is: a parameter, or the displacement of a DOF.
        shape: What its force does not grow with: a gap, an elongation at which it slips (m), a frequency (Hz); NaN:
            nothing.
        share: Part of what the model leaves out, at the frequencies at which the structure moves, that it explains
            beside those before it.
    """

    kind: str
    of: str
    value: float
    std: float
    unit: str
    log_odds: float
    moves: float
    moved: str
    shape: float = math.nan
    share: float = math.nan


@dataclass(frozen=True)
class Peak:
    """The largest absolute value of a history, and where uncertainty may take it, over its whole length.

    Attributes:
        quantity: A response quantity, ``drift`` or ``connection_force``.
        of: Name of the DOF or of the connection.
        unit: Of the values.
        peak: Of the structure with the mean parameters.
        time: When, s.
        lower_90, upper_90: The central 90 % interval of the peak, whenever it comes.
    """

    quantity: str
    of: str
    unit: str
    peak: float
    time: float
    lower_90: float
    upper_90: float


@dataclass(frozen=True, eq=False)
class ConnectionHistories:
    """What the connections do, in the order of the structure's; of modes, those that were added to them.

    Attributes:
        elongation: (N, D), m, :attr:`Structure.drifts`, the connections' own first.
        elongation_std: (N, D), m, its posterior standard deviation.
        force: (N, C), N, internal forces, those of memory included.
        force_std: (N, C), N.
        dissipated: (C,), J, energy dissipated over the record; None where the training does not say.
        dissipated_std: (C,), J.
    """

    elongation: np.ndarray
    elongation_std: np.ndarray
    force: np.ndarray
    force_std: np.ndarray
    dissipated: np.ndarray | None = None
    dissipated_std: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimated motion of every DOF, its uncertainty, the parameters, and how they were found.

    Attributes:
        response: Posterior mean of every quantity at the record's times, (N, n).
        std: Posterior standard deviation of the same; NaN where the training gives none.
        parameters: The parameters that were uncertain, in the order of the connections.
        history: One row per iteration: ``iteration``, ``seconds``, every loss term ``loss_*`` and every weight
            ``weight_*``.
        summary: Iterations, stop reason and the like, for run.json.
        correlation: (p, p), posterior correlation of ``parameters``, None where the training gives none.
        likelihoods: Of the parameters, for a sampler; None where no posterior distribution was asked for.
        connections: Their elongations; None where the training gives no standard deviations of them.
        records: Of every record that was solved together with others, each with its own parameters and the same
            history; empty of a lone one. Motion, forces and noise are then those of the first, ``parameters`` and
            ``correlation`` those of all records.
        rivals: Other solutions that explain the record as well.
        damping_doubt: What spectra say of another model of damping; None where no spectra told the parameters.
        disagreements: Of every record that was solved together with others; none of a lone one.
        known: Of ``parameters``, before bounds cut anything off; None where the training gives no covariance.
        end: Where the motion ended; None where the training does not say, or of several records.
        handed_over: To a record that goes on before this one ends; None where there is none.
        changes: Of the structure since the records before, where it was looked for any.
        peaks: Of a prediction.
        misfit: The force that the model leaves out; None where the training does not say.
        doubts: What the model may lack; nothing where the training does not say.
        structure: In whose coordinates the motion is; None: in those of the problem.
        stories: Of a record that the model does not quite explain, the one that ``parameters`` are of first.
        left: Name of a sensor with samples of its own to measured minus estimated, in what it feels, at these (J,); NaN
            where it felt no motion within the record. Empty where the training does not say.
        noise: That was found.
        of_motion: The parameters that ``response`` goes with, where ``parameters`` are of another story; None: these.
    """

    response: Response
    std: Response
    parameters: list[ParameterEstimate]
    history: pd.DataFrame
    summary: dict[str, Any]
    correlation: np.ndarray | None = None
    likelihoods: ParameterLikelihoods | None = None
    connections: ConnectionHistories | None = None
    records: tuple[Estimate, ...] = ()
    rivals: tuple[Rival, ...] = ()
    damping_doubt: DampingDoubt | None = None
    disagreements: tuple[Disagreement, ...] = ()
    known: ParameterKnowledge | None = None
    end: EndState | None = None
    handed_over: HandOver | None = None
    changes: Changes | None = None
    peaks: tuple[Peak, ...] = ()
    misfit: Misfit | None = None
    doubts: tuple[Doubt, ...] = ()
    structure: Structure | None = None
    stories: tuple[Story, ...] = ()
    left: Mapping[str, np.ndarray] = field(default_factory=dict)
    noise: FoundNoise = field(default_factory=FoundNoise)
    of_motion: tuple[ParameterEstimate, ...] | None = None

    def state_std(self, structure: Structure, sample: int) -> list[np.ndarray]:
        """Deviations of ``response.state(sample)``; 0 of modal coordinates and of hidden forces."""
        motion = [] if structure.is_modal else [np.nan_to_num(x) for x in self.std.state(sample)]
        return [*motion, *(np.zeros_like(x) for x in self.response.state(sample)[len(motion) :])]

    @property
    def before_any_record(self) -> list[ParameterEstimate]:
        """The parameters beside what was believed of them before the first record that they were learned from.

        The prior of an update is what earlier records say. That it narrows little says nothing of how well all
        determine a parameter.
        """
        if self.changes is None or self.known is None:
            return self.parameters
        return [
            replace(p, parameter=replace(p.parameter, prior_std=float(std)))
            for p, std in zip(self.parameters, self.known.first_std, strict=True)
        ]

    @property
    def by_record(self) -> tuple[Estimate, ...]:
        """That of every record; the first one's with what is said of all."""
        if not self.records:
            return (self,)
        first, *others = self.records
        joint = replace(self, records=(), disagreements=())
        return (replace(joint, parameters=first.parameters, correlation=first.correlation), *others)


@dataclass(frozen=True, eq=False)
class RunContext:
    """What a training may know about the run that it is part of.

    Attributes:
        device: Where networks whose weights are all trained live, ``cpu`` or ``cuda``; fixed features stay on the CPU.
        seed: Seeds the weights of networks that start from random ones.
        directory: The run's directory, for what a stage keeps; None in a library call that keeps nothing.
        progress: Whether to draw a progress bar (never when the output is no terminal).
        checkpoints: Of the trainings; None in a library call that keeps none.
        watch: Who looks on as the history grows.
    """

    device: str = "cpu"
    seed: int = 0
    directory: Path | None = None
    progress: bool = field(default=False)
    checkpoints: Checkpoints | None = None
    watch: Watch = unwatched


def estimated_structure(prescribed: Structure, parameters: Iterable[ParameterEstimate]) -> Structure:
    """The prescribed chain with its estimated parameters in place; those that are not listed stay as prescribed.

    Those of sensors are left out.

    Raises:
        ValueError: A parameter that the chain does not have.
    """
    values = {}
    for estimate in parameters:
        if estimate.kind in CALIBRATION_UNITS:
            continue
        if estimate.parameter.index >= len(prescribed.parameters.get(estimate.kind, ())):
            raise ValueError(f"the chain of {prescribed.ndof} DOFs has no parameter {estimate.name}")
        values[estimate.parameter] = estimate.estimate
    return prescribed.with_values(values)


def sought_laws(structure: Structure, parameters: Iterable[ParameterEstimate]) -> set[int]:
    """The connections, from 0, of whose law a parameter was unknown."""
    of_laws = [p for p in parameters if p.unknown and p.kind in structure.members and p.kind not in LINEAR_UNITS]
    return {int(structure.members[p.kind][p.parameter.index]) for p in of_laws}
