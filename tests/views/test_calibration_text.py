"""The printed report of launches, iterations and methods: the form of the paper's Tables 1 to 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from tests.support.calibrated import calibration, with_fields
from tumble.cli import main
from tumble.inference.estimate import GroupFinding, HyperparameterEstimate, Integral, Outcome, ProcessBias
from tumble.inference.prediction import Prediction
from tumble.planning.setup import Setup
from tumble.recording.session import AutopilotSensor
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.further import decided_by_priors, verdicts
from tumble.result.parts import Parameter, SourceContributions
from tumble.run.calibrate import calibrate
from tumble.run.launches import LaunchRun, mean_of_launches
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, rounded, two_digits
from tumble.views.blocks import Block, Items, Table, Text
from tumble.views.calibration import (
    MEANING_OF_INCREMENTS,
    calibration_blocks,
    difference_percent,
    group_table,
    iteration_table,
    launch_table,
    method_table,
)
from tumble.views.numbers import cells, shown_units
from tumble.views.render.terminal import print_blocks, text_of
from tumble.views.report.document import write_report

REQUEST = Setup.of(rest=10.0, sample_rate=50.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    base = tmp_path_factory.mktemp("launches")
    return [simulate_session(base / f"launch{i}", REQUEST, seed=21, launch=i) for i in (1, 2)]


@pytest.fixture(scope="module")
def by_method(folders: list[Path]) -> dict[str, Calibration]:
    sessions = [read_session(folder) for folder in folders]
    return {
        method: mean_of_launches(
            [LaunchRun(session=s, calibration=calibrate(s, method=method, terms="linear")) for s in sessions]
        )
        for method in ("scalar", "sequential")
    }


def printed(blocks: Sequence[Block]) -> str:
    return text_of(blocks, 160)


def numbers(shown: Table) -> dict[str, list[float]]:
    """The numbers of each row of a table, by its first cell; the last one is the unit."""
    return {row[0]: [float(cell) for cell in row[1:-1]] for row in shown.rows}


def test_each_launch_its_mean_and_the_deviation_from_run_to_run_are_in_a_row(by_method: dict[str, Calibration]) -> None:
    found = by_method["scalar"]
    units = shown_units(found.parameters)
    rows = numbers(launch_table(found, found.parameters))
    assert list(rows) == [p.name for p in found.parameters]
    for i, p in enumerate(found.parameters):
        size = units[p.name][0]
        values = [launch.parameters[i].value / size for launch in found.evidence.launches]
        last = 0.06 * max((launch.parameters[i].u or 0.0) for launch in found.evidence.launches) / size
        expected = [*values, float(np.mean(values)), float(np.std(values, ddof=1))]
        np.testing.assert_allclose(np.array(rows[p.name]), np.array(expected), atol=last)


def test_the_increments_add_up_to_the_result(by_method: dict[str, Calibration]) -> None:
    for found in by_method.values():
        units = shown_units(found.parameters)
        for name, row in numbers(iteration_table(found, found.parameters)).items():
            first, second, percent, _ = row
            assert percent == pytest.approx(100.0 * abs(second / first), rel=0.06)
            assert first + second == pytest.approx(found[name].value / units[name][0], abs=0.006 * abs(first))


def test_the_statement_on_increments_is_beside_them_and_only_there(by_method: dict[str, Calibration]) -> None:
    said = " ".join(printed(calibration_blocks(by_method["sequential"], every=True)).split())
    assert MEANING_OF_INCREMENTS in said
    assert said.index("mean increment of") < said.index(MEANING_OF_INCREMENTS)
    assert "increment" not in printed(calibration_blocks(replace(by_method["scalar"], method="joint"), every=True))


def test_the_increments_of_a_second_method_are_there_too(by_method: dict[str, Calibration]) -> None:
    """As in Table 1 of the paper: each method by pass, and the second pass in % of the first."""
    scalar, sequential = by_method["scalar"], by_method["sequential"]
    tables = [b for b in calibration_blocks(scalar, others=[sequential], every=True) if isinstance(b, Table)]
    shown = [numbers(each) for each in tables if "2 in % of 1" in each.columns]
    assert shown == [numbers(iteration_table(found, found.parameters)) for found in (scalar, sequential)]


def test_the_methods_differ_by_what_is_printed(by_method: dict[str, Calibration]) -> None:
    """In the parameter's unit, and in % of the first method's value."""
    scalar, sequential = by_method["scalar"], by_method["sequential"]
    rows = numbers(method_table(scalar, sequential, scalar.parameters))
    assert len(rows) == 21
    for name, (_, _, difference, percent) in rows.items():
        a, b = scalar[name].value, sequential[name].value
        last = 0.006 * (scalar[name].u or 0.0)
        assert difference * shown_units(scalar.parameters)[name][0] == pytest.approx(b - a, rel=1e-12, abs=last)
        assert percent == pytest.approx(100.0 * (b - a) / a, abs=0.006)


def test_the_difference_in_percent_is_that_of_table_1() -> None:
    """Sequential less scalar method, both iterations, of k_y, k_z and γ_zx: published 11.46, −10.47 and 5.28 % (from
    values with more digits than those of the table)."""
    sequential = np.array([-21.3 + 0.085, -11.7 - 0.19, 14.71 - 0.18])
    scalar = np.array([-19.0 - 0.0038, -13.4 + 0.0537, 13.80 + 0.008])
    np.testing.assert_allclose(difference_percent(sequential, scalar), [11.46, -10.47, 5.28], atol=0.6)


def test_launches_iterations_and_methods_are_a_line_each_unless_all_is_asked_for(
    by_method: dict[str, Calibration],
) -> None:
    """With the figures that the tables of --all have."""
    scalar, sequential = by_method["scalar"], by_method["sequential"]
    lines = lines_of(calibration_blocks(scalar, others=[sequential]), 100)
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 100
    said = " ".join(" ".join(lines).split())
    for found in (scalar, sequential):
        size = {p.name: abs(found.evidence.iterations[-1][p.name]) / p.u for p in found.parameters if p.u}
        name = max(size, key=size.__getitem__)
        assert f"{found.method}: the last of 2 iterations added at most {size[name]:.2g} u ({name})" in said
    apart = {
        p.name: abs(sequential[p.name].value - p.value) / np.hypot(p.u, sequential[p.name].u or 0.0)
        for p in scalar.parameters
        if p.u
    }
    name = max(apart, key=apart.__getitem__)
    assert f"sequential differs from scalar by at most {apart[name]:.2g} combined u ({name})" in said
    scatter = [p.run_to_run or 0.0 for p in scalar.parameters if p.name.startswith("accel.axis")]
    rms = float(np.sqrt(np.mean(np.square(scatter)))) / shown_units(scalar.parameters)["accel.axis.yx"][0]
    assert f"accel.axis {rms:.2g} " in said


def test_deviations_from_the_systematic_values_stand_beside_the_totals(
    by_method: dict[str, Calibration], folders: list[Path], tmp_path: Path
) -> None:
    passport = tmp_path / "passport.json"
    by_method["scalar"].write(passport)
    sessions = [read_session(folder) for folder in folders]
    sessions = [replace(s, device=replace(s.device, systematic=passport)) for s in sessions]
    mean = mean_of_launches(
        [LaunchRun(session=s, calibration=calibrate(s, method="scalar", terms="linear")) for s in sessions]
    )
    rows = numbers(launch_table(mean, mean.parameters, deviations=True))
    for p in mean.parameters:
        size = shown_units(mean.parameters)[p.name][0]
        deviations = [
            next(q for q in launch.parameters if q.name == p.name).deviation for launch in mean.evidence.launches
        ]
        expected = [d / size for d in deviations if d is not None]
        assert len(expected) == 2
        np.testing.assert_allclose(rows[p.name][:2], expected, atol=0.1 * (p.u or 0.0) / size)
    tables = [block for block in calibration_blocks(mean, every=True) if isinstance(block, Table)]
    assert sum("launch1" in table.columns for table in tables) == 2
    assert "deviation of" in printed(calibration_blocks(mean, every=True))


def test_several_methods_are_compared_and_the_first_is_written(folders: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "both.json"
    arguments = ["calibrate", str(folders[0]), "--method", "scalar", "--method", "sequential", "--out", str(out)]
    done = CliRunner().invoke(main, [*arguments, "--all"])
    assert done.exit_code == 0, done.stderr
    assert '"method": "scalar"' in out.read_text(encoding="utf-8")
    assert "scalar  sequential  difference" in done.stdout
    once = CliRunner().invoke(main, [*arguments[:-4], "--out", str(tmp_path / "one.json")])
    assert "difference" not in once.stdout


# -------------------- beyond the linear model --------------------

MICRO_G = 1e-6 * G_STANDARD
QUADRATIC = MICRO_G / G_STANDARD**2


def parameter(name: str, value: float, u: float, unit: str, **more: float) -> Parameter:
    return Parameter(name=name, value=value, u=u, unit=unit, **more)


@pytest.fixture
def full(by_method: dict[str, Calibration]) -> Calibration:
    """A calibration with three further groups: one learned in part with a widened prior, one well, one not at all."""
    whole = by_method["scalar"]
    further = (
        parameter("accel.quadratic.x", 42 * QUADRATIC, 9 * QUADRATIC, "s^2/m", prior=90 * QUADRATIC, learned=0.99),
        parameter("accel.quadratic.y", -61 * QUADRATIC, 88 * QUADRATIC, "s^2/m", prior=90 * QUADRATIC, learned=0.04),
        parameter("accel.delay", 2e-3, 5e-5, "s", prior=5e-3, learned=0.9999, dof=6.0),
        parameter("gyro.bias.x.drift", 3 * DEGREE_PER_HOUR / 3600, 1e-9, "rad/s/s", prior=1e-8, learned=0.5),
    )
    groups = (
        GroupFinding(name="accel.quadratic", kept=True, prior=90 * QUADRATIC, prior_widened=3.0, learned=(0.99, 0.04)),
        GroupFinding(name="accel.delay", kept=True, prior=5e-3, prior_widened=1.0, learned=(0.9999,)),
        GroupFinding(name="gyro.bias.drift", kept=True, prior=1e-8, prior_widened=1.0, learned=(0.5,)),
        GroupFinding(name="gyro.asymmetry", kept=False, prior=1e-5, prior_widened=1.0, learned=(0.0, 0.0, 0.0)),
    )
    biases = tuple(replace(p, u=10 * MICRO_G) if p.name.startswith("accel.bias") else p for p in whole.parameters)
    prediction = Prediction(force_u=1.7 * MICRO_G, rate_u=0.4 * DEGREE_PER_HOUR, at_rate=23.0 * DEGREE)
    return with_fields(
        whole,
        parameters=biases + further,
        covariance=None,
        launches=(),
        iterations=(),
        groups=groups,
        prediction=prediction,
    )


def lines_of(blocks: Sequence[Block], width: int | None = None) -> list[str]:
    return text_of(blocks, width).splitlines()


def test_a_line_for_each_further_group(full: Calibration) -> None:
    whole = lines_of(calibration_blocks(full, every=True), 100)
    groups = next(i for i, line in enumerate(whole) if line.startswith("group "))
    said = {line.split()[0]: line.split()[1:] for line in whole[groups:] if line.strip()}
    assert said["accel.quadratic"] == ["61", "88", "µg/g²", "4–99", "%", "3", "times", "the", "usual", "size"]
    assert said["accel.delay"] == ["2.000", "0.050", "ms", "100", "%"]
    assert said["gyro.asymmetry"] == ["not", "determined"]
    of_parameters = {line.split()[0]: line.split()[1:] for line in whole[:groups] if line.strip()}
    assert {p.name for p in full.parameters} < set(of_parameters)
    factor, expanded = map(float, of_parameters["accel.delay"][2:4])
    assert factor == pytest.approx(full["accel.delay"].k, abs=0.006)
    assert expanded == pytest.approx(factor * 0.05, abs=0.006)
    assert [row[0] for row in group_table(full).rows] == [group.name for group in full.groups]


def test_the_tables_fit_a_terminal_of_100_columns(full: Calibration) -> None:
    truth = {p.name: p.value for p in full.parameters}
    for every in (False, True):
        report = calibration_blocks(full, truth, every=every)
        rows = [line for line in lines_of(report, 100) if line.split()[:1] and line.split()[0] in truth]
        shown = [line for line in rows if line.endswith("+0.00")]
        assert len(shown) == (25 if every else 21)
        assert len(rows) == len(shown) + every  # and the group accel.delay
        assert max(map(len, lines_of(report, 100))) <= 100
    assert any("truth: 25 parameters" in line for line in lines_of(report))


def test_a_value_that_rounds_to_zero_has_no_sign() -> None:
    assert rounded(-0.004, 0.12) == ("0.00", "0.12")
    assert rounded(-3.0, 120.0) == ("0", "120")
    assert [two_digits(value) for value in (2.98, 0.05, 78.0, 996.0)] == ["3.0", "0.050", "78", "1000"]


def test_a_prior_that_decides_u_is_named_with_the_rests_that_would_settle_it(full: Calibration) -> None:
    decided = decided_by_priors(full)
    assert decided is not None
    assert "quadratic nonlinearity" in decided
    assert "5.9 times" in decided
    assert "oblique" in decided
    assert full.prediction is not None
    assert decided_by_priors(replace(full, prediction=replace(full.prediction, force_u=6 * MICRO_G))) is None
    learned = tuple(replace(group, learned=(0.9, 0.9)) for group in full.groups)
    assert decided_by_priors(replace(full, groups=learned)) is None


def test_verdicts_of_accelerometers_and_gyros_stand_apart_where_they_differ(full: Calibration) -> None:
    remark = "gyro turns: the residuals are 4 times the noise; hysteresis fits best"
    scattered = replace(full, outcome=Outcome(remarks=(remark,), concerns={remark: ("gyro",)}))
    assert verdicts(full) == ("accepted",)
    assert verdicts(replace(full, outcome=Outcome(reasons=("too few rests",)))) == ("not accepted",)
    lines = lines_of(calibration_blocks(scattered))
    assert lines[1] == "accepted with scatter (accelerometers: accepted; gyros: accepted with scatter)"
    assert f"remark: {remark}" in lines
    verdict = ["accelerometers: accepted", "gyros: accepted with scatter", "accepted with scatter"]
    assert lines_of(calibration_blocks(scattered, every=True))[1:4] == verdict


def test_groups_of_refused_sensors_that_are_accepted_are_named_in_the_terminal_the_report_and_the_file(
    full: Calibration, tmp_path: Path
) -> None:
    why = "biases of the gyros jump"
    made = replace(full, outcome=Outcome(reasons=(why,), concerns={why: ("gyro.bias",)}))
    lines = lines_of(calibration_blocks(made))
    spared = "accepted groups: gyro.scale, gyro.axis"
    assert lines[1] == f"not accepted (accelerometers: accepted; gyros: not accepted; {spared})"
    rows = [line.split()[0] for line in lines if line.startswith(("accel.", "gyro."))]
    assert rows == ["accel.bias", "accel.scale", "accel.axis", "gyro.scale", "gyro.axis"]
    made.write(tmp_path / "calibration.json")
    assert read_calibration(tmp_path / "calibration.json").outcome == made.outcome
    write_report([tmp_path / "calibration.json"], tmp_path / "r.html")
    assert "The accelerometers, gyro.scale and gyro.axis alone: values of others" in (tmp_path / "r.html").read_text()


def test_a_calibration_shows_priors_and_what_was_learned(full: Calibration) -> None:
    lines = {line.split()[0]: line.split() for line in full.table().splitlines()[1:] if line}
    assert lines["parameter"][-4:] == ["dof", "prior", "from", "data"]
    assert lines["accel.delay"][-4:] == ["6", "5", "100", "%"]
    u, k, expanded = (float(lines["accel.delay"][column]) for column in (2, 3, 4))
    assert k == pytest.approx(full["accel.delay"].k, abs=0.005)
    assert expanded == pytest.approx((full["accel.delay"].k or 0.0) * u, rel=0.05)
    assert "<th>from data</th>" in full._repr_html_()
    frame = full.to_polars()
    assert frame["learned"].to_list()[-4:] == [0.99, 0.04, 0.9999, 0.5]
    assert frame["k"].to_list() == [p.k for p in full.parameters]


def test_sentences_are_not_broken_in_a_pipe_and_tables_are(capsys: pytest.CaptureFixture[str]) -> None:
    sentence = "remark: " + "a word and another " * 20 + "the end"
    print_blocks(Text(text=sentence), Table(columns=("parameter", "said"), rows=(("x", "words " * 100),), text=(0, 1)))
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == [sentence, ""]
    assert len(lines) > 4
    assert max(map(len, lines[1:])) <= 160


# -------------------- blocks of any result --------------------


@pytest.mark.parametrize("remarks", range(6))
@pytest.mark.parametrize("words", [3, 20, 60, 200])
def test_what_is_printed_is_at_most_25_lines_of_100_characters(full: Calibration, remarks: int, words: int) -> None:
    """However many remarks there are, of magnetometers too; the first one whole, what is left is counted."""
    said = tuple(f"{i}: " + "a word " * words + f"end of {i}" for i in range(remarks))
    field = tuple(
        parameter(f"mag.{name}", 0.1, 0.01, "uT")
        for name in ("bias.x", "bias.y", "bias.z", "scale.x", "scale.y", "scale.z", "axis.yx", "axis.zx", "axis.zy")
    )
    made = with_fields(full, assumptions=said[1:], outcome=Outcome(remarks=said[:1]), notes=("a note",) * 3)
    made = replace(made, parameters=made.parameters[:21] + field)
    shown = text_of(calibration_blocks(made, file="a folder/calibration.json"), 100)
    lines = shown.splitlines()
    assert max(map(len, lines)) <= 100
    whole = [i for i in range(remarks) if f"end of {i}" in " ".join(shown.split())]
    assert whole == list(range(len(whole)))
    assert len(lines) <= 25 or (words == 200 and whole == [0])
    assert len(whole) >= min(remarks, 3 if words == 3 else 1)
    hidden = remarks - len(whole)
    counted = f"{hidden} remark{'s' * (hidden > 1)}, " if hidden else ""
    assert f"more with --all: {counted}3 notes, all tables" in lines
    assert lines[-1].startswith("next: tumble export 'a folder/calibration.json' --to ")


@pytest.mark.parametrize(
    ("log", "column", "imu", "to"),
    [
        ("flight.bin", "accel_x", True, "ardupilot -o imu.parm (others"),
        ("flight.ulg", "accel_x", True, "px4 -o imu.params (others"),
        ("ride.mcap", "accel_x", False, "kalibr -o imu.yaml (others"),
        ("LOG00001.01.csv", "accSmooth[0]", False, "betaflight -o imu.txt (others"),
        ("sensor_combined.csv", "accelerometer_m_s2[0]", False, "px4 -o imu.params (others"),
        ("session", "accel_x", True, "px4 -o imu.params (ardupilot, others"),
        ("log.csv", "ax", False, "json -o imu.json (others"),
    ],
)
def test_the_next_command_exports_to_the_program_that_recorded_the_log(
    full: Calibration, log: str, column: str, imu: bool, to: str
) -> None:
    readings = replace(full.provenance.readings["accel"], columns=(column, "b", "c"))
    made = with_fields(full, readings={"accel": readings})
    sensors = {"accel": AutopilotSensor(number=1, id=None)} if imu else {}
    made = replace(made, device=replace(made.device, imu=sensors))
    assert f" --to {to}: --help)" in lines_of(calibration_blocks(made, log=log))[-1]
    if to.startswith("kalibr"):  # which needs gyros too
        alone = replace(made, gyro=None, outcome=Outcome(reasons=("gyro",), concerns={"gyro": ("gyro",)}))
        assert " --to ros-imu-calib -o imu.yaml " in lines_of(calibration_blocks(alone, log=log))[-1]


def test_every_parameter_is_printed_with_its_u(full: Calibration) -> None:
    """To the digits of the table that has a row for each."""
    linear, units = full.parameters[:21], shown_units(full.parameters)
    rows = [line.split() for line in lines_of(calibration_blocks(full)) if line.startswith(("accel.", "gyro.", "    "))]
    found: dict[str, list[str]] = {}
    group = ""
    for row in rows:
        group = row.pop(0) if row[0].startswith(("accel.", "gyro.")) else group
        found |= {f"{group}.{row[i]}": row[i + 1 : i + 3] for i in range(0, 3 * (len(row) // 3), 3)}
    assert found == {p.name: list(cells(p.value, p.u, units[p.name][0])) for p in linear}


def test_what_was_assumed_of_the_log_is_said_once_where_the_result_is_read(full: Calibration) -> None:
    doubt = "gyros in 83 counts per deg/s, as on no data sheet"
    for every in (False, True):
        lines = lines_of(calibration_blocks(with_fields(full, assumptions=(doubt,)), every=every))
        assert lines.count(f"remark: {doubt}") == 1
    assert doubt in with_fields(full, assumptions=(doubt,)).table()


def test_remarks_are_in_the_order_of_their_harm(full: Calibration) -> None:
    """What is unexplained, then turns that were lost, then what u does not contain, then what it does."""
    assumed = (
        "the height is not stated: 4 mm/s² are in u of accel.scale",
        "the time base is not stated: 30 ppm, usual for time stamps of a crystal, is in u of gyro.scale",
        "beyond these temperatures the result is hardly valid",
    )
    made = with_fields(full, assumptions=assumed, outcome=Outcome(remarks=("the residuals are large",)))
    lost = tuple(f"turn from rest {i} to rest {i + 1} is left out: samples are lost in it" for i in range(1, 5))
    for notes, said in (((), "the residuals are large"), (lost, f"{lost[0]} (and 3 more)"), (lost[:1], lost[0])):
        made = with_fields(made, notes=notes)
        lines = [line for line in lines_of(calibration_blocks(made)) if line.startswith("remark: ")]
        assert f"remark: {said}" in lines
        every = [line.removeprefix("remark: ") for line in lines_of(calibration_blocks(made, every=True))]
        order = [every.index(line) for line in ("the residuals are large", assumed[2], assumed[0], assumed[1])]
        assert order == sorted(order)
    made = with_fields(made, outcome=Outcome(remarks=("one", "two", "three")))
    lines = [line for line in lines_of(calibration_blocks(made)) if line.startswith("remark: ")]
    assert lines == ["remark: one", "remark: two", f"remark: {lost[0]}"]


def test_what_is_not_stated_is_a_remark_only_where_it_is_most_of_u() -> None:
    made = calibration()
    height = "the height is not stated: gravity is that of sea level, which is in u of accel.scale; state height_m"
    clock = "the uncertainty of the time base is not stated: 30 ppm are in u of gyro.scale; state clock_ppm_u"
    for share in (0.2, 0.7):
        parts = {p.name: np.sqrt(share) * (p.u or 0.0) for p in made.parameters if p.name.startswith("accel.scale")}
        gravity = SourceContributions(name="gravity", words="gravity", type="B", contributions=parts)
        unstated = {height: "gravity", clock: "clock"}
        made = with_fields(made, assumptions=(height, clock), unstated=unstated, budget=(gravity,))
        text = "\n".join(line for line in text_of(calibration_blocks(made), 400).splitlines() if "stated" in line)
        minor = "with less effect on u: "
        time_base = "the uncertainty of the time base is not stated"
        if share > 0.5:
            assert text == f"{minor}{time_base}\nremark: {height}"
        else:
            assert text == f"{minor}the height is not stated; {time_base}"
    every = text_of(calibration_blocks(made, every=True), 400)
    assert f"remark: {height}" in every
    assert f"remark: {clock}" in every


def test_of_a_refused_session_no_numbers_are_printed_and_the_next_command_looks_at_it(full: Calibration) -> None:
    lines = lines_of(calibration_blocks(replace(full, outcome=Outcome(reasons=("it moved",)))))
    assert lines[1] == "not accepted"
    assert not [line for line in lines if line.startswith(("accel.", "gyro.", "at rest", "after"))]
    assert lines[-1].startswith("next: tumble inspect ")


def test_the_verdict_is_first_and_the_length_does_not_grow_with_the_rests(
    full: Calibration, by_method: dict[str, Calibration]
) -> None:
    rests = by_method["scalar"].evidence.launches[0].rests
    lines, longer = (lines_of(calibration_blocks(with_fields(full, rests=rests * times))) for times in (1, 3))
    assert lines[0].startswith("device ")
    assert lines[1] == full.outcome.verdict
    assert sum(line.startswith(("accel.", "gyro.")) for line in lines) == 6
    assert len(longer) == len(lines)
    whole, more = (lines_of(calibration_blocks(with_fields(full, rests=rests * n), every=True)) for n in (1, 3))
    assert len(more) - len(whole) == 2 * len(rests)


@pytest.mark.parametrize("width", [20, 40, 80])
@given(data=st.data())
def test_a_table_keeps_every_number_and_the_width(width: int, data: st.DataObject) -> None:
    """Words may be broken into lines, numbers never; nothing is lost."""
    word = st.lists(st.text("abcdefgh", min_size=1, max_size=7), max_size=5).map(" ".join)
    number = st.integers(-99999, 99999).map(str)
    rows = data.draw(st.lists(st.tuples(word, number, word, number), min_size=1, max_size=4))
    shown = text_of([Table(columns=("name", "first", "said", "last"), rows=tuple(rows), text=(0, 2))], width)
    assert {row[i] for row in rows for i in (1, 3)} <= set(shown.split())
    assert max(map(len, shown.splitlines())) <= width
    for _, _, said, _ in rows:
        assert set(said.split()) <= set(shown.split())


def test_lines_of_a_file_stay_lines_on_a_terminal() -> None:
    text = '[incoming]\n"accel.bias" = "5 mg"\n\n[periodic]'
    assert text_of([Items(items=(text,))], 40) == text_of([Items(items=(text,))]) == f"{text}\n"


def test_all_shows_what_the_model_did_not_know_about_itself() -> None:
    """A scatter in its engineering unit, a size without one, the integral, and u of the bias met next."""
    made = calibration()
    bias = made["accel.bias.x"]
    size = HyperparameterEstimate(name="lever", unit="1", words="size", value=1.5, low=1.0, high=2.25, usual=1.0)
    scatter = HyperparameterEstimate(
        name="accel", unit="m/s^2", words="rests", value=20e-6 * G_STANDARD, low=0.0, high=0.0, usual=0.0
    )
    known = with_fields(
        made,
        hyperparameters=(scatter, size),
        integral=Integral(points=64, effective=44.0, pareto=-0.22),
        process_bias=(ProcessBias(name=bias.name, value=bias.value, u=1.0, next_u=2.0 * G_STANDARD),),
    )
    shown = text_of(calibration_blocks(known, every=True))
    rows = {cells[0]: cells for cells in map(str.split, shown.splitlines()) if cells}
    assert rows["accel"][2] == "20"
    assert rows["accel"][-1] == "µg"
    assert rows["lever"][2:] == ["1.5", "1", "2.25", "1"]
    assert "at 64 points (effectively 44)" in shown
    assert "u next minute" in shown
    assert "68 % from" not in text_of(calibration_blocks(known))
    assert "68 % from" not in text_of(calibration_blocks(made, every=True))
