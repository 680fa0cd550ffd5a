"""How well a linear structure makes of the measured force what the sensors saw: the misfit of its cross spectra."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels, record_band
from pinn_cli.record.cross_spectra import CrossSpectra, band_edges
from pinn_cli.record.inputs import measured_orders
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import LOWEST_BINS
from pinn_cli.scheme.calibration import ChannelDoubts, Doubt
from pinn_cli.system.frequency_response import Acting, FrequencyResponse, real_rows
from pinn_cli.system.parameters import FACTOR
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.system.structure import Structure

# Frequencies at most: a dense matrix is inverted at each.
MOST_FREQUENCIES = 300
# Relative widths of the smoothing, one after the other.
WIDTHS = 0.15, 0.05, 0.015
# Loss factor that every spring has at least: nothing is singular at a resonance then.
LEAST_LOSS = 1e-5
# Damping ratio at which damping starts where it is unknown.
STARTING_RATIO = 0.02
# Power over the noise floor at which a frequency counts half.
ABOVE_FLOOR = 10.0
# How far one start and width may take a parameter, as a logarithm.
FARTHEST = np.log(20.0)
# Evaluations of the misfit for one start and width, at most, and for those that lead to a solution.
START_EVALUATIONS, LAST_EVALUATIONS = 30, 100


def what_acts(record: Record) -> list[Channel] | None:
    """Load cells, supports, and last the ground; None where nothing acts, or where some of it is unknown."""
    supports = {channel.place: channel for channel in channels(record, tuple(SUPPORT))}
    moved = [supports[quantity, i] for i, (quantity, _) in enumerate(measured_orders(record))]
    acting = [*channels(record, (FORCE,)), *moved, *channels(record, (GROUND,))]
    return acting if acting and not record.unmeasured else None


def spectra_under(record: Record, acting: Sequence[Channel]) -> CrossSpectra[Channel]:
    """Of the response and of what acts, up to the end of the record's band."""
    return CrossSpectra.of_bands(record, channels(record), acting, lines_in_band(record))


