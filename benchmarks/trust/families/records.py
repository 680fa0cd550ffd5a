"""Several records of one building: solved together, to predict the next one, to update what was found, to find damage.

By the seed's remainder by four: two to four records together; a prediction with the model of a run before; an update
with a record of the same building; an update after one stiffness has changed by 5 to 20 %.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.trust.buildings import Shaking, building, columns, guessed, shaking
from benchmarks.trust.case import BEFORE, UNKNOWN_STRUCTURE, Arrays, Case, Settings, defaults, record_data
from benchmarks.trust.structures import Motion, Structure


def draw(seed: int) -> Case:
    """A building of 2 to 5 storeys with accelerometers on half of the floors to all; its stiffnesses are unknown."""
    rng = np.random.default_rng([seed, 109])
    structure = building(rng, int(rng.integers(2, 6)))
    kinds = "k" if rng.random() < 0.5 else "kc"
    kind = (_together, _predicted, _updated, _damaged)[seed % 4]
    return kind(seed, rng, structure, kinds)


def _together(seed: int, rng: Generator, structure: Structure, kinds: str) -> Case:
    """Two to four tests with a force, a rate and sensors of their own; the sensors rove."""
    entries, tables, motions, every = [], {}, [], []
    for i in range(int(rng.integers(2, 5))):
        shaken = shaking(rng, structure, int(rng.integers(structure.n)), periods=(20.0, 40.0))
        sensed = _sensed(rng, structure)
        name = f"test_{i + 1}.csv"
        motion = shaken.motion()
        tables[name] = pd.DataFrame(columns(rng, shaken, sensed, motion))
        entries.append(_data(name, shaken, sensed))
        motions.append(motion)
        every.append(sensed)
    settings = _identification(rng, structure, kinds) | {"data": {"records": entries}}
    truth = motions[0].truth(structure.parameters(kinds), every[0])
    about = f"{len(entries)} records of {structure.n} storeys, floors {[[i + 1 for i in s] for s in every]}"
    return Case("records", seed, tables, settings, truth, about)


def _predicted(seed: int, rng: Generator, structure: Structure, kinds: str) -> Case:
    """A force that nobody has seen, at another place and level, with noise."""
    sensed = _sensed(rng, structure)
    before, table = _first(rng, structure, kinds, sensed)
    shaken = _shaken(rng, structure)
    level = float(rng.uniform(0.5, 2.0))
    motion = shaken.motion()
    new = {name: x if name == "t" else level * x for name, x in columns(rng, shaken, (), motion).items()}
    scaled = Motion(level * motion.displacement, level * motion.velocity, level * motion.acceleration, motion.memory)
    settings = _again("predict", _data("record.csv", shaken, ()))
    truth = scaled.truth({}, ())
    about = f"prediction of {structure.n} storeys, identified from floors {[i + 1 for i in sensed]}"
    return Case("records", seed, _files(table, new), settings, truth, about, before=before)


def _updated(seed: int, rng: Generator, structure: Structure, kinds: str) -> Case:
    """A second record of the same building."""
    return _update(seed, rng, structure, structure, kinds)


def _damaged(seed: int, rng: Generator, structure: Structure, kinds: str) -> Case:
    """A second record after one stiffness has lost 5 to 20 %."""
    link = structure.connections[int(rng.integers(len(structure.connections)))]
    now = structure.with_values("k", {link.name: link.values["k"] * (1.0 - float(rng.uniform(0.05, 0.2)))})
    return _update(seed, rng, structure, now, kinds)


def _update(seed: int, rng: Generator, then: Structure, now: Structure, kinds: str) -> Case:
    sensed = _sensed(rng, then)
    before, table = _first(rng, then, kinds, sensed)
    shaken = _shaken(rng, now)
    motion = shaken.motion()
    new = columns(rng, shaken, sensed, motion)
    settings = _again("update", _data("record.csv", shaken, sensed))
    lost = {a: 100 * (y / x - 1) for (a, x), y in zip(then.parameters("k").items(), now.parameters("k").values(),
                                                     strict=True) if x != y}  # fmt: skip
    about = f"update of {now.n} storeys, floors {[i + 1 for i in sensed]}, changed: {lost or 'nothing'}"
    truth = motion.truth(now.parameters(kinds), sensed)
    return Case("records", seed, _files(table, new), settings, truth, about, before=before)


def _shaken(rng: Generator, structure: Structure) -> Shaking:
    return shaking(rng, structure, int(rng.integers(structure.n)))


def _sensed(rng: Generator, structure: Structure) -> tuple[int, ...]:
    count = int(rng.integers(-(-structure.n // 2), structure.n + 1))
    return tuple(int(i) for i in np.sort(rng.choice(structure.n, count, replace=False)))


def _first(
    rng: Generator, structure: Structure, kinds: str, sensed: tuple[int, ...]
) -> tuple[Settings, dict[str, np.ndarray]]:
    """The experiment of the run before, and its table."""
    shaken = _shaken(rng, structure)
    table = columns(rng, shaken, sensed, shaken.motion())
    return _identification(rng, structure, kinds) | {"data": _data("before.csv", shaken, sensed)}, table


def _identification(rng: Generator, structure: Structure, kinds: str) -> dict[str, object]:
    """All but the data of an experiment that asks for the kinds."""
    return {
        "defaults": UNKNOWN_STRUCTURE,
        "system": guessed(rng, structure, kinds),
        "scheme": {"unknown": [f"{kind}_*" for kind in kinds]},
    }


def _again(scheme: str, data: dict[str, object]) -> Settings:
    """An experiment with the model of the run before."""
    return {"defaults": defaults(data="csv", scheme=scheme), "model": BEFORE, "data": data}


def _data(name: str, shaken: Shaking, sensed: tuple[int, ...]) -> dict[str, object]:
    dofs = shaken.structure.dofs
    felt = {"acceleration": {dofs[i]: f"a{i + 1}" for i in sensed}} if sensed else {}
    return record_data(name, force={dofs[shaken.dof]: "f"}, **felt)


def _files(before: Arrays, now: Arrays) -> dict[str, pd.DataFrame]:
    return {"record.csv": pd.DataFrame(now), "before.csv": pd.DataFrame(before)}
