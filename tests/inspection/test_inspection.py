"""What a look at a record says: gaps, clipping, offsets, signs, units, and a command that can be typed."""

import shlex

import numpy as np
import pandas as pd
import pytest

from pinn_cli.inspection.inspection import inspect_record
from pinn_cli.inspection.proposal import Said
from pinn_cli.record.signal import Signal
from pinn_cli.settings.errors import InputError

RATE = 50.0


@pytest.fixture(scope="module")
def record(chain):
    return chain.record(60.0, 11)


def look(record, overrides=("data=csv",), frequencies=None, **columns):
    """With ``columns`` in place of the record's own; None: left out."""
    time, f, _, a = record
    every = {
        "f": Signal("f", f, "force", "5"), "a1": Signal("a1", a[:, 0], "acceleration", "1"),
        "a5": Signal("a5", a[:, 4], "acceleration", "5"),
    } | columns  # fmt: skip
    return inspect_record([s for s in every.values() if s is not None], time, Said(overrides), frequencies)


def notes(*arguments, **columns) -> str:
    return " / ".join(look(*arguments, **columns).notes)


def test_a_sound_record_is_told_without_a_note(record):
    found = look(record)
    assert found.notes == ()
    row = found.channels.set_index("column").loc["a1"]
    _, _, _, a = record
    assert row["rms"] == pytest.approx(a[:, 0].std())
    assert row["noise"] == pytest.approx(a[:, 0].std() * 10**-1.5, rel=0.15)
    assert row["snr_db"] == pytest.approx(30.0, abs=1.5)
    assert 6.0 < row["band_high_hz"] < 9.0
    assert (row["missing_percent"], row["clipped_percent"]) == (0.0, 0.0)
    assert "acceleration of DOF 1" in found.text()
    assert max(len(line) for line in found.text().splitlines()) <= 100


def test_gaps_missing_rows_clipped_held_and_dead_channels(record):
    _, f, _, a = record
    gapped = a[:, 0].copy()
    gapped[700:750] = np.nan
    found = look(record, a1=Signal("a1", gapped, "acceleration", "1"))
    row = found.channels.set_index("column").loc["a1"]
    assert row["missing_percent"] == pytest.approx(100.0 * 50 / len(f))
    assert row["longest_gap_s"] == pytest.approx(51 / RATE)
    assert "1.7 % of the samples of acceleration of DOF 1 are missing, at most 1.02 s at a time" in found.notes
    time, f, _, a = record
    kept = np.delete(np.arange(len(time)), slice(1000, 1200))
    jitter = time + np.random.default_rng(0).uniform(-0.1, 0.1, len(time)) / RATE
    short = (jitter[kept], f[kept], None, a[kept])
    found = look(short)
    assert found.sampling.rate == pytest.approx(RATE, rel=1e-3)
    assert "1 times rows are missing, at most 4" in found.notes[0]
    assert found.notes[1].startswith("steps in time scatter by ")
    assert len(found.sampling.regular) == pytest.approx(len(time), abs=2)
    clipped = np.clip(a[:, 0], -1.5 * a[:, 0].std(), 1.5 * a[:, 0].std())
    held = np.repeat(a[::10, 4], 10)[: len(a)]
    said = notes(
        record, a1=Signal("a1", clipped, "acceleration", "1"), a5=Signal("a5", held, "acceleration", "5"),
        dead=Signal("d", np.full(len(f), 0.25), "displacement", "2"),
    )  # fmt: skip
    level = 1.5 * a[:, 0].std()
    assert f"the acceleration of DOF 1 is clipped at {level:.4g} and {-level:.4g}: 1" in said
    assert "% of acceleration of DOF 5 are repeated values: held, or a slower sensor?" in said
    assert "the displacement of DOF 2 is 0.25 throughout: a dead sensor?" in said
    marked = np.where(np.arange(len(f)) % 500 == 3, -7999.0, a[:, 0])
    text = "acceleration of DOF 1 is -7999 in 6 samples, far from all others: if it marks gaps, name it in data.missing"
    assert text in notes(record, a1=Signal("a1", marked, "acceleration", "1"))


@pytest.mark.parametrize(
    ("noise", "offset", "expected"),
    [
        (1.0, 0.0, "acceleration of DOF 1 is hardly above its noise: "),
        (0.0, 0.5, "the acceleration of DOF 1 has an offset of 0.5 (26 % of its rms): integrated over the record"),
        (0.0, 9.81, "the acceleration of DOF 1 has an offset of 9.81 (516 % of its rms): as of gravity in m/s^2"),
    ],
)
def test_noise_and_offsets(record, noise, offset, expected):
    a = record[3][:, 0] / record[3][:, 0].std()
    a = 1.9 * (a - a.mean() + noise * np.random.default_rng(0).normal(size=len(a))) + offset
    assert expected in notes(record, a1=Signal("a1", a, "acceleration", "1"))


