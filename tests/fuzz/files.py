"""Inputs of the families csv, yaml, resume, disk and bombs: files that a run reads, and where it writes."""

import gzip
from typing import Any

from fuzz.changes import BOMBS
from fuzz.overrides import HANDLER
from fuzz.trial import FINISHED, MEASURED, QUICK, STOPPED, UNFOLDING, Trial, rig
from hypothesis import strategies as st

CELLS = (
    "", "NaN", "inf", "True", "1e300", "1e-300", "-", "1,5", '"1', "0x1", "1_0", "abc", "2024-05-01T10:00:00",
    "10:00:01",
    "5/1/2024", "\x00", "ä", "1e30", "9" * 400, "#", "=1+1", "1;2", " 1 ", "1\t2", "None", "1.5.2", "١",
)  # fmt: skip
HEADERS = (
    "", "t;f;a", "t\tf\ta", "t,f", "t,f,a,a", "f,f,a", "T,F,A", "t ,f ,a ", '"t","f","a"', "0,0,0", "t,f,a,", "﻿t,f,a",
)  # fmt: skip
ENCODINGS = ("utf-16", "utf-32", "latin-1", "utf-8-sig", "cp037")
FRAGMENTS = (
    "case: x", "seed: 3", "seed: [1", "system: {ndof: 2}", "system:\n\tndof: 2", "noise: {snr_db: .nan}", "- 1", "3",
    "null",
    "noise: &a {b: *a}", "a: &a [1]\nb: *a", "<<: 5", "? [1, 2]\n: 3",
    "case: !!python/object/apply:os.mkdir ['{marker}']",
    "case: !!python/name:os.system", "case: !x y", "case: x\ncase: y", "defaults: 5", "defaults: [x]",
    "defaults: [nothing: x]",
    "defaults: [_self_, _self_]", "defaults:\n  - override /system: linear", "defaults:\n  - override /system: nothing",
    "defaults: [bad]", "defaults: [/experiment/bad]", "defaults: [{a: b, c: d}]", "hydra: {run: {dir: '{marker}'}}",
    "hydra: {callbacks: {x: {_target_: os.mkdir, path: '{marker}'}}}", "case: ${case}", "case: ${oc.env:NOTHING}",
    "case: ${",
    f"network: {{_target_: {HANDLER}, entrypoint: mkdir, args: ['{{marker}}']}}", "network: {_target_: os.system}",
    "network: 5", "training: [1, 2]", "system: null", "data: ~", "simulation: {1: 2}", "nothing: 1", "1: 2",
    "? {a: 1}\n: 2",
    "%YAML 9.9\n---\ncase: x", "---\ncase: x\n---\ncase: y", "case: |\n  a\n  b", "case: 'x", "\x07",
    "case: 2024-05-01",
    "case: 0o17", "seed: 1:30", "seed: 1_0", "case: \ud7ff", "# only a comment", "", "{", "[" * 3000, "a: " * 50,
    "network: {degree: [[[[1]]]]}", "case: true", "hydra: 5", "hydra: {job_logging: {handlers: {x: {(): os.mkdir}}}}",
    UNFOLDING,
)  # fmt: skip
RUN_FILES = (
    ".hydra/config.yaml", ".hydra/hydra.yaml", ".hydra/overrides.yaml", ".hydra", "run.json", "checkpoint.pt",
    "checkpoint.previous.pt", "tracking.json", "run.lock", "pinn-run.log", "history.csv", "fitness.csv",
    "parameters.csv",
    "residuals.csv", "response.nc", "multirun.yaml", "jobs.csv", "chains",
)  # fmt: skip
PLACES = (
    ".", "''", "/dev/null", "..", "a" * 256, "/".join(["a" * 200] * 30), "there", "there/below", "pipe", "pipe/below",
    "loop", "mine", "${x}", "ä/ö", "a b", "~", "run", "run/figures", "/proc/x", "'a\nb'", "link",
)  # fmt: skip


def _scaled(rows: list[list[str]], column: int, factor: float, offset: float) -> None:
    for row in rows[1:]:
        row[column] = repr(float(row[column]) * factor + offset)


