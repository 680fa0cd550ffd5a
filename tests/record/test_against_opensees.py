"""Simulated responses against OpenSees, which follows the same structures with elements and a solver of its own.

OpenSees steps by Newmark's average acceleration, of order two, and its Bouc-Wen material by Euler's method, of order
one: two of its step lengths give its own step error.
"""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from pinn_cli.record.simulation import simulate
from pinn_cli.system.topology import build_structure

pytestmark = pytest.mark.slow

MASS, STIFFNESS, DAMPING = (2000.0, 2000.0, 1500.0), (8e6, 7.2e6, 5.6e6), (9e3, 8e3, 6e3)
DURATION, STEP = 4.0, 0.01


@pytest.fixture(scope="module")
def opensees():
    found = importlib.util.find_spec("openseespylinux")
    if found is None:
        pytest.skip("openseespy is not installed: pip install openseespy")
    # It finds the libraries that it brings along only where they are loaded already.
    for name in ("libquadmath.so.0", "libgfortran.so.4", "libgomp.so.1", "libblas.so.3", "liblapack.so.3"):
        library = Path(found.submodule_search_locations[0]) / "lib" / name
        if library.exists():
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    try:
        from openseespy import opensees
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"openseespy does not start: {error}")
    return opensees


def load(t):
    return 2e4 * np.sin(2.0 * np.pi * 2.3 * t) + 1e4 * np.sin(2.0 * np.pi * 6.1 * t)


def shaking(t):
    return 1.5 * np.sin(2.0 * np.pi * 1.9 * t) * np.sin(np.pi * t / DURATION) + 0.8 * np.sin(2.0 * np.pi * 4.7 * t)


def frame_of_opensees(ops, step, ground, hysteresis=None):
    """(samples, 3) displacements, m, relative to the ground."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for node in range(4):
        ops.node(node, 0.0)
    ops.fix(0, 1)
    for i in range(3):
        ops.mass(i + 1, MASS[i])
        ops.uniaxialMaterial("Elastic", 10 + i, STIFFNESS[i])
        ops.uniaxialMaterial("Viscous", 20 + i, DAMPING[i], 1.0)
        materials = [10 + i, 20 + i]
        if hysteresis is not None and i == 0:
            ops.uniaxialMaterial("BoucWen", 30, *hysteresis)
            materials = [30, 20]
        ops.element("zeroLength", i + 1, i, i + 1, "-mat", *materials, "-dir", *[1] * len(materials), "-doRayleigh", 0)
    steps = round(DURATION / step)
    times = step * np.arange(steps + 1)
    if ground:
        ops.timeSeries("Path", 1, "-dt", step, "-values", *shaking(times))
        ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    else:
        ops.timeSeries("Path", 1, "-dt", step, "-values", *load(times))
        ops.pattern("Plain", 1, 1)
        ops.load(3, 1.0)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", 1e-13, 50)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    out = np.zeros((steps + 1, 3))
    for k in range(steps):
        assert ops.analyze(1, step) == 0
        out[k + 1] = [ops.nodeDisp(node, 1) for node in (1, 2, 3)]
    return out[:: round(STEP / step)]


def ours(ground, law):
    frame = build_structure(
        ["x1", "x2", "x3"],
        dict(zip(("x1", "x2", "x3"), MASS, strict=True)),
        {
            "storey_1": {"between": ["ground", "x1"], "c": DAMPING[0], "k": STIFFNESS[0], "law": "linear", **law},
            "storey_2": {"between": ["x1", "x2"], "c": DAMPING[1], "k": STIFFNESS[1], "law": "linear"},
            "storey_3": {"between": ["x2", "x3"], "c": DAMPING[2], "k": STIFFNESS[2], "law": "linear"},
        },
    )
    time = STEP * np.arange(round(DURATION / STEP) + 1)
    roof = np.array([0.0, 0.0, 1.0])
    force = lambda t: (0.0 if ground else 1.0) * load(t)[:, None] * roof  # noqa: E731
    return simulate(frame, force, time, substeps=20, ground=shaking if ground else None).displacement


# A storey of which a quarter stays elastic: OpenSees has z without unit and its force (1 - alpha) k0 z.
ALPHA, K0, BETA, GAMMA = 0.25, 8e6, 120.0, 60.0
HYSTERETIC = {"law": "bouc_wen", "k": ALPHA * K0, "A": (1 - ALPHA) * K0, "beta": BETA, "gamma": GAMMA, "n": 1}
OF_OPENSEES = (ALPHA, K0, 1.0, GAMMA, BETA, 1.0, 0.0, 0.0, 0.0, 1e-12, 200)


@pytest.mark.parametrize("ground", [False, True], ids=["force", "ground"])
@pytest.mark.parametrize(
    ("law", "hysteresis", "order"), [({}, None, 2), (HYSTERETIC, OF_OPENSEES, 1)], ids=["elastic", "bouc_wen"]
)
def test_opensees_comes_to_our_response_as_its_steps_get_shorter(opensees, ground, law, hysteresis, order):
    found = ours(ground, law)
    coarse, fine = (frame_of_opensees(opensees, step, ground, hysteresis) for step in (1e-3, 2.5e-4))
    own = (coarse - fine) / (4**order - 1)  # what the shorter steps are still off
    size = lambda x: np.sqrt(np.mean(x**2) / np.mean(found**2))  # noqa: E731
    assert size(own) < 4e-3
    assert size(fine - found) < 1.2 * size(own)
    assert size(fine - own - found) < 0.1 * size(own)
