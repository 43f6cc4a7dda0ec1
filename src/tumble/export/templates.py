"""Exports described by templates: one text file for each target, which users can write.

A template has a front matter of TOML between two lines `+++`, and a body of Jinja that becomes the file:

    +++
    about = "SlowFly: settings of its accelerometers"
    formula = "corrected = (reading - zero) * gain"
    source = "SlowFly, imu.c"
    needs = ["accel"]

    [accel]
    numbers = { zero = "bias", gain = "1 / diagonal(matrix)" }
    corrected = "(reading - zero) * gain"
    +++
    {% for line in comments %}
    # {{ line }}
    {% endfor %}
    zero: {{ accel.zero | yaml }}
    gain: {{ accel.gain | yaml }}

`numbers` are the content of the file, each an expression of the calibration and of the numbers above it; `corrected` is
what the target computes from a `reading`, both SI. From these the export computes a worked example and the remaining
errors, which are written as comments. Expressions and body are Jinja in a sandbox, with the names `matrix`, `bias` and
`inverse` of the sensors, `counts` (per SI unit), `g_sensitivity`, `force` (zero), and FUNCTIONS.

    key          meaning
    about        the target, in one sentence
    formula      what the target computes, as in its documentation
    source       that documentation
    ending       suffix of the file, ".txt" by default
    counts       [per g, per deg/s]: usual counts, of a target that works in counts
    needs        ["accel"], ["gyro"] or both: sensors that a calibration must have
    holds        groups of parameters beyond matrix and bias that are in the file, such as "gyro.g_sensitivity"
    notes        what the user has to do or to check
    [accel], [gyro]
      numbers, corrected
      limits     [lowest, highest] of numbers, by name
      zeroed     sentence for a target that estimates the bias itself
    [test.accel], [test.gyro]
      matrix, bias, reading, corrected: a test vector, which is checked whenever the template is read
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from tumble.documents import text_of_document, validated
from tumble.errors import InputError
from tumble.export import FENCE, split_template
from tumble.export.exported import (
    Correct,
    Exported,
    example_line,
    g_sensitivity,
    notes_of,
    one_line,
    origin,
    shown,
    triads,
    yaml_number,
)
from tumble.result.calibration import Calibration
from tumble.result.correction import linear_example
from tumble.sensors.model import WORDS, SensorKind, SensorModel
from tumble.units import DEGREE, G_STANDARD, Array

if TYPE_CHECKING:
    from jinja2.sandbox import SandboxedEnvironment

LAYOUTS = Path(__file__).with_name("layouts")
"""Folder of the layouts of targets that need code."""
_TEST_TOLERANCE = 1e-6  # m/s² or rad/s, of a template's test vector


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


_Two = Annotated[list[float], Field(min_length=2, max_length=2)]
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]


class Sensors(_Table):
    """Front matter on the sensors of one kind."""

    numbers: dict[str, str] = {}
    limits: dict[str, _Two] = {}
    corrected: str = ""
    zeroed: str = ""


class WorkedExample(_Table):
    """Test vector: a model, a reading, and the result of the target."""

    matrix: list[_Three] = Field(min_length=3, max_length=3)
    bias: _Three
    reading: _Three
    corrected: _Three


class Front(_Table):
    """Front matter of a template."""

    about: str
    formula: str
    source: str
    ending: str = ".txt"
    counts: _Two | None = None
    needs: list[Literal["accel", "gyro"]] = []
    holds: list[str] = []
    notes: list[str] = []
    accel: Sensors | None = None
    gyro: Sensors | None = None
    test: dict[Literal["accel", "gyro"], WorkedExample] = {}

    def sensors(self, kind: SensorKind) -> Sensors | None:
        """Front matter on the sensors of a kind."""
        return self.accel if kind == "accel" else self.gyro


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Template:
    """A template: its name in messages, front matter, body, and the number of the line before the body."""

    name: str
    front: Front
    body: str
    line: int

    def write(self, calibration: Calibration, *, counts: tuple[float, float] | None = None) -> Exported:
        """Return the file of a calibration; `counts` are those per g and per °/s.

        Raises InputError for a calibration that the target cannot hold, and for an expression or a body with an
        error."""
        from jinja2 import TemplateSyntaxError

        front = self.front
        needs: list[SensorKind] = [*front.needs]
        by_kind = triads(calibration, self.name, needed=needs, held=front.holds)
        numbers: dict[SensorKind, dict[str, Any] | None] = {"accel": None, "gyro": None}
        comments, remarks = [*origin(calibration), front.formula], list[str]()
        corrections: dict[SensorKind, Correct] = {}
        for kind in numbers:
            model, sensors, words = by_kind.get(kind), front.sensors(kind), WORDS[kind]
            if model is None:
                continue
            if sensors is None or sensors.zeroed:
                remarks.append(f"{words}: not in this file" if sensors is None else sensors.zeroed)
                bias = np.zeros(3) if sensors is None else model.bias
                corrections[kind] = partial(np.add, -bias)
                continue
            per_si = 1.0
            if front.counts is not None:
                (size, unit), readings = _COUNTED_PER[kind], calibration.provenance.readings.get(kind)
                if counts is not None:
                    per_si, source = _counts_per_si(kind, counts), "--counts"
                elif readings is not None and readings.unit == "count" and np.ptp(readings.scale) == 0.0:
                    per_si, source = float(readings.scale[0]), "the recording"
                else:
                    per_si = _counts_per_si(kind, front.counts)
                    source = "the usual range of the chip: see that it is yours, or give --counts"
                comments.append(f"{kind}: {per_si * size:.6g} counts a {unit}, by {source}")
            values, correct = self.correction(kind, model, per_si, g_sensitivity(calibration))
            numbers[kind] = {name: value.tolist() for name, value in values.items()}
            worked = linear_example(kind, model)
            comments.append(example_line(kind, worked, correct(worked.reading)))
            corrections[kind] = correct
        losses = notes_of(calibration, corrections=corrections, remarks=remarks, held=front.holds, see_to=front.notes)
        names: dict[str, Any] = {str(kind): each for kind, each in numbers.items()}
        names |= {
            "comments": [*comments, *losses],
            "serial": one_line(calibration.serial),
            "model": one_line(calibration.model or ""),
            "frame": calibration.frame,
        }
        try:
            text = str(_environment().from_string(self.body).render(names))
        except Exception as error:  # of Jinja, and of what the body calls
            place = f", line {self.line + error.lineno}" if isinstance(error, TemplateSyntaxError) else ""
            fault = _reason(error, names)
            raise InputError(f"{self.name}{place}: expected a body that can be filled in, found {fault}") from None
        return Exported(content=text.encode(), losses=losses)

    def correction(
        self, kind: SensorKind, model: SensorModel, counts: float, sensitivity: Array
    ) -> tuple[dict[str, Array], Correct]:
        """Return the numbers of the file by name, and the correction of readings by the target.

        `counts` are those per SI unit, `sensitivity` is the g-sensitivity (3, 3). Raises InputError for numbers beyond
        their limits, and for a correction that is not affine."""
        sensors = self.front.sensors(kind)
        if sensors is None:
            raise InputError(f"{self.name}: [test.{kind}]: expected a table [{kind}] too, found none")
        given = {
            "matrix": model.matrix,
            "bias": model.bias,
            "inverse": model.inverse(),
            "counts": counts,
            "g_sensitivity": sensitivity,
            "force": np.zeros(3),
        }
        numbers: dict[str, Array] = {}
        for name, text in sensors.numbers.items():
            numbers[name] = self._value(f"[{kind}] {name}", text, given | numbers)
            low, high = sensors.limits.get(name, (-np.inf, np.inf))
            if not np.all((numbers[name] >= low) & (numbers[name] <= high)):
                advice = "; give --counts of the chip" if self.front.counts is not None else ""
                raise InputError(
                    f"export to {self.name}: expected {name} from {low:g} to {high:g}, found {shown(numbers[name])}"
                    + advice
                )

        def corrected(reading: Array) -> Array:
            names = given | numbers | {"reading": reading}
            return self._value(f"[{kind}] corrected", sensors.corrected, names, shape=(3,))

        offset, probe = corrected(np.zeros(3)), np.array([3.0, -5.0, 7.0])
        matrix = np.column_stack([corrected(axis) - offset for axis in np.eye(3)])
        if not np.allclose(corrected(probe), matrix @ probe + offset, rtol=1e-9, atol=1e-9):
            raise InputError(f"{self.name}: [{kind}] corrected: expected A reading + b, found what is not linear")
        return numbers, lambda reading: np.asarray(reading @ matrix.T + offset)

    def check(self) -> None:
        """Raise InputError unless the formulas reproduce the test vectors."""
        for kind, test in self.front.test.items():
            model = SensorModel(matrix=np.array(test.matrix), bias=np.array(test.bias))
            counts = 1.0 if self.front.counts is None else _counts_per_si(kind, self.front.counts)
            _, correct = self.correction(kind, model, counts, np.zeros((3, 3)))
            result = correct(np.array(test.reading))
            if np.abs(result - test.corrected).max() > _TEST_TOLERANCE:
                raise InputError(
                    f"{self.name}: [test.{kind}] corrected: expected what the formula gives, "
                    f"{shown(result.round(9))}, found {shown(np.array(test.corrected))}"
                )

    def _value(self, where: str, text: str, names: Mapping[str, Any], shape: tuple[int, ...] | None = None) -> Array:
        """Evaluate an expression. Raises InputError if it has no finite value of this shape."""
        from jinja2 import Undefined

        try:
            result = _environment().compile_expression(text, undefined_to_none=False)(**names)
            value = np.asarray(str(result) if isinstance(result, Undefined) else result)  # str() of it raises
            if not np.issubdtype(value.dtype, np.number) or not np.all(np.isfinite(value)):
                raise ValueError("no finite numbers")
            if shape is not None and value.shape != shape:
                raise ValueError(f"an array of the shape {value.shape}")
        except Exception as error:  # of Jinja, of NumPy, of arithmetic
            reason = _reason(error, names)
            raise InputError(f"{self.name}: {where}: expected an expression with a value, found {reason}") from None
        return value


def read_template(file: Path, name: str) -> Template:
    """Read a template, called by `name` in messages.

    Raises InputError for a file that is not a template, and for a formula that does not give its test vector."""
    text = text_of_document(file)
    front, body = split_template(text, name)
    line = text.count("\n") - body.count("\n")
    template = Template(name=name, front=validated(Front, front, name), body=body, line=line)
    template.check()
    return template


def write_template(file: Path, name: str, calibration: Calibration, **options: Any) -> Exported:
    """Return the file of a calibration by a template. Raises InputError as `read_template` and `Template.write`."""
    return read_template(file, name).write(calibration, **options)


_COUNTED_PER: Mapping[SensorKind, tuple[float, str]] = {"accel": (G_STANDARD, "g"), "gyro": (DEGREE, "deg/s")}
"""Units by which counts are stated: size in SI, name."""


def _counts_per_si(kind: SensorKind, counts: list[float] | tuple[float, float]) -> float:
    """Convert counts per g and per °/s to counts per SI unit."""
    per_g, per_degree_per_second = counts
    return (per_g if kind == "accel" else per_degree_per_second) / _COUNTED_PER[kind][0]


# -------------------- functions and filters of templates --------------------


def _single(values: Any) -> Array:
    """Round to single precision, as the shortest decimals that read back to the same numbers."""
    values = np.asarray(values, dtype=np.float32)
    return np.array([float(str(value)) for value in values.ravel()]).reshape(values.shape)


def cardan_angles(matrix: Array) -> Array:
    """Return roll, pitch and yaw, °, of the rotation R = R_x R_y R_z that is nearest to a matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(polar(matrix)[0]).as_euler("XYZ", degrees=True))


