"""A record that is simulated (``data=simulated``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import INTERSAMPLE_OF_HOLD
from pinn_cli.record.record import Frame, Measurements, Record, Truth, check_frame

if TYPE_CHECKING:
    from pinn_cli.record.excitation.base import Excitation
    from pinn_cli.record.noise import Noise
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.system.structure import Structure


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
