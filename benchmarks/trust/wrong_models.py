"""Models that do not fit their record: a mass, the damping, a storey, a cubic spring, the place of a force."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.trust.case import HERE, Case

# Share of a spring's force from which on its cubic term matters: kappa e^2 over k, e the rms elongation.
LEAST_CUBIC = 0.05


def mass(case: Case, rng: Generator) -> Case | None:
    """One mass is 1.3 to 3 times what it is, or as much less; of a finite-element model there is too much on one DOF.

    Free stiffnesses make up for the mass of a single DOF on a ground that moves, and for all without a measured force.
    """
    settings, data = _copied(case)
    forces = any((data_of.get("force") or {}).values() for data_of in [data, *data.get("records", [])])
    forced = forces or any(c["sensor"] == "force" for c in data.get("channels", {}).values())
    system = settings.get("system", {})
    known = system.get("mass", system.get("m"))
    several = isinstance(known, Mapping | list | np.ndarray) and len(known) > 1
    if not (forced or (several and data.get("ground_acceleration"))):
        return None
    if "path" in system:
        return _heavier(case, rng)
    if known is None:
        return None
    wrong = float(rng.uniform(1.3, 3.0) ** rng.choice([-1, 1]))
    if isinstance(known, Mapping):
        dof: object = list(known)[int(rng.integers(len(known)))]
        system["mass"] = {name: float(x) * (wrong if name == dof else 1.0) for name, x in known.items()}
    else:
        key = "m" if "m" in system else "mass"
        values = np.broadcast_to(np.array(known, float), len(system.get("dofs", [])) or system["ndof"]).copy()
        dof = int(rng.integers(len(values))) + 1
        values[int(dof) - 1] *= wrong  # type: ignore[call-overload]
        system[key] = values
    return _named(case, settings, rf"\bm_{dof}\b|mass of (DOF )?{dof}\b|swung on DOF {dof}\b")


def _heavier(case: Case, rng: Generator) -> Case | None:
    system: Any = case.settings["system"]
    file = str(system["path"]).removeprefix(f"{HERE}/")
    if file not in case.matrices or "M" not in case.matrices[file]:
        return None
    M = case.matrices[file]["M"].copy()
    place = list(system["dofs"].values())[int(rng.integers(len(system["dofs"])))] - 1
    M[place, place] += float(rng.uniform(0.1, 0.3)) * 0.5 * np.trace(M)  # of two directions and rotations
    matrices = case.matrices | {file: case.matrices[file] | {"M": M}}
    return replace(case, matrices=matrices, truth=replace(case.truth, names_it=r"\bmass(es)? (of|is|are)\b|\bm_\w"))


def damping(case: Case, rng: Generator) -> Case | None:
    """Dampers that are known, or ratios, 3 to 6 times what they are, or as much less."""
    settings, _ = _copied(case)
    system: dict[str, Any] = settings.get("system", {})
    wrong, found = float(rng.uniform(3.0, 6.0) ** rng.choice([-1, 1])), False
    asked = settings.get("scheme", {}).get("unknown") or []
    if any(str(name).startswith(("c", "zeta", "a_", "*")) for name in ([asked] if isinstance(asked, str) else asked)):
        return None
    whole = system.get("damping") or {}
    for place, key in ((system, "c"), (system, "damping_ratio"), (whole, "ratio"), (whole, "rayleigh"),
                       *((link, "c") for link in system.get("connections", {}).values())):  # fmt: skip
        value = place.get(key)
        if value is None or np.equal(value, None).any() or not np.any(value):
            continue
        place[key], found = np.array(value, float) * wrong, True
    words = r"model of damping|damping ratio|quadratic damping|the damping of|prescribed parameters (moved|are off)"
    return _named(case, settings, words) if found else None


def storey(case: Case, rng: Generator) -> Case | None:
    """The model lacks a DOF without a force, with all that joins it: a top floor, a machine on a floor.

    Its sensors have no place in the model and are left out, if others stay.
    """
    settings, data = _copied(case)
    system: dict[str, Any] = settings.get("system", {})
    if data.get("records") or case.before is not None or system.get("damping") or "path" in system:
        return None
    dofs = system.get("dofs") or list(range(1, system.get("ndof", 0) + 1))
    for i in rng.permutation(len(dofs)):
        gone = dofs[i]
        if "ndof" in system and gone != len(dofs):
            continue
        links = {name for name, link in system.get("connections", {}).items() if gone in _joins(link)}
        if not _holds(system, dofs, gone, links) or not _without(data, gone):
            continue
        if "ndof" in system:
            names = {f"_{gone}"}
            kept = {key: x[:-1] for key, x in system.items() if isinstance(x, list | np.ndarray)}
            settings["system"] = system | kept | {"ndof": len(dofs) - 1}
        else:
            names = {f"_{name}" for name in (*links, gone)}
            system["dofs"] = [dof for dof in dofs if dof != gone]
            if isinstance(system.get("mass"), Mapping):
                system["mass"] = {dof: x for dof, x in system["mass"].items() if dof != gone}
            system["connections"] = {a: b for a, b in system["connections"].items() if a not in links}
        return _without_dof(case, settings, int(i), names)
    return None


def _joins(link: dict[str, Any]) -> set[object]:
    return set(link.get("weights") or link["between"])


def _holds(system: dict[str, Any], dofs: list[Any], gone: object, links: set[str]) -> bool:
    """Whether the rest stands without a DOF."""
    if "ndof" in system:
        return len(dofs) > 1
    others = [dof for dof in dofs if dof != gone]
    rows = [
        [w.get(dof, 0.0) for dof in others]
        for name, link in system["connections"].items() if name not in links
        for w in [link.get("weights") or dict(zip(link["between"], (-1.0, 1.0), strict=True))]
    ]  # fmt: skip
    return bool(others) and bool(rows) and int(np.linalg.matrix_rank(np.array(rows), tol=1e-3)) == len(others)


def _without(data: dict[str, Any], gone: object) -> bool:
    """Take away a DOF's sensors; whether it has no force and other sensors stay."""
    sensors = 0
    for quantity in ("displacement", "velocity", "acceleration"):
        if quantity in data:
            data[quantity] = {dof: column for dof, column in data[quantity].items() if dof != gone}
            sensors += len(data[quantity])
    for name, said in list(data.get("channels", {}).items()):
        if said["sensor"] == "force":
            if said["dof"] == gone:
                return False
        elif gone in (said.get("weights") or [said.get("dof")]):
            del data["channels"][name]
        else:
            sensors += "dof" in said
    return gone not in (data.get("force") or {}) and sensors > 0


