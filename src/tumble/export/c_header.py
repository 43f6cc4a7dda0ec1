"""A C header (C99, C++): bias and inverse matrix as constants, and functions that apply them, in double and in float.

    out = inverse · (reading − bias)        inverse = M⁻¹, or the pseudo-inverse for more than three sensors

The sum runs from the first sensor to the last. Where the calibration has quadratic, cubic or asymmetric terms or a
g-sensitivity of the gyros, the functions take them off in the fixed-point steps of `tumble.sensors.compensation`:

    out ← inverse · (reading − bias − what is not linear in out)

Where parameters change with temperature, there are functions with a temperature too: with d = T − T₀ in °C

    out = inverse · ((reading − bias − d (b₁ + d b₂)) / (1 + d (s₁ + d s₂)))

sensor by sensor. Where the sensors lag behind the thermometer by λ, a function follows it from reading to reading,
exact where the temperature is straight between two (`tumble.reduction.thermometer`): over h seconds, with
g = 1 − e^(−h/λ),

    y₁ = y₀ + g (T₀ − y₀) + (T₁ − T₀) (1 − g λ/h)

Nothing needs a library.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.temperature_curves import changing, coefficients, measured_range, own_thermometers, references
from tumble.export.exported import NO_UNCERTAINTY, Exported, example, models, numbers, origin, shown
from tumble.export.larger_model import not_held
from tumble.reduction.thermometer import followed
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.instrument import is_linear
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import FORCE, OWN_CUBE, OWN_SIZE, PRODUCTS
from tumble.units import Array

UNITS = {"accel": "m/s^2", "gyro": "rad/s"}

_FUNCTION = """\
/* {what}, {unit}, from readings of {n} sensors in {unit}{needs} */
static inline void imu_correct_{kind}{at}{suffix}(const {type} reading[{n}], {argument}{type} out[3])
{{
    static const {type} bias[{n}] = {{{bias}}};
    static const {type} inverse[3][{n}] = {{
{rows}
    }};
{warm}
    for (int i = 0; i < 3; i++) {{
        {type} sum = 0;
        for (int j = 0; j < {n}; j++) {{
            sum += inverse[i][j] * (reading[j] - bias[j]{less}){over};
        }}
        out[i] = sum;
    }}
}}
"""

_BEYOND = """\
/* {what}, {unit}, from readings of {n} sensors in {unit}{needs} */
static inline void imu_correct_{kind}{at}{suffix}(const {type} reading[{n}], {argument}{type} out[3])
{{
    static const {type} bias[{n}] = {{{bias}}};
    static const {type} inverse[3][{n}] = {{
{rows}
    }};
{tables}
{warm}
    {type} left[{n}];
    for (int j = 0; j < {n}; j++) {{
        left[j] = (reading[j] - bias[j]{less}){over};
    }}
    for (int step = 0; step <= {steps}; step++) {{
        for (int i = 0; i < 3; i++) {{
            {type} sum = 0;
            for (int j = 0; j < {n}; j++) {{
                sum += inverse[i][j] * left[j];
            }}
            out[i] = sum;
        }}
        for (int j = 0; j < {n}; j++) {{
            const {type} own = axis[j][0] * out[0] + axis[j][1] * out[1] + axis[j][2] * out[2];
            left[j] = reading[j] - bias[j]{less} - (own < 0 ? -own : own) * asymmetry[j] - own * own * own * cubic[j];
{more}
{divided}
        }}
    }}
}}
"""

_QUADRATIC = """\
            left[j] -= quadratic[j][0] * out[0] * out[0] + quadratic[j][1] * out[0] * out[1]
                + quadratic[j][2] * out[0] * out[2] + quadratic[j][3] * out[1] * out[1]
                + quadratic[j][4] * out[1] * out[2] + quadratic[j][5] * out[2] * out[2];"""
_BY_FORCE = """\
            left[j] -= by_force[j][0] * force[0] + by_force[j][1] * force[1] + by_force[j][2] * force[2];"""

_WARM = """\
    {type} shift[{n}], gain[{n}];
    for (int j = 0; j < {n}; j++) {{
        const {type} warmer = celsius{own} - {reference};
        shift[j] = warmer * (bias_slope[j] + warmer * bias_curve[j]);
        gain[j] = 1 + warmer * (scale_slope[j] + warmer * scale_curve[j]);
    }}"""

_LAG = """\
/* what follows a thermometer: all zero before its first reading */
typedef struct {{
    int started;
    double thermometer, behind;
}} imu_thermometer;

