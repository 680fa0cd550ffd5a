"""A record that is simulated (``data=simulated``), and how large it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import INTERSAMPLE_OF_HOLD
from pinn_cli.record.record import MINIMUM_SAMPLES, Frame, Measurements, Record, Truth, check_frame
from pinn_cli.record.steps import at_rest, fastest_rates
from pinn_cli.runs.machine import of_this_machine
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pinn_cli.record.excitation.base import Excitation
    from pinn_cli.record.noise import Noise
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.system.structure import Structure

# Each takes some 50 us at 6 DOFs: two minutes.
MOST_STEPS = 2 * 10**6
# Bytes per DOF: of a step of the simulation (states, forces), at least of a sample of the record and what is estimated
# from it, and of each repeat of a sample.
_STEP, _SAMPLE, _REPEAT = 40, 400, 32


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
        """The noisy record of the true chain, and the truth.

        Raises:
            InputError: The response overflows.
        """
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
    """Refuse a record that this machine cannot simulate.

    Args:
        simulation: Of the record.
        structure: That is simulated.
        repeats: How often the response is measured.

    Raises:
        InputError: Naming ``simulation.samples``, ``system.ndof`` or ``noise.repeats``, the record does not fit into
            memory; naming ``system.k`` or ``system.c``, a connection is so stiff or so damped for its mass that the
            simulation takes too many steps.
    """
    samples, ndof, memory = simulation.samples, structure.ndof, of_this_machine()
    because = f"the record has to fit into the memory of this machine, {memory / 2**30:.3g} GiB"
    most = min(memory // (_SAMPLE * ndof), MOST_STEPS)
    if most < MINIMUM_SAMPLES:
        raise InputError("system.ndof", ndof, f"at most {memory // (_SAMPLE * samples)}", because)
    if samples > most:
        raise InputError("simulation.samples", samples, f"at most {most} with system.ndof={ndof}", because)
    most = memory // (_REPEAT * ndof * samples)
    if repeats > most:
        raise InputError("noise.repeats", repeats, f"at most {most} with this record", because)
    _check_steps(simulation, structure, min(memory // (_STEP * ndof), MOST_STEPS))


def _check_steps(simulation: Simulation, structure: Structure, most: int) -> None:
    intervals = simulation.samples - 1
    if simulation.substeps is not None:
        if simulation.substeps > most // intervals:
            raise InputError("simulation.substeps", simulation.substeps, f"at most {most // intervals}")
        return
    steps = intervals * simulation.steps_per_sample(structure)
    if steps <= most:
        return
    oscillation, decay = fastest_rates(structure)
    stiff = oscillation >= decay
    rate = simulation.step_times_rate * most / simulation.duration
    allowed = f"a natural frequency above {rate / (2.0 * math.pi):.3g} Hz" if stiff else f"a decay above {rate:.3g} 1/s"
    takes = f"the simulation takes {steps:.1e} steps, of which {most:.1e} are allowed"
    name = "k" if stiff else "c"
    sizes = at_rest(structure)[0 if stiff else 1]
    parameter = structure.parameter(name, int(np.argmax(sizes)))
    own, least = abs(parameter.prescribed), float(structure.parameters["m"].min())
    rest = f"at rest its law adds {sizes.max() - own:.3g}; " if sizes.max() > own else ""
    hint = f"{rest}{takes}; a larger mass or a shorter simulation.duration makes them fewer, too"
    raise InputError(
        structure.labels.setting(parameter),
        float(sizes.max()),
        f"small enough for {least:.3g} kg not to have {allowed}",
        hint,
    )