@pytest.mark.parametrize(("noise", "flat"), [(0.4, False), (1.0, True)])
def test_a_spectrum_that_is_flat_nearly_throughout_need_not_be_noise(record, noise, flat):
    """White forces move a structure up to the Nyquist frequency: then the noise is known to lie below that, no more."""
    a = record[3][:, 0] / record[3][:, 0].std() + noise * np.random.default_rng(0).normal(size=len(record[0]))
    found = look(record, a1=Signal("a1", a, "acceleration", "1"))
    (note,) = (note for note in found.notes if "above its noise" in note)
    assert note.endswith(" dB, if its flat spectrum is noise, and not what white forces do") == flat
    (shown,) = (line for line in found.text().splitlines() if line.startswith("acceleration of DOF 1 "))
    assert ("<" in shown, ">" in shown) == (flat, flat)


def test_sensors_that_contradict_each_other_and_hum_of_the_mains(record):
    noise = Signal("u", np.random.default_rng(0).normal(size=len(record[0])), "displacement", "5")
    assert "acceleration of DOF 5 and displacement of DOF 5 have little in common" in notes(record, u=noise)
    opposite = Signal("a5", -record[3][:, 4], "acceleration", "5")
    assert "acceleration of DOF 5 moves against force of DOF 5" in notes(record, a5=opposite)
    time, _, _, a = record
    line = 0.5 * a[:, 0].std() * np.sin(2.0 * np.pi * 60.0 * time)
    told = notes(record, a1=Signal("a1", a[:, 0] + line, "acceleration", "1"))
    assert "acceleration of DOF 1 hums: 11 % of its power is a steady line at 60 Hz of the mains" in told
    assert "or at 10 Hz" in told  # at 50 Hz nothing tells them apart


def test_a_hammers_force_is_not_taken_for_noise(record):
    """Its blows fill the spectrum; between them it is quiet, or nothing at all."""
    time, random = record[0], np.random.default_rng(0)
    force = np.zeros(len(time))
    force[200::700] = 50.0
    force[201::700] = 30.0
    for noise in (0.0, 0.05):
        found = look(record, f=Signal("f", force + noise * random.normal(size=len(force)), "force", "5"))
        assert not [note for note in found.notes if "force" in note and ("noise" in note or "repeated" in note)]
        assert found.channels.set_index("column").loc["f", "noise"] == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize(
    ("order", "factor", "expected"),
    [
        (0, 1.0, None),
        (1, 1.0, None),
        (0, -1.0, "times what displacement of DOF 5 says; the sign of one of them is wrong?"),
        (0, 1.0 / 9.80665, "the acceleration is in g?"),
        (0, 1e3, "the acceleration is in mm/s^2?"),
        (1, 1e-3, "the other one is in mm or mm/s?"),
        (1, 1.4, "a gain or a unit is wrong?"),
    ],
)
def test_two_sensors_of_one_dof(record, factor, expected, order):
    time, _, u, a = record
    quantity = ("displacement", "velocity")[order]
    values = np.gradient(u[:, 4], time) if order else u[:, 4]
    other = Signal("x", values + 1e-4 * np.random.default_rng(0).normal(size=len(time)), quantity, "5")
    said = notes(record, f=None, x=other, a5=Signal("a5", factor * a[:, 4], "acceleration", "5"))
    assert ("says" in said) == (expected is not None)
    assert expected is None or expected in said


@pytest.mark.parametrize(("gain", "told"), [(1.0, False), (1.0 / 9.80665, True)])
def test_a_structure_moves_with_the_ground_far_below_its_frequencies(gain, told):
    """One mode at 2 Hz, shaken: the absolute acceleration is the ground's there."""
    random, n = np.random.default_rng(0), 12000
    frequency = np.fft.rfftfreq(n, 1.0 / RATE)
    ground = np.fft.rfft(random.normal(size=n)) * (frequency < 8.0)
    s, w = 1j * frequency, 2.0
    absolute = ground * (2 * 0.02 * w * s + w**2) / (s**2 + 2 * 0.02 * w * s + w**2)
    roof, base = np.fft.irfft(absolute, n), np.fft.irfft(ground, n)
    every = [Signal("g", base, "ground_acceleration"), Signal("a", gain * roof, "acceleration", "1")]
    found = inspect_record(every, np.arange(n) / RATE, Said(), None)
    assert found.peaks["frequency_hz"].tolist() == pytest.approx([2.0], rel=2e-3)
    assert any("times the ground's; the acceleration is in g?" in note for note in found.notes) == told


