"""Inputs of the families options, numbers, physics and launchers: the command line."""

from functools import cache

from fuzz.trial import QUICK, STEPPED, Trial
from hypothesis import strategies as st

GROUPS = (
    "system", "excitation", "model_error", "data", "scheme", "network", "training", "posterior", "validation",
    "baseline", "tracking", "experiment", "hydra/launcher", "hydra/sweeper", "hydra/job_logging",
)  # fmt: skip
HANDLER = "torch.distributed.elastic.multiprocessing.subprocess_handler.subprocess_handler.SubprocessHandler"
# Values that were never meant.
ODD = (
    "", "null", "true", "???", "[]", "{}", "[1,2]", "{a:1}", "[[]]", "'", '"', "[1", "{a", "a b", "ä", "~/x", "-",
    "${nothing}", "${oc.env:HOME}", "${now:%Y}", "${", "$", "\\", "=", "a=b", "1,2", "range(3)", "choice(1,2)",
    "glob(*)",
    "../../etc", "/dev/null", "nan", "0x10", "1e", "1_000", "None", "on", "\t", "%", "${seed}", "${sweep_name:1,2}",
    "\x00",
    "a" * 300, "..", "_", "'a'", "'${x}'", "interval(0,1)", "sort(3,1)", "[null]", "{1: a1}", "\U0001f600", ":",
    "1e999",
)  # fmt: skip
EXECUTED = (
    "network._target_=os.system",
    "network._target_=subprocess.Popen",
    f"network={{_target_: {HANDLER}, entrypoint: mkdir, args: [../executed], env: {{}}, stdout: null, stderr: null}}",
    f"+excitation.x={{_target_: {HANDLER}}}",
    '+system.x={_target_: builtins.eval, _args_: [\'__import__("os").mkdir("../executed")\']}',
    f"+hydra.callbacks.x={{_target_: {HANDLER}, entrypoint: mkdir, args: [../executed], env: {{}}}}",
    "+hydra.callbacks.x={_target_: os.mkdir, path: ../executed}",
    "+hydra.job_logging.handlers.x={(): os.mkdir, path: ../executed}",
    "++hydra.job_logging.handlers.file={class: logging.FileHandler, filename: ../executed, mode: w}",
    "hydra.launcher._target_=os.system",
    "hydra.sweeper._target_=os.system",
    "+hydra.job.env_set={GIT_CONFIG_COUNT: 1, GIT_CONFIG_KEY_0: core.fsmonitor, GIT_CONFIG_VALUE_0: mkdir}",
    "hydra.output_subdir=../../executed",
    "hydra.sweep.subdir=../../executed",
    "tracking={_target_: torch.utils.tensorboard.SummaryWriter, log_dir: ../executed}",
    "training._target_=pinn_cli.runs.process.os.system",
    "validation={_target_: pinn_cli.settings.instantiation.importlib.import_module, name: antigravity}",
    "baseline._target_=torch.load",
    "+scheme.x=${oc.create:{a:1}}",
    "posterior={_target_: torch.hub.load, repo_or_dir: ../x}",
)
# A line of options more.
FLAGS = (
    "--config-dir", "--config-dir=", "--config-dir=nowhere", "--config-dir=/dev/null", "--config-name=nothing",
    "--config-path=.", "--multirun", "--cfg", "--cfg=job", "--cfg=nothing", "--info=config", "--info=all", "--help",
    "--resolve", "--package=x", "--run", "--experimental-rerun=x", "--unknown", "-x", "--", "--version", "--hydra-help",
    "-m", "--shell-completion", "@file",
)  # fmt: skip
NUMBERS = (
    "0", "-0.0", "-1", "1", "2", "0.5", "1e-30", "1e-31", "1e30", "1e31", "1e300", "-1e300", "1e-300", "5e-324",
    "1e309",
    "nan", "inf", "-inf", "4294967296", "9223372036854775808", "1" + "0" * 400, "true", "null", "abc", "[]", "[1,2]",
    "[1,2,3]", "[1,-2,3]", "[0,0,0]", "[1,null,3]", "[nan]", "1e6", "1000000000", "-1e-9", "0.999999", "1.5",
)  # fmt: skip
NUMERIC = (
    "system.ndof", "system.m", "system.c", "system.k", "system.kappa", "seed", "threads", "excitation.rms",
    "excitation.band", "excitation.dofs", "excitation.seed", "simulation.duration", "simulation.samples",
    "+simulation.substeps", "noise.snr_db", "noise.repeats", "noise.seeds", "scheme.unobserved_fraction",
    "scheme.unobserved", "scheme.parameter_uncertainty", "network.degree", "network.knots_per_period",
    "network.intervals", "training.iterations", "training.tolerance", "training.most_residuals",
    "training.collocation_points", "training.checkpoint_every_s", "posterior.chains", "posterior.draws",
    "posterior.warmup", "posterior.target_accept",
)  # fmt: skip
STEPPING = (
    "network.depth", "network.width", "training.iterations", "training.learning_rate", "training.collocation_points",
    "training.history_every", "training.checkpoint_every_s",
)  # fmt: skip


@cache
def setting_names() -> tuple[str, ...]:
    """Every setting of the default configuration."""
    from pinn_cli.cli.composing import compose_config
    from pinn_cli.runs.identity import flattened

    return tuple(sorted(name for name in flattened(compose_config(())) if "_target_" not in name))


