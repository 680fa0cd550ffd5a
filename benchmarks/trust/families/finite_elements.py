"""Beams and plane frames of finite elements, of which the program keeps some modes; parts are softer or stiffer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.linalg import eigh

from benchmarks.trust.case import HERE, Case, Truth, defaults, record_data
from benchmarks.trust.structures import noisy
from benchmarks.trust.waves import random_waves

SAMPLES = 600  # at most: twelve coordinates and their factors take a minute over 2400
PERIODS = 15  # of the first mode, at least


@dataclass(frozen=True)
class Mesh:
    """Nodes (nodes, 2), m; elements as pairs of nodes, each of a part; DOFs 3 node + (0 along x, 1 along y, 2 turn)."""

    nodes: np.ndarray
    elements: np.ndarray
    part: np.ndarray
    held: np.ndarray
    deep: float  # depth of the sections over the length of the longest member

    @property
    def free(self) -> np.ndarray:
        """DOFs that are not held."""
        return np.setdiff1d(np.arange(3 * len(self.nodes)), self.held)


def draw(seed: int) -> Case:
    """Even seeds begin at rest. Odd ones move already."""
    rng = np.random.default_rng([seed, 107])
    mesh = frame(rng) if rng.random() < 0.5 else beam(rng)
    names = [f"part_{i + 1}" for i in range(int(mesh.part.max()) + 1)]
    M, K_parts = assembled(mesh)
    K = K_parts.sum(0)
    factors = rng.uniform(0.7, 1.25, len(names))
    true_K = np.tensordot(factors, K_parts, 1)
    squared, shapes = eigh(true_K, M)
    first = 10.0 ** rng.uniform(-0.3, 2.3)  # the material is scaled to it
    stiffer = (2.0 * np.pi * first) ** 2 / squared[0]
    heavier = 10.0 ** rng.uniform(-2, 5) / np.trace(M)
    M, K, K_parts, true_K = M * heavier, K * stiffer * heavier, K_parts * stiffer * heavier, true_K * stiffer * heavier
    frequencies, shapes = np.sqrt(squared * stiffer) / (2.0 * np.pi), shapes / np.sqrt(heavier)
    ratio = rng.uniform(0.004, 0.03)
    C = M @ shapes @ np.diag(4.0 * np.pi * ratio * frequencies) @ shapes.T @ M

    within = np.count_nonzero(1.3 * frequencies <= SAMPLES / (2.56 * PERIODS) * first)
    reached = min(int(rng.integers(2, 5)), int(within))  # modes that the force's band reaches
    high = frequencies[reached - 1] * rng.uniform(1.05, 1.3)
    finest = min(10.0, SAMPLES * first / (PERIODS * high))  # samples in the shortest period
    rate = 2.56 * (finest / 2.56) ** rng.uniform() * high
    times = np.arange(0.0, min(rng.uniform(20, 50) / first, SAMPLES / rate), 1.0 / rate)
    told = told_best(mesh, shapes[:, :reached])
    count = min(int(rng.integers(3, 6)), len(told))
    dofs = rng.choice(told, count, replace=False)
    named = {f"p{i + 1}": int(x) + 1 for i, x in enumerate(dofs)}
    place = np.eye(len(M))[:, dofs[-1:]]
    rms = np.array([0.02 * 9.81 * np.trace(M) / 3.0])
    waves = random_waves(rng, (0.3 * first, high), rms, 300, np.ones_like)
    moving = seed % 2 == 1
    waves = replace(waves, begin=-20.0 / first if moving else 0.0)
    motion = waves.moves(M, C, true_K, place, times)

    sensors = np.sort(rng.choice(count, int(rng.integers(2, count + 1)), replace=False))
    kind = str(rng.choice(["acceleration"] * 4 + ["velocity", "displacement"]))
    response_db, force_db = rng.uniform(20, 60), rng.uniform(30, 60)
    felt, keys = getattr(motion, kind)[:, dofs], list(named)
    table = {"t": times, "f": noisy(rng, waves(times)[:, 0], force_db)}
    table |= {f"y{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}

    damping_known = bool(rng.random() < 0.5)
    settings: dict[str, object] = {
        "defaults": defaults(system="matrices", data="csv", scheme="state_parameter"),
        "system": {
            "path": f"{HERE}/model.npz", "dofs": named, "modes": reached + int(rng.integers(1, 4)),
            "factors": dict.fromkeys(names), "damping": {"ratio": ratio if damping_known else None},
        },
        "data": record_data(force={keys[-1]: "f"}, **{kind: {keys[i]: f"y{i + 1}" for i in sensors}}),
        "scheme": {"unknown": ["factor_*"] + ([] if damping_known else ["zeta"]), "parameter_uncertainty": 0.0}
        | ({} if moving else {"initial_motion": "rest"}),
    }  # fmt: skip
    truth = Truth(
        {f"factor_{name}": float(x) for name, x in zip(names, factors, strict=True)}
        | ({} if damping_known else {"zeta": float(ratio)}),
        motion.displacement[:, dofs], motion.velocity[:, dofs], motion.acceleration[:, dofs],
        tuple(int(i) for i in sensors),
    )  # fmt: skip
    about = (
        f"{'frame' if np.ptp(mesh.nodes, 0).min() > 0.0 else 'beam'} of {len(mesh.elements)} elements, {len(M)} DOFs,"
        f" {reached} modes from {first:.3g} to {high:.3g} Hz, {rate:.4g} Hz x {len(times)}, {kind} on"
        f" {[keys[i] for i in sensors]} of {count}, {response_db:.0f} dB, {len(names)} factors,"
        f" {'moving' if moving else 'at rest'}{'' if damping_known else ', damping unknown'}"
    )
    matrices = {"M": M, "K": K} | dict(zip(names, K_parts, strict=True))
    return Case("finite_elements", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about,
                matrices={"model.npz": matrices})  # fmt: skip


def told_best(mesh: Mesh, shapes: np.ndarray) -> np.ndarray:
    """Half of the displacements that move most in these modes: where somebody would put sensors and a shaker."""
    moves = np.flatnonzero(mesh.free % 3 != 2)
    largest = (np.abs(shapes[moves]) / np.abs(shapes[moves]).max(0)).max(1)
    return moves[np.argsort(-largest)[: max(4, len(moves) // 2)]]


def beam(rng: Generator) -> Mesh:
    """Along x, of 8 to 24 elements in two or three parts: a cantilever, simply supported or clamped."""
    count, length = int(rng.integers(8, 25)), 10.0 ** rng.uniform(-0.5, 1.5)
    nodes = np.column_stack([np.linspace(0.0, length, count + 1), np.zeros(count + 1)])
    elements = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    part = np.minimum(np.arange(count) * int(rng.integers(2, 4)) // count, 2)
    along = 3 * np.arange(count + 1)  # nobody asks for the motion along a beam
    last = 3 * count
    ends = [[1, 2], [1, last + 1], [1, 2, last + 1, last + 2]][int(rng.integers(0, 3))]
    return Mesh(nodes, elements, part, np.r_[along, ends], rng.uniform(0.01, 0.05))


def frame(rng: Generator) -> Mesh:
    """One or two storeys, one bay, columns clamped; the columns of a storey are a part, and all girders are one."""
    storeys, pieces = int(rng.integers(1, 3)), 3
    height, width = 10.0 ** rng.uniform(-0.5, 1.0) * np.array([1.0, rng.uniform(0.8, 2.0)])
    corners = [np.array([x, height * level]) for level in range(storeys + 1) for x in (0.0, width)]
    members = [(2 * i + side, 2 * i + 2 + side, i) for i in range(storeys) for side in (0, 1)]
    members += [(2 * i, 2 * i + 1, storeys) for i in range(1, storeys + 1)]
    nodes, elements, part = list(corners), [], []
    for a, b, own in members:
        inner = [corners[a] + (corners[b] - corners[a]) * j / pieces for j in range(1, pieces)]
        line = [a, *range(len(nodes), len(nodes) + len(inner)), b]
        nodes += inner
        elements += list(pairwise(line))
        part += [own] * pieces
    return Mesh(np.array(nodes), np.array(elements), np.array(part), np.arange(6), rng.uniform(0.03, 0.08))


def assembled(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix (n, n) and stiffness matrix of each part (parts, n, n), of a mass of 1 kg/m and E I = 1 N m^2."""
    size = 3 * len(mesh.nodes)
    M, K = np.zeros((size, size)), np.zeros((int(mesh.part.max()) + 1, size, size))
    longest = float(np.ptp(mesh.nodes, 0).max())
    axial = 12.0 / (mesh.deep * longest) ** 2  # E A of a rectangular section with E I = 1
    for (a, b), own in zip(mesh.elements, mesh.part, strict=True):
        along = mesh.nodes[b] - mesh.nodes[a]
        h = float(np.hypot(*along))
        x, y = along / h
        turn = np.kron(np.eye(2), np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]]))
        at = np.ix_(*[np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]] * 2)
        mass, stiff = np.zeros((6, 6)), np.zeros((6, 6))
        ends, bends = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
        mass[ends], stiff[ends] = h / 6.0 * np.array([[2, 1], [1, 2]]), axial / h * np.array([[1, -1], [-1, 1]])
        mass[bends] = h / 420.0 * np.array([
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ])  # fmt: skip
        stiff[bends] = h**-3 * np.array([
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ])  # fmt: skip
        M[at] += turn.T @ mass @ turn
        K[own][at] += turn.T @ stiff @ turn
    kept = np.ix_(mesh.free, mesh.free)
    return M[kept], np.array([part[kept] for part in K])
