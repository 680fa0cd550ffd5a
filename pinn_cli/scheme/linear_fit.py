"""How well a linear structure makes of the measured force what the sensors saw: the misfit of its cross spectra."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pinn_cli.record.channels import Channel, channels, record_band
from pinn_cli.record.cross_spectra import CrossSpectra, band_edges
from pinn_cli.record.record import Record
from pinn_cli.record.response import GROUND
from pinn_cli.record.spectrum import LOWEST_BINS
from pinn_cli.record.supports import told_by
from pinn_cli.scheme.channel_doubts import ChannelDoubts
from pinn_cli.system.flexibility import Flexibility, Slopes
from pinn_cli.system.quantities import FORCE, SUPPORT

# Frequencies at most: a dense matrix is inverted at each.
MOST_FREQUENCIES = 300
# Relative width of the smoothing, to begin with.
WIDEST = 0.15
# Loss factor that every spring has at least: nothing is singular at a resonance then.
LEAST_LOSS = 1e-5
# Damping ratio at which damping starts where it is unknown.
DAMPING = 0.02
# Power over the noise floor at which a frequency counts half.
ABOVE_FLOOR = 10.0
# How far one start and width may take a parameter, as a logarithm.
FARTHEST = np.log(20.0)
# Evaluations of the misfit for one start and width, at most.
EVALUATIONS = 30


def what_acts(record: Record) -> list[Channel] | None:
    """Load cells, supports, and last the ground; None where nothing acts, or where some of it is unknown."""
    supports = {channel.place: channel for channel in channels(record, tuple(SUPPORT))}
    moved = [supports[quantity, i] for i, (quantity, _) in enumerate(told_by(record))]
    acting = [*channels(record, (FORCE,)), *moved, *channels(record, (GROUND,))]
    return acting if acting and np.isfinite(record.force).all() else None


def spectra_under(record: Record, acting: Sequence[Channel]) -> CrossSpectra[Channel]:
    """Of the response and of what acts, up to the end of the record's band."""
    stop = int(np.searchsorted(np.fft.rfftfreq(len(record.time), record.step), record_band(record), side="right"))
    stop = min(max(stop, LOWEST_BINS + 8), len(record.time) // 2 + 1)
    return CrossSpectra.of_bands(record, channels(record), acting, band_edges(LOWEST_BINS, stop, MOST_FREQUENCIES))


@dataclass(frozen=True, eq=False)
class Driven:
    """A linear structure under what acts.

    Attributes:
        parameters: See :meth:`LinearFit.parameters`.
        flexibility: (B, n, n).
        moved: (B, n, F), displacements for one of what acts.
        shown: (B, S, 1), what sensors show of what they feel.
        of_acting: (B, F, F), spectra of what acts with those that are shown of it.
        parts: (F, B, S, F), what each of what acts adds to the cross spectra; empty where no channel is in doubt.
        cross: (B, S, F), the cross spectra of what sensors and what acts show.
    """

    parameters: Mapping[str, np.ndarray]
    flexibility: np.ndarray
    moved: np.ndarray
    shown: np.ndarray
    of_acting: np.ndarray
    parts: np.ndarray
    cross: np.ndarray


class LinearFit:
    """Masses, stiffnesses and the damping of a structure as logarithms, and the misfit of its frequency response.

    A damping ratio of the whole structure is half a loss factor of its springs: at every resonance they do the same.

    Args:
        record: What was measured; see :func:`what_acts`.
        stretch, known: See :func:`pinn_cli.scheme.screening.screened`.
        typical: (C,), stiffnesses, of which the median stands for that of a connection without a spring.
        influence: See :func:`pinn_cli.scheme.screening.screened`.
        doubted: A channel whose gain and delay are in doubt, whatever is said of it.
    """

    def __init__(
        self,
        record: Record,
        stretch: np.ndarray,
        known: Mapping[str, np.ndarray],
        typical: np.ndarray,
        influence: np.ndarray | None = None,
        doubted: Channel | None = None,
    ) -> None:
        n = len(known["m"])
        self.spectra = s = spectra_under(record, what_acts(record) or [])
        doubts = ChannelDoubts(record, s, doubted)
        self.doubts = doubts if len(doubts) and s.acting else None
        self.known = {"loss": np.zeros(1)} | dict(known)
        self.stretch = stretch[:, :n]
        self.end, self.typical = last_ends(self.stretch), float(np.median(typical))
        self.free = {kind: np.flatnonzero(np.isnan(self.known[kind])) for kind in ("m", "k", "c", "loss")}
        self.damped, self.lossy = len(self.free["c"]) > 0, len(self.free["loss"]) > 0
        self.count = len(self.free["m"]) + len(self.free["k"]) + self.damped + self.lossy
        self.sensed = np.array([sensor.dof for sensor in s.sensors], dtype=int)
        absolute = [sensor.quantity == "acceleration" and record.frame == "absolute" for sensor in s.sensors]
        self.absolute = np.array(absolute)[:, None]
        self.influence = np.ones(n) if influence is None else influence
        self.act(s.acting, s.of_acting, stretch[:, n:])
        self.smooth(WIDEST)

    def act(self, acting: Sequence[Channel], spectra: np.ndarray, by_supports: np.ndarray) -> None:
        """Choose what acts, and its spectra (B, F, F).

        It pushes DOFs (n, F), moves supports, which stretches connections (B, C, F), or shakes all (n, F).
        """
        omega, self.of_acting = self.spectra.omega, spectra
        self.pushed, self.shaken = np.zeros((2, len(self.influence), len(acting)))
        self.carried = np.zeros((len(omega), len(self.stretch), len(acting)), complex)
        for i, channel in enumerate(acting):
            if channel.quantity == FORCE:
                self.pushed[channel.dof, i] = 1.0
            elif channel.quantity == GROUND:
                self.shaken[:, i] = self.influence
            else:
                self.carried[:, :, i] = (1j * omega[:, None]) ** -channel.order * by_supports[:, channel.dof]
        self.felt = self.absolute * self.shaken[self.sensed]

    def smooth(self, width: float) -> None:
        """Choose how widely the misfit is smoothed."""
        s, count = self.spectra, len(self.spectra.sensors)
        self.kernel = s.smoothing(width)
        power = self.kernel @ s.power
        told = power / np.maximum(power + ABOVE_FLOOR * s.floor, 1e-300) / np.sqrt(np.maximum(power, 1e-300))
        self.scale = told[:, :count, None] * told[:, None, count:]
        self.common = self.scale * self._smoothed(s.of_both)
        self.size = float(np.sum(np.abs(self.common) ** 2))
        self.scatter = 0.0
        if s.scatter is not None:
            by_chance = np.einsum("ob,bsf->osf", self.kernel**2 / s.count, s.scatter[:, :count])
            self.scatter = float(np.sum(self.scale**2 * by_chance))

    def start(self, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """The vector of unknowns at given masses (n,) and stiffnesses (C,)."""
        m, k = (
            np.where(np.isnan(self.known[kind]), value, self.known[kind])
            for kind, value in (("m", mass), ("k", stiffness))
        )
        damping = [np.log(DAMPING)] * self.damped + [np.log(2.0 * DAMPING)] * self.lossy
        in_doubt = np.zeros(0 if self.doubts is None else len(self.doubts))
        return np.concatenate((np.log(m[self.free["m"]]), np.log(k[self.free["k"]]), damping, in_doubt))

    def parameters(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """``m`` (n,), ``c``, ``k`` (C,) and ``loss`` (1,) at the unknowns x; unknown dampers have one damping ratio."""
        m, k, c, loss = (self.known[kind].copy() for kind in ("m", "k", "c", "loss"))
        split = len(self.free["m"])
        m[self.free["m"]] = np.exp(x[:split])
        k[self.free["k"]] = np.exp(x[split : split + len(self.free["k"])])
        if self.damped:
            critical = 2.0 * np.sqrt(np.where(k == 0, self.typical, np.maximum(k, 1e-300)) * m[self.end])
            c[self.free["c"]] = np.exp(x[split + len(self.free["k"])]) * critical[self.free["c"]]
        loss[self.free["loss"]] = np.exp(x[self.count - self.lossy : self.count])
        return {"m": m, "c": c, "k": k, "loss": loss}

    def calibration(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        return {} if self.doubts is None else self.doubts.calibration(x[self.count :])

    def outline(self, x: np.ndarray) -> float:
        """Squares of the misfit of sizes alone, each channel as large as it comes nearest, whatever is in doubt."""
        cross = self._driven(x, doubted=False).cross
        size, common = np.abs(self.scale * self._smoothed(cross)), np.abs(self.common)
        gain = (size * common).sum(0) / np.maximum((size**2).sum(0), 1e-300)
        return float(np.sum((gain * size - common) ** 2))

    def aligned(self, x: np.ndarray) -> np.ndarray:
        """The unknowns with every doubtful channel shifted and scaled to where the others want it, one by one."""
        if self.doubts is None:
            return x
        x, doubts = x.copy(), self.doubts
        omega = self.kernel @ self.spectra.omega
        for channel in 2 * doubts.doubtful:
            places = {kind: self.count + i for kind, i in doubts.places(channel).items()}
            x[list(places.values())] = 0.0
            here = self._driven(x)
            acts, number = channel >= doubts.sensors, channel - doubts.sensors
            own = self.scale * self._smoothed(here.parts[number] if acts else here.cross)
            rest = self.scale * self._smoothed(here.cross) - own if acts else np.zeros_like(own)
            pick = np.ones(own.shape[1], bool) if acts else np.arange(own.shape[1]) == channel
            own, wanted = own[:, pick], (self.common - rest)[:, pick]
            together = (own.conj() * wanted).sum((1, 2))
            sign = -1.0 if acts else 1.0
            gain = 1.0
            if "delay" in places:
                doubt = doubts.doubts[places["delay"] - self.count]
                tried = doubts.tried_delays(doubt)
                shifted = (np.exp(1j * sign * np.outer(tried * doubt.std, omega)) @ together).real
                best = int(np.argmax(shifted))
                x[places["delay"]], gain = tried[best], float(shifted[best])
            else:
                gain = float(together.real.sum())
            ratio = gain / max(float((np.abs(own) ** 2).sum()), 1e-300)
            if "gain" in places and ratio > 0:
                x[places["gain"]] = float(np.clip(sign * np.log(ratio), -FARTHEST, FARTHEST))
        return x

    def _smoothed(self, values: np.ndarray) -> np.ndarray:
        # Real and imaginary parts side by side: a complex product would take twice as long.
        flat = np.ascontiguousarray(values).reshape(len(values), -1).view(np.float64)
        return (self.kernel @ flat).view(np.complex128).reshape(-1, *values.shape[1:])

    def residual(self, x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """(O, S, F) misfit of the cross spectra and, if wanted, its slopes (O, S, F, p)."""
        here = self._driven(x)
        residual = self.scale * self._smoothed(here.cross) - self.common
        if not slopes:
            return residual, np.empty(0)
        by = [*self._slopes(here), *([] if self.doubts is None else self.doubts.slopes(here.cross, here.parts))]
        return residual, np.stack([self.scale * self._smoothed(slope) for slope in by], axis=-1)

    def _slopes(self, here: Driven) -> Iterator[np.ndarray]:
        """(B, S, F), of the cross spectra by every unknown of the structure."""
        s, p = self.spectra, here.parameters
        seen = here.shown * s.differentiation[:, :, None] * here.flexibility[:, self.sensed]
        driven = here.moved @ here.of_acting
        slopes = Slopes(
            seen,
            seen @ self.stretch.T,
            s.omega[:, None, None] ** 2 * driven - self.shaken @ here.of_acting,
            self.stretch @ driven + self.carried @ here.of_acting,
        )
        spring = 1.0 + (LEAST_LOSS + p["loss"]) * 1j
        # Critical damping grows with the root of mass and stiffness.
        damper = 1j * s.omega[:, None] * np.where(np.isnan(self.known["c"]), p["c"], 0.0)
        masses, connections = np.arange(len(p["m"])), np.arange(len(p["k"]))
        for dof in self.free["m"]:
            yield slopes.by(p["m"] * (masses == dof), 0.5 * damper * (self.end == dof))
        for i in self.free["k"]:
            yield slopes.by(np.zeros(len(masses)), (p["k"] * spring + 0.5 * damper) * (connections == i))
        for stiffer in [damper] * self.damped + [1j * p["loss"] * p["k"] + 0.0 * damper] * self.lossy:
            yield slopes.by(np.zeros(len(masses)), stiffer)

    def _driven(self, x: np.ndarray, doubted: bool = True) -> Driven:
        """At the unknowns x, those of the channels included or not."""
        s, p = self.spectra, self.parameters(x)
        connection = p["k"] * (1.0 + (LEAST_LOSS + p["loss"]) * 1j) + 1j * s.omega[:, None] * p["c"]
        flexibility = Flexibility(s.omega, self.stretch, p["m"], connection).matrix
        pulled = self.stretch.T @ (connection[:, :, None] * self.carried)
        moved = flexibility @ (self.pushed - p["m"][:, None] * self.shaken - pulled)
        response = s.differentiation[:, :, None] * moved[:, self.sensed] + self.felt
        shown, of_acting, parts = np.ones((1, 1, 1)), self.of_acting, np.empty(0)
        if self.doubts is None or not doubted:
            return Driven(p, flexibility, moved, shown, of_acting, parts, response @ of_acting)
        of_sensors, of_inputs = self.doubts.factors(x[self.count :])
        shown, of_acting = of_sensors[:, :, None], of_acting / of_inputs[:, :, None]
        parts = np.einsum("bsf,bfg->fbsg", shown * response, of_acting)
        return Driven(p, flexibility, moved, shown, of_acting, parts, parts.sum(0))


class JointFit:
    """The same of several records of one structure: one vector of unknowns, and the misfits of all of them.

    Gain and delay of a sensor that has one name in two records are one gain and one delay.

    Args:
        each: Of every record; they differ in their spectra and in what is in doubt of their channels.

    Attributes:
        doubts: Kind and name of the gauge, of everything that is in doubt.
    """

    def __init__(self, each: Sequence[LinearFit]) -> None:
        self.each = each
        self.known, self.free, self.stretch, self.count = each[0].known, each[0].free, each[0].stretch, each[0].count
        self.parameters = each[0].parameters
        of_each = [() if fit.doubts is None else fit.doubts.doubts for fit in each]
        std: dict[tuple[str, str], float] = {}
        for doubt in (doubt for own in of_each for doubt in own):
            std.setdefault((doubt.kind, doubt.gauge), doubt.std)
        self.doubts = list(std)
        # Of every record's own unknowns the places among all of them, and one over their unit, that of the first.
        structure = np.arange(self.count)
        self.places = [
            np.append(structure, [self.count + self.doubts.index((d.kind, d.gauge)) for d in own]).astype(int)
            for own in of_each
        ]
        self.rates = [
            np.append(np.ones(self.count), [std[d.kind, d.gauge] / d.std if d.kind == "delay" else 1.0 for d in own])
            for own in of_each
        ]

    def smooth(self, width: float) -> None:
        """See :meth:`LinearFit.smooth`."""
        for fit in self.each:
            fit.smooth(width)

    @property
    def size(self) -> float:
        """Sum of squares of all that there is to explain."""
        return max(sum(fit.size for fit in self.each), 1e-300)

    def start(self, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """See :meth:`LinearFit.start`."""
        return np.append(self.each[0].start(mass, stiffness)[: self.count], np.zeros(len(self.doubts)))

    def _own(self, x: np.ndarray) -> list[tuple[LinearFit, np.ndarray]]:
        """Every record's fit and its own unknowns."""
        return [(fit, x[at] * rate) for fit, at, rate in zip(self.each, self.places, self.rates, strict=True)]

    def aligned(self, x: np.ndarray) -> np.ndarray:
        """See :meth:`LinearFit.aligned`; a sensor of two records is where the last of them wants it."""
        x = x.copy()
        for (fit, own), at, rate in zip(self._own(x), self.places, self.rates, strict=True):
            x[at] = fit.aligned(own) / rate
        return x

    def outline(self, x: np.ndarray) -> float:
        """See :meth:`LinearFit.outline`, over all that there is to explain."""
        return sum(fit.outline(own) for fit, own in self._own(x)) / self.size

    def misfit(self, x: np.ndarray) -> float:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        residuals = [fit.residual(own, slopes=False)[0] for fit, own in self._own(x)]
        return sum(float(np.sum(np.abs(residual) ** 2)) for residual in residuals) / self.size

    def calibration(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        out: dict[str, dict[str, float]] = {}
        for fit, own in self._own(x):
            for name, numbers in fit.calibration(own).items():
                out[name] = numbers | out.get(name, {})
        return out

    @property
    def scatter(self) -> float:
        """See :class:`pinn_cli.scheme.screening.Candidate`."""
        return min(sum(fit.scatter for fit in self.each) / self.size, 1.0)

    def fitted(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The misfit and the unknowns at the bottom of the valley that x lies in."""
        if not len(x):
            return self.misfit(x), x

        def residual(x: np.ndarray) -> np.ndarray:
            return _real(np.concatenate([fit.residual(own, slopes=False)[0].reshape(-1) for fit, own in self._own(x)]))

        def jacobian(x: np.ndarray) -> np.ndarray:
            return _real(np.concatenate([self._slopes(i, own, len(x)) for i, (_, own) in enumerate(self._own(x))]))

        bounds = (x - FARTHEST, x + FARTHEST)
        found = least_squares(residual, x, jacobian, bounds, loss="soft_l1", f_scale=0.3, max_nfev=EVALUATIONS)
        return self.misfit(found.x), found.x

    def _slopes(self, record: int, own: np.ndarray, unknowns: int) -> np.ndarray:
        """Of one record's residuals, by all unknowns."""
        slopes = self.each[record].residual(own, slopes=True)[1].reshape(-1, len(own)) * self.rates[record]
        out = np.zeros((len(slopes), unknowns), complex)
        out[:, self.places[record]] = slopes
        return out


def last_ends(stretch: np.ndarray) -> np.ndarray:
    """(C,), of every connection, a row of (C, n), the last coordinate that stretches it; of a chain its own mass."""
    last: np.ndarray = stretch.shape[1] - 1 - np.argmax(stretch[:, ::-1] != 0, axis=1)
    return last


def _real(values: np.ndarray) -> np.ndarray:
    return np.concatenate((values.real, values.imag))
