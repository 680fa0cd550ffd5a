"""Files of settings, by `--config` or in folders: what they set, and those that no run can use; `--quiet`, `--json`."""

import json
import time
from pathlib import Path

import pytest
from calls import SMALL, PinnRun

from pinn_cli.cli.options import overrides_of
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.yaml_file import MOST_LEVELS, MOST_YAML_BYTES, read_yaml

BOMB = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
FILES = {
    "alias bomb": (BOMB, ["line 2=*a0", "written out"]),
    "bomb of interpolated lists": (
        "a0: [x, y]\n" + "".join(f"a{i}: ['${{..a{i - 1}}}', '${{..a{i - 1}}}']\n" for i in range(1, 40)),
        ["network.a", "at most 100000 values", "unfold"],
    ),
    "bomb of selected names": (
        "a0: x\n" + "".join(f"a{i}: ${{oc.select:network.a{i - 1}}}${{network[a{i - 1}]}}\n" for i in range(1, 40)),
        ["network.a", "at most 100000 values", "unfold"],
    ),
    "bomb behind a name": (
        "b0: {x: [1]}\n"
        + "".join(
            f"a{i}: ${{.b{i}}}\nb{i}: {{x: ['${{...a{i - 1}.x}}', '${{...a{i - 1}.x}}']}}\n" for i in range(1, 40)
        )
        + "a0: ${.b0}\n",
        ["at most 100000 values", "unfold"],
    ),
    "names within names": (
        "one: a0\na0: x\na1: ${network.${network.one}}\n",
        ["network.a1=${network.${network.one}}", "plainly"],
    ),
    "long text": (
        f"a0: {'x' * 100_000}\n" + "".join(f"a{i}: ${{.a{i - 1}}}${{.a{i - 1}}}\n" for i in range(1, 12)),
        ["at most 100000 values"],
    ),
    "interpolated circle": ("depth: ${.width}\nwidth: ${.depth}\n", ["network.depth=${.width}", "names itself"]),
    "name within itself": ("depth: &a\n  b: *a\n", ["line 2=*a", "aliases are not read"]),
    "a list": ("- depth\n", ["mine.yaml=- depth", "settings"]),
    "tab": ("depth: 3\nweights:\n\tphysics: 2\n", ["line 3=physics: 2", "spaces, not with tabs"]),
    "open bracket": ("depth: [1,\nwidth: 2\n", ["line 3", "YAML", "flow sequence of line 1"]),
    "twice": ("depth: 1\nwidth: 2\ndepth: 3\n", ["line 3=depth: 3", "duplicate key depth"]),
    "Python object": ("depth: !!python/object/apply:os.system [ls]\n", ["line 1", "YAML"]),
    "control character": ("depth: 1\n# \x01\n", ["line 2", "'\\x01'"]),
    "half an interpolation": ("depth: ${\n", ["mine.yaml", "settings"]),
    "deeply nested": (f"depth: {'[' * 9000}{']' * 9000}\n", [f"at most {MOST_LEVELS} levels"]),
    "itself included": ("defaults: [mine]\n", ["mine.yaml, defaults=mine", "another file"]),
    "circle of files": ("defaults: [theirs]\n", ["network=mine", "include each other in a circle"]),
    "defaults that are none": ("defaults: 5\n", ["network=mine", "must be a list"]),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "own" / "network"
    folder.mkdir(parents=True)
    (folder / "theirs.yaml").write_text("defaults: [mine]\n")
    return folder


@pytest.mark.parametrize(("text", "told"), FILES.values(), ids=FILES.keys())
def test_a_file_that_is_none(pinn_run: PinnRun, folder: Path, text: str, told: list[str]) -> None:
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    begun = time.monotonic()
    pinn_run("--config-dir", "own", "network=mine").refused(*told)
    assert time.monotonic() - begun < 20
    assert not (folder.parents[1] / "outputs").exists()


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_another_encoding(pinn_run: PinnRun, folder: Path, encoding: str) -> None:
    (folder / "mine.yaml").write_bytes("depth: 1\nwidth: 2  # Körper\n".encode(encoding))
    for place in ("--config-dir", "own"), ("hydra.searchpath=[own]",), (f"hydra.searchpath=[file://{folder.parent}]",):
        pinn_run(*place, "network=mine").refused(
            "UTF-8", f"mine.yaml, line {2 if encoding == 'latin-1' else 1}=byte 0x"
        )


def test_a_file_of_another_kind(tmp_path: Path) -> None:
    file = tmp_path / "large.yaml"
    file.write_bytes(b"#" * (MOST_YAML_BYTES + 1))
    with pytest.raises(InputError, match=f"at most {MOST_YAML_BYTES} bytes"):
        read_yaml(file)
    with pytest.raises(InputError, match="a file that can be read"):
        read_yaml(tmp_path)
    file.write_text("")
    assert read_yaml(file) == {}


@pytest.mark.parametrize("stored", [".hydra/config.yaml", ".hydra/hydra.yaml", "multirun.yaml"])
def test_stored_files_of_somebody_else(pinn_run: PinnRun, tmp_path: Path, stored: str) -> None:
    for name in (".hydra/config.yaml", stored):
        (tmp_path / "theirs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "theirs" / name).write_text("case: theirs\n")
    (tmp_path / "theirs" / stored).write_text(BOMB)
    asked = "collect" if stored == "multirun.yaml" else "resume"
    begun = time.monotonic()
    pinn_run(f"{asked}=theirs").refused(f"pinn-run: {asked}=", f"{Path(stored).name}, line 2")
    assert time.monotonic() - begun < 20


def test_folders_of_one_s_own_work_in_every_way(pinn_run: PinnRun, folder: Path) -> None:
    (folder / "mine.yaml").write_text("# @package network\n_target_: pinn_cli.network.spline.Spline\ndegree: 4\n")
    (folder / "longer.yaml").write_text("defaults: [mine, _self_]\nintervals: 9\n")
    for place in (
        ("--config-dir", "own"),
        ("hydra.searchpath=[own]",),
        (f"hydra.searchpath=['file://{folder.parent}']",),
    ):
        outcome = pinn_run(*place, "network=longer", "--cfg", "job", "--package", "network")
        assert outcome.out.split("\n")[1:4] == ["_target_: pinn_cli.network.spline.Spline", "degree: 4", "intervals: 9"]
    outcome = pinn_run("--config-dir", "own", "--multirun", "network=longer,mine", "seed=0,1", task=lambda config: None)
    assert "4 jobs" in outcome.out, outcome.err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("true: 1\n2: 3", "True=1"),
        ("noise: {seeds: {true: 1, 2: 3}}", "noise.seeds="),
        ("data: {1.5: 3, true: 4}", "data.1.5=3"),
        ("case: ${hydra.nothing}", "hydra.nothing"),
        ("hydra: {run: {dir: 'out/${hydra.nothing}'}}", "hydra.run.dir="),
    ],
)
def test_odd_keys_and_names_leave_nothing(pinn_run: PinnRun, folder: Path, text: str, told: str) -> None:
    place = folder.parent / "experiment"
    place.mkdir()
    (place / "odd.yaml").write_text(f"# @package _global_\n{text}\n")
    pinn_run("--config-dir", "own", "experiment=odd").refused(told)
    assert [entry.name for entry in folder.parents[1].iterdir()] == ["own"]