/* temperature of the sensors, degC, which lag behind the thermometer: from its reading, degC, and the seconds since the
   reading before; as warm as the thermometer with the first */
static inline double imu_sensors_celsius(imu_thermometer *state, double celsius, double seconds)
{{
    static const double lag = {size!r};
    if (!state->started) {{
        state->started = 1;
        state->behind = celsius;
    }} else if (seconds > 0) {{
        double x = seconds / lag, gain = 1;
        if (x < 40) {{
            int doublings = 0;
            while (x > 0.01) {{
                x *= 0.5;
                doublings++;
            }}
            gain = x * (1 - x / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5))));
            while (doublings-- > 0) {{
                gain *= 2 - gain;
            }}
        }}
        state->behind += gain * (state->thermometer - state->behind)
            + (celsius - state->thermometer) * (1 - gain * lag / seconds);
    }}
    state->thermometer = celsius;
    return {found};
}}
"""
LAG_EXAMPLE = ((20.0, 0.0), (21.0, 10.0), (23.0, 10.0), (23.0, 60.0))
"""Readings of a thermometer, degC, and the seconds since the one before."""

HELD = frozenset(
    {"accel.quadratic", "accel.cubic", "accel.asymmetry", "gyro.asymmetry", "gyro.cubic", "gyro.g_sensitivity"}
)
"""Groups of parameters beyond the linear model that the functions apply."""

HELD_AT = frozenset(f"{kind}.{what}.{t}" for kind in UNITS for what in ("bias", "scale") for t in ("t1", "t2"))
"""Those that the functions with a temperature apply."""

_WHAT = {"accel": "true specific force", "gyro": "true angular rate"}


def c_header(calibration: Calibration) -> Exported:
    """The header of a calibration."""
    known = models(calibration)
    compensator = calibration.compensator
    digits = "the functions in float have 7 digits; use those in double where that matters"
    warm = bool(changing(calibration)) and calibration.reference_temperature is not None
    lag = compensator.lag if warm else 0.0
    held = HELD | (HELD_AT if warm else frozenset()) | ({"temperature.lag"} if lag else frozenset())
    losses = (*not_held(calibration, held), NO_UNCERTAINTY, digits)
    comments = [
        *origin(calibration),
        *_worked(compensator, known),
        *(_temperatures(calibration) if warm else []),
        *_lagging(lag),
        *losses,
    ]
    lines = ["#ifndef IMU_CALIBRATION_H", "#define IMU_CALIBRATION_H", ""]
    lines += ["/*", *(f" * {line}" for line in comments), " */", ""]
    if lag:
        lines.append(_LAG.format(size=abs(lag), found="state->behind" if lag > 0 else "2 * celsius - state->behind"))
    for kind, model in known.items():
        for single in (False, True):
            for at in [None, calibration] if warm else [None]:
                if _is_linear(compensator, kind):
                    lines.append(_function(kind, model, single=single, at=at))
                else:
                    lines.append(_beyond(compensator, kind, model, single=single, at=at))
    lines += ["#endif", ""]
    return Exported(content="\n".join(lines).encode(), losses=losses)


def _temperatures(calibration: Calibration) -> list[str]:
    """What the functions with a temperature are for."""
    measured = measured_range(calibration)
    known = "" if measured is None else f", measured from {measured.low:.1f} to {measured.high:.1f}"
    return [
        f"functions without a temperature are for {calibration.reference_temperature:g} degC; those in _at take it, "
        f"in degC{known}",
        *own_thermometers(calibration),
    ]


def _lagging(lag: float) -> list[str]:
    """What the function of the lag is for, with an example; nothing where there is none."""
    if not lag:
        return []
    readings = "; ".join(f"{celsius:g} after {seconds:g} s" for celsius, seconds in LAG_EXAMPLE)
    return [
        f"sensors lag behind the thermometer by {lag:.6g} s: give functions in _at what imu_sensors_celsius makes of "
        "every reading, with a state for each thermometer",
        f"example lag: the thermometer reads {readings}; the sensors have {shown(sensors_celsius(lag).round(9))}",
    ]


def sensors_celsius(lag: float) -> Array:
    """Temperatures, °C, of the sensors with the readings of LAG_EXAMPLE."""
    out = [LAG_EXAMPLE[0][0]]
    for (before, _), (now, seconds) in pairwise(LAG_EXAMPLE):
        out.append(float(followed(np.array([before, now]), seconds, abs(lag), first=out[-1])[1]))
    celsius = np.array([each for each, _ in LAG_EXAMPLE])
    return np.array(out) if lag > 0.0 else 2.0 * celsius - np.array(out)


def _over_temperature(kind: str, model: SensorModel, at: Calibration | None, *, single: bool) -> dict[str, str]:
    """The parts of a function that take off what changes with temperature; without `at` there are none."""
    if at is None:
        return {"at": "", "warm": "", "less": "", "over": "", "divided": "", "needs_at": "", "argument_at": ""}
    number = "float" if single else "double"
    bias, scale = (coefficients(at, kind, what) for what in ("bias", "scale"))
    scale = scale / np.linalg.norm(model.matrix, axis=1)[:, None]
    columns = {"bias_slope": bias[:, 0], "bias_curve": bias[:, 1], "scale_slope": scale[:, 0]}
    columns["scale_curve"] = scale[:, 1]
    n, apart = len(model.bias), len(set(at.thermometers.get(kind, ()))) > 1
    columns |= {"reference": references(at, kind)} if apart else {}
    tables = [_table(name, values, single=single) for name, values in columns.items()]
    reference = "reference[j]" if apart else f"({number}){float(references(at, kind)[0])!r}"
    body = _WARM.format(type=number, n=n, reference=reference, own="[j]" if apart else "")
    return {
        "at": "_at",
        "warm": "\n".join([*tables, body]),
        "less": " - shift[j]",
        "over": " / gain[j]",
        "divided": "            left[j] /= gain[j];",
        "needs_at": " and their temperatures, degC" if apart else " and a temperature, degC",
        "argument_at": f"const {number} celsius[{n}], " if apart else f"{number} celsius, ",
    }


def _examples(known: dict[str, SensorModel]) -> list[str]:
    out = []
    for kind, model in known.items():
        worked = example(kind, model)
        out.append(f"example {kind}: reading {shown(worked.reading)} is {shown(worked.true.round(9))} {UNITS[kind]}")
    return out


def _worked(compensator: Compensator, known: dict[str, SensorModel]) -> list[str]:
    """Examples by the whole model, those of gyros in the specific force of the accelerometers' example."""
    if all(_is_linear(compensator, kind) for kind in known):
        return _examples(known)
    reading = {kind: example(kind, model).reading for kind, model in known.items()}
    force = compensator.force(reading["accel"][None]) if "accel" in known else np.zeros((1, 3))
    true = {"accel": force} if "accel" in known else {}
    if "gyro" in known:
        true["gyro"] = compensator.rate(reading["gyro"][None], force)
    felt = "in that specific force" if "accel" in known else "without a specific force"
    said = f" {felt}" if _needs_force(compensator) else ""
    return [
        f"example {kind}: reading {shown(reading[kind])}{said if kind == 'gyro' else ''} is "
        f"{shown(vector[0].round(9))} {UNITS[kind]}"
        for kind, vector in true.items()
    ]


