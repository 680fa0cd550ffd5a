"""Inputs of the families directories and terminal: runs and sweeps of somebody else, and what is shown of them."""

import json
import math
from collections.abc import Sequence
from typing import Any

from fuzz.changes import HISTORIES
from fuzz.trial import FINISHED, MEASURED, QUICK, SEARCHED, STOPPED, SWEPT, UNFOLDING, WINDOWED, Trial, rig
from hypothesis import strategies as st

Form = tuple[str, Any]

# What a terminal would obey, or hide.
ESCAPES = (
    "\x1b[2J\x1b[1;1Hverdict: sound", "\x1b]0;title\x07", "\x9b31m", "a\rpinn-run: fine", "\x08\x08\x08",
    "\u202etxt.exe", "\x1b]52;c;cm0=\x07", "a\x00b", "line\nverdict: sound", "\x7f", "\u200b", "\x1bP+q\x1b\\",
)  # fmt: skip
NAMES = (
    "$", "a$", "$a", "$x$", "$\\frac$", "$$", "a$b$c", "$\\", "{$}", "$_", "$^", "$\\undefined{x}$", "a\\$", "%$#&_^",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, 5, -1, 1e300, "text", "", True, [], [None], [[1]], {}, {"a": None}, [1, "x"], {"total": "x"}, {"total": None},
    {"score": [1]}, {"score": "x"}, {"score": None, "reason": 5}, {"settings": 5, "versions": None}, 10**400,
    "9" * 5000, ["x" * 20_000],
)  # fmt: skip
JSON_TEXTS = ("null", "5", '"x"', "[]", "{}", "NaN", "{", "", '{"seconds": {"total": 1e999}}', "\x00", '{"a":1}' * 2)
YAML_TEXTS = (
    "5", "x", "a: b", "- {a: b}", "- [1, [2]]", "- 5", "- null", "- 'seed='", "- '=5'", "- seed=0,1", "- 'a b c'",
    "[", "",
    "- !!python/name:os.system", "- &a [*a]", "\t", "- x: 1\n  x: 2", "- 2024-05-01",
    UNFOLDING,
)  # fmt: skip
CSV_TEXTS = ("", "a", "a,b\n1\n", "a,b\n1,2,3\n", '"', "\x00\x00", "group,quantity\nall,x\n", "\n\n\n", "\ufeff")
OF_RUN_JSON = (
    "seconds", "training", "verdict", "reasons", "validation", "configuration", "case", "seed", "baseline",
    "observed",
)  # fmt: skip
OF_JSON = {
    "run.json": OF_RUN_JSON,
    "failure.json": ("status", "reason", "traceback", "more"),
    "tracking.json": ("tracking", "configuration", "key", "ended"),
    "windows.json": ("configuration",),
    "window.json": (
        "number", "start", "hand_over", "stop", "verdict", "reasons", "changed", "training", "step", "doubts",
        "beliefs",
    ),
}  # fmt: skip
OF_CSV = ("fitness_percent", "group", "std", "prior_std", "estimate", "nmse_percent", "run", "record")
OF_SWEEP = (
    "hydra.sweeper", "hydra.sweep", "hydra.overrides", "hydra.overrides.task", "hydra", "hydra.sweeper.max_jobs",
    "hydra.sweeper.params", "hydra.sweep.subdir",
)  # fmt: skip
ARRAYS = ("content", "parameters_mean", "parameters_covariance", "structure_value_k", "end_mean", "sigma_acceleration",
          "level_step", "structure_group_0_indices", "structure_group_0_shape", "draws")  # fmt: skip
_ENDLESS = (
    "ALTER TABLE trials RENAME TO other; CREATE VIEW trials AS WITH RECURSIVE c(trial_id, number, study_id, state, "
    "datetime_start, datetime_complete) AS (SELECT 0, 0, 1, 'FAIL', NULL, NULL UNION ALL SELECT trial_id + 1, "
    "number + 1, 1, 'FAIL', NULL, NULL FROM c) SELECT * FROM c"
)
STATEMENTS = (
    "UPDATE trial_values SET value = 'x'", "UPDATE trial_values SET value = 1e999",
    "UPDATE trial_params SET distribution_json = '{}'",
    "UPDATE trial_params SET param_value = 'x'", "UPDATE trial_params SET distribution_json = '5'",
    "DELETE FROM studies",
    "UPDATE study_user_attributes SET value_json = '5'", "UPDATE study_user_attributes SET value_json = '{'",
    "DROP TABLE trials",
    "UPDATE trials SET state = 'x'", "UPDATE trials SET number = 7", "UPDATE trials SET datetime_start = 'x'",
    "UPDATE trial_user_attributes SET value_json = '[[[]]]'", "UPDATE trial_params SET param_name = 'a b'",
    "ALTER TABLE trials RENAME TO other; CREATE VIEW trials AS SELECT * FROM trials",
    _ENDLESS,
    "UPDATE version_info SET schema_version = 'x'", "UPDATE alembic_version SET version_num = 'v9'",
)  # fmt: skip