def lines_in_band(record: Record) -> list[int]:
    """Groups of lines of a spectrum up to the end of the record's band; see :func:`band_edges`."""
    stop = int(np.searchsorted(np.fft.rfftfreq(len(record.time), record.step), record_band(record), side="right"))
    return band_edges(LOWEST_BINS, min(max(stop, LOWEST_BINS + 8), len(record.time) // 2 + 1), MOST_FREQUENCIES)


class LinearStructure:
    """Masses, springs and dampers of which some are unknown: those as logarithms, unknown dampers as one damping ratio.

    A damping ratio of the whole structure is half a loss factor of its springs: at every resonance they do the same.

    Args:
        structure: Its connections that are no damping of the whole; that of a part of a finite-element model is one
            less than its factor.
        known: See :func:`pinn_cli.scheme.starts.linear_parts`.
        typical: (C,), stiffnesses, of which the median stands for that of a connection without a spring.

    Attributes:
        stretch: (C, n), how the coordinates stretch the connections.
        by_supports: (C, S), how supports that move do.
        spring, less: (C,), the number k that is the stiffness of every connection, and what it is less than that.
    """

    def __init__(self, structure: Structure, known: Mapping[str, np.ndarray], typical: np.ndarray) -> None:
        self.known, self.influence, self.shapes = dict(known), structure.with_ground, structure.shapes
        own = np.arange(len(structure.parameters["k"]))
        parts, factors = structure.carriers.get(FACTOR, (own[:0], own[:0]))
        self.spring = np.append(own, len(own) + factors)
        self.less = (self.spring >= len(own)).astype(float)
        stretch = structure.stretch.matrix[np.append(own, parts)].toarray()
        self.stretch, self.by_supports = np.hsplit(stretch, [structure.coordinates])
        self.end, self.typical = last_ends(self.stretch), float(np.median(typical))
        self.free = {kind: np.flatnonzero(np.isnan(self.known[kind])) for kind in ("m", "k", "c", "loss")}
        self.damped, self.lossy = len(self.free["c"]) > 0, len(self.free["loss"]) > 0
        self.count = len(self.free["m"]) + len(self.free["k"]) + self.damped + self.lossy

    def start(self, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """The vector of unknowns at given masses (n,) and stiffnesses (C,)."""
        m, k = np.log(mass[self.free["m"]]), np.log(stiffness[self.free["k"]])
        return np.concatenate(
            (m, k, [np.log(STARTING_RATIO)] * self.damped, [np.log(2.0 * STARTING_RATIO)] * self.lossy)
        )

    def parameters(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """``m`` (n,), ``c``, ``k`` (C,) and ``loss`` (1,) at the unknowns, with which x begins."""
        m, k, c, loss = (self.known[kind].copy() for kind in ("m", "k", "c", "loss"))
        split = len(self.free["m"])
        m[self.free["m"]] = np.exp(x[:split])
        k[self.free["k"]] = np.exp(x[split : split + len(self.free["k"])])
        if self.damped:
            stiffness = self.stiffness(k)
            critical = 2.0 * np.sqrt(
                np.where(stiffness == 0, self.typical, np.maximum(stiffness, 1e-300)) * m[self.end]
            )
            c[self.free["c"]] = np.exp(x[split + len(self.free["k"])]) * critical[self.free["c"]]
        loss[self.free["loss"]] = np.exp(x[self.count - self.lossy : self.count])
        return {"m": m, "c": c, "k": k, "loss": loss}

    def stiffness(self, k: np.ndarray) -> np.ndarray:
        """(C,), of the connections, of the numbers k."""
        return np.asarray(k[self.spring] - self.less)

    def slopes(self, omega: np.ndarray, p: Mapping[str, np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """What every unknown adds to masses (n,) and dynamic stiffnesses (B, C), where the parameters are p."""
        lossy = p["k"][self.spring] * (1.0 + (LEAST_LOSS + p["loss"]) * 1j)
        # Critical damping grows with the roots of mass and stiffness.
        damper = 1j * omega[:, None] * np.where(np.isnan(self.known["c"]), p["c"], 0.0)
        masses, connections, nothing = np.arange(len(p["m"])), self.spring, np.zeros(len(p["m"]))
        for dof in self.free["m"]:
            yield p["m"] * (masses == dof), 0.5 * damper * (self.end == dof)
        for i in self.free["k"]:
            yield nothing, (lossy + 0.5 * damper) * (connections == i)
        if self.damped:
            yield nothing, damper
        if self.lossy:
            yield nothing, 1j * p["loss"] * self.stiffness(p["k"]) * np.ones((len(omega), 1))


class LinearFit:
    """The misfit of one record's cross spectra, as a function of the structure's unknowns and of the channels'.

    What is in doubt of the channels of other records may be among the doubts. See :func:`what_acts`.
    """

    def __init__(self, record: Record, structure: LinearStructure, doubts: Sequence[Doubt] = ()) -> None:
        self.structure, self.duration, n = structure, record.duration, len(structure.influence)
        self.spectra = s = spectra_under(record, what_acts(record) or [])
        self.doubts, self.of_acting = ChannelDoubts(record, s, doubts), s.of_acting
        self.sensed = np.array([sensor.dof for sensor in s.sensors], dtype=int)
        self.sensing = s.differentiation[:, :, None] * structure.shapes.matrix[self.sensed]
        pushed, shaken = np.zeros((2, n, len(s.acting)))
        carried = np.zeros((len(s.omega), len(structure.stretch), len(s.acting)), complex)
        for i, channel in enumerate(s.acting):
            if channel.quantity == FORCE:
                pushed[:, i] = structure.shapes.matrix[channel.dof]
            elif channel.quantity == GROUND:
                shaken[:, i] = structure.influence
            else:
                back = (1j * s.omega[:, None]) ** -channel.order
                carried[:, :, i] = back * structure.by_supports[:, channel.dof]
        self.acting = Acting(pushed, shaken, carried)
        absolute = np.array([c.quantity == "acceleration" and record.frame == "absolute" for c in s.sensors])
        ground = structure.shapes.with_ground
        self.felt = np.zeros(len(absolute)) if ground is None else ground[self.sensed] * absolute
        self.smooth(WIDTHS[0])

    @property
    def ground_shown(self) -> np.ndarray:
        """(S, A), how far sensors feel what acts at once."""
        return np.outer(self.felt, (self.acting.shaken != 0.0).any(axis=0))

    def smooth(self, width: float) -> None:
        """Choose how widely the misfit is smoothed."""
        s, count = self.spectra, len(self.spectra.sensors)
        self.kernel = s.smoothing(width)
        power = self.kernel @ s.power
        share = power / np.maximum(power + ABOVE_FLOOR * s.floor, 1e-300) / np.sqrt(np.maximum(power, 1e-300))
        self.scale = share[:, :count, None] * share[:, None, count:]
        self.common = self.scale * self._smoothed(s.of_both)
        self.size = float(np.sum(np.abs(self.common) ** 2))

    def outline(self, x: np.ndarray) -> float:
        """Squares of the misfit of sizes alone, each channel as large as it comes nearest, whatever is in doubt."""
        cross = (self._response(x).value + self.ground_shown) @ self.of_acting
        size, common = np.abs(self.scale * self._smoothed(cross)), np.abs(self.common)
        gain = (size * common).sum(0) / np.maximum((size**2).sum(0), 1e-300)
        return float(np.sum((gain * size - common) ** 2))

    def aligned(self, x: np.ndarray) -> np.ndarray:
        """The unknowns with every doubtful channel shifted and scaled to where the others want it, one by one."""
        x, doubts, count = x.copy(), self.doubts, self.structure.count
        omega = self.kernel @ self.spectra.omega
        for channel in 2 * doubts.doubtful:
            places = {kind: count + i for kind, i in doubts.places(channel).items()}
            x[list(places.values())] = 0.0
            parts = self._parts(x)
            acts, number = channel >= doubts.sensors, channel - doubts.sensors
            part = self.scale * self._smoothed(parts[number] if acts else parts.sum(0))
            rest = self.scale * self._smoothed(parts.sum(0)) - part if acts else np.zeros_like(part)
            pick = np.ones(part.shape[1], bool) if acts else np.arange(part.shape[1]) == channel
            part, wanted = part[:, pick], (self.common - rest)[:, pick]
            together = (part.conj() * wanted).sum((1, 2))
            sign = -1.0 if acts else 1.0
            gain = 1.0
            if "delay" in places:
                doubt = doubts.doubts[places["delay"] - count]
                tried = doubts.tried_delays(doubt)
                shifted = (np.exp(1j * sign * np.outer(tried * doubt.std, omega)) @ together).real
                best = int(np.argmax(shifted))
                x[places["delay"]], gain = tried[best], float(shifted[best])
            else:
                gain = float(together.real.sum())
            ratio = gain / max(float((np.abs(part) ** 2).sum()), 1e-300)
            if "gain" in places and ratio > 0:
                x[places["gain"]] = float(np.clip(sign * np.log(ratio), -FARTHEST, FARTHEST))
        return x

    def _smoothed(self, values: np.ndarray) -> np.ndarray:
        # Real and imaginary parts side by side: a complex product would take twice as long.
        flat = np.ascontiguousarray(values).reshape(len(values), -1).view(np.float64)
        return (self.kernel @ flat).view(np.complex128).reshape(-1, *values.shape[1:])

    def residual(self, x: np.ndarray) -> np.ndarray:
        """(O, S, F) misfit of the cross spectra."""
        return self.scale * self._smoothed(self._parts(x).sum(0)) - self.common

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(O, S, F, p), of the residual by the unknowns of the structure and of the channels."""
        of_sensors, of_inputs = self.doubts.factors(x[self.structure.count :])
        shown, of_acting = of_sensors[:, :, None], self.of_acting / of_inputs[:, :, None]
        by = [shown * slope @ of_acting for slope in self._response_slopes(x)]
        by += self.doubts.slopes(self._parts(x)) if len(self.doubts) else []
        return np.stack([self.scale * self._smoothed(slope) for slope in by], axis=-1)

    def _parts(self, x: np.ndarray) -> np.ndarray:
        """(F, B, S, F), what each input adds to the cross spectra; all together, (1, B, S, F), without doubts."""
        response = self._response(x).value + self.ground_shown
        if not len(self.doubts):
            return (response @ self.of_acting)[None]
        of_sensors, of_inputs = self.doubts.factors(x[self.structure.count :])
        return np.einsum("bsf,bfg->fbsg", of_sensors[:, :, None] * response, self.of_acting / of_inputs[:, :, None])

    def _response(self, x: np.ndarray) -> FrequencyResponse:
        """Of the structure, but for what accelerometers feel of the ground itself."""
        p, omega = self.structure.parameters(x), self.spectra.omega
        stiffness = self.structure.stiffness(p["k"])
        connection = stiffness * (1.0 + (LEAST_LOSS + p["loss"]) * 1j) + 1j * omega[:, None] * p["c"]
        return FrequencyResponse(omega, self.structure.stretch, self.sensing, self.acting, p["m"], connection)

    def _response_slopes(self, x: np.ndarray) -> Iterator[np.ndarray]:
        """(B, S, F), by every unknown of the structure."""
        response = self._response(x)
        for mass, connection in self.structure.slopes(self.spectra.omega, self.structure.parameters(x)):
            yield response.slope(mass, connection)


class JointFit:
    """The misfits of several records: unknowns of their one structure, then gains and delays of their sensors."""

    def __init__(self, fits: Sequence[LinearFit]) -> None:
        self.fits, self.structure, self.doubts = fits, fits[0].structure, fits[0].doubts

    def smooth(self, width: float) -> None:
        """See :meth:`LinearFit.smooth`."""
        for fit in self.fits:
            fit.smooth(width)

    @property
    def size(self) -> float:
        """Sum of squares of all that there is to explain."""
        return max(sum(fit.size for fit in self.fits), 1e-300)

    def start(self, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """See :meth:`LinearStructure.start`; sensors are as they are believed to be."""
        return np.append(self.structure.start(mass, stiffness), np.zeros(len(self.doubts)))

    def aligned(self, x: np.ndarray) -> np.ndarray:
        """See :meth:`LinearFit.aligned`; a sensor of two records is where the last of them wants it."""
        for fit in self.fits:
            x = fit.aligned(x)
        return x

    def outline(self, x: np.ndarray) -> float:
        """See :meth:`LinearFit.outline`, over all that there is to explain."""
        return sum(fit.outline(x) for fit in self.fits) / self.size

    def misfit(self, x: np.ndarray) -> float:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        return sum(float(np.sum(np.abs(fit.residual(x)) ** 2)) for fit in self.fits) / self.size

    def calibration(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        return self.doubts.calibration(x[self.structure.count :])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(R, p), of all residuals by the unknowns, as real rows."""
        return real_rows(np.concatenate([fit.slopes(x).reshape(-1, len(x)) for fit in self.fits]))

    def fitted(self, x: np.ndarray, most: int) -> tuple[float, np.ndarray]:
        """The misfit and the unknowns at the bottom of the valley that x lies in, or so many evaluations nearer."""
        if not len(x):
            return self.misfit(x), x

        def residual(x: np.ndarray) -> np.ndarray:
            return real_rows(np.concatenate([fit.residual(x).reshape(-1) for fit in self.fits]))

        bounds = (x - FARTHEST, x + FARTHEST)
        solution = least_squares(residual, x, self.slopes, bounds, loss="soft_l1", f_scale=0.3, max_nfev=most)
        return self.misfit(solution.x), solution.x


def last_ends(stretch: np.ndarray) -> np.ndarray:
    """(C,), of every connection, a row of (C, n), the last coordinate that stretches it; of a chain its own mass."""
    return stretch.shape[1] - 1 - np.argmax(stretch[:, ::-1] != 0, axis=1)
