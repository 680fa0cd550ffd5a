"""`pinn-run --json-schema`: files of settings that a run takes pass, and slips do not."""

import json
import re
from pathlib import Path

import pytest
import yaml
from calls import PinnRun
from jsonschema import Draft7Validator
from omegaconf import OmegaConf

from pinn_cli.cli.config import NODES
from pinn_cli.cli.help import option_names
from pinn_cli.cli.schema import json_schema
from pinn_cli.settings.errors import InputError

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
WRITTEN = [
    (f"{page.name}:{number}", text)
    for page in PAGES
    for number, text in enumerate(re.findall(r"^```yaml\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL))
    if "_target_:" not in text  # files of options, which are not files of settings
]
WRITTEN += [(file.stem, file.read_text("utf-8")) for file in sorted((ROOT / "conf" / "experiment").rglob("*.yaml"))]


@pytest.fixture(scope="module")
def checked() -> Draft7Validator:
    schema = json_schema()
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


def read(text: str) -> object:
    """As OmegaConf reads numbers, with the keys of JSON."""
    return json.loads(json.dumps(OmegaConf.to_container(OmegaConf.create(text), resolve=False)))


@pytest.mark.parametrize(("place", "text"), WRITTEN, ids=[place for place, _ in WRITTEN])
def test_experiments_and_files_that_pages_show_pass(checked: Draft7Validator, place: str, text: str) -> None:
    assert isinstance(yaml.safe_load(text), dict), place
    checked.validate(read(text))


@pytest.mark.parametrize("name", NODES)
def test_the_files_of_conf_pass(checked: Draft7Validator, name: str) -> None:
    """What an option sets is legal, in a block and with dots."""
    for option in option_names(name):
        node = OmegaConf.load(ROOT / "conf" / name / f"{option}.yaml")
        plain = {key: value for key, value in read(OmegaConf.to_yaml(node)).items() if key not in ("defaults", "kind")}
        checked.validate({name: plain})
        checked.validate({name: option, **{f"{name}.{k}": v for k, v in plain.items() if not k.startswith("_")}})


@pytest.mark.parametrize(
    "text",
    [
        "system: {ndof: 3, k: [1.0, null, 3]}", "system: linear\nsystem.ndof: 4", "excitation.dofs: [floor_1]",
        "data: {path: [a.csv, b.csv], force: {1: f, 2: null}, validation: {start: 1, stop: 2}}",
        "data.force.1: f", "noise.snr_db: null", "threads: ${oc.env:CORES}", "training.weights.physics: 10",
        "system: {connections: {brace: {between: [ground, a], law: linear, k: 1.0e5}}}", "report.between: [1, 2]",
        "hydra/launcher: joblib", "hydra: {sweeper: {params: {seed: 'range(3)'}}}", "figures: false",
        "data: {channels: {a: {sensor: force, dof: 1, unit: kN, gain: unknown}, b: {_target_: mine.Strain, at: 3}}}",
        "defaults: [override /network: mlp, _self_]", "experiment: [paper/sr_6dof_snr50, paper_training]",
    ],
)  # fmt: skip
def test_what_a_run_takes_passes(checked: Draft7Validator, text: str) -> None:
    checked.validate(read(text))


@pytest.mark.parametrize(
    "text",
    [
        "sytem: linear", "system: linaer", "system: {ndfo: 3}", "system.ndfo: 3", "system.ndof: three",
        "network: {degree: 5, width: 20}", "network: {continuity: exactly}", "network.activation: relu",
        "scheme.initial_motion: quiet", "training.dtype: float16", "data: {time_unit: hours}", "seed: 1.5",
        "noise: {snr: 20}", "report: {export: [zip]}", "strict: yes it is", "data: {format: {sheet: a, separator: b}}",
        "data: {channels: {a: {sensor: accelerometer, dof: 1}}}", "data: {channels: {a: {sensor: force, dofs: 1}}}",
        "defaults: [override /network: mlpp]", "experiment: paper/no", "simulation: 5", "excitation: {phases: mine}",
    ],
)  # fmt: skip
def test_slips_are_seen(checked: Draft7Validator, text: str) -> None:
    assert not checked.is_valid(read(text))


def test_settings_are_explained(checked: Draft7Validator) -> None:
    said = checked.schema["properties"]
    assert said["noise.repeats"]["description"].startswith("how often the same response is measured")
    assert said["noise.repeats"]["default"] == 1
    assert "Hz" in said["data.sampling_rate"]["description"]


def test_the_command_prints_it_with_options_of_a_folder(pinn_run: PinnRun, tmp_path: Path) -> None:
    (tmp_path / "mine" / "network").mkdir(parents=True)
    own = tmp_path / "mine" / "network" / "coarse.yaml"
    own.write_text("# Coarse.\ndefaults: [spline, _self_]\nintervals: 20\n")
    outcome = pinn_run("--json-schema", "--config-dir", "mine")
    assert Draft7Validator(json.loads(outcome.out)).is_valid({"network": "coarse", "network.intervals": 20})
    assert not Draft7Validator(json_schema()).is_valid({"network": "coarse"})
    own.write_text("_target_: os.system\n")
    with pytest.raises(InputError, match="network"):
        json_schema("mine")
