"""The whole model undone: readings from known parameters of all groups give the truth back, in arrays and streams."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.support.calibrated import HEXAD, calibration, session_of
from tumble.errors import InputError
from tumble.inference.estimate import GroupFinding
from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedTemperature, Parameter
from tumble.sensors.instrument import Instrument, readings
from tumble.sensors.model import Block
from tumble.sensors.parameters import ParameterGroup, Variable, group_of
from tumble.units import DEGREE, ZERO_CELSIUS, Array
from tumble.use.apply import apply_to_session, correction_notes

N = 500
AT_REST: tuple[Variable, ...] = ("temperature", "temperature²")


def _usual(group: ParameterGroup) -> float:
    """The usual size of a group in MEMS devices; for one that has none, 100 ppm at 100 °/s."""
    return group.usual.get("mems", 1e-4 / (100.0 * DEGREE) ** 2)


def larger(
    *, accel: Array | None = None, gyro: Array | None = None, leave: tuple[str, ...] = ("accel.lever", "accel.delay")
) -> tuple[Calibration, Instrument, Array]:
    """A calibration with all groups but those to `leave`, of a MEMS device, its instrument and its values."""
    made = calibration(accel=accel, gyro=gyro)
    nominal = [np.eye(3) if axes is None else axes for axes in (accel, gyro)]
    blocks = Block(kind="accel", axes=nominal[0]), Block(kind="gyro", axes=nominal[1])
    every = Instrument.of(*blocks, variables=AT_REST)
    instrument = Instrument.of(*blocks, [g.name for g in every.further if g.name not in leave], variables=AT_REST)
    count, rng = instrument.linear_count, np.random.default_rng(3)
    sizes = [_usual(group_of(name)) for name in instrument.names[count:]]
    further = np.array(sizes) * rng.uniform(-1.0, 1.0, len(sizes))
    more = tuple(
        Parameter(name=n, value=float(v), u=0.1 * s, unit=group_of(n).unit, prior=s, learned=0.99)
        for n, v, s in zip(instrument.names[count:], further, sizes, strict=True)
    )
    assert made.covariance is not None
    covariance = np.zeros((len(instrument.names),) * 2)
    covariance[:count, :count] = made.covariance
    covariance[count:, count:] = np.diag(np.array(sizes) ** 2 * 0.01)
    values = np.concatenate([[p.value for p in made.parameters], further])
    found = replace(
        made,
        parameters=made.parameters + more,
        covariance=covariance,
        groups=tuple(
            GroupFinding(name=g.name, kept=True, prior=_usual(g), prior_widened=1.0, learned=(0.99,) * 3)
            for g in instrument.further
        ),
        axes={kind: tuple(map(tuple, axes.tolist())) for kind, axes in zip(("accel", "gyro"), nominal, strict=True)},
        temperature=CalibratedTemperature(reference=20.0),
    )
    return found, instrument, values


def truth(seed: int = 1) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return 9.8 * rng.uniform(-1.0, 1.0, (N, 3)), 2.0 * rng.uniform(-1.0, 1.0, (N, 3))


def read(instrument: Instrument, values: Array, force: Array, rate: Array, celsius: Array | None = None) -> list[Array]:
    """Readings of accelerometers and gyros, each with the parameters at the temperature of its sample."""
    assert instrument.gyro is not None
    rows = []
    for i in range(len(force)):
        at = values.copy()
        for own, base, variable in instrument.changes:
            power = {"temperature": 1, "temperature²": 2}[variable]
            at[base] += values[own] * (0.0 if celsius is None else celsius[i] - 20.0) ** power
        blocks = (instrument.accel, instrument.gyro)
        f, w = force[i : i + 1], rate[i : i + 1]
        rows.append([readings(block, instrument.coefficients(block, at), f, w)[0] for block in blocks])
    return [np.array(kind) for kind in zip(*rows, strict=True)]


COLUMNS = ["ax", "ay", "az", "p", "q", "r"]


def logged(
    folder: Path, t: Array, accel: Array, gyro: Array, temperature: Array | None = None, unit: str = "K"
) -> Path:
    """A session with this log, perhaps with a thermometer."""
    table = pl.DataFrame({"t": t, **dict(zip(COLUMNS, np.hstack([accel, gyro]).T, strict=True))})
    log: dict[str, object] = {
        "time": "t",
        "accel": {"columns": COLUMNS[:3], "unit": "m/s^2"},
        "gyro": {"columns": COLUMNS[3:], "unit": "rad/s"},
    }
    if temperature is not None:
        table = table.with_columns(T=temperature)
        log["temperature"] = {"columns": ["T"], "unit": unit}
    return session_of(folder, table.write_csv(), log)


def corrected(made: Calibration, folder: Path) -> tuple[Array, Array]:
    """Forces and rates that `apply` makes of it."""
    apply_to_session(made, folder, folder / "out.parquet")
    out = pl.read_parquet(folder / "out.parquet").select(COLUMNS).to_numpy()
    return out[:, :3], out[:, 3:]


@pytest.mark.parametrize("axes", [None, HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]], ids=["triad", "six sensors"])
@pytest.mark.parametrize("warm", [False, True])
def test_readings_of_all_groups_give_the_truth_back(axes: Array | None, warm: bool) -> None:
    made, instrument, values = larger(accel=axes, gyro=axes)
    force, rate = truth()
    celsius = np.random.default_rng(4).uniform(-20.0, 60.0, N) if warm else None
    accel, gyro = read(instrument, values, force, rate, celsius)
    kelvin = None if celsius is None else celsius + ZERO_CELSIUS
    found_f, found_w = made.apply(accel, gyro, temperature=kelvin)
    assert found_w is not None
    np.testing.assert_allclose(found_f, force, rtol=0.0, atol=1e-9 * 9.8)
    np.testing.assert_allclose(found_w, rate, rtol=0.0, atol=1e-9 * 2.0)
    dt = np.random.default_rng(5).uniform(0.009, 0.011, N)
    dv, angle = made.apply(accel * dt[:, None], gyro * dt[:, None], dt=dt, temperature=kelvin)
    assert angle is not None
    np.testing.assert_allclose(dv, force * dt[:, None], rtol=0.0, atol=1e-11 * 9.8)
    np.testing.assert_allclose(angle, rate * dt[:, None], rtol=0.0, atol=1e-11 * 2.0)


def test_a_linear_calibration_is_applied_as_ever() -> None:
    made, (force, rate) = calibration(), truth()
    assert made.accel is not None
    assert made.gyro is not None
    accel, gyro = made.accel.predict(force), made.gyro.predict(rate)
    found_f, found_w = made.apply(accel, gyro)
    assert found_w is not None
    np.testing.assert_allclose(found_f, made.accel.apply(accel), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(found_w, made.gyro.apply(gyro), rtol=0.0, atol=1e-14)


def test_a_temperature_in_celsius_and_another_number_of_samples_are_refused() -> None:
    made, instrument, values = larger()
    accel, gyro = read(instrument, values, *truth())
    with pytest.raises(InputError, match="kelvin"):
        made.apply(accel, temperature=20.0)
    with pytest.raises(InputError, match="as many samples"):
        made.apply(accel, gyro[:-1])


@pytest.mark.parametrize("frame", ["paper", "symmetric"])
def test_in_another_frame_the_same_readings_are_predicted(frame: str) -> None:
    """The true vectors of the new frame are those of the old one turned; g-sensitivity has turned with them."""
    made, instrument, values = larger(leave=tuple(g for g in instrument_groups() if g != "gyro.g_sensitivity"))
    turned = made.in_frame(frame)
    force, rate = truth()
    accel, gyro = read(instrument, values, force, rate)
    assert made.accel is not None
    assert turned.accel is not None
    Q = np.linalg.solve(made.accel.matrix, turned.accel.matrix)
    assert np.abs(Q - np.eye(3)).max() > 1e-3
    found_f, found_w = turned.apply(accel, gyro)
    assert found_w is not None
    np.testing.assert_allclose(found_f, force @ Q, atol=1e-12)
    np.testing.assert_allclose(found_w, rate @ Q, atol=1e-12)
    back = turned.in_frame("accelerometer")
    for p in made.parameters:
        assert back[p.name].value == pytest.approx(p.value, abs=1e-12)
        assert back[p.name].u == pytest.approx(p.u, rel=1e-6)


def instrument_groups() -> list[str]:
    every = Instrument.of(Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3)), variables=AT_REST)
    return [group.name for group in every.further]


def test_lever_arms_are_undone_in_a_log_with_rates_whatever_its_pieces(tmp_path: Path) -> None:
    """A smooth motion at 200 Hz: what is left is the error of central differences, and each row is there."""
    made, instrument, values = larger(leave=("accel.delay", "accel.cubic", "gyro.cubic"))
    t = 0.005 * np.arange(float(N))
    force = np.column_stack([9.8 * np.sin(t), 9.8 * np.cos(t), 3.0 * np.sin(2 * t)])
    rate = np.column_stack([3.0 * np.sin(3 * t), 2.0 * np.cos(2 * t), np.sin(t)])
    change = np.column_stack([9.0 * np.cos(3 * t), -4.0 * np.sin(2 * t), np.cos(t)])
    _, gyro = read(instrument, values, force, rate)
    arms = instrument.levers(values)[None]
    across = np.cross(rate[:, None], np.cross(rate[:, None], arms))
    felt = force[:, None] + np.cross(change[:, None], arms) + across
    accel = readings(instrument.accel, instrument.coefficients(instrument.accel, values), felt, rate)
    folder = logged(tmp_path, t + 0.005, accel, gyro)
    found, _ = corrected(made, folder)
    alone, _ = made.apply(accel, gyro)
    inside = slice(1, -1)
    assert np.abs(alone - force)[inside].max() > 0.05
    assert np.abs(found - force)[inside].max() < 1e-4
    assert "accelerometers are moved" in correction_notes(made, folder)[0]


@pytest.mark.parametrize(("unit", "zero"), [("degC", 0.0), ("K", 273.15)])
def test_a_log_with_a_thermometer_is_corrected_at_its_temperatures(tmp_path: Path, unit: str, zero: float) -> None:
    """With a lost temperature, which is that of the row before, and a lost accelerometer sample, which stays lost."""
    made, instrument, values = larger()
    force, rate = truth()
    celsius = np.linspace(10.0, 40.0, N)
    celsius[100] = celsius[99]
    accel, gyro = read(instrument, values, force, rate, celsius)
    accel[200, 1] = np.nan
    celsius[100] = np.nan
    folder = logged(tmp_path, 0.01 * np.arange(1.0, N + 1), accel, gyro, celsius + zero, unit)
    found_f, found_w = corrected(made, folder)
    lost = np.isnan(np.hstack([found_f, found_w])).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [200]
    np.testing.assert_allclose(found_f[~lost], force[~lost], atol=1e-8)
    np.testing.assert_allclose(found_w[~lost], rate[~lost], atol=2e-9)


def test_a_log_is_corrected_at_the_temperatures_of_sensors_that_lag(tmp_path: Path) -> None:
    """They follow the thermometer over the tables of a file, in either direction of time."""
    made, instrument, values = larger()
    force, rate = truth()
    celsius = 20.0 + 15.0 * np.sin(np.arange(N) / 60.0)
    for lag in (1.5, -1.5):
        behind, a = celsius.copy(), np.exp(-0.01 / 1.5)
        for k in range(1, N):  # what follows, in steps of a straight line
            change = celsius[k] - celsius[k - 1]
            behind[k] = a * behind[k - 1] + celsius[k] - a * celsius[k - 1] - change / 0.01 * 1.5 * (1.0 - a)
        sensors = behind if lag > 0.0 else 2.0 * celsius - behind
        accel, gyro = read(instrument, values, force, rate, sensors)
        folder = logged(tmp_path / f"{lag}", 0.01 * np.arange(1.0, N + 1), accel, gyro, celsius, "degC")
        late = (Parameter(name=f"{kind}.lag", value=lag, u=0.1, unit="s") for kind in ("accel", "gyro"))
        lagging = replace(made, parameters=(*made.parameters, *late), covariance=None)
        found_f, found_w = corrected(lagging, folder)
        np.testing.assert_allclose(found_f, force, atol=1e-8)
        np.testing.assert_allclose(found_w, rate, atol=2e-9)
        assert any(
            f"with a lag of {lag:.0f} s (accel), {lag:.0f} s (gyro)" in s for s in correction_notes(lagging, folder)
        )
