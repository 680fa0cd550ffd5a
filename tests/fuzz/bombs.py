"""Inputs of the family bombs: little that unfolds to more than a machine holds, or is waited for long."""

from typing import Any

from fuzz.changes import BOMBS
from fuzz.starts import MEASURED, QUICK, rig
from fuzz.trial import Trial
from hypothesis import strategies as st

SWEEPS = (
    "seed=range(0,1000000000)", "seed=range(0,1e9,0.001)", "noise.snr_db=range(0,1,1e-12)", "seed=range(0,10001)",
    "seed=range(5,0)", "seed=range(0,10,0)", "seed=range(0,10,-1)", "seed=range(1000000000,0,-1)",
    "seed=range(0,1e400)",
    "seed=sort(range(0,1000000000))", "seed=shuffle(range(0,1000000000))", "seed=range(-1e18,1e18)",
    "seed=tag(x,range(0,1000000000))", "seed=range(0,5,1e-320)",
)  # fmt: skip
SEARCH = (
    "hydra/sweeper=search", "validation=heldout", "scheme.unobserved_fraction=0.3", "hydra.sweeper.n_trials=1",
)  # fmt: skip
PRODUCTS = tuple(f"{name}=range(0,300)" for name in ("seed", "excitation.seed", "noise.snr_db", "scheme.seed"))
# How one line names the line before it; each unfolds to twice as much.
DOUBLING = (
    "'${{{0}}}${{{0}}}'", "'${{oc.select:{0}}}${{oc.select:{0}}}'", "['${{{0}}}', '${{{0}}}']",
    "{{x: '${{{0}}}', y: '${{{0}}}'}}",
    "'${{.{0}}}${{.{0}}}'", "'${{oc.select:{0},x}}${{oc.select:{0},x}}'", "'${{case[{0}]}}${{{0}}}'",
    "'${{oc.dict.values:{0}}}${{oc.dict.values:{0}}}'",
)  # fmt: skip
# Seconds that a clock is put on, or set back, in the middle of a record.
JUMPS = (3600.0, -3600.0, 1.0, -1.0, 86400.0, 0.05, 1e9, 3.15e7, 60.0, 7200.0, 0.5)


def _doubling(line: str, count: int) -> str:
    lines = ["# @package _global_", "a0: xxxxxxxxxx", *(f"a{n + 1}: {line.format(f'a{n}')}" for n in range(count))]
    return "\n".join([*lines, f"case: ${{a{count}}}"])


@st.composite
def bombs(draw: st.DrawFn) -> Trial:
    """Interpolations that double, ranges of jobs, arrays that unfold or go round, deep nesting, clocks that jump."""
    match draw(st.sampled_from(("doubling", "sweep", "sweep", "file", "file", "nested", "clock", "clock"))):
        case "doubling":
            text = _doubling(draw(st.sampled_from(DOUBLING)), draw(st.sampled_from((3, 20, 40, 300))))
            files: dict[str, tuple[str, Any]] = {"conf/experiment/bomb.yaml": ("text", text)}
            return Trial("bombs", (*QUICK, "--config-dir", "conf", "experiment=bomb"), files)
        case "sweep":
            ranges = draw(st.sampled_from((*((one,) for one in SWEEPS), PRODUCTS[:2], PRODUCTS)))
            sweeper = draw(st.sampled_from(((), (), SEARCH)))
            return Trial("bombs", (*QUICK, "--multirun", *ranges, *sweeper, "hydra.sweep.dir=sweep"))
        case "file":
            kind = draw(st.sampled_from(sorted(BOMBS)))
            data, name = draw(st.sampled_from((("mat", "rig.mat"), ("hdf5", "rig.h5"), ("netcdf", "rig.nc"))))
            column = draw(st.sampled_from(("a", "acc.1", "table.c1", "s.c", "rig.rig.a", "e")))
            own = [a for a in MEASURED if not a.startswith(("data=", "data.path", "data.acc"))]
            arguments = (f"data={data}", f"data.path={name}", *own, f"data.acceleration={{1: {column}}}")
            if draw(st.booleans()):
                arguments = ("inspect", f"data={data}", f"data.path={name}")
            return Trial("bombs", arguments, {name: ("bomb", kind)})
        case "nested":
            text = draw(st.sampled_from(("[", "{a: ", "- ", '{"a":', "a: &a\n  ", "'${", "? ")))
            files = {"conf/experiment/bomb.yaml": ("repeated", [text, draw(st.sampled_from((60, 5000, 100_000)))])}
            if draw(st.booleans()):
                return Trial("bombs", (*QUICK, f"case={text * 2000}"))
            return Trial("bombs", (*QUICK, "--config-dir", "conf", "experiment=bomb"), files)
    rows, jump = rig(), draw(st.sampled_from(JUMPS))
    first = draw(st.integers(2, len(rows) - 2))
    for row in rows[first:]:
        row[0] = f"{float(row[0]) + jump:.2f}"
    unknown, windows = ("scheme=state_parameter", "scheme.unknown=[k_1]"), ("data.window=4", "data.overlap=1")
    extra = draw(st.sampled_from(((), unknown, ("data.time_unit=ms",), windows)))
    files = {"rig.csv": ("text", "\n".join(",".join(row) for row in rows))}
    if draw(st.integers(0, 3)) == 0:
        return Trial("bombs", ("inspect", "data=csv", "data.path=rig.csv"), files)
    return Trial("bombs", (*MEASURED, *extra), files)