def _coefficients(compensator: Compensator, kind: str) -> tuple[Block, Array]:
    """The sensors of a kind and their coefficients (n, 15)."""
    if kind == "accel" or compensator.gyro is None:
        return compensator.accel, compensator.accel_coefficients
    return compensator.gyro, compensator.gyro_coefficients


def _is_linear(compensator: Compensator, kind: str) -> bool:
    return is_linear(*_coefficients(compensator, kind))


def _needs_force(compensator: Compensator) -> bool:
    """Whether the rate depends on the specific force."""
    return bool(np.any(compensator.gyro_coefficients[:, FORCE]))


def _beyond(
    compensator: Compensator, kind: str, model: SensorModel, *, single: bool, at: Calibration | None = None
) -> str:
    """The function of sensors that are not linear."""
    block, K = _coefficients(compensator, kind)
    number, by_force = "float" if single else "double", kind == "gyro" and _needs_force(compensator)
    tables = {"axis": block.axes, "asymmetry": K[:, OWN_SIZE], "cubic": K[:, OWN_CUBE]}
    tables |= {"quadratic": K[:, PRODUCTS]} if kind == "accel" else {}
    tables |= {"by_force": K[:, FORCE]} if by_force else {}
    more = [_QUADRATIC] * (kind == "accel") + [_BY_FORCE] * by_force
    inverse = model.inverse()
    warm = _over_temperature(kind, model, at, single=single)
    force = f"const {number} force[3], " if by_force else ""
    return _BEYOND.format(
        what=_WHAT[kind],
        unit=UNITS[kind],
        n=block.size,
        kind=kind,
        needs=(" and the true specific force, m/s^2" if by_force else "") + warm["needs_at"],
        suffix="f" if single else "",
        type=number,
        argument=force + warm["argument_at"],
        bias=_constants(model.bias, single=single),
        rows=_rows(inverse, single=single),
        tables="\n".join(_table(name, values, single=single) for name, values in tables.items()),
        steps=FIXED_POINT_STEPS,
        more="\n".join(more),
        **{part: warm[part] for part in ("at", "warm", "less", "over", "divided")},
    ).replace("\n\n", "\n")


