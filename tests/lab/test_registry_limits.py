"""Acceptance limits: the verdict follows the stated rule, and stands as it was given."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.registry_files import added
from tumble.errors import InputError
from tumble.lab.conformity import LimitJudgement, Result, judge_parameters
from tumble.lab.limits import Limits, months_later, parse_limits, read_limits
from tumble.lab.registry.registry import Registry, open_registry
from tumble.lab.registry.views import due_table
from tumble.result.coverage import expanded_of
from tumble.result.parts import Parameter
from tumble.units import ARCSEC, DEGREE_PER_HOUR, G_STANDARD

MG = 1e-3 * G_STANDARD
ALL_FORMS = """
format = 1
interval_months = 12

[device_interval_months]
"A-0007" = 6

[incoming]
"accel.bias" = "5 mg"
"accel.bias.z" = { min = "-1 mg", max = "3 mg" }
"gyro.bias.x" = { max = "2 deg/h" }
"accel.scale" = { min = "900 ppm", max = "1100 ppm" }
"gyro.axis.xy" = "20 arcsec"
"""


def limits(text: str = ALL_FORMS) -> Limits:
    return parse_limits(text, "limits.toml")


def row(name: str, value: float, u: float | None = 0.0) -> Parameter:
    return Parameter(name=name, value=value, u=u, unit="1")


# -------------------- the rule --------------------


def judged(value: float, u: float | None, low: float, high: float) -> Result:
    return LimitJudgement(name="accel.bias.x", unit="1", value=value, u=u, low=low, high=high).result


@given(st.floats(-10, 10), st.floats(0, 3), st.floats(-5, 0), st.floats(0, 5))
def test_the_verdict_is_whether_the_interval_of_the_value_is_within_the_limits(
    value: float, u: float, low: float, high: float
) -> None:
    """All of value ± U inside: pass. None of it: fail. Part of it: conditional, by the value. Points of the
    interval are counted."""
    points = [value - 2.0 * u + k / 200 * 4.0 * u for k in range(201)]
    inside = [low <= point <= high for point in points]
    verdict = judged(value, u, low, high)
    edge = min(abs(value + s * 2.0 * u - limit) for s in (-1, 1) for limit in (low, high)) < 1e-9
    wide = 4.0 * u > 0.5 * (high - low)  # the limits may lie between two of the points
    if not edge and not wide:
        conditional = "conditional pass" if low <= value <= high else "conditional fail"
        assert verdict == ("pass" if all(inside) else conditional if any(inside) else "fail")
    assert verdict.endswith("pass") == (low <= value <= high)


@pytest.mark.parametrize("dof", [None, 3.0, 30.0])
@pytest.mark.parametrize(
    ("off", "result", "risk"),
    [
        (-1.0, "pass", 0.02275),  # the guard band w = U
        (0.0, "conditional pass", 0.5),
        (1.0, "conditional fail", 0.02275),
    ],
)
def test_the_risk_at_a_limit_and_at_its_guard_band(dof: float | None, off: float, result: str, risk: float) -> None:
    """JCGM 106:2012, 9.3.2: one half at the limit, whatever u is, and by the definition of U one half of 4.55 % a guard
    band beside it."""
    U = expanded_of(1e-4, dof)
    assert U is not None
    one_sided = parse_limits('format = 1\n[incoming]\n"accel.bias.x" = { max = "1 m/s^2" }\n', "limits.toml")
    value = Parameter(name="accel.bias.x", value=1.0 + (off * (1.0 + 1e-9)) * U, u=1e-4, unit="m/s^2", dof=dof)
    verdict = judge_parameters(one_sided, "incoming", [replace(value, value=1.0) if off == 0.0 else value])
    assert verdict is not None
    assert verdict.result in (result, "fail" if result == "conditional fail" else result)
    assert verdict.judgements[0].risk == pytest.approx(risk, rel=1e-3)
    assert verdict.risk == verdict.judgements[0].risk


def test_the_risk_is_how_often_a_value_is_on_the_other_side() -> None:
    """Between two limits 2.2 u apart, by 200,000 true values drawn about each value."""
    drawn = np.random.default_rng(1).standard_t(7.0, 200_000)
    both = parse_limits('format = 1\n[incoming]\n"gyro.scale" = { min = "0 ppm", max = "220 ppm" }\n', "l.toml")
    for value in (-2e-4, -0.5e-4, 0.3e-4, 1.1e-4, 4e-4):
        verdict = judge_parameters(
            both, "incoming", [Parameter(name="gyro.scale.x", value=value, u=1e-4, unit="1", dof=7.0)]
        )
        assert verdict is not None
        inside = float(np.mean((value + 1e-4 * drawn >= 0.0) & (value + 1e-4 * drawn <= 2.2e-4)))
        wrong = 1.0 - inside if verdict.result.endswith("pass") else inside
        assert verdict.judgements[0].risk == pytest.approx(wrong, abs=4.5e-3)


def test_the_risk_of_a_whole_is_a_bound_on_that_of_its_values() -> None:
    """That all are inside is wrong if one is outside; that not all are, only if none is."""
    pair = parse_limits('format = 1\n[incoming]\n"accel.bias" = "1 m/s^2"\n', "limits.toml")

    def at(*values: float) -> list[Parameter]:
        return [
            Parameter(name=f"accel.bias.{axis}", value=v, u=0.1, unit="m/s^2")
            for axis, v in zip("xyz", values, strict=True)
        ]

    for values, bound in (((0.9, 0.95, 0.0), sum), ((1.1, 1.2, 0.0), min)):
        verdict = judge_parameters(pair, "incoming", at(*values))
        assert verdict is not None
        risks = [j.risk for j in verdict.judgements if bound is sum or not j.result.endswith("pass")]
        assert verdict.risk == pytest.approx(bound(risk for risk in risks if risk is not None))


def test_an_undecided_whole_has_no_risk() -> None:
    """Even if another value is judged: outside by less than U, but the result is not about it."""
    pair = parse_limits('format = 1\n[incoming]\n"accel.bias" = "1 m/s^2"\n', "limits.toml")
    outside = Parameter(name="accel.bias.x", value=1.1, u=0.1, unit="m/s^2")
    verdict = judge_parameters(pair, "incoming", [outside], ["accel.bias.y"])
    assert verdict is not None
    assert [j.result for j in verdict.judgements] == ["conditional fail", "undecided"]
    assert (verdict.result, verdict.risk, verdict.risk_sentence) == ("undecided", None, "")


def test_without_an_uncertainty_nothing_is_decided() -> None:
    assert judged(0.0, None, -1.0, 1.0) == "undecided"


def test_where_u_is_larger_than_the_limits_nothing_passes() -> None:
    assert {judged(v / 10, 1.0, -1.0, 1.0) for v in range(-100, 101)} == {
        "conditional pass",
        "conditional fail",
        "fail",
    }


def test_limits_are_in_their_units_about_zero_or_between_two_values() -> None:
    parsed = limits()
    assert parsed.of("accel.bias.x", "incoming") == pytest.approx((-5 * MG, 5 * MG))
    assert parsed.of("accel.bias.z", "incoming") == pytest.approx((-1 * MG, 3 * MG))  # the longer name goes before
    assert parsed.of("gyro.bias.x", "incoming") == pytest.approx((-math.inf, 2 * DEGREE_PER_HOUR))
    assert parsed.of("gyro.bias.y", "incoming") is None
    assert parsed.of("accel.scale.x", "incoming") == pytest.approx((0.9e-3, 1.1e-3))
    assert parsed.of("gyro.axis.xy", "incoming") == pytest.approx((-20 * ARCSEC, 20 * ARCSEC))
    assert parsed.of("accel.bias.x", "periodic") is None
    assert (parsed.device_interval_months, parsed.interval_months) == ({"A-0007": 6}, 12)


def test_a_whole_is_as_good_as_its_worst_parameter() -> None:
    good, guard, bad = row("accel.bias.x", 0.0), row("accel.bias.y", 5 * MG, 1e-6), row("gyro.axis.xy", 21 * ARCSEC)
    others = [row("gyro.bias.x", 0.0), row("accel.scale.x", 1e-3), row("accel.bias.z", 0.0), row("gyro.axis.yx", 1.0)]
    inside = row("gyro.axis.xy", 0.0)
    for several, result in (([good, inside], "pass"), ([guard, inside], "conditional pass"), ([guard, bad], "fail")):
        verdict = judge_parameters(limits(), "incoming", [*several, *others])
        assert verdict is not None
        assert verdict.result == result
    last = judge_parameters(limits(), "incoming", [guard, bad, *others])
    assert last is not None
    assert last.reasons == ["fail: gyro.axis.xy", "conditional pass: accel.bias.y"]


def test_what_was_not_determined_does_not_pass() -> None:
    rows = [row("accel.bias.x", 0.0), row("accel.scale.x", 1e-3, None)]
    verdict = judge_parameters(limits(), "incoming", rows, unobservable=["accel.bias.z", "accel.axis.yx"])
    assert verdict is not None
    assert verdict.result == "undecided"
    assert verdict.reasons == ["without U: accel.scale.x", "not determined: accel.bias.z, gyro.bias.x, gyro.axis.xy"]
    assert judge_parameters(limits(), "periodic", [row("accel.bias.x", 0.0)]) is None


# -------------------- the file --------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "format: expected 1, found none"),
        ("format = 1", "expected limits in [incoming] or [periodic], found none"),
        ("format = 1\nincoming = 3", "incoming: expected a table of limits, found 3"),
        ("format = 1\n[outgoing]", "unknown key 'outgoing' at the top level"),
        ("format = ", "expected TOML, found an error in its syntax"),
        ('format = 1\nframe = "ned"\n[incoming]', "frame: expected one of accelerometer, case, paper, symmetric"),
        ('format = 1\n[incoming]\naccel.bias = "5 mg"', 'accel: expected a quoted name such as "accel.bias"'),
        ('format = 1\n[incoming]\n"accel.bias" = 5', 'expected a text such as "5 mg", or a table'),
        ('format = 1\n[incoming]\n"accel.bias" = "5 ppm"', "accel.bias: expected a number and one of m/s^2, g, mg"),
        ('format = 1\n[incoming]\n"accel.bias" = "-5 mg"', "accel.bias: expected more than 0, found '-5 mg'"),
        ('format = 1\n[incoming]\n"accel.bias" = {min = 1}', 'expected a text such as "5 mg"'),
        ('format = 1\n[incoming]\n"accel.bias" = {min = "1 mg", max = "0 mg"}', "expected a min below max"),
        ('format = 1\n[incoming]\n"accel.bias" = {deviation = "1 mg"}', 'expected a text such as "5 mg"'),
        ('format = 1\ninterval_months = 0\n[incoming]\n"accel.bias" = "5 mg"', "expected a whole number of"),
        ('format = 1\ndevice_interval_months = 3\n[incoming]\n"accel.bias" = "5 mg"', "expected a table of"),
    ],
)  # fmt: skip
def test_limits_that_cannot_be_used_are_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        limits(text)
    assert said in str(refused.value)
    assert str(refused.value).startswith("limits.toml: ")
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none.toml: cannot be read: No such file"):
        read_limits(tmp_path / "none.toml")


def test_limits_of_a_further_group_are_in_its_units_and_a_bias_limit_is_not_for_its_slope() -> None:
    found = limits(
        'format = 1\n[incoming]\n"accel.quadratic" = "20 ug/g^2"\n"accel.bias" = "5 mg"\n"accel.bias.t1" = "0.1 mg/K"',
    )
    high = 20e-6 / G_STANDARD
    assert found.of("accel.quadratic.x", "incoming") == pytest.approx((-high, high))
    assert found.of("accel.bias.x", "incoming") == pytest.approx((-5 * MG, 5 * MG))
    assert found.of("accel.bias.x.t1", "incoming") == pytest.approx((-0.1 * MG, 0.1 * MG))
    assert found.of("accel.bias.x.drift", "incoming") is None


# -------------------- verdicts in the registry --------------------


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    with open_registry(tmp_path / "r.sqlite", create=True) as opened:
        yield opened


def put_in_force(registry: Registry, text: str, model: str = "BCHE-501") -> int:
    """The number of the limits of a text."""
    file = Path(registry.name).with_name("limits.toml")
    file.write_text(text, encoding="utf-8")
    return registry.set_limits(model, file).number


def result(registry: Registry, number: int) -> str | None:
    record = registry.record(number)
    verdict = registry.verdict(record)
    word = None if verdict is None else verdict.result
    assert record.verdict == word  # as it was when it was added
    return word


def test_a_verdict_stands_when_limits_are_replaced(registry: Registry) -> None:
    wide, narrow = (f'format = 1\n[incoming]\n"accel.bias" = "{size} mg"\n[periodic]\n"accel.bias" = "{size} mg"'
                    for size in (5, 1))  # fmt: skip
    value = {"accel.bias.x": 3 * MG}
    added(registry, log="a", values=value)
    assert [put_in_force(registry, wide), put_in_force(registry, wide)] == [1, 1]
    added(registry, log="b", values=value)
    assert put_in_force(registry, narrow) == 2
    added(registry, log="c", values=value)
    assert [result(registry, number) for number in (1, 2, 3)] == [None, "pass", "fail"]
    assert put_in_force(registry, wide) == 3  # back again: limits of their own
    assert [result(registry, number) for number in (1, 2, 3)] == [None, "pass", "fail"]
    assert [each.in_force for each in registry.limits()] == [False, False, True]


def test_limits_of_one_type_do_not_judge_another(registry: Registry) -> None:
    put_in_force(registry, ALL_FORMS)
    assert result(registry, added(registry, serial="B", model="other", log="a").number) is None
    assert result(registry, added(registry, serial="C", model=None, log="b").number) is None
    assert result(registry, added(registry, log="c").number) == "fail"  # scale factors are not those of the limits


def test_limits_in_another_frame_judge_the_converted_values(registry: Registry) -> None:
    """In the paper's frame the X axis has the angles that Y and Z have in the accelerometers' frame."""
    put_in_force(registry, 'format = 1\nframe = "paper"\n[incoming]\n"accel.axis.xy" = "2 mrad"')
    assert result(registry, added(registry, log="a", values={"accel.axis.yx": -1e-3}).number) == "pass"
    far = added(registry, occasion="incoming", log="b", values={"accel.axis.yx": -3e-3})
    assert result(registry, far.number) == "fail"


def test_a_frame_that_cannot_be_converted_is_refused_in_one_line(registry: Registry) -> None:
    added(registry, log="a")
    added(registry, performed=day("2026-04-01"), log="b", frame="house")
    with pytest.raises(InputError, match=r"record 1: is in the frame 'accelerometer' and cannot be compared in the f"):
        registry.trend("A-0007")


# -------------------- what is due --------------------


def day(text: str) -> datetime:
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


@pytest.mark.parametrize(
    ("begin", "months", "later"),
    [
        ("2026-03-01", 12, "2027-03-01"),
        ("2026-08-31", 6, "2027-02-28"),
        ("2027-08-31", 6, "2028-02-29"),
        ("2026-12-15", 1, "2027-01-15"),
        ("2026-11-30", 25, "2028-12-30"),
    ],
)
def test_months_end_where_the_calendar_ends_them(begin: str, months: int, later: str) -> None:
    assert str(months_later(date.fromisoformat(begin), months)) == later


def test_what_is_due_counts_from_the_last_calibration(registry: Registry) -> None:
    put_in_force(registry, ALL_FORMS.replace('"accel.scale" = { min = "900 ppm", max = "1100 ppm" }', ""))
    for serial, begin in (("A-0007", "2026-01-10"), ("B", "2025-12-31"), ("A-0007", "2025-01-10")):
        added(registry, performed=day(begin), serial=serial, log=f"{serial}{begin}")
    added(registry, serial="C", model="no limits", log="c")
    found = [(item.record.serial, str(item.day), item.months) for item in registry.due()]
    assert found == [("A-0007", "2026-07-10", 6), ("B", "2026-12-31", 12), ("C", "None", None)]


def test_a_failed_device_is_withdrawn_until_it_is_calibrated_again(registry: Registry) -> None:
    """Before all others, also while its interval lasts, and by a value outside its limit by no more than U."""
    put_in_force(registry, 'format = 1\ninterval_months = 12\n[incoming]\n"accel.bias" = "5 mg"\n')
    over = 5 * MG + 1e-6
    for serial, value in (("A", 0.0), ("Z", over)):
        added(registry, serial=serial, log=serial, performed=day("2026-01-10"), values={"accel.bias.x": value})
    first, second = registry.due(date(2026, 6, 1))
    assert (first.record.serial, first.record.verdict, first.withdrawn, first.overdue) == (
        *("Z", "conditional fail"),
        *(True, False),
    )
    assert not second.withdrawn
    assert "withdrawn until calibrated again: conditional fail" in due_table([first]).rows[0][-1]
    added(registry, serial="Z", log="again", performed=day("2026-02-10"), occasion="incoming")
    assert not any(item.withdrawn for item in registry.due())