def test_units_of_the_header(record):
    a = record[3][:, 0]
    found = look(
        record, a1=Signal("a1", a / 9.80665, "acceleration", "1", "g"), f=Signal("f", record[1], "force", "5", "N")
    )
    assert found.notes == ()
    row = found.channels.set_index("column").loc["a1"]
    assert (row["unit"], row["rms"]) == ("m/s^2", pytest.approx(a.std()))
    said = notes(record, a1=Signal("a1", a, "acceleration", "1", "V"))
    assert "is in V, which is no unit of it: unit: 1 in the command below takes one V for one m/s^2" in said


def test_a_force_without_a_number_acts_where_it_is_seen_to(record):
    time, f, _, a = record
    found = inspect_record(
        [Signal("hammer", f), Signal("a1", a[:, 0]), Signal("a5", a[:, 4])], time, Said(("data=csv",)), None
    )
    assert "data.force={5: hammer}" in shlex.split(found.command)
    assert "which DOF 'hammer' acts on is not in its name: DOF 5 is taken" in " / ".join(found.notes)
    assert not any("moves against" in note for note in found.notes)


def test_a_record_of_the_ground_alone_has_no_modes_and_says_what_an_estimate_lacks(pinn_run, tmp_path):
    """It was no record with a sensor, by which sizes of a matrix were divided."""
    time = np.arange(0.0, 30.0, 0.02)
    ground = np.random.default_rng(0).standard_normal(len(time)) * np.exp(-time / 10.0)
    pd.DataFrame({"t (s)": time, "ground acceleration (m/s^2)": ground}).to_csv(tmp_path / "quake.csv", index=False)
    said = pinn_run("inspect", "quake.csv").done().out
    assert "no natural frequency stands out" in said
    assert "data.acceleration; to shake a simulated structure" in " ".join(said.split())


def test_what_columns_are_is_guessed_by_their_names(record):
    _, f, _, a = record
    plain = {"f": Signal("Force 5 (N)", f), "a1": Signal("a1", a[:, 0]), "a5": Signal("acc_5", a[:, 4]),
             "n": Signal("note", np.arange(len(f)) % 7.0)}  # fmt: skip
    found = look(record, **plain)
    assert found.notes[0].startswith("what columns are is guessed by their names")
    assert len(found.peaks) >= 4
    words = shlex.split(found.command)
    assert 'data.force={5: "Force 5 (N)"}' in words
    assert "data.acceleration={1: a1, 5: acc_5}" in words
    assert words[-4:] == [
        "system=linear", "system.ndof=5", "scheme=state_parameter", "scheme.unknown=[m_*,k_*,c_*]",
    ]  # fmt: skip


def test_what_is_given_is_not_proposed_again(record):
    given = ("data=csv", "++data.force={5: f}", "data.acceleration={1: a1}", "system=duffing", "system.m=2",
             "scheme=bayesian")  # fmt: skip
    words = shlex.split(look(record, given).command)
    assert words == ["pinn-run", "data=csv", "data.force={5: f}", "data.acceleration={1: a1}", "system=duffing",
                     "system.m=2", "scheme=bayesian", "system.ndof=5"]  # fmt: skip


def test_many_samples_of_a_low_band_are_decimated():
    time, random = np.arange(20_000) / 1000.0, np.random.default_rng(0)
    spectrum = np.fft.rfft(random.normal(size=20_000))
    spectrum[np.fft.rfftfreq(20_000, 1e-3) > 10.0] = 0.0
    slow = np.fft.irfft(spectrum, 20_000)
    noisy = [slow + 0.01 * slow.std() * random.normal(size=20_000) for _ in range(2)]
    every = [Signal("f", noisy[0], "force", "1"), Signal("a", noisy[1], "acceleration", "1")]
    (word,) = [w for w in inspect_record(every, time, Said(), None).settings if w.startswith("data.decimate=")]
    assert 15 <= int(word.partition("=")[2]) <= 20


@pytest.mark.parametrize(
    ("samples", "expected"),
    [(10, "data.start, data.stop=10 samples"), (60, "must be a record with a column that varies")],
)
def test_nothing_to_look_at(samples, expected):
    still = [Signal("a", np.ones(samples), "acceleration", "1"), Signal("n", np.full(samples, np.nan))]
    with pytest.raises(InputError, match=expected):
        inspect_record(still, np.arange(samples) / RATE, Said(), None)


@pytest.fixture
def rig_csv(record, tmp_path):
    time, f, _, a = record
    pd.DataFrame({"t": time, "f5": f, "a1": a[:, 0], "a5": a[:, 4]}).to_csv(tmp_path / "rig.csv", index=False)
    return tmp_path / "rig.csv"


