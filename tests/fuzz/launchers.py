"""Inputs of the family launchers: options of launchers and trackers, and foreign files where trackers keep theirs."""

from fuzz.starts import QUICK
from fuzz.trial import Trial
from hypothesis import strategies as st

NAMES = ("nope", "''", "null", "joblib,basic", "../joblib", "[joblib]", "slurm", "ray_local", "ray_cluster", "basic")
ODD = ("0", "-2", "1.5", "null", "abc", "[]", "{}", "1e400", "true", "''", "'\x1b[2J'", "nan", "99999999999999999999")
SETTINGS = {
    "joblib": ("n_jobs", "timeout", "pre_dispatch", "batch_size", "temp_folder", "max_nbytes", "mmap_mode", "x"),
    "workstation": ("jobs_per_task", "timeout_min", "cpus_per_task", "gpus_per_node", "mem_gb", "nodes"),
}  # fmt: skip
FOLDERS = (
    "logs", "there", "pipe", "''", "null", "/dev/null", "/proc/x", "loop", "[]", "5", "run", "a\nb",
    "'\x1b[2J'",
)  # fmt: skip
STORES = (
    "sqlite:///logs/app.db", "sqlite:///there", "sqlite:///pipe", "sqlite:////dev/null", "sqlite:///", "http://localhost:9",
    "file:///etc", "nope://x", "''", "null", "5", "[]", "sqlite:///nowhere/x/y.db",
    "'sqlite:///\x1b.db'", "mysql://a:b@c/d",
)  # fmt: skip
FOREIGN = {
    "there": ("text", "a file of the user's"),
    "pipe": ("pipe", None),
    "loop": ("link", "loop"),
    "logs/default/run/events.out.tfevents.1.other": ("text", "events of another program"),
    "logs/app.db": ("text", "no database"),
}


@st.composite
def launchers(draw: st.DrawFn) -> Trial:
    """Launchers that there are not, odd settings of those that there are, trackers with somebody's files."""
    match draw(st.sampled_from(("name", "setting", "setting", "folder", "folder", "store"))):
        case "name":
            mode = draw(st.sampled_from(((), ("--multirun", "seed=0,1", "hydra.sweep.dir=sweep"))))
            return Trial("launchers", (*QUICK, *mode, f"hydra/launcher={draw(st.sampled_from(NAMES))}"))
        case "setting":
            launcher = draw(st.sampled_from(sorted(SETTINGS)))
            setting = f"hydra.launcher.{draw(st.sampled_from(SETTINGS[launcher]))}={draw(st.sampled_from(ODD))}"
            sweep = ("--multirun", "seed=0,1", f"hydra/launcher={launcher}", "hydra.sweep.dir=sweep")
            return Trial("launchers", (*QUICK, *sweep, setting))
        case "folder":
            given = f"tracking.directory={draw(st.sampled_from(FOLDERS))}"
            return Trial("launchers", (*QUICK, "hydra.run.dir=run", "tracking=tensorboard", given), FOREIGN)
    setting = draw(st.sampled_from(("uri", "uri", "experiment", "artifacts", "files")))
    values = STORES if setting == "uri" else ODD
    given = (f"tracking.{setting}={draw(st.sampled_from(values))}",)
    return Trial("launchers", (*QUICK, "hydra.run.dir=run", "tracking=mlflow", *given), FOREIGN)
