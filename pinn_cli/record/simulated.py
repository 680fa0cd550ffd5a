"""A record that is simulated (``data=simulated``), the white Gaussian noise of its sensors, and its size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from pinn_cli.record.between_samples import INTERSAMPLE_OF_HOLD
from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.record.record import MINIMUM_SAMPLES, Frame, Measurements, Record, Truth, check_frame
from pinn_cli.record.response import MEASURED_QUANTITIES, QUANTITIES, Repeats, Response
from pinn_cli.record.simulation import Simulation
from pinn_cli.record.steps import at_rest, rates
from pinn_cli.runs.process import of_this_machine
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import LARGEST_LEGACY_SEED, is_finite_number, one_of, whole_number
from pinn_cli.system.quantities import GROUND
from pinn_cli.system.structure import Structure

STREAMS = ("independent", "shared")
# Noise of 1e-15 times the signal, which is the last digit of a number.
LARGEST_SNR_DB = 300
# Seeds of one repeat's channels are consecutive: far enough apart for chains of a thousand DOFs.
REPEAT_STRIDE = 1000
# Each takes some 50 us at 6 DOFs: two minutes.
MOST_SIMULATED_STEPS = 2 * 10**6
# Bytes per DOF: of a step of the simulation (states, forces), at least of a sample of the record and what is estimated
# from it, and of each repeat of a sample.
_STEP, _SAMPLE, _REPEAT = 40, 400, 32


@dataclass(frozen=True)
class Noise:
    """White Gaussian noise with SNR = 10 log10(signal power / noise power) per channel; power is the mean square.

    Attributes:
        snr_db: dB; None for no noise.
        seed: Each channel draws from a stream of its own, derived from (seed, quantity, DOF), so that a channel's noise
            does not depend on which others there are.
        seeds: None, or quantity to seed: channel i (from 0) then draws from legacy ``RandomState(seeds[quantity] + i)``
            as the authors' do.
        repeats: How often the same response is measured.
        repeat_streams: ``independent``: every repeat has noise of its own. ``shared``, with ``seeds``: repeat r (from
            0) of channel i draws from ``RandomState(seeds[quantity] + i + r)``: the seed grows by one from channel to
            channel and from repeat to repeat, so that neighbouring channels share most of their noise.

    Raises:
        InputError: Naming ``noise.<setting>`` or ``seed``.
    """

    snr_db: float | None = None
    seed: int = 0
    seeds: Mapping[str, int] | None = None
    repeats: int = 1
    repeat_streams: Annotated[str, STREAMS] = "independent"

    def __post_init__(self) -> None:
        if self.snr_db is not None and not (is_finite_number(self.snr_db) and abs(self.snr_db) <= LARGEST_SNR_DB):
            allowed = f"a number of dB between -{LARGEST_SNR_DB} and {LARGEST_SNR_DB}, or null for no noise"
            raise InputError("noise.snr_db", self.snr_db, allowed)
        whole_number("seed", self.seed)
        if self.seeds is not None:
            if not isinstance(self.seeds, Mapping) or set(self.seeds) - {GROUND} != set(QUANTITIES):
                allowed = f"null or one seed for each of {', '.join(QUANTITIES)}, and {GROUND} where the ground moves"
                raise InputError("noise.seeds", self.seeds, allowed)
            for quantity, seed in self.seeds.items():
                whole_number(f"noise.seeds.{quantity}", seed, most=LARGEST_LEGACY_SEED)
        whole_number("noise.repeats", self.repeats, least=1)
        one_of("noise.repeat_streams", self.repeat_streams, STREAMS)
        if self.repeat_streams == "shared" and self.seeds is None:
            raise InputError("noise.repeat_streams", "shared", "independent, or noise.seeds given")
        if self.repeats > 1 and self.snr_db is None:
            raise InputError("noise.repeats", self.repeats, "1 where there is no noise (noise.snr_db=null)")

    def added_to(self, response: Response, repeat: int = 0) -> Response:
        """The response, which is not changed, as sensors would show it at one of the repeats, counted from 0.

        Every channel that is not identically zero has noise, so of the forces those of forced DOFs.

        Raises:
            InputError: ``seeds`` have none for the ground that moves.
        """
        if self.snr_db is None:
            return response
        noisy = {}
        for quantity, clean in _histories(response).items():
            values = clean.copy()
            if self.seeds is not None and quantity not in self.seeds:
                raise InputError("noise.seeds", dict(self.seeds), f"with a seed for {quantity}")
            for i in np.flatnonzero(np.any(values != 0.0, axis=0)):
                deviation = math.sqrt(np.mean(values[:, i] ** 2) / 10.0 ** (self.snr_db / 10.0))
                values[:, i] += deviation * self._drawn(quantity, int(i), len(values), repeat)
            noisy[quantity] = values
        return _with_histories(response, noisy)

    def _drawn(self, quantity: str, i: int, samples: int, repeat: int) -> np.ndarray:
        """(samples,), standard normal, of channel i of a quantity."""
        if self.seeds is not None:
            stride = 1 if self.repeat_streams == "shared" else REPEAT_STRIDE
            return np.random.RandomState(self.seeds[quantity] + stride * repeat + i).standard_normal(samples)
        # The first repeat is what a single measurement with this seed is.
        entropy = [self.seed, MEASURED_QUANTITIES.index(quantity), i, *([repeat] if repeat else [])]
        return np.random.default_rng(entropy).standard_normal(samples)

    def measured(self, response: Response) -> tuple[Response, Repeats | None]:
        """The mean of all repeats, and their scatter; of a single one itself, and None."""
        if self.repeats == 1:
            return self.added_to(response), None
        return averaged([self.added_to(response, repeat) for repeat in range(self.repeats)])


def _histories(response: Response) -> dict[str, np.ndarray]:
    """Quantity to (N, channels); the ground's one channel comes last, where it moves."""
    histories = {quantity: getattr(response, quantity) for quantity in QUANTITIES}
    ground = response.ground_acceleration
    return histories if ground is None else {**histories, GROUND: ground[:, None]}


