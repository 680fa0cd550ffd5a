"""The figure of residuals: what is in its panels, and which sensors have a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pinn_cli.report.figures import residuals_figure, save


def rows(figure):
    return np.array(figure.axes).reshape(-1, 3)


def texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_row_for_every_sensor_with_its_noise(make_case):
    case = make_case(ndof=3, observed=2)
    estimate = replace(case.estimate, summary={"sigma_acceleration": [0.02, None, None]})
    figure = residuals_figure(estimate, case.record)
    labels = [row[0].get_ylabel() for row in rows(figure)]
    assert labels == [r"$\ddot{u}$, DOF 1", r"$\ddot{u}$, DOF 2", "$f$, DOF 1"]
    left = case.record.acceleration[:, 0] - case.estimate.response.acceleration[:, 0]
    history, spectrum, _ = rows(figure)[0]
    assert history.get_title(loc="left") == "(mm/s²)"
    np.testing.assert_allclose(history.lines[0].get_ydata(), 1e3 * left)
    assert [line.get_ydata()[0] for line in history.lines[1:]] == pytest.approx([-39.2, 39.2])
    assert spectrum.lines[2].get_ydata()[0] == pytest.approx(0.02**2)
    assert len(rows(figure)[1][1].lines) == 2
    assert texts(figure)[2].startswith("noise found")
    assert "noise found" not in " ".join(texts(residuals_figure(case.estimate, case.record)))


def test_the_bounds_of_white_noise_are_those_of_the_samples(make_case):
    case = make_case(ndof=1, observed=1, samples=400)
    correlation = rows(residuals_figure(case.estimate, case.record))[0][2]
    assert correlation.patches[0].get_y() == pytest.approx(-1.96 / 20.0)
    assert correlation.patches[0].get_height() == pytest.approx(2.0 * 1.96 / 20.0)


def test_of_many_sensors_the_worst_are_shown_and_counted(make_case):
    case = make_case(ndof=12, observed=12)
    acceleration = case.record.acceleration.copy()
    acceleration[:, [3, 10]] += 5.0
    figure = residuals_figure(case.estimate, replace(case.record, acceleration=acceleration))
    assert len(rows(figure)) == 8
    labels = [row[0].get_ylabel() for row in rows(figure)]
    assert {r"$\ddot{u}$, DOF 4", r"$\ddot{u}$, DOF 11"} <= set(labels)
    assert [text.get_text() for text in figure.texts] == ["the 8 of 13 sensors with the largest NMSE"]


@pytest.mark.parametrize("signal", [0.0, 1.0])
def test_a_dead_sensor_and_an_exact_estimate_can_be_drawn(signal, make_case, tmp_path):
    case = make_case(ndof=1, observed=1)
    record = replace(case.record, acceleration=signal * case.truth.response.acceleration)
    response = replace(case.truth.response, acceleration=record.acceleration)
    for path in save(residuals_figure(replace(case.estimate, response=response), record), tmp_path, "residuals"):
        assert path.stat().st_size > 1000
