"""A channel's band and noise, filters for all channels alike, and cross spectra against scipy's."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import csd
from scipy.signal.windows import tukey
from vibrating_records import low_passed

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.cross_spectra import CrossSpectra, Samples, cross_spectrum, independent_part, misses_samples, taper
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import (
    BandPass,
    band_share,
    decimate,
    lowest_level,
    occupied_band,
    periodogram,
    reaches_nyquist,
    signal_band,
    signal_edges,
    visible_floor,
    white_level,
)
from pinn_cli.settings.errors import InputError

DURATION, SAMPLES = 40.0, 2049
STEP = DURATION / (SAMPLES - 1)
TIME = np.linspace(0.0, DURATION, SAMPLES)


def banded(low: float, high: float, dofs: int = 1) -> np.ndarray:
    """(N, dofs) of rms 1."""
    return BandedNoise(dofs, DURATION, SAMPLES, [low, high], 1.0, list(range(1, dofs + 1)), seed=3).signals(TIME)


def white(std: float, columns: int = 1, seed: int = 0) -> np.ndarray:
    return std * np.random.default_rng(seed).normal(size=(SAMPLES, columns))


def test_the_periodogram_of_white_noise_is_its_variance():
    frequency, power = periodogram(white(3.0)[:, 0], STEP)
    assert frequency[-1] == pytest.approx(0.5 / STEP, rel=1e-3)
    assert power[2:-2].mean() == pytest.approx(9.0, rel=0.1)


@pytest.mark.parametrize("noise", [1e-3, 0.03, 0.3])
@pytest.mark.parametrize("top", [1.0, 4.0, 0.275 / STEP])
def test_signal_band(top, noise):
    """The last one reaches to where the floor is read: a third of the bins of the upper half hold signal."""
    x = banded(0.1, top)[:, 0] + white(noise)[:, 0]
    # A Hann window widens a line by two bins.
    assert signal_band(x, STEP) == pytest.approx(top, abs=0.1 * top + 4.0 / DURATION)


@pytest.mark.parametrize("begins", [0.0, 0.02 * DURATION, 0.9 * DURATION])
def test_what_soon_dies_out_is_in_the_band(begins):
    """Little beside the noise of the whole record, and taken away by a window over it."""
    age, fast = TIME - begins, 0.3 / STEP
    slow = np.sin(2.0 * np.pi * TIME)
    decaying = np.where(age >= 0.0, np.exp(-np.abs(age) / 1.0) * np.sin(2.0 * np.pi * fast * age), 0.0)
    x = slow + decaying + white(0.01)[:, 0]
    assert signal_band(x, STEP) == pytest.approx(fast, rel=0.15)
    assert signal_band(slow + white(0.01)[:, 0], STEP) == pytest.approx(1.0, abs=4.0 / DURATION)


@pytest.mark.parametrize(("low", "top"), [(0.5, 4.0), (2.0, 8.0)])
def test_a_signal_stands_out_between_its_edges_and_has_its_power_there(low, top):
    x = banded(low, top)[:, 0] + white(0.1)[:, 0]
    found = signal_edges(x, STEP)
    assert found == pytest.approx((low, top), abs=0.1 * top)
    assert 0.97 < band_share(x, STEP, *found) < 1.0
    assert band_share(x, STEP, 0.0, 0.5 / STEP) == pytest.approx(1.0)
    assert np.isnan(signal_edges(np.ones(SAMPLES), STEP)).all()  # nothing stands out of a constant
    assert band_share(np.ones(SAMPLES), STEP, np.nan, np.nan) == 0.0


@pytest.mark.parametrize("samples", [129, *(pytest.param(count, marks=pytest.mark.slow) for count in (257, 513))])
def test_the_noise_of_a_short_channel_does_not_pass_for_signal(samples):
    rng, taken_in = np.random.default_rng(0), 0
    for _ in range(1000):
        phase = 2.0 * np.pi * (np.outer([0.02, 0.05, 0.08], np.arange(samples)) + rng.uniform(size=(3, 1)))
        taken_in += signal_band(10.0 * np.sin(phase).sum(axis=0) + rng.normal(size=samples), 1.0) > 0.2
    assert taken_in <= 3  # with two floors throughout it is 34 where there are 129


@pytest.mark.parametrize(
    ("histories", "share"),
    [(white(1.0, 4), 0.93), (banded(1.0, 1.5, 3), 0.08), (banded(0.05, 5.0, 4), 0.5)],
    ids=["white", "narrow", "half"],
)
def test_histories_fill_the_share_that_they_occupy(histories, share):
    assert occupied_band(histories, STEP, 10.0) == pytest.approx(share, abs=0.12)


@pytest.mark.parametrize(("histories", "top"), [
    (np.zeros((100, 2)), 10.0), (white(1.0), 0.0), (np.empty((SAMPLES, 0)), 10.0), (white(1.0)[:5], 10.0),
], ids=["silence", "no band", "every force is unknown", "a spline of a handful of intervals"])  # fmt: skip
def test_what_says_nothing_of_a_band_fills_it(histories, top):
    assert occupied_band(histories, STEP, top) == 1.0


@pytest.mark.parametrize("low", [0.1, 6.0])
def test_the_lowest_level_is_found_beside_a_signal_wherever_that_lies(low):
    """A record whose content reaches the Nyquist frequency shows its noise below its band."""
    nyquist = 0.5 / STEP
    for high in (0.3 * nyquist, 0.99 * nyquist):
        x = banded(low, high)[:, 0] + white(0.01)[:, 0]
        if low < 1.0 and high > 0.9 * nyquist:
            assert lowest_level(x, STEP) > 0.1  # nothing but signal: an upper bound
        else:
            assert lowest_level(x, STEP) == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize("noise", [1e-3, 0.03, 0.3])
def test_the_visible_floor_is_the_noise_above_the_band(noise):
    found = [visible_floor(banded(0.1, 8.0)[:, 0] + white(noise, seed=seed)[:, 0], STEP) for seed in range(10)]
    np.testing.assert_allclose(found, noise, rtol=0.15)
    assert white_level(banded(0.1, 4.0)[:, 0] + white(noise)[:, 0], STEP, 5.0) == pytest.approx(noise, rel=0.1)


def test_what_is_no_floor():
    """Signal up to the Nyquist frequency, responses that fall off above their band; an anti-alias filter is none."""
    assert visible_floor(banded(0.1, 0.79 * 0.5 / STEP)[:, 0] + white(0.01)[:, 0], STEP) is None
    frequency = np.fft.rfftfreq(SAMPLES, STEP)
    for power in (1, 2):
        spectrum = np.fft.rfft(white(1.0, seed=4)[:, 0]) / np.maximum(frequency, 1.0) ** power
        assert visible_floor(np.fft.irfft(spectrum, SAMPLES), STEP) is None
    spectrum = np.fft.rfft(white(0.2)[:, 0]) * (frequency < 0.85 * frequency[-1])
    assert white_level(np.fft.irfft(spectrum, SAMPLES), STEP, 5.0) == pytest.approx(0.2, rel=0.1)


def test_content_at_the_nyquist_frequency_falls_off_and_noise_does_not():
    rng = np.random.default_rng(3)
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling, 0.01)
    smooth = low_passed(4, 3000, 0.2)
    assert not any(reaches_nyquist(smooth + 0.05 * rng.standard_normal(3000), 0.01) for _ in range(20))


@pytest.mark.parametrize("end", [0.63, 0.7, 0.76])
def test_content_that_ends_below_the_nyquist_frequency_leaves_noise_in_the_uppermost_tenth(end: float):
    """A cutoff is a share of the sampling rate."""
    rng = np.random.default_rng(5)
    for seed in range(10):
        ended = low_passed(seed, 3000, 0.5 * end)
        level = 0.01 * ended.std()
        shown = ended + level * rng.standard_normal(3000)
        assert not reaches_nyquist(shown, 0.01, level)
        assert not reaches_nyquist(shown, 0.01, 0.8 * level)  # what is thought of the noise is not needed
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling + 0.01 * rng.standard_normal(2999), 0.01, 0.01)


FAST = 1000.0


def waves(frequency: float, samples: int = 4001) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(samples) / FAST
    return time, np.stack([np.sin(2 * np.pi * frequency * time + phase) for phase in (0.0, 1.0)], axis=1)


@pytest.mark.parametrize("factor", [2, 3, 4, 7])
def test_slow_content_stays_where_it_is(factor):
    # 0.8 of the new Nyquist frequency; a filter with a phase would shift it.
    time, values = waves(0.4 * FAST / factor)
    kept = decimate(values, factor)
    assert len(kept) == len(time[::factor])
    middle = slice(10, -10)
    np.testing.assert_allclose(kept[middle], values[::factor][middle], atol=0.04)
    time, values = waves(0.2 * FAST / factor)
    np.testing.assert_allclose(decimate(values, factor)[middle], values[::factor][middle], atol=0.005)
    _, fast = waves(0.62 * FAST / factor)  # which goes instead of folding down
    assert np.max(np.abs(decimate(fast, factor)[middle])) < 0.011


def test_the_ends_are_as_good_as_a_longer_record():
    time, values = waves(7.3)
    values = values + 0.5 * np.sin(2 * np.pi * 17.0 * time + 0.3)[:, None]
    whole = decimate(values, 4)
    cut = decimate(values[400:3601], 4)
    np.testing.assert_allclose(cut, whole[100:901], atol=0.02)
    np.testing.assert_allclose(cut[10:-10], whole[110:891], atol=1e-12)
    ramp = np.stack([np.full(200, 3.0), np.linspace(-1.0, 1.0, 200)], axis=1)
    np.testing.assert_allclose(decimate(ramp, 5), ramp[::5], atol=5e-3)


SLOW, SECONDS = 100.0, 40.0
AT = np.arange(round(SLOW * SECONDS)) / SLOW


def test_what_lies_in_the_band_stays_at_every_time_and_the_rest_is_gone() -> None:
    band = BandPass.of((4.0, 12.0), len(AT), 1.0 / SLOW)
    inside = np.sin(2 * np.pi * np.outer(AT, [4.0, 7.3, 12.0]) + 0.3)
    outside = np.sin(2 * np.pi * np.outer(AT, [1.0, 15.0, 30.0]))
    kept = slice(band.half, len(AT) - band.half, band.factor)
    np.testing.assert_allclose(band.filtered(inside), inside[kept], atol=3e-3)
    assert np.abs(band.filtered(outside)).max() < 3e-3
    assert 0.5 * SLOW / band.factor > 1.2 * 12.0
    assert band.factor > 1


def test_a_file_is_filtered_with_the_samples_beyond_the_window(tmp_path) -> None:
    values = np.column_stack((AT, np.sin(2 * np.pi * 6.0 * AT), 9.81 + np.cos(2 * np.pi * 6.0 * AT)))
    path = tmp_path / "record.csv"
    np.savetxt(path, values, delimiter=",", header="t,f,a", comments="")
    given = {"force": {1: "f"}, "acceleration": {1: "a"}, "band": [4, 12]}
    part = MeasuredData(str(path), "t", start=10.0, stop=30.0, **given).measure(1).record
    assert part.band.edges == (4.0, 12.0)
    assert part.time[0] == pytest.approx(10.0)
    assert 29.9 < part.time[-1] <= 30.0 + 1e-9
    np.testing.assert_allclose(part.acceleration[:, 0], np.cos(2 * np.pi * 6.0 * part.time), atol=3e-3)
    whole = MeasuredData(str(path), "t", **given).measure(1).record
    assert 0.2 < whole.time[0] < 4.0
    assert AT[-1] - 4.0 < whole.time[-1] < AT[-1] - 0.2


@pytest.mark.parametrize(("band", "told"), [([12, 4], "grow"), (7, "two frequencies"), ([4, 60], "50 Hz")])
def test_a_band_that_is_none(tmp_path, band, told) -> None:
    path = tmp_path / "record.csv"
    np.savetxt(path, np.column_stack((AT, AT**2, AT**3)), delimiter=",", header="t,f,a", comments="")
    with pytest.raises(InputError, match=r"data\.band") as refused:
        MeasuredData(str(path), "t", {1: "f"}, acceleration={1: "a"}, band=band).measure(1)
    assert told in str(refused.value)


COUNT, OF_A_HUNDREDTH = 256, 0.01
HUNDREDTHS = 3.0 + OF_A_HUNDREDTH * np.arange(COUNT)


def record_of(column: np.ndarray, *calibrated: Channel) -> Record:
    nothing = np.full((COUNT, 1), np.nan)
    return Record(
        HUNDREDTHS, nothing, nothing, column[:, None], np.zeros((COUNT, 1)), np.array([True]), calibrated=calibrated
    )


def channel_at(time: np.ndarray, values: np.ndarray, **calibration: Calibration) -> Channel:
    return Channel("a1", "acceleration", {0: 1.0}, time, values, calibration)


@dataclass(frozen=True)
class Sensor:
    order: int = 2


def test_averages_over_pieces_are_scipys():
    values = np.random.default_rng(0).standard_normal((20_000, 4)) + np.array([1.0, 0.0, -3.0, 0.0])
    values[3:, 1] += values[:-3, 2]
    found = CrossSpectra.of_pieces([Sensor(), Sensor(0)], [Sensor(), Sensor()], values, OF_A_HUNDREDTH)
    length = 2 * (len(found.frequency) - 1)
    options = {"fs": 1.0, "window": np.hanning(length), "nperseg": length, "return_onesided": False}
    for i in range(4):
        for j in range(4):
            _, expected = csd(values[:, j], values[:, i], detrend="constant", **options)
            np.testing.assert_allclose(found.cross[:-1, i, j], expected[: length // 2], atol=1e-12)
    np.testing.assert_allclose(found.frequency, np.fft.rfftfreq(length, OF_A_HUNDREDTH))
    np.testing.assert_array_equal(found.power, np.einsum("bcc->bc", found.cross).real)
    np.testing.assert_allclose(found.power.mean(0), [1.0, 2.0, 1.0, 1.0], rtol=0.05)
    np.testing.assert_allclose(found.differentiation[:, 1], 1.0)
    np.testing.assert_allclose(found.differentiation[:, 0], -((2.0 * np.pi * found.frequency) ** 2))


def test_responses_are_those_of_least_squares():
    values = np.random.default_rng(1).standard_normal((40_000, 3))
    values[:, 0] += 2.0 * values[:, 1] - 5.0 * values[:, 2]
    found = CrossSpectra.of_pieces([Sensor()], [Sensor(), Sensor()], values, OF_A_HUNDREDTH)
    assert np.abs(found.response[:, 0] - [2.0, -5.0]).max() < 1.0
    np.testing.assert_allclose(found.response[:, 0].mean(0), [2.0, -5.0], atol=0.05)
    assert np.mean(found.coherence) == pytest.approx(29.0 / 30.0, abs=0.01)


@pytest.mark.parametrize("part", [1.0, 0.1])
def test_averages_over_bands_are_scipys(part):
    rng, nothing = np.random.default_rng(2), np.full((COUNT, 2), np.nan)
    record = Record(HUNDREDTHS, nothing, nothing, rng.standard_normal((COUNT, 2)), rng.standard_normal((COUNT, 2)),
                    np.zeros(2, bool))  # fmt: skip
    sensors, loads, edges = channels(record), channels(record, ("force",)), [3, 4, 9, 20]
    found = CrossSpectra.of_bands(record, sensors, loads[:1], edges, tapered=part)
    assert found.cross.shape == (3, 3, 1)
    window = tukey(COUNT, part)
    lines = csd(record.force[:, 0], record.acceleration[:, 1], fs=1.0, window=window, nperseg=COUNT,
                detrend="constant", return_onesided=False)[1]  # fmt: skip
    expected = [lines[low:high].mean() for low, high in pairwise(edges)]
    np.testing.assert_allclose(found.of_both[:, 1, 0], expected, rtol=1e-9)
    whole = CrossSpectra.of_bands(record, sensors, loads, edges, 4, part)
    np.testing.assert_allclose(whole.cross[:, :3, 2], found.cross[..., 0], rtol=1e-12)
    np.testing.assert_allclose(whole.power, np.einsum("bcc->bc", whole.cross).real, rtol=1e-12)


def test_counts_tell_how_averages_scatter():
    rng, window = np.random.default_rng(3), taper(400)
    lines = np.fft.rfft(rng.standard_normal((4000, 400)) * window)[:, 20:120] / np.sqrt(np.sum(window**2))
    means = np.mean(np.abs(lines) ** 2, axis=1)
    assert np.var(means) * 100.0 * independent_part(window) == pytest.approx(1.0, rel=0.1)


def test_samples_that_are_there_give_the_sums_over_their_pairs():
    """Against sums over all pairs, lag by lag, which nothing but a pair that is there enters."""
    rng, nothing = np.random.default_rng(4), np.full((COUNT, 1), np.nan)
    a, f, there = *rng.standard_normal((2, COUNT)), rng.random(COUNT) < 0.7
    channel = channel_at(HUNDREDTHS[there], a[there])
    record = Record(HUNDREDTHS, nothing, nothing, a[:, None], f[:, None], np.zeros(1, bool), calibrated=(channel,))
    edges = list(range(10, 14))
    found = CrossSpectra.of_bands(record, channels(record), channels(record, ("force",)), edges)
    window, lags = np.hanning(COUNT), np.arange(1 - COUNT, COUNT)
    swing = np.where(there, window * (a - np.average(a[there], weights=window[there])), 0.0)
    products, pairs, every = (
        np.correlate(x, y, "full")
        for x, y in ((swing, window * (f - f.mean())), (window * there, window), (window, window))
    )
    seen = pairs > 0.01 * every + 1e-9 * every[COUNT - 1]
    scaled = np.where(seen, products * every / np.where(seen, pairs, 1.0), 0.0)
    lines = np.exp(-2j * np.pi * np.outer(edges[:-1], lags) / COUNT) @ scaled / np.sum(window**2)
    np.testing.assert_allclose(found.of_both[:, 0, 0], lines, rtol=1e-9)


def test_samples_between_the_records_times_have_the_phases_of_their_own():
    rng = np.random.default_rng(1)
    at = HUNDREDTHS + OF_A_HUNDREDTH * rng.uniform(-0.5, 0.5, COUNT)
    channel = channel_at(at, rng.standard_normal(COUNT))
    found = Samples.at_own_times(channel, record_of(channel.measured, channel), np.hanning(COUNT))
    place = np.rint((at - HUNDREDTHS[0]) / OF_A_HUNDREDTH).astype(int)
    inside = (place >= 0) & (place < COUNT)
    at, felt, weight = at[inside], channel.measured[inside], np.hanning(COUNT)[place[inside]]
    swing = weight * (felt - np.average(felt, weights=weight))
    phase = -1j * np.pi * np.arange(COUNT + 1)[:, None] / COUNT * (at - HUNDREDTHS[0]) / OF_A_HUNDREDTH
    np.testing.assert_allclose(found.values, np.exp(phase) @ swing, atol=1e-5 * np.abs(found.values).max())


@pytest.mark.parametrize("missing", ["half at random", "four of five", "a gap"])
def test_what_is_missing_scatters_and_does_not_shift(missing):
    """Averaged over white records the cross spectrum of a channel and its echo is that of the whole channel."""
    rng, late = np.random.default_rng(2), 3
    window, total, rounds = np.hanning(COUNT), 0.0, 400
    for _ in range(rounds):
        force = rng.standard_normal(COUNT + late)
        echo, force = force[:COUNT], force[late:]
        there = {
            "half at random": rng.random(COUNT) < 0.5,
            "four of five": np.arange(COUNT) % 5 == 2,
            "a gap": np.abs(np.arange(COUNT) - 100) > 25,
        }[missing]
        channel = channel_at(HUNDREDTHS[there], echo[there])
        assert misses_samples(channel, record_of(echo, channel))
        seen = Samples.at_own_times(channel, record_of(echo, channel), window)
        total = total + cross_spectrum(seen, Samples.of_column(force, window)) / rounds
    turned = total * np.exp(2j * np.pi * np.fft.rfftfreq(COUNT) * late)
    assert np.abs(np.mean(turned[4:-4]) - 1.0) < 0.05
    assert np.std(turned[4:-4]) < 0.2


def test_a_channel_that_misses_none_has_the_spectra_of_its_column():
    """A delay that is known moves its samples off the record's times and loses none."""
    column = np.random.default_rng(5).standard_normal(COUNT)
    late = channel_at(HUNDREDTHS, column, delay=Calibration(2.3 * OF_A_HUNDREDTH))
    record = record_of(late.history(HUNDREDTHS), late)
    assert not misses_samples(late, record)
    with_channel, without = (
        CrossSpectra.of_bands(each, channels(each), [], [2, 5, 9], 1)
        for each in (record, replace(record, calibrated=()))
    )
    np.testing.assert_array_equal(with_channel.cross, without.cross)