def _with_histories(response: Response, histories: Mapping[str, np.ndarray]) -> Response:
    """The reverse of :func:`_histories`."""
    given = {name: values[:, 0] if name == GROUND else values for name, values in histories.items()}
    return replace(response, **given)


def averaged(measured: Sequence[Response]) -> tuple[Response, Repeats]:
    """Mean of repeats, (N, n) each, and their scatter about it."""
    repeats = [_histories(response) for response in measured]
    histories = {q: np.stack([repeat[q] for repeat in repeats]) for q in repeats[0]}
    means = {q: values.mean(axis=0) for q, values in histories.items()}
    square = {q: np.sum((values - means[q]) ** 2, axis=(0, 1)) for q, values in histories.items()}
    first = measured[0]
    return _with_histories(first, means), Repeats(len(measured), len(first.time), square)


@dataclass(frozen=True)
class Simulated:
    """Sensors for every quantity on every DOF of a simulated chain; a scheme keeps those that it observes.

    Attributes:
        excitation: The force, and how the ground moves, made for the same ndof, duration and samples.
        simulation: How the response is computed; its hold is the record's intersample behaviour.
        noise: What the sensors add.
        frame: What accelerometers measure where the ground moves: ``absolute``, or ``relative`` to the ground.
        kind: The name of the config group's choice.

    Raises:
        InputError: Naming ``data.frame``: it does not exist, or is relative to a ground at rest.
    """

    excitation: Excitation
    simulation: Simulation
    noise: Noise
    frame: Frame = "absolute"
    kind: str = "simulated"

    def __post_init__(self) -> None:
        check_frame(self.frame, self.excitation.ground is not None, "excitation=ground_motion moves it")

    def measure(self, structure: Structure) -> Measurements:
        """The noisy record of the true chain, and the truth; a response that overflows is refused."""
        response = self.simulation.run(structure, self.excitation.force, self.excitation.ground, self.frame)
        seen, repeats = self.noise.measured(response)
        intersample = INTERSAMPLE_OF_HOLD[self.simulation.hold]
        unforced = ~self.excitation.forced
        record = Record(
            **seen.measurable, unforced=unforced, intersample=intersample, repeats=repeats, simulated=True,
            frame=self.frame,
        )  # fmt: skip
        return Measurements(record, Truth(response, structure.parameters_like(np.empty(0))))


def check_size(simulation: Simulation, structure: Structure, repeats: int = 1) -> None:
    """Refuse a record that this machine cannot simulate: one that does not fit into memory, by its setting.

    Or a connection (``system.k``, ``system.c``) so stiff or so damped for its mass that it takes too many steps.
    """
    samples, ndof, memory = simulation.samples, structure.ndof, of_this_machine()
    because = f"the record has to fit into the memory of this machine, {memory / 2**30:.3g} GiB"
    most = min(memory // (_SAMPLE * ndof), MOST_SIMULATED_STEPS)
    if most < MINIMUM_SAMPLES:
        raise InputError("system.ndof", ndof, f"at most {memory // (_SAMPLE * samples)}", because)
    if samples > most:
        raise InputError("simulation.samples", samples, f"at most {most} with system.ndof={ndof}", because)
    most = memory // (_REPEAT * ndof * samples)
    if repeats > most:
        raise InputError("noise.repeats", repeats, f"at most {most} with this record", because)
    _check_steps(simulation, structure, min(memory // (_STEP * ndof), MOST_SIMULATED_STEPS))


def _check_steps(simulation: Simulation, structure: Structure, most: int) -> None:
    intervals = simulation.samples - 1
    if simulation.substeps is not None:
        if simulation.substeps > most // intervals:
            raise InputError("simulation.substeps", simulation.substeps, f"at most {most // intervals}")
        return
    steps = intervals * simulation.steps_per_sample(structure)
    if steps <= most:
        return
    oscillation, decay = rates(structure).max(axis=1)
    name, rate = "k" if oscillation >= decay else "c", simulation.step_times_rate * most / simulation.duration
    sizes = at_rest(structure)[0 if name == "k" else 1]
    parameter, least = structure.parameter(name, int(np.argmax(sizes))), float(structure.parameters["m"].min())
    has = (
        f"a natural frequency above {rate / (2.0 * math.pi):.3g} Hz" if name == "k" else f"a decay above {rate:.3g} 1/s"
    )
    hint = f"the simulation takes {steps:.1e} steps; a larger mass or a shorter simulation.duration makes them fewer"
    allowed = f"small enough for {least:.3g} kg not to have {has}"
    raise InputError(structure.labels.setting(parameter), float(sizes.max()), allowed, hint)