def _table(name: str, values: Array, *, single: bool) -> str:
    """A constant array of one row or more."""
    number = "float" if single else "double"
    if values.ndim == 1:
        return f"    static const {number} {name}[{len(values)}] = {{{_constants(values, single=single)}}};"
    rows = _rows(values, single=single)
    return f"    static const {number} {name}[{values.shape[0]}][{values.shape[1]}] = {{\n{rows}\n    }};"


def _rows(values: Array, *, single: bool) -> str:
    return ",\n".join(f"        {{{_constants(row, single=single)}}}" for row in values)


def _function(kind: str, model: SensorModel, *, single: bool, at: Calibration | None = None) -> str:
    inverse = model.inverse()
    warm = _over_temperature(kind, model, at, single=single)
    return _FUNCTION.format(
        what=_WHAT[kind],
        unit=UNITS[kind],
        n=len(model.bias),
        kind=kind,
        suffix="f" if single else "",
        type="float" if single else "double",
        bias=_constants(model.bias, single=single),
        rows=_rows(inverse, single=single),
        needs=warm["needs_at"],
        argument=warm["argument_at"],
        **{part: warm[part] for part in ("at", "warm", "less", "over")},
    ).replace("\n\n", "\n")


def _constants(values: Array, *, single: bool) -> str:
    """Numbers as C constants that read back to the same ones."""
    if not single:
        return ", ".join(map(repr, numbers(values)))
    return ", ".join(f"{value!s}f" for value in values.astype(np.float32))
