"""A record that is simulated (``data=simulated``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.record import Intersample, Measurements, Record, Truth

if TYPE_CHECKING:
    from pinn_cli.record.excitation.base import Excitation
    from pinn_cli.record.noise import Noise
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.system.structure import Structure

# What the force of a record does between its samples is what the simulator had it do.
INTERSAMPLE_OF_HOLD: dict[str, Intersample] = {"exact": "band_limited", "zero_order": "zero_order_hold"}


@dataclass(frozen=True)
class Simulated:
    """Sensors for every quantity on every DOF of a simulated chain; a scheme keeps those that it observes.

    Attributes:
        excitation: The force, made for the same ndof, duration and samples.
        simulation: How the response is computed; its hold is the record's intersample behaviour.
        noise: What the sensors add.
        kind: The name of the config group's choice.
    """

    excitation: Excitation
    simulation: Simulation
    noise: Noise
    kind: str = "simulated"

    def measure(self, structure: Structure) -> Measurements:
        """The noisy record of the true chain, and the truth.

        Raises:
            InputError: The response overflows.
        """
        response = self.simulation.run(structure, self.excitation.force)
        seen, repeats = self.noise.measured(response)
        intersample = INTERSAMPLE_OF_HOLD[self.simulation.hold]
        unforced = ~self.excitation.forced
        record = Record(**seen.measurable, unforced=unforced, intersample=intersample, repeats=repeats, simulated=True)
        return Measurements(record, Truth(response, structure.parameters_like(np.empty(0))))