def odd_values() -> st.SearchStrategy[str]:
    """Text that stands behind an equals sign; an argument cannot hold a null character."""
    return st.one_of(st.sampled_from(ODD), st.text(max_size=12)).map(lambda text: text.replace("\x00", ""))


@st.composite
def options(draw: st.DrawFn) -> Trial:
    """Settings of any value, unknown ones, groups, classes to call, flags."""
    override = st.builds(
        "{}{}={}".format,
        st.sampled_from(("", "", "", "+", "++", "~")),
        st.sampled_from(setting_names()) | st.sampled_from(GROUPS) | st.text("abc.@:/_é ", min_size=1, max_size=8),
        odd_values(),
    )
    kinds = st.one_of(override, override, st.sampled_from(EXECUTED), st.sampled_from(FLAGS), odd_values())
    arguments = [a for a in draw(st.lists(kinds, min_size=1, max_size=2)) if a]
    return Trial("options", (*QUICK, *arguments))


@st.composite
def numbers(draw: st.DrawFn) -> Trial:
    """Numeric settings at and beyond their ends."""
    stepped = draw(st.booleans())
    names = STEPPING if stepped else NUMERIC
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=2, unique=True))
    values = st.one_of(st.sampled_from(NUMBERS), st.floats().map(repr), st.integers(-5, 70).map(str))
    arguments = tuple(f"{name}={draw(values)}" for name in chosen)
    return Trial("numbers", (*(STEPPED if stepped else QUICK), *arguments))


@st.composite
def physics(draw: st.DrawFn) -> Trial:
    """Structures, forces and schemes that are possible and strange."""
    size = st.floats(-6, 9).map(lambda exponent: f"{10**exponent:.3g}")
    entry = st.one_of(size, st.just("0"))
    some = {
        "system": st.sampled_from(("linear", "duffing", "van_der_pol", "power_damping", "friction", "polynomial")),
        "system.ndof": st.sampled_from(("1", "2", "3", "5")),
        "system.m": entry,
        "system.c": entry,
        "system.k": entry,
        "system.kappa": entry,
        "excitation": st.sampled_from(("banded_noise", "sine_sweep", "impulse", "ground_motion")),
        "excitation.rms": size,
        "excitation.dofs": st.sampled_from(("[1]", "[2]", "[1,2]", "[]")),
        "excitation.band": st.sampled_from(("[0,1]", "[0.2,1.5]", "[5,9]", "[0.01,0.02]", "[10,10.1]")),
        "noise.snr_db": st.sampled_from(("null", "-40", "0", "300")),
        "scheme": st.sampled_from(("sparse_recovery", "state_parameter")),
        "scheme.unknown": st.sampled_from(("[k_*]", "[m_*,c_*,k_*]", "[c_1]", "[kappa_*]", "[x]")),
        "scheme.unobserved": st.sampled_from(("[]", "[1]", "[1,2,3]", "[9]")),
        "scheme.sensors": st.sampled_from(("{acceleration: false}", "{displacement: true}", "{velocity: true}")),
        "scheme.initial_motion": st.sampled_from(("rest", "free")),
        "model_error": st.sampled_from(("linear", "perturbed", "none")),
        "network": st.sampled_from(("spline", "fourier")),
        "simulation.duration": size,
        "simulation.samples": st.sampled_from(("16", "17", "64", "256")),
        "simulation.hold": st.sampled_from(("exact", "zero_order")),
        "baseline": st.sampled_from(("kalman_smoother", "none")),
    }
    names = draw(st.lists(st.sampled_from(sorted(some)), min_size=1, max_size=4, unique=True))
    return Trial("physics", (*QUICK, *(f"{name}={draw(some[name])}" for name in sorted(names))))


LAUNCHERS = (
    "nope", "''", "null", "joblib,basic", "../joblib", "[joblib]", "slurm", "ray_local", "ray_cluster", "basic",
)  # fmt: skip
UNMEANT = (
    "0", "-2", "1.5", "null", "abc", "[]", "{}", "1e400", "true", "''", "'\x1b[2J'", "nan", "99999999999999999999",
)  # fmt: skip
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
            return Trial("launchers", (*QUICK, *mode, f"hydra/launcher={draw(st.sampled_from(LAUNCHERS))}"))
        case "setting":
            launcher = draw(st.sampled_from(sorted(SETTINGS)))
            setting = f"hydra.launcher.{draw(st.sampled_from(SETTINGS[launcher]))}={draw(st.sampled_from(UNMEANT))}"
            sweep = ("--multirun", "seed=0,1", f"hydra/launcher={launcher}", "hydra.sweep.dir=sweep")
            return Trial("launchers", (*QUICK, *sweep, setting))
        case "folder":
            given = f"tracking.directory={draw(st.sampled_from(FOLDERS))}"
            return Trial("launchers", (*QUICK, "hydra.run.dir=run", "tracking=tensorboard", given), FOREIGN)
    setting = draw(st.sampled_from(("uri", "uri", "experiment", "artifacts", "files")))
    values = STORES if setting == "uri" else UNMEANT
    given = (f"tracking.{setting}={draw(st.sampled_from(values))}",)
    return Trial("launchers", (*QUICK, "hydra.run.dir=run", "tracking=mlflow", *given), FOREIGN)