def _set(names: Sequence[str], values: Sequence[Any]) -> st.SearchStrategy[Form]:
    return st.tuples(st.just("set"), st.tuples(st.sampled_from(names), st.sampled_from(values)).map(list))


def _texts(*texts: str) -> st.SearchStrategy[Form]:
    return st.tuples(st.just("text"), st.sampled_from(texts))


def _nested(*texts: str) -> st.SearchStrategy[Form]:
    return st.sampled_from(texts).map(lambda text: ("repeated", [text, 100_000]))


def _of(name: str) -> st.SearchStrategy[Form]:
    """What may be done to a file of that name."""
    whole: list[Form] = [
        ("pipe", None), ("link", "/dev/zero"), ("link", "nowhere"), ("folder", None), ("sparse", 200 * 2**20),
        ("gone", None),
    ]  # fmt: skip
    part = st.floats(0, 1)
    either = [
        st.sampled_from(whole), st.tuples(st.just("cut"), part), st.tuples(st.just("flipped"), part),
        st.tuples(st.just("bytes"), st.binary(max_size=30)),
    ]  # fmt: skip
    match name.rpartition("/")[2].rpartition("."):
        case _, _, "json":
            set_ = _set(OF_JSON[name.rpartition("/")[2]], VALUES)
            either += [set_, set_, set_, _texts(*JSON_TEXTS), _nested("[", '{"a":', '{"seconds":[')]
        case "overrides", _, "yaml":
            either += [_texts(*YAML_TEXTS), _texts(*YAML_TEXTS), _nested("[", "- ", "{a: ")]
        case kind, _, "yaml":
            keys = OF_SWEEP if kind == "multirun" else ("hydra.runtime", "hydra.runtime.cwd", "hydra")
            either += [_texts(*YAML_TEXTS), _nested("[", "- ", "{a: "), _set(keys, VALUES), _set(keys, VALUES)]
        case _, _, "csv":
            set_ = _set(OF_CSV, ("", "x", "nan", "inf", "1e400", "\x1b[2J", "9" * 5000))
            either += [_texts(*CSV_TEXTS), set_, set_]
        case _, _, "npz":
            numbers = (None, [], [math.nan], [0.0] * 50, [[1.0]], [-1.0], 1e300, "text", [10**12, 10**12])
            either += [_set(ARRAYS, numbers)] * 4
        case _, _, "nc":
            either += [st.tuples(st.just("hdf5"), st.sampled_from(sorted(HISTORIES)))] * 5
            either += [st.tuples(st.just("bytes"), st.binary(max_size=300).map(b"\x89HDF\r\n\x1a\n".__add__))]
        case _, _, "db":
            either += [st.tuples(st.just("sql"), st.sampled_from(STATEMENTS))] * 5
    return st.one_of(either)


# By what lies there: what is called for, and what of it is changed.
_TABLES = (
    "fitness.csv", "parameters.csv", "history.csv", "residuals.csv", "score.csv", "validation.csv",
    "identifiability.csv",
)  # fmt: skip
_AGAIN = (*FINISHED, "resume=auto")
_PREDICTED, _UPDATED = (*QUICK, "model=run", "scheme=predict"), (*QUICK, "model=run", "scheme=update")
_MODEL = (_PREDICTED, _UPDATED)
_SHOWN = (("collect=sweep",), ("load", "sweep"))
_KINDS: tuple[tuple[str, tuple[tuple[str, ...], ...], tuple[str, ...]], ...] = (
    ("finished", (("resume=run",), _AGAIN, ("resume=run", "strict=true"), *_MODEL, ("load", "run")), ("run/run.json",)),
    ("finished", (("resume=run",), _AGAIN), ("run/tracking.json", "run/.hydra/config.yaml", "run/.hydra/hydra.yaml")),
    ("finished", _MODEL, ("run/model.npz",)),
    ("finished", (_UPDATED,), ("run/parameters_over_time.csv",)),
    ("finished", (("load", "run"),), ("run/response.nc", "run/posterior.nc")),
    ("finished", (("load", "run"), ("load", "run"), ("collect=run",)),
     ("run/response.nc", "run/.hydra/config.yaml", "run/.hydra/hydra.yaml", *(f"run/{name}" for name in _TABLES))),
    ("stopped", (("resume=run",), (*STOPPED, "resume=auto")),
     ("run/checkpoint.pt", "run/checkpoint.previous.pt", "run/.hydra/config.yaml", "run/run.lock", "run/pinn-run.log")),
    ("swept", (*_SHOWN, SWEPT), ("sweep/seed=0*/run.json", "sweep/seed=0*/failure.json", "sweep/multirun.yaml")),
    ("swept", (*_SHOWN, SWEPT), (
        "sweep/seed=9/.hydra/overrides.yaml", "sweep/seed=0*/.hydra/overrides.yaml", "sweep/fitness.csv",
        "sweep/jobs.csv", *(f"sweep/seed=0*/{name}" for name in _TABLES),
    )),
    ("searched", (*_SHOWN, SEARCHED), ("sweep/search.db",)),
    ("searched", (*_SHOWN, SEARCHED), (
        "sweep/multirun.yaml", "sweep/network*/run.json", "sweep/network*/failure.json",
        "sweep/network*/.hydra/overrides.yaml",
    )),
    ("windowed", ((*WINDOWED, "resume=auto"), ("resume=run",)), ("run/windows/0001/response.nc",)),
    ("windowed", ((*WINDOWED, "resume=auto"), ("resume=run",)), (
        "run/windows/windows.json", "run/windows/0001/window.json", "run/windows/0001/window.json",
        "run/windows/0001/handed_over/model.npz", "run/windows/0002/window.json", "run/windows/0001/response.nc",
        "run/windows/0001/residuals.csv",
    )),
)  # fmt: skip