def cardan_matrix(angles: Array) -> Array:
    """Return R_x R_y R_z (3, 3) of roll, pitch and yaw, °."""
    return np.asarray(Rotation.from_euler("XYZ", angles, degrees=True).as_matrix())


FUNCTIONS: Mapping[str, Callable[..., Array]] = {
    "dot": np.dot,
    "transpose": np.transpose,
    "inverted": np.linalg.inv,
    "diagonal": np.diagonal,
    "lengths": lambda matrix: np.linalg.norm(matrix, axis=1),  # of the rows
    "column": lambda vector: vector[:, None],  # matrix / column(vector) divides row by row
    "beside": lambda matrix, vector: np.column_stack([matrix, vector]),
    "with_one": lambda vector: np.append(vector, 1.0),  # argument of [A | b]
    "degrees": lambda radians: radians / DEGREE,
    "radians": lambda degrees: degrees * DEGREE,
    "round": lambda values: np.asarray(np.rint(values), dtype=np.int64),
    "single": _single,
    "cardan_angles": cardan_angles,
    "cardan_matrix": cardan_matrix,
}
"""Functions for the expressions of templates."""


def _reason(error: Exception, names: Iterable[str]) -> str:
    """Return an error of Jinja or NumPy in a line, for an unknown name or filter with those that there are."""
    reason = " ".join(str(error).split()) or type(error).__name__
    if reason.endswith(" is undefined"):
        return f"{reason}; there are {', '.join((*names, *FUNCTIONS))}"
    return reason + (f"; there are {', '.join(_FILTERS)}" if reason.startswith("No filter named") else "")