def _without_dof(case: Case, settings: dict[str, Any], i: int, names: set[str]) -> Case:
    """What is left of the truth; DOF `i` from 0, and the ends of the names of the parameters that are gone."""
    of = case.truth
    columns = tuple(sorted(settings["data"].get("channels", {})))
    asked = settings.get("scheme", {}).get("unknown")
    if isinstance(asked, list):
        settings["scheme"]["unknown"] = [name for name in asked if not str(name).endswith(tuple(names))]
    kept = {
        name: x for name, x in of.parameters.items()
        if not name.endswith(tuple(names))
        and (name.split("_")[0] not in ("gain", "offset", "drift", "delay") or name.split("_", 1)[1] in columns)
    }  # fmt: skip
    histories = (np.delete(x, i, axis=1) for x in (of.displacement, of.velocity, of.acceleration))
    sensed = tuple(j - (j > i) for j in of.sensed if j != i)
    return replace(
        case, settings=settings, truth=replace(
            of, parameters=kept, sensed=sensed,
            names_it=r"a mode at .* is not in the model|add its mass|storey|floor|no force of the model reaches",
            **dict(zip(("displacement", "velocity", "acceleration"), histories, strict=True)),
        ),
    )  # fmt: skip


def cubic(case: Case, rng: Generator) -> Case | None:
    """The springs of the record are cubic, some by 5 % of their force or more; the model's are linear."""
    settings, _ = _copied(case)
    system: dict[str, Any] = settings.get("system", {})
    true, u = case.truth.parameters, case.truth.displacement
    if "kappa" in system:
        strength = {
            str(i + 1): np.ravel(system["kappa"])[i] * np.diff(u, axis=1, prepend=0.0)[:, i].var() / k
            for i, k in enumerate(np.ravel(system["k"]))
        }
        del system["kappa"]
        settings["defaults"] = [
            {"override /system": "linear"} if "override /system" in x else x for x in settings["defaults"]
        ]
    else:
        strength = {}
        for name, link in system.get("connections", {}).items():
            if link.get("law") != "duffing":
                continue
            row = np.array([link["weights"].get(dof, 0.0) for dof in system["dofs"]])
            kappa, k = (true.get(f"{kind}_{name}", link.get(kind)) for kind in ("kappa", "k"))
            strength[name] = kappa * (u @ row).var() / k
            del link["kappa"]
            link["law"] = "linear"
    named = [name for name, x in strength.items() if x >= LEAST_CUBIC]
    if not named:
        return None
    asked = settings.get("scheme", {}).get("unknown")
    if isinstance(asked, list):
        settings["scheme"]["unknown"] = [name for name in asked if not str(name).startswith("kappa")] or ["k_*"]
    kept = {name: x for name, x in true.items() if not name.startswith("kappa_")}
    words = rf"connection ({'|'.join(named)}) lacks a (cubic|one-sided|backlash)|\bkappa_|cubic|nonlinear"
    return _named(replace(case, truth=replace(case.truth, parameters=kept)), settings, words)


def other_dof(case: Case, rng: Generator) -> Case | None:
    """The settings have a force on another DOF than the one that it acts on."""
    settings, data = _copied(case)
    system: dict[str, Any] = settings.get("system", {})
    dofs = list(system.get("dofs") or range(1, system.get("ndof", 0) + 1))
    maps = [of["force"] for of in [data, *data.get("records", [])] if of.get("force")]
    forces = [(found, dof) for found in maps for dof, x in found.items() if x is not None]
    forces += [(said, said["dof"]) for said in data.get("channels", {}).values() if said["sensor"] == "force"]
    if not forces:
        return None
    place, dof = forces[int(rng.integers(len(forces)))]
    free = [x for x in dofs if x != dof and x not in place]
    if not free:
        return None
    new = free[int(rng.integers(len(free)))]
    if "sensor" in place:
        place["dof"] = new
    else:
        place[new] = place.pop(dof)
    words = rf"force of DOF ({dof}|{new}) (fits|acts|belongs)|another DOF|\(data\.force\)|force .*(placed|other place)"
    return _named(case, settings, words)


def _copied(case: Case) -> tuple[dict[str, Any], dict[str, Any]]:
    settings: dict[str, Any] = deepcopy(dict(case.settings))
    return settings, settings["data"]


def _named(case: Case, settings: dict[str, Any], words: str) -> Case:
    return replace(case, settings=settings, truth=replace(case.truth, names_it=words))


MODEL_FAULTS: dict[str, Callable[[Case, Generator], Case | None]] = {
    "mass": mass,
    "damping": damping,
    "storey": storey,
    "cubic": cubic,
    "other_dof": other_dof,
}
