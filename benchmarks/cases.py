"""The runs of `make bench`: sizes, durations, topologies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

# The paper samples 60 s with 4096 points; longer records keep the rate.
SAMPLES_PER_MINUTE = 4096
# Of the paper's chain, in every topology: kg, N s/m, N/m, N/m^3.
MASS, DAMPING, STIFFNESS, CUBIC = 10.0, 1.0, 15.0, 100.0
# DOFs and seconds up to which the Kalman smoother solves the record too: its matrices are dense.
SMOOTHER_DOFS, SMOOTHER_SECONDS = 20, 960


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        against: What it is compared over: ``ndof``, ``duration_s`` or, of structures other than chains, ``topology``.
        ndof: Degrees of freedom.
        duration_s: Of the record.
        topology: ``chain``, ``ring`` (every mass has a spring to the ground as well) or ``grid`` (two-dimensional).
        overrides: Of the structure.
    """

    against: str
    ndof: int
    duration_s: int
    topology: str = "chain"
    overrides: tuple[str, ...] = field(default=(), compare=False)

    @property
    def smoothed(self) -> bool:
        """Whether the smoother solves it too."""
        return self.ndof <= SMOOTHER_DOFS and self.duration_s <= SMOOTHER_SECONDS

    @property
    def command(self) -> list[str]:
        """All overrides."""
        samples = SAMPLES_PER_MINUTE * self.duration_s // 60
        size = [f"system.ndof={self.ndof}"] if self.topology == "chain" else list(self.overrides)
        return [*size, f"simulation.duration={self.duration_s}", f"simulation.samples={samples}"]


def cases(full: bool) -> list[Case]:
    """What is measured by default, or all of it, which takes an hour."""
    dofs = (6, 10, 20, 50, 100, 200) if full else (6, 10, 20, 50)
    durations = (60, 240, 960, 3600) if full else (60, 240, 960)
    sides = (3, 4, 6, 8, 10) if full else (3, 4, 6)
    return [
        *(Case("ndof", n, 60) for n in dofs),
        *(Case("duration_s", 6, seconds) for seconds in durations),
        *(Case("topology", side**2, 60, "chain") for side in sides),
        *(Case("topology", side**2, 60, "ring", structure(ring(side**2))) for side in sides),
        *(Case("topology", side**2, 60, "grid", structure(grid(side))) for side in sides),
    ]


def ring(ndof: int) -> Iterator[tuple[str, str]]:
    """Both ends of the connections of masses in a circle, each of them held by the ground."""
    for i in range(ndof):
        yield "ground", f"m{i + 1}"
        yield f"m{i + 1}", f"m{(i + 1) % ndof + 1}"


def grid(side: int) -> Iterator[tuple[str, str]]:
    """Both ends of the connections of masses in a square, each joined to those beside it; the ground holds one side."""
    for row in range(side):
        for column in range(side):
            own = f"m{row * side + column + 1}"
            yield (f"m{row * side + column}" if column else "ground"), own
            if row:
                yield f"m{(row - 1) * side + column + 1}", own


def structure(ends: Iterator[tuple[str, str]]) -> tuple[str, ...]:
    """Overrides of a structure whose connections are those of the paper's chain, pushed at its first mass."""
    pairs = list(ends)
    law = f"law: duffing, c: {DAMPING}, k: {STIFFNESS}, kappa: {CUBIC}"
    joined = ", ".join(f"s{i + 1}: {{between: [{a}, {b}], {law}}}" for i, (a, b) in enumerate(pairs))
    count = max(int(name[1:]) for pair in pairs for name in pair if name != "ground")
    names = ",".join(f"m{i + 1}" for i in range(count))
    masses = f"system.dofs=[{names}]", f"system.mass={MASS}"
    return "system=structure", *masses, f"system.connections={{{joined}}}", "excitation.dofs=[m1]"