def render_layout(layout: str, **names: Any) -> str:
    """Render a layout, without its front matter, with these names."""
    text = text_of_document(LAYOUTS / layout)
    body = split_template(text, layout)[1] if text.startswith(FENCE) else text
    return str(_environment().from_string(body).render(names))


@cache
def _environment() -> SandboxedEnvironment:
    from jinja2 import StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    class Environment(ImmutableSandboxedEnvironment):
        """Sandbox of Jinja without access to attributes of arrays, some of which write files."""

        def is_safe_attribute(self, obj: Any, attr: str, value: Any) -> bool:
            return not isinstance(obj, np.ndarray | np.generic) and super().is_safe_attribute(obj, attr, value)

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.globals |= FUNCTIONS
    environment.filters |= _FILTERS
    return environment


def _as_json(value: Any, indent: int | None = None) -> str:
    return json.dumps(value, indent=indent, allow_nan=False, default=str)  # str() of an undefined name raises


def _as_yaml(value: Any) -> str:
    """Format a number, or numbers as a list on one line."""
    return yaml_number(value) if np.ndim(value) == 0 else f"[{', '.join(map(yaml_number, np.ravel(value)))}]"


def _as_float32(value: float) -> str:
    """Format a number with the fewest digits that read back to it in single precision, without an exponent."""
    return np.format_float_positional(np.float32(value), trim="0")


def identifier(text: str) -> str:
    """Return a text as an identifier of most languages: letters, digits and underscores, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return name if name[:1].isalpha() else f"imu_{name}"


_FILTERS = {"json": _as_json, "yaml": _as_yaml, "identifier": identifier, "float32": _as_float32}
"""Filters for the bodies of templates, beside those of Jinja."""
