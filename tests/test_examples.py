"""The worked examples of docs/how-to/my-structure.md, as their commands run them."""

import pandas as pd
import pytest
from calls import PinnRun

# Per cent by which each unknown parameter may be off: some four standard deviations.
EXAMPLES = {
    "frame_with_brace": {"k_storey_1": 0.7, "k_brace": 0.7, "kappa_storey_1": 1.7},
    "tuned_mass_damper": {"k_spring": 0.3, "c_damper": 1.6},
    "shear_building_earthquake": {"k_storey_1": 1.6, "k_storey_2": 2.1, "k_storey_3": 0.7},
    "frame_with_hysteretic_brace": {},
    "ambient_vibration": {},
}
# Where forces are not measured, slow drift is not told.
DISPLACEMENT = {"ambient_vibration": 90.0}
# What the roof of a frame does, other frames do too.
SEVERAL = ("shear_building_earthquake",)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_finds_what_it_asks_for(pinn_run: PinnRun, example: str) -> None:
    outcome = pinn_run(f"experiment=examples/{example}", "figures=false").done()
    parameters = outcome.parameters
    for name, percent in EXAMPLES[example].items():
        assert parameters.loc[name, "error_percent"] < percent
    fitness = pd.read_csv(outcome.directory / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert fitness["unobserved", "displacement"] > DISPLACEMENT.get(example, 97.0)
    verdict = outcome.record
    if example not in SEVERAL:
        assert verdict["verdict"] == "sound"
        return
    assert verdict["verdict"] == "questionable"
    (reason,) = verdict["reasons"]
    assert reason.startswith("another structure explains the record as well")
