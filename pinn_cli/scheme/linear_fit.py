"""How well a linear structure makes of the measured force what the sensors saw: the misfit of its cross spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from pinn_cli.scheme.channel_doubts import ChannelDoubts
from pinn_cli.scheme.cross_spectra import CrossSpectra

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
# Frequencies next to each other that a Hann window makes one.
TOGETHER = 1.5
# Evaluations of the misfit for one start and width, at most.
EVALUATIONS = 30


class LinearFit:
    """Masses, stiffnesses and the damping of a structure as logarithms, and the misfit of its frequency response.

    A damping ratio of the whole structure is half a loss factor of its springs: at every resonance they do the same.

    Args:
        spectra: Of the record.
        stretch, known: See :func:`pinn_cli.scheme.screening.screened`.
        typical: (C,), stiffnesses, of which the median stands for that of a connection without a spring.
        influence: See :func:`pinn_cli.scheme.screening.screened`.
        doubts: What is in doubt of the channels; None: nothing.
        width: Of the smoothing, to begin with.
    """

    def __init__(
        self,
        spectra: CrossSpectra,
        stretch: np.ndarray,
        known: Mapping[str, np.ndarray],
        typical: np.ndarray,
        influence: np.ndarray | None = None,
        doubts: ChannelDoubts | None = None,
        width: float = WIDEST,
    ) -> None:
        self.doubts = doubts if doubts is not None and len(doubts) else None
        n = len(known["m"])
        self.influence = np.ones(n) if influence is None else influence
        self.spectra, self.known = spectra, {"loss": np.zeros(1)} | dict(known)
        self.stretch, self.by_supports = stretch[:, :n], stretch[:, n:]
        self.end, self.typical = last_ends(self.stretch), float(np.median(typical))
        self.free = {kind: np.flatnonzero(np.isnan(self.known[kind])) for kind in ("m", "k", "c", "loss")}
        self.damped, self.lossy = len(self.free["c"]) > 0, len(self.free["loss"]) > 0
        self.count = len(self.free["m"]) + len(self.free["k"]) + self.damped + self.lossy
        self.smooth(width)

    def smooth(self, width: float) -> None:
        """Choose how widely the misfit is smoothed."""
        s = self.spectra
        self.kernel = s.smoothing(width)
        sensed, driven = self.kernel @ s.of_sensors, self.kernel @ s.of_acting
        size = sensed[:, :, None] * driven[:, None, :]
        heard = (driven / np.maximum(driven + ABOVE_FLOOR * s.force_floor, 1e-300))[:, None, :]
        seen = (sensed / np.maximum(sensed + ABOVE_FLOOR * s.sensor_floor, 1e-300))[:, :, None]
        self.scale = heard * seen / np.sqrt(np.maximum(size, 1e-300))
        self.common = self.scale * self._smoothed(s.of_both)
        self.size = float(np.sum(np.abs(self.common) ** 2))
        # The window makes neighbouring frequencies go together.
        by_chance = (
            0.0 if s.scatter is None else np.einsum("ob,bsf->osf", self.kernel**2 * TOGETHER / s.count, s.scatter)
        )
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
        cross, _, _, _ = self._cross(x, np.zeros(0))
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
            cross, _, _, driven = self._cross(x, x[self.count :])
            acts, number = channel >= doubts.sensors, channel - doubts.sensors
            own = self.scale * self._smoothed(driven[number] if acts else cross)
            rest = self.scale * self._smoothed(cross) - own if acts else np.zeros_like(own)
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
        s, p = self.spectra, self.parameters(x)
        cross, flexibility, of_forces, driven_by = self._cross(x, x[self.count :])
        residual = self.scale * self._smoothed(cross) - self.common
        if not slopes:
            return residual, np.empty(0)
        shown = 1.0 if self.doubts is None else self.doubts.factors(x[self.count :])[0][:, :, None]
        seen = shown * s.differentiation[:, :, None] * flexibility[:, s.sensors]  # (B, S, n)
        by = []
        driven = self._moved(p, flexibility) @ of_forces
        pull, stretched = seen @ self.stretch.T, self.stretch @ driven + self.by_supports @ self._carried() @ of_forces
        for dof in self.free["m"]:
            slope = p["m"][dof] * s.omega[:, None, None] ** 2 * seen[:, :, [dof]] * driven[:, [dof]]
            if s.felt is not None:  # a heavier mass also feels more of the ground
                slope = slope - p["m"][dof] * self.influence[dof] * seen[:, :, [dof]] * of_forces[:, [-1]]
            # Critical damping grows with the mass.
            for i in self.free["c"][self.end[self.free["c"]] == dof]:
                slope = slope - 0.5j * s.omega[:, None, None] * p["c"][i] * pull[:, :, [i]] * stretched[:, [i]]
            by.append(slope)
        for i in self.free["k"]:
            rate = p["k"][i] * (1.0 + (LEAST_LOSS + p["loss"]) * 1j) + (
                0.5j * s.omega * p["c"][i] if i in self.free["c"] else 0.0
            )
            by.append(-np.reshape(rate, (-1, 1, 1)) * pull[:, :, [i]] * stretched[:, [i]])
        if self.damped:
            c = self.free["c"]
            by.append(-1j * s.omega[:, None, None] * (pull[:, :, c] * p["c"][c]) @ stretched[:, c])
        if self.lossy:
            by.append(-1j * (pull * p["loss"] * p["k"]) @ stretched)
        if self.doubts is not None:
            by += self.doubts.slopes(cross, driven_by)
        return residual, np.stack([self.scale * self._smoothed(slope) for slope in by], axis=-1)

    def _cross(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Cross spectra of what sensors and forces show, and what they are made of.

        Returns:
            The cross spectra (B, S, F); the flexibility (B, n, n); the spectra of the forces that act with those that
            are shown (B, F, F); what each force adds to the first (F, B, S, F), empty where no channel is in doubt.
        """
        s, p = self.spectra, self.parameters(x)
        connection = self._connection(p)
        stiffness = np.einsum("ci,bc,cj->bij", self.stretch, connection, self.stretch)
        stiffness[:, range(len(p["m"])), range(len(p["m"]))] -= s.omega[:, None] ** 2 * p["m"]
        flexibility = np.linalg.inv(stiffness)
        response = s.differentiation[:, :, None] * self._moved(p, flexibility)[:, s.sensors]
        if s.felt is not None:
            response[:, :, -1] += s.felt * self.influence[s.sensors]
        if self.doubts is None or not len(y):
            return response @ s.of_forces, flexibility, s.of_forces, np.empty(0)
        of_sensors, of_acting = self.doubts.factors(y)
        response, of_forces = of_sensors[:, :, None] * response, s.of_forces / of_acting[:, :, None]
        driven = np.einsum("bsf,bfg->fbsg", response, of_forces)
        return driven.sum(0), flexibility, of_forces, driven

    def _connection(self, p: Mapping[str, np.ndarray]) -> np.ndarray:
        """(B, C), dynamic stiffness of every connection."""
        connection: np.ndarray = p["k"] * (1.0 + (LEAST_LOSS + p["loss"]) * 1j)
        return connection + 1j * self.spectra.omega[:, None] * p["c"]

    def _carried(self) -> np.ndarray:
        """(B, S', F), displacements of supports for one of what acts."""
        s = self.spectra
        count, forced = len(s.carried), len(s.forced)
        out = np.zeros((len(s.omega), self.by_supports.shape[1], forced + count + (s.felt is not None)), complex)
        for i, order in enumerate(s.carried):
            out[:, i, forced + i] = (1j * s.omega) ** -order
        return out

    def _moved(self, p: Mapping[str, np.ndarray], flexibility: np.ndarray) -> np.ndarray:
        """(B, n, F), displacements for one of what acts."""
        moved = flexibility[:, :, self.spectra.forced]
        if self.spectra.carried:
            own = slice(len(self.spectra.forced), len(self.spectra.forced) + len(self.spectra.carried))
            pushed = self.stretch.T @ (self._connection(p)[:, :, None] * (self.by_supports @ self._carried()[..., own]))
            moved = np.concatenate((moved, -flexibility @ pushed), axis=2)
        if self.spectra.felt is None:
            return moved
        shaken = -flexibility @ (p["m"] * self.influence)
        return np.concatenate((moved, shaken[:, :, None]), axis=2)


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