TEXT = """# @package _global_
defaults:
  - override /system: linear
  - override /scheme: state_parameter
  - _self_
system: {ndof: 3, k: [1.0, null, 3]}
scheme.unknown: k_2
data:
  path: my rig.csv
  force: {1: "F (1)", 2: null}
case: yes it is
strict: false
"""


def test_settings_of_a_file_are_overrides(tmp_path: Path, pinn_run: PinnRun) -> None:
    (tmp_path / "my.yaml").write_text(TEXT)
    assert overrides_of(str(tmp_path / "my.yaml"), ["system.ndof=4", "~case"]) == [
        "system=linear", "scheme=state_parameter", "system.k=[1.0,null,3]", "scheme.unknown=k_2",
        'data.path="my rig.csv"', 'data.force={1: "F (1)", 2: null}', "strict=false",
    ]  # fmt: skip
    (tmp_path / "my.yaml").write_text(
        "system: linear\nsystem.ndof: 3\nnoise: {snr_db: 20.0}\nexcitation.dofs: [1, 2]\n"
    )
    text = pinn_run("--config", "my.yaml", "system.ndof=4", "--cfg", "job", "-p", "system").out
    assert "ndof: 4" in text
    assert "linear.Linear" in text
    assert pinn_run("--config", "my.yaml", "--cfg", "job", "-p", "excitation.dofs").out.split() == [
        "#", "@package", "excitation.dofs", "-", "1", "-", "2",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "--config=my.yaml: must be a file of settings (YAML) that exists"),
        ("- a\n", "settings, as in"),
        ("system: {ndfo: 3}\n", "system.ndfo=3: must be one of the settings"),
        ("sytem: linear\n", "did you mean system?"),
        ("defaults: 5\n", "my.yaml, defaults=5"),
        ("a: &x [1]\nb: *x\n", "aliases are not read"),
        ("network: {_target_: os.system}\n", "network"),
    ],
)
def test_a_file_that_no_command_can_use(pinn_run: PinnRun, tmp_path: Path, text, expected) -> None:
    if text is not None:
        (tmp_path / "my.yaml").write_text(text)
    pinn_run("--config", "my.yaml").refused(expected)
    assert not (tmp_path / "outputs").exists()


def test_quiet_and_json(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SMALL, "--quiet", "figures=false", "hydra.run.dir=mine").done()
    assert outcome.err == ""
    assert len(outcome.out.splitlines()) == 1
    assert (outcome.directory / "pinn-run.log").read_text()
    again = pinn_run(*SMALL, "--json", "figures=false", "hydra.run.dir=mine", "resume=auto")
    found = json.loads(again.out)
    assert found["directory"] == str(outcome.directory)
    run = outcome.record
    assert (found["verdict"], found["reasons"]) == (run["verdict"], run["reasons"])
    assert {row["parameter"] for row in found["parameters"]} >= {"k_1", "kappa_3"}
    # Of its jobs those alone that failed.
    outcome = pinn_run(*SMALL, "--quiet", "--multirun", "seed=1,x", "hydra.sweep.dir=sweep").refused()
    assert outcome.out == "sweep\n"
    (line,) = outcome.err.splitlines()
    assert line.endswith("failed: seed=x: must be a whole number >= 0")


def test_help_of_a_group(pinn_run: PinnRun) -> None:
    text = pinn_run("--help", "network").out
    assert "--- network=spline" in text
    assert "--- network=mlp" in text
    assert "_target_" not in text
    one = pinn_run("--help", "data=csv").out
    assert "names_line: null" in one
    assert "path: null                 # to be given" in one
    assert "`pinn-run --help experiment=" in pinn_run("--help", "experiment").out
