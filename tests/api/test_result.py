"""Results read from the directory of a run: tables, response, posterior and figures, in Python and in a notebook."""

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import SMALL
from matplotlib.figure import Figure
from matplotlib.image import imread

from pinn_cli import InputError, Result, load, run
from pinn_cli.report import figures

UNKNOWN = ("scheme=state_parameter", "scheme.unobserved=[2]", "scheme.unknown=[k_2]", "system=linear")


def ran(directory: Path, *overrides: str) -> Result:
    return run(*SMALL, *UNKNOWN, "case=small", "report.between=[2,9]", *overrides, directory=directory)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return ran(tmp_path_factory.mktemp("result") / "run", "figures=false")


def test_tables_are_those_of_the_files(result: Result) -> None:
    for name in ("fitness", "parameters", "modes", "residuals", "free_run", "history"):
        written, shown = pd.read_csv(result.directory / f"{name}.csv"), getattr(result, name)
        scored = [column for column in written if column == "fitness_percent"]
        kept = written.dropna(subset=scored).reset_index(drop=True)
        pd.testing.assert_frame_equal(shown, kept, check_like=True)
        assert "case" not in shown or list(shown)[-1] == "seed"
    assert list(result.parameters)[:2] == ["estimator", "parameter"]
    (k_2,) = [found for found in result.run_record["parameters"] if found["name"] == "k_2"]
    assert k_2["estimate"] == pytest.approx(result.parameters.set_index("parameter").loc["k_2", "estimate"])
    assert result.validation is None
    assert result.posterior is None
    assert result.verdict == result.run_record["verdict"]
    assert result.settings["system"]["ndof"] == 3
    with pytest.raises(InputError, match=r"table=drfit: must be one of .*drift"):
        result.table("drfit")


def test_the_response_is_labelled_and_a_notebook_shows_it(result: Result) -> None:
    of_dof = result.response.sel(dof=2)
    assert np.isnan(of_dof["acceleration_observed"]).all()
    error = np.abs(of_dof["displacement"] - of_dof["displacement_true"]).max()
    assert error < 0.1 * np.abs(of_dof["displacement_true"]).max()
    shown = result._repr_html_()
    assert "k_2" in shown
    assert str(result.directory) in shown
    assert "small" in repr(result)


@pytest.mark.slow
def test_figures_are_those_that_the_run_drew(tmp_path: Path) -> None:
    result = ran(tmp_path / "run")
    drawn = {file.stem for file in (result.directory / "figures").glob("*.png")}
    (result.directory / "own.csv").write_bytes(b"a user's;\n1,2\n3,4,\xff\n")
    assert set(result.plot.names) == drawn
    for name in drawn:
        figure = getattr(result.plot, name)()
        assert isinstance(figure, Figure)
        shown = BytesIO(figure._repr_png_())  # type: ignore[attr-defined]
        again, first = imread(shown), imread(result.directory / "figures" / f"{name}.png")
        assert again.shape == first.shape
        assert np.abs(again - first).mean() < 1e-5, name  # tables have ten digits: a pixel may fall to its neighbour
    with pytest.raises(InputError, match=r"plot.hysteresis=\(\): must be one of response"):
        result.plot.hysteresis()
    assert result.plot.response().axes[0].get_xlim() == pytest.approx((2.0, 9.0), abs=0.1)
    assert result.plot.response(between=(1.0, 2.0)).axes[0].get_xlim() == pytest.approx((1.0, 2.0), abs=0.2)
    with pytest.raises(InputError, match=r"plot.response, between=\(2, 1\): must be two times of the record"):
        result.plot.response(between=(2, 1))
    with pytest.raises(InputError, match="response and drift take it"):
        result.plot.modes(between=(1.0, 2.0))


def test_every_figure_that_a_run_may_draw_can_be_asked_for(result: Result) -> None:
    """`restoring` stood among the names, and was no figure."""
    drawn = set(re.findall(r'builders\["(\w+)"\]', Path(figures.__file__).read_text()))
    assert {"restoring", "discrepancy", "frequency_response"} < drawn <= set(dir(result.plot))


def test_a_directory_that_is_none(result: Result, tmp_path: Path) -> None:
    assert repr(load(result.directory)) == repr(result)
    for place, told in ((tmp_path, "no run.json"), (tmp_path / "none", "there is no such directory")):
        with pytest.raises(InputError, match=told):
            load(place)
    (tmp_path / ".hydra").mkdir()
    with pytest.raises(InputError, match=r"run\('resume="):
        load(tmp_path)


@pytest.mark.slow
def test_draws_of_a_posterior() -> None:
    settings = ("scheme=bayesian", "posterior=laplace", "noise.repeats=2", "figures=false", "system.ndof=2")
    result = run(*SMALL, *settings, keep=False)
    assert result.posterior is not None
    draws = result.posterior["posterior"]["k_1"]
    row = result.parameters.set_index("parameter").loc["k_1"]
    assert float(draws.mean()) == pytest.approx(row["estimate"], rel=1e-6)
    assert isinstance(result.plot.posterior(), Figure)