def test_fewer_samples_are_looked_at_where_the_run_would_have_them(pinn_run, rig_csv):
    look = pinn_run("inspect", "rig.csv", "data.decimate=2", "data.start=0.98", "figures=false")
    assert look.err == ""
    assert "1476 samples from 0.98 to 59.98 s, at 25 Hz" in look.out
    assert look.out.count("data.decimate") == 1
    rig_csv.write_text("t,f5,a1\n0,1,2\n1,,3\n2,3,4\n")
    pinn_run("inspect", "rig.csv", "data.decimate=2").refused("data.decimate=2: must be 1 where samples are missing")


@pytest.mark.usefixtures("rig_csv")
def test_the_command_inspect(pinn_run):
    settings = ["data=csv", "data.path=rig.csv", "data.force={5: f5}", "data.acceleration={1: a1, 5: a5}"]
    chain = ("system=linear", "system.ndof=5", "system.m=1", "system.k=386.4", "system.c=0")
    outcome = pinn_run("inspect", *settings, *chain).done()
    assert outcome.err == ""
    files = {str(file.relative_to(outcome.directory)) for file in outcome.directory.rglob("*") if file.is_file()}
    assert files >= {"inspect.csv", "peaks.csv", "pinn-run.log", "figures/inspect.png", "figures/inspect.pdf",
                     ".hydra/config.yaml"}  # fmt: skip
    peaks = pd.read_csv(outcome.directory / "peaks.csv")
    np.testing.assert_allclose(peaks["difference_percent"], 0.0, atol=0.3)
    assert "run.json" not in files


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["inspect", "data=csv"], "data.path=None: must be given: data=csv reads a file of yours"),
        (["inspect"], "data=simulated: must be csv or another format of files with inspect"),
        (["inspect", "no.csv"], "data.path=no.csv: must be a file that exists"),
        (["inspect", "rig.xyz"], "must be a file in one of the formats csv (.csv, .txt"),
        (["inspect", "resume=auto"], "resume=auto: must be left out with inspect"),
        (["inspect", "--multirun", "seed=1,2"], "--multirun=inspect: must be left out with inspect"),
        (["inspct", "force.csv"], "did you mean inspect?"),
        (["force.csv"], "pinn-run inspect force.csv looks at a record"),
        (["modes", "data=csv", "data.records=[{path: no.csv}, {path: b.csv}]"], "record 1: data.path"),
        (["modes", "resume=auto"], "resume=auto: must be left out with modes"),
        (["modes", "data=csv", "data.path=force.csv", "data.force={1: f}"], "a record with a sensor of the motion"),
        (["modes", "data=csv", "data.path=short.csv"], "data.start, data.stop=5 samples"),
    ],
)
def test_a_look_that_cannot_be_had(pinn_run, tmp_path, arguments, expected):
    (tmp_path / "rig.xyz").write_bytes(bytes(range(256)))
    random = np.random.default_rng(0)
    pd.DataFrame({"t": np.arange(500) / 50.0, "f": random.normal(size=500)}).to_csv(tmp_path / "force.csv", index=False)
    pd.DataFrame({"t": np.arange(5) / 50.0, "a1": np.arange(5.0)}).to_csv(tmp_path / "short.csv", index=False)
    pinn_run(*arguments).refused(expected)
    assert not list(tmp_path.glob("outputs/*/*"))


def test_channels_in_the_long_form_and_names_of_dofs(record, pinn_run, tmp_path):
    time, f, u, a = record
    columns = {"t": time, "f5": f / 1e3, "acc": a[:, 4] / 9.80665, "lvdt": 1e3 * (u[:, 1] - u[:, 0])}
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    channels = (
        "data.channels={f5: {sensor: force, dof: 5, unit: kN}, lvdt: {sensor: displacement, between: [2, 1], unit: mm},"
        " top: {sensor: acceleration, dof: 5, unit: g, column: acc, gain: unknown}}"
    )
    outcome = pinn_run("inspect", "data=csv", "data.path=rig.csv", channels, "figures=false").done()
    assert outcome.err == ""
    table = pd.read_csv(outcome.directory / "inspect.csv").set_index("column")
    assert table["channel"].to_dict() == {"f5": "force of DOF 5", "acc": "acceleration of DOF 5", "lvdt": "'lvdt'"}
    assert table.loc["f5", "rms"] == pytest.approx(f.std())
    assert table.loc["acc", "rms"] == pytest.approx(a[:, 4].std())


@pytest.mark.slow
def test_a_million_rows_are_inspected(pinn_run, tmp_path):
    random, rows = np.random.default_rng(0), np.arange(10**6)
    columns = {"t": rows / 1000.0, "f1": random.normal(size=10**6)}
    columns |= {f"a{i}": np.cumsum(columns["f1"]) + random.normal(size=10**6) for i in range(1, 5)}
    pd.DataFrame(columns).round(6).to_csv(tmp_path / "big.csv", index=False)
    assert pinn_run("inspect", "data=csv", "data.path=big.csv").done().out.startswith("1000000 samples")
