"""Structures and records that are built and simulated in Python, without the command."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from pinn_cli.api.data import channels_of, refuse_nameless, settings_of_record
from pinn_cli.api.sep005 import placed, table_of_sep005
from pinn_cli.record import record
from pinn_cli.record.between_samples import INTERSAMPLE_OF_HOLD, BandLimited
from pinn_cli.record.clock import Clock
from pinn_cli.record.files.table import TIME_COLUMN
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.simulated import Noise
from pinn_cli.record.simulation import simulate
from pinn_cli.record.steps import substeps_needed
from pinn_cli.record.units import si_factor
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import is_whole_number
from pinn_cli.system import structure
from pinn_cli.system.building import build_chain, law_called, law_settings
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.quantities import GROUND
from pinn_cli.system.topology import build_structure, whole

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd

# Steps of Runge-Kutta per sample, at least: laws that are not smooth have harmonics of the structure's frequencies.
_LEAST_SUBSTEPS = 10


@dataclass(frozen=True, eq=False)
class Record(record.Record):
    """What sensors have measured; see :class:`pinn_cli.record.record.Record`.

    :meth:`pinn_cli.Structure.simulate` makes one, and ``run(..., data=record)`` takes one.

    Example:
        >>> import numpy as np
        >>> from pinn_cli import Structure
        >>> time = np.arange(500) / 50
        >>> record = Structure.chain(ndof=2, m=10.0, c=5.0, k=4e3).simulate(time, {2: np.sin(9.0 * time)})
        >>> record.keep({"acceleration": [1]}).with_noise(40.0).to_frame().columns.tolist()
        ['t', 'acceleration.1', 'force.2']
    """

    def with_noise(self, snr_db: float, seed: int = 0) -> Self:
        """The same with white Gaussian noise on every channel.

        Args:
            snr_db: 10 log10(signal power / noise power) of every channel.
            seed: The same seed gives the same noise; a channel's does not depend on which others there are.

        Raises:
            InputError: Naming ``noise.snr_db`` or ``seed``.
        """
        clean = Response(**{name: getattr(self, name) for name in ("time", *QUANTITIES, GROUND)})
        return replace(self, **Noise(snr_db, seed).added_to(clean).measurable)

    @classmethod
    def from_sep005(cls, series: Any, dofs: Mapping[str, int] | None = None) -> Self:
        """Of time series as SDyPy's SEP 5 has them: maps with ``name``, ``data``, ``unit_str``, and ``fs`` or ``time``.

        ``quantity`` (``a``, ``v``, ``d``, ``f``) says what a channel measures, or else its unit. A DOF without a force
        among the channels carries none.

        Args:
            series: One, or a list of them, on one even clock and without gaps; others are taken by
                ``run(..., data=series)``.
            dofs: Name of a channel to its DOF, from 1, and no others are taken; None: that is the number in its name.

        Raises:
            InputError: What a channel measures, or at which DOF, is not said; or it cannot be used.
        """
        table = table_of_sep005(series, "series") if dofs is None else placed(table_of_sep005(series, "series"), dofs)
        channels = channels_of(table)
        if not channels:
            refuse_nameless(table.columns)
        places = {dof: name for of_quantity in channels.values() for dof, name in of_quantity.items() if dof}
        for dof, name in places.items():
            if not dof.isdecimal() or int(dof) < 1:
                allowed = "a channel of a DOF by its number, from 1"
                raise InputError(f"series[{name!r}]", dof, allowed, "give dofs={...}")
        time = Clock.by_column(table, TIME_COLUMN, None).uniform(0, len(table))
        forced = record.dof_mask([int(dof) for dof in channels.get("force", ())], max(map(int, places), default=1))
        columns: dict[str, Any] = {quantity: np.full((len(time), len(forced)), np.nan) for quantity in QUANTITIES}
        columns["force"][:] = 0.0
        for quantity, of_quantity in channels.items():
            for dof, name in of_quantity.items():
                factor = si_factor(f"series[{name!r}], unit_str", table.hints[name].unit or None, quantity)
                values = factor * table.numbers(name)
                table.refuse_gaps(name, values)
                if quantity == GROUND:
                    columns[GROUND] = values
                else:
                    columns[quantity][:, int(dof) - 1] = values
        return cls(time, **columns, unforced=~forced)

    def to_frame(self) -> pd.DataFrame:
        """A column for each sensor, ``acceleration.3``, and the times ``t``, SI units: what `run` reads as data.

        Raises:
            InputError: It has sensors that are no columns.
        """
        import pandas as pd

        return pd.DataFrame(settings_of_record(self)[0])


@dataclass(frozen=True, eq=False)
class Structure(structure.Structure):
    """Masses that connections hold together; see :class:`pinn_cli.system.structure.Structure`.

    Example:
        >>> from pinn_cli import Structure
        >>> frame = Structure.chain(ndof=2, m=2000.0, c=4500.0, k=[1.5e6, 1.4e6])
        >>> frame.modes()["frequency"].round(3).tolist()
        [2.667, 6.881]
    """

    @classmethod
    def chain(
        cls,
        law: str = "linear",
        *,
        ndof: int | None = None,
        m: float | Sequence[float],
        c: float | Sequence[float],
        k: float | Sequence[float],
        **parameters: Any,
    ) -> Self:
        """A chain: connection i joins DOF i-1 to DOF i, the first one the ground to DOF 1.

        Args:
            law: Of every connection: ``linear``, ``duffing``, ``van_der_pol``, ``power_damping``, ``polynomial``,
                ``friction``, ``jenkins``, ``bouc_wen``, ``baber_noori``, ``gap``, ``spline``, or one of an installed
                plug-in.
            ndof: Number of DOFs; None: as many as the longest list has entries.
            m: Masses, kg; a number for all, or a list from the fixed end.
            c: Damping, N s/m.
            k: Stiffness, N/m.
            **parameters: Of the law, such as ``kappa`` (N/m^3); and its settings.

        Raises:
            InputError: Naming ``system.<parameter>``.
        """
        settings = {name: parameters.pop(name) for name in law_settings(law, "law") if name in parameters}
        given = {"m": m, "c": c, "k": k, **parameters}
        longest = max(map(np.size, given.values()))
        count = longest if ndof is None else ndof
        return cls._of(build_chain(count, law_called(law, settings, "system"), **given))

    @classmethod
    def connected(
        cls,
        dofs: Sequence[str],
        mass: float | Mapping[str, float],
        connections: Mapping[str, Mapping[str, Any]],
        drifts: Mapping[str, Sequence[str]] | None = None,
    ) -> Self:
        """Named coordinates and connections, as ``system=structure`` has them.

        Args:
            dofs: Names of the coordinates.
            mass: Of each, kg; or one number for all.
            connections: Name to ``{"between": [a, b], "law": "linear", "c": 10.0, "k": 5e4}``; an end may be
                ``ground``.
            drifts: Name to a pair ``[a, b]`` whose drift is wanted beside those of the connections.

        Raises:
            InputError: Naming ``system.<setting>``.
        """
        return cls._of(whole(build_structure(dofs, mass, connections, drifts=drifts)))

    @classmethod
    def _of(cls, built: structure.Structure) -> Self:
        return cls(**{field.name: getattr(built, field.name) for field in fields(structure.Structure)})

    def modes(self) -> pd.DataFrame:
        """Natural ``frequency`` (Hz), ``damping_ratio`` and shape (``shape_1`` and so on) of every mode, about rest."""
        import pandas as pd

        modes = NaturalModes.of(self)
        assert modes is not None  # every parameter is given
        table = pd.DataFrame({"mode": np.arange(1, len(modes.squares) + 1), "frequency": modes.frequencies})
        table["damping_ratio"] = modes.damping_ratios
        for dof in range(self.ndof):
            table[f"shape_{self.dof_name(dof)}"] = modes.shapes[dof]
        return table

    def simulate(
        self,
        time: npt.ArrayLike,
        force: npt.ArrayLike | Mapping[int | str, npt.ArrayLike] | Callable[[np.ndarray], np.ndarray] | None = None,
        *,
        ground_acceleration: npt.ArrayLike | None = None,
        initial: npt.ArrayLike | None = None,
        hold: str = "exact",
        frame: str = "absolute",
        method: str = "rk4",
    ) -> Record:
        """The response to a force or to a motion of the ground, as sensors without noise would record it.

        Args:
            time: (N,), s, even; from rest at the first one, unless ``initial`` says otherwise.
            force: DOF (from 1, or its name) to (N,) N, DOFs that are left out carrying none; or (N, ndof); or a
                function from times (M,) to (M, ndof), which may be asked for any time; None: no force.
            ground_acceleration: (N,), m/s^2; None: the ground is at rest.
            initial: Displacement (m) and velocity (m/s) at the first time, (2, ndof), where the coordinates are the
                DOFs.
            hold: What samples of a force do in between: ``exact``, band-limited; ``zero_order``, each holds until the
                next.
            frame: Of the accelerations where the ground moves: ``absolute``, or ``relative`` to it.
            method: ``rk4``; ``dop853``, adaptive with tight tolerances; or ``lsoda``, with implicit steps.

        Returns:
            Every quantity of every DOF: :meth:`pinn_cli.Record.keep` leaves some, and
            :meth:`pinn_cli.Record.with_noise` adds noise.

        Raises:
            InputError: Times that are not even, a force of another shape, a DOF that does not exist; or the response
                overflows.
        """
        times = _even(time)
        acting, forced = self._acting(force, times)
        ground = None
        if ground_acceleration is not None:
            ground = BandLimited(times, _shaped("ground_acceleration", ground_acceleration, times.shape))
        substeps = max(substeps_needed(self, times[1] - times[0]), _LEAST_SUBSTEPS)
        response = simulate(
            self, acting, times, hold, method, substeps, initial=initial, ground=ground, frame=frame  # type: ignore[arg-type]
        )  # fmt: skip
        between = INTERSAMPLE_OF_HOLD[hold]
        return Record(
            **response.measurable, unforced=~forced, intersample=between, frame=frame, dofs=self.labels.dofs  # type: ignore[arg-type]
        )  # fmt: skip

    def _acting(self, force: Any, time: np.ndarray) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]:
        """The force at any time, and which DOFs (ndof,) carry one."""
        if force is None or isinstance(force, Mapping):
            samples, forced = np.zeros((len(time), self.ndof)), np.zeros(self.ndof, dtype=bool)
            for dof, values in (force or {}).items():
                place = self._place(dof)
                samples[:, place], forced[place] = _shaped(f"force[{dof!r}]", values, time.shape), True
            return BandLimited(time, samples), forced
        samples = _shaped("force", force(time) if callable(force) else force, (len(time), self.ndof))
        return force if callable(force) else BandLimited(time, samples), (samples != 0.0).any(axis=0)

    def _place(self, dof: int | str) -> int:
        names = self.labels.dofs
        if isinstance(dof, str) and dof in names:
            return names.index(dof)
        if is_whole_number(dof) and 1 <= int(dof) <= self.ndof:
            return int(dof) - 1
        allowed = f"a DOF from 1 to {self.ndof}" + (f", or one of {', '.join(names)}" if names else "")
        raise InputError("force", dof, allowed, suggestion(str(dof), names))


def _even(time: npt.ArrayLike) -> np.ndarray:
    times = np.asarray(time, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise InputError("time", f"an array of shape {times.shape}", "a vector of two finite times or more")
    step = (times[-1] - times[0]) / (len(times) - 1)
    if step <= 0 or np.abs(np.diff(times) - step).max() > 1e-6 * step:
        raise InputError("time", f"{times[0]:g}, {times[1]:g}, ...", "times that grow by one step")
    return times


def _shaped(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(name, f"an array of shape {array.shape}", f"finite numbers of shape {shape}")
    return array
