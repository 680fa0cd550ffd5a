"""Values of overrides that hold signs of Hydra's grammar."""

from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from pinn_cli.settings.override_syntax import with_folder_quoted


@pytest.mark.parametrize("name", ["noise.snr_db=50,seed=3", "system=linear", "it's=odd,too"])
def test_a_folder_of_a_sweep_is_a_model_as_it_stands(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    folder.mkdir()
    (parsed,) = OverridesParser.create().parse_overrides([with_folder_quoted(f"model={folder}")])
    value = parsed.value()
    assert not parsed.is_sweep_override()
    assert str(getattr(value, "text", value)) == str(folder)


@pytest.mark.parametrize("override", ["model=missing=1,b", "seed=0,1", "model='a=1'", "model=plain"])
def test_other_values_stay_as_they_are(override: str) -> None:
    assert with_folder_quoted(override) == override