@st.composite
def directories(draw: st.DrawFn) -> Trial:
    """Runs, sweeps, searches and windows of somebody else's, asked for in every way."""
    start, calls, names = draw(st.sampled_from(_KINDS))
    name = draw(st.sampled_from(names))
    return Trial("directories", draw(st.sampled_from(calls)), {name: draw(_of(name))}, start)


@st.composite
def terminal(draw: st.DrawFn) -> Trial:
    """Texts that a terminal would obey, and names that a figure would set as mathematics."""
    escape = draw(st.sampled_from(ESCAPES))
    match draw(st.sampled_from(("job", "reason", "failure", "name", "search", "column", "column", "figure", "figure"))):
        case "job":
            place, content = f"sweep/{escape.replace(chr(0), '')}", {"status": 1, "reason": escape, "traceback": ""}
            files: dict[str, Form] = {
                f"{place}/.hydra/overrides.yaml": ("text", "- seed=5\n"),
                f"{place}/failure.json": ("text", json.dumps(content)),
            }
            return Trial("terminal", ("collect=sweep",), files, "swept")
        case "reason":
            key, value = draw(st.sampled_from((("reasons", [escape]), ("verdict", escape), ("case", escape))))
            calls = (("resume=run", "strict=true"), _PREDICTED, ("load", "run"))
            return Trial("terminal", draw(st.sampled_from(calls)), {"run/run.json": ("set", [key, value])}, "finished")
        case "failure":
            content = {"status": 2, "reason": escape, "traceback": f"Traceback\n{escape}"}
            files = {"sweep/seed=0*/failure.json": ("text", json.dumps(content))}
            return Trial("terminal", draw(st.sampled_from(_SHOWN)), files, "swept")
        case "name":
            column, text = draw(st.sampled_from((("group", escape), ("quantity", escape), ("estimator", escape))))
            files = {"sweep/seed=0*/fitness.csv": ("set", [column, text])}
            return Trial("terminal", ("collect=sweep",), files, "swept")
        case "search":
            change = draw(st.sampled_from(("trial_params SET param_name", "trial_user_attributes SET key")))
            text = escape.replace("\x00", "").replace("'", "")
            files = {"sweep/search.db": ("sql", f"UPDATE {change} = '{text}'")}
            return Trial("terminal", ("collect=sweep",), files, "searched")
    named = escape.replace("\n", "").replace("\r", "") if draw(st.booleans()) else draw(st.sampled_from(NAMES))
    rows = rig()
    rows[0] = ["t", "f", named]
    rig_csv = {"rig.csv": ("text", "\n".join(",".join(row) for row in rows))}
    if draw(st.booleans()):
        return Trial("terminal", ("inspect", "data=csv", "data.path=rig.csv"), rig_csv)
    own = [a for a in MEASURED if "acceleration" not in a and a != "figures=false"]
    form = draw(st.sampled_from((
        {"acceleration": {1: named}}, {"channels": [{"column": named, "quantity": "acceleration", "dof": 1}]},
    )))  # fmt: skip
    text = "# @package _global_\n" + json.dumps({"data": form})
    figures = draw(st.sampled_from(("figures=true", "figures=false")))
    arguments = (*own, "--config-dir", "conf", "experiment=named", figures)
    return Trial("terminal", arguments, {**rig_csv, "conf/experiment/named.yaml": ("text", text)})