def _change_whole(draw: st.DrawFn, rows: list[list[str]]) -> None:
    """Change the header, or a column, or the number of rows, of a table whose rows are whole."""
    column = draw(st.integers(0, 2))
    match draw(st.sampled_from(("header", "scaled", "constant", "short", "none"))):
        case "header":
            rows[0] = draw(st.one_of(st.sampled_from(HEADERS), st.text(max_size=9))).split(",")
        case "scaled":
            factor = 10.0 ** draw(st.sampled_from((-300, -30, -12, -3, 3, 12, 29, 300)))
            _scaled(rows, column, factor, draw(st.sampled_from((0.0, 1.7e9, -1e6))))
        case "constant":
            value = draw(st.sampled_from(("0", "1", "True", "nan", "1e29")))
            for row in rows[1:]:
                row[column] = value
        case "short":
            del rows[draw(st.integers(1, 40)) :]


def _change_one(draw: st.DrawFn, rows: list[list[str]]) -> None:
    """Change one cell or a few rows."""
    row, other = draw(st.integers(0, len(rows) - 1)), draw(st.integers(0, len(rows) - 1))
    match draw(st.sampled_from(("cell", "cell", "gap", "swap", "wide"))):
        case "cell":
            rows[row][draw(st.integers(0, 2)) % len(rows[row])] = draw(st.sampled_from(CELLS) | st.text(max_size=6))
        case "gap":
            rows[row : row + draw(st.integers(0, 60))] = [draw(st.sampled_from(([], ["", "", ""], ["1"])))]
        case "swap":
            rows[row], rows[other] = rows[other], rows[row]
        case "wide":
            rows[row] += ["1"] * draw(st.sampled_from((1, 3, 500)))


@st.composite
def tables(draw: st.DrawFn) -> bytes:
    """The content of a file that is, or nearly is, a record."""
    rows = rig()
    _change_whole(draw, rows)
    if draw(st.booleans()):
        _change_one(draw, rows)
    text = draw(st.sampled_from(("\n", "\r\n", "\r"))).join(",".join(row) for row in rows)
    match draw(st.sampled_from(("utf-8",) * 5 + ("other", "packed", "cut", "byte"))):
        case "other":
            return text.encode(draw(st.sampled_from(ENCODINGS)), errors="replace")
        case "packed":
            return gzip.compress(text.encode(), mtime=0)[: draw(st.sampled_from((None, 40)))]
        case "cut":
            return text.encode()[: draw(st.integers(0, 600))]
        case "byte":
            index = draw(st.integers(0, 900))
            return text.encode()[:index] + draw(st.binary(min_size=1, max_size=4)) + text.encode()[index:]
    return text.encode()


@st.composite
def csv(draw: st.DrawFn) -> Trial:
    """Records of one's own."""
    windows = (
        "data.start=1", "data.stop=2", "data.start=nan", "data.decimate=3", "data.decimate=1e9", "data.time=f",
        "data.force={1: a}", "data.holdout=[1]", "data.intersample=zero_order_hold", "data.velocity={1: f}",
        "scheme=state_parameter", "data.force={1: null}", "data.acceleration={0: a}", "data.acceleration=[a]",
        "data.path=nothing.csv", "data.path=.", "data.path=~", "data.path=pipe", "data.path=/dev/zero", "data.path=[1]",
    )  # fmt: skip
    extra = tuple(draw(st.lists(st.sampled_from(windows), max_size=1)))
    name = draw(st.sampled_from(("rig.csv",) * 6 + ("rig.csv.gz", "rig.zip", "rig.xlsx", "rig")))
    files: dict[str, tuple[str, Any]] = {name: ("bytes", draw(tables())), "pipe": ("pipe", None)}
    return Trial("csv", (*MEASURED, f"data.path={name}", *extra), files)


