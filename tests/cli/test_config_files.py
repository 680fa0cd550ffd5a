"""Files of settings of somebody's own that no run can use: the file, the line and what to do, in one line and soon."""

import time
from pathlib import Path

import pytest
from calls import PinnRun

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
    outcome = pinn_run("--config-dir", "own", "network=mine")
    assert time.monotonic() - begun < 20
    assert (outcome.status, outcome.err.count("\n")) == (2, 1), outcome.err
    for part in told:
        assert part in outcome.err
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
    outcome = pinn_run(f"{asked}=theirs")
    assert time.monotonic() - begun < 20
    assert (outcome.status, outcome.err.count("\n")) == (2, 1), outcome.err
    assert outcome.err.startswith(f"pinn-run: {asked}=")
    assert f"{Path(stored).name}, line 2" in outcome.err


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