@st.composite
def yaml(draw: st.DrawFn) -> Trial:
    """Configurations of one's own."""
    fragments = st.one_of(st.sampled_from(FRAGMENTS), st.text(max_size=20))
    text = "\n".join(draw(st.lists(fragments, min_size=1, max_size=2)))
    head = draw(st.sampled_from(("# @package _global_\n", "# @package _global_\n", "", "# @package nothing.x\n")))
    group = draw(st.sampled_from(("experiment", "experiment", "network", "system", "hydra/launcher")))
    content = (head + text).encode("utf-8", "replace")
    match draw(st.sampled_from(("whole",) * 6 + ("utf-16", "byte", "folder", "cycle"))):
        case "utf-16":
            form: tuple[str, Any] = ("bytes", content.decode().encode("utf-16"))
        case "byte":
            form = ("bytes", content + b"\xff\x00")
        case "folder":
            form = ("folder", None)
        case "cycle":
            form = ("link", "bad.yaml")
        case _:
            form = ("text", content.decode())
    return Trial("yaml", (*QUICK, "--config-dir", "conf", f"{group}=bad"), {f"conf/{group}/bad.yaml": form})


@st.composite
def resume(draw: st.DrawFn) -> Trial:
    """Directories of runs and sweeps that were damaged or made by somebody else."""
    start = draw(st.sampled_from(("finished", "stopped", "stopped", "swept")))
    directory = "sweep" if start == "swept" else "run"
    below = draw(st.sampled_from(("sweep", "sweep/seed=0*"))) if start == "swept" else directory
    names = draw(st.lists(st.sampled_from(RUN_FILES), min_size=1, max_size=2, unique=True))
    if ".hydra" in names:
        names = [".hydra"]
    part = st.floats(0, 1)
    forms = st.one_of(
        st.tuples(st.just("cut"), part),
        st.tuples(st.just("flipped"), part),
        st.sampled_from((("gone", None), ("folder", None), ("pipe", None), ("link", "nowhere"), ("link", "/dev/zero"))),
        st.tuples(st.just("forged"), st.sampled_from(("bare", "archive", "checkpoint"))),
        st.tuples(st.just("text"), st.sampled_from(FRAGMENTS)),
        st.tuples(st.just("bytes"), st.binary(max_size=30)),
    )
    files = {f"{below}/{name}": draw(forms) for name in names}
    again = {"finished": FINISHED, "stopped": STOPPED}.get(start, ())
    of_run = (("resume=run",), (*again, "resume=auto"), ("collect=run",), ("resume=run", "seed=1"), again)
    of_sweep = (("collect=sweep",), ("resume=sweep",), ("collect=sweep/seed=0",))
    return Trial("resume", draw(st.sampled_from(of_sweep if start == "swept" else of_run)), files, start)


@st.composite
def disk(draw: st.DrawFn) -> Trial:
    """Places that cannot be written to, or that are somebody's."""
    files: dict[str, tuple[str, Any]] = {
        "there": ("text", "a file of the user's"),
        "pipe": ("pipe", None),
        "loop": ("link", "loop"),
        "link": ("link", "mine"),
        "mine/history.csv": ("text", "iteration\n1\n"),
        "mine/.x.partial1": ("text", "mine"),
        "history.csv": ("text", "my own history"),
    }
    match draw(st.sampled_from(("place", "place", "small", "outputs", "beside", "case"))):
        case "place":
            place = draw(st.sampled_from(PLACES))
            resumes = ("resume=auto",) if draw(st.booleans()) else ()
            return Trial("disk", (*QUICK, f"hydra.run.dir={place}", *resumes), files)
        case "small":
            arguments = draw(st.sampled_from((STOPPED, FINISHED, (*FINISHED, "tracking=tensorboard"))))
            limit = draw(st.sampled_from((0, 10, 500, 2000, 8000, 20000, 60000)))
            return Trial("disk", arguments, largest_file=limit)
        case "outputs":
            form = draw(st.sampled_from((("text", "mine"), ("pipe", None), ("link", "outputs"), ("link", "nowhere/x"))))
            return Trial("disk", QUICK, {**files, "outputs": form})
        case "case":
            return Trial("disk", (*QUICK, f"case={draw(st.sampled_from(PLACES))}"), files)
    name = draw(st.sampled_from((*RUN_FILES, "figures", "figures/x", "validation.csv")))
    forms = (("folder", None), ("pipe", None), ("link", "../there"), ("text", "mine"), ("link", "x"))
    form = draw(st.sampled_from(forms))
    start, arguments = draw(st.sampled_from((("finished", FINISHED), ("stopped", (*STOPPED, "resume=auto")))))
    return Trial("disk", arguments, {"there": files["there"], f"run/{name}": form}, start)


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
