"""Options, arguments and parameter types that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from tumble import usual_setup
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.drafting.new_session import Given
    from tumble.inference.prior import DevicePrior
    from tumble.planning.setup import Setup
    from tumble.result.launch_variances import LaunchVariances

_Command = Callable[..., None]
_Option = Callable[[_Command], _Command]


class _NamedPath(click.Path):
    """A path that is neither empty, as of an unset variable, which would mean the working folder, nor `-`, by which
    others mean a stream."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("", "-"):
            found = "'-', and no stream is read or written" if value else "an empty one"
            self.fail(f"expected a path, found {found}", param, ctx)
        inside = Path(value) / "calibration.json"
        if not self.dir_okay and "\0" not in str(value) and inside.is_file():
            self.fail(f"expected a file, found a folder; its calibration is {inside}", param, ctx)
        return super().convert(value, param, ctx)


class Numbers(click.ParamType[tuple[Any, ...]]):
    """Comma-separated numbers, each larger than `above`; exactly `count` of them unless it is 0."""

    name = "numbers"

    def __init__(
        self, expected: str, kind: Callable[[str], float] = float, *, count: int = 0, above: float = -math.inf
    ) -> None:
        self.expected, self.kind, self.count, self.above = expected, kind, count, above

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        del ctx
        return self.read(param.opts[0] if param else "", value)

    def read(self, option: str, text: str) -> tuple[Any, ...]:
        """Return the numbers in the text of an option. Raises InputError."""
        try:
            values = tuple(map(self.kind, text.split(",")))
        except ValueError:
            values = ()
        if not values or len(values) != (self.count or len(values)) or not all(each > self.above for each in values):
            raise InputError(f"{option}: expected {self.expected}, found {text!r}")
        return values


def _latitude(text: str | float) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"--latitude: expected decimal degrees, south negative, such as 48.1, found {text!r}"
        ) from None


PATH = _NamedPath(path_type=Path)
FILE = _NamedPath(path_type=Path, dir_okay=False)
FOLDER = _NamedPath(path_type=Path, file_okay=False)
METHOD_NAMES = ["joint", "sequential", "scalar", "scalar-nominal", "ellipsoid"]
NUMBERS = Numbers("numbers with commas between them")
FRAMES = ["accelerometer", "case", "paper", "symmetric"]
AS_JSON = "tumble.json"
"""Key of a click context under which `--json` is stored."""


def examples(*lines: str) -> str:
    """Return the examples below the help of a command."""
    return "\b\n" + "\n".join(("Examples:", *(f"  {line}" for line in lines)))


def option(name: str, text: str, default: Any = None, **settings: Any) -> _Option:
    """Return an option, with its default shown if it has one."""
    if default is not None:
        settings |= {"default": default, "show_default": True}
    return click.option(*name.split("/"), help=text, **settings)


def _group(*options: _Option) -> _Option:
    return lambda command: reduce(lambda wrapped, each: each(wrapped), reversed(options), command)


def programmes_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    """Return the built-in programmes that begin with the typed text, for completion."""
    from tumble.programme.positions import programmes

    return [name for name in programmes() if name.startswith(typed)]


def _grades_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    from tumble.sensors.grades import GRADES

    return [name for name in GRADES if name.startswith(typed)]


def out(text: str, kind: click.Path = FILE, **settings: Any) -> _Option:
    return click.option("-o", "--out", type=kind, help=text, **settings)


def force(text: str = "Replace an existing file.") -> _Option:
    return click.option("--force", is_flag=True, help=text)


def programme(text: str, default: str | None = None) -> _Option:
    return option("--programme", text, default, shell_complete=programmes_like)


def grade(default: str | None = usual_setup.GRADE, text: str = "") -> _Option:
    return option("--grade", f"navigation, tactical, mems or consumer{text}.", default, shell_complete=_grades_like)


def terms(default: str) -> _Option:
    text = "Groups of parameters: all (full), or bias, scale factor and axis angles alone (linear)."
    return option("--terms", text, default, type=click.Choice(["full", "linear"]))


def frame(frames: list[str] = FRAMES) -> _Option:
    return option("--frame", "Frame of the result.", frames[0], type=click.Choice(frames))


def method(methods: list[str], default: str | list[str] | None, text: str, **settings: Any) -> _Option:
    return option("--method", text, default, type=click.Choice(methods), **settings)


def registry(text: str) -> _Option:
    return option("--registry", text, metavar="FILE|URL")


WANT = option("--want/wanted", "Wanted u, e.g. accel.scale=3.5ppm; repeat.", multiple=True, metavar="GROUP=VALUE")
JSON = click.option(
    *("--json", "as_json"),
    is_flag=True,
    expose_value=False,
    callback=lambda context, _, asked: context.meta.update({AS_JSON: asked}),
    help="Print the result as JSON, in SI, instead of tables.",
)
EVERY = click.option("--all", "every", is_flag=True, help="Show every parameter and every table.")
CERTIFICATE = option("--certificate", "TOML file of a certificate: laboratory, customer, number.", type=FILE)


def registry_place(**settings: Any) -> _Option:
    text = "The registry: an SQLite file or postgresql://USER@HOST/NAME."
    return option("--registry/place", text, metavar="FILE|URL", envvar="TUMBLE_REGISTRY", show_envvar=True, **settings)


REGISTRY = registry_place()
GRAVITY = option("--gravity", "Measured gravity, m/s²; default: normal gravity.", type=float)
HEIGHT = option("--height", "Height of the place above sea level, m; default: 0, u 1300 m.", type=float, metavar="M")
LATITUDE = option("--latitude", "Latitude of the place, ° north.", type=_latitude, metavar="DEGREES")
SERIAL = option("--serial", "Serial number of the device; default: the name of FOLDER or LOG.", metavar="NUMBER")
SAMPLE_RATE = "--sample-rate", "Samples per second"
COLUMNS = _group(
    option(SAMPLE_RATE[0], f"For a LOG: {SAMPLE_RATE[1]}, instead of its times.", type=float, metavar="HZ"),
    option("--accel", "For a LOG: columns of the accelerometers, names or numbers from 1.", metavar="N,N,N"),
    option("--gyro", "For a LOG: columns of the gyros, names or numbers from 1.", metavar="N,N,N"),
    option("--time", "For a LOG: column of the time, its name or number from 1.", metavar="N"),
    option("--accel-unit", "For a LOG: unit of the accelerometers, as in session.toml.", metavar="UNIT"),
    option("--gyro-unit", "For a LOG: unit of the gyros, as in session.toml.", metavar="UNIT"),
)
"""Options that describe the columns of a log without a session."""
LOG = _group(SERIAL, LATITUDE, HEIGHT, COLUMNS)
"""Options for making a session of a log."""


def given_of(options: dict[str, Any]) -> Given:
    """Remove the options that describe a log from `options` and return them."""
    from tumble.drafting.new_session import Given

    names = "serial", "latitude", "height", "sample_rate", "programme", "message", "time", "accel_unit", "gyro_unit"
    stated: dict[str, Any] = {name: options.pop(name, None) for name in names}
    for kind in ("accel", "gyro"):
        columns = options.pop(kind)
        stated[kind] = tuple(columns.split(",")) if columns else ()
    return Given(**stated)


TABLE_ERROR = option("--table-error", "Largest error of a position, °.", usual_setup.TABLE_ERROR_DEG, type=float)
MOUNTING_ERROR = option(
    "--mounting-error", "Largest error of the mounting, °.", usual_setup.MOUNTING_ERROR_DEG, type=float
)
SITE_LATITUDE = option("--latitude", "Latitude of the site, ° north.", usual_setup.LATITUDE_DEG, type=_latitude)
NOISELESS = click.option(
    "--noiseless",
    is_flag=True,
    help="Only errors of the method: no noise, no instability and, in plans, exact gravity and time base, and no "
    "parameters beyond bias, scale factor and axis angles.",
)
PACE = _group(
    option("--rest", "Duration of a rest, s.", usual_setup.ON_TABLE.rest, type=float),
    option("--turn-rate", "Rate of the turns, °/s.", usual_setup.ON_TABLE.rate_deg_s, type=float),
)

SETUP = _group(
    grade(),
    TABLE_ERROR,
    MOUNTING_ERROR,
    PACE,
    SITE_LATITUDE,
    GRAVITY,
    option("--gravity-u", "Uncertainty of gravity, m/s².", usual_setup.GRAVITY_U, type=float),
    option("--clock-ppm-u", "Uncertainty of the time base, ppm.", 30.0, type=float),
    NOISELESS,
)
"""Options that describe a set-up on a table before anything is measured."""


def setup_of(options: dict[str, Any]) -> Setup:
    """Return a set-up from the options of `plan` or `simulate`."""
    from tumble.planning.setup import Setup

    named = {"turn_rate": "rate_deg_s", "table_error": "table_error_deg", "mounting_error": "mounting_error_deg"}
    named |= {"latitude": "latitude_deg"}
    words = {named.get(name, name): value for name, value in options.items() if name != "noiseless"}
    if options["noiseless"]:
        words |= dict.fromkeys(("noise_factor", "gravity_u", "clock_ppm_u"), 0.0)
    return Setup.of(**words)


CLUSTER = _group(
    out("Folder of the results; an interrupted run is resumed.", FOLDER, required=True),
    option("--workers", "Number of local processes; default: one per core.", type=click.IntRange(min=1)),
    option("--cluster", "Compute on an existing dask cluster.", metavar="tcp://HOST:PORT"),
    click.option("--in-process", "serial", is_flag=True, help="Compute in this process."),
)
"""Options of the folder of many tasks, and of where they are computed."""


class Knowledge(Protocol):
    """Earlier calibrations of devices and device types, such as those in a registry."""

    def prior(self, model: str, *, without: str | None = None) -> DevicePrior:
        """Return the prior from the units of a type, except the unit with one serial number."""

    def launches(self, serial: str) -> tuple[LaunchVariances, ...]:
        """Return the variances between the launches of a device."""


@contextmanager
def opened(place: str) -> Iterator[Knowledge]:
    """Open a registry by the entry point of its package. Raises InputError if none is installed."""
    from types import FunctionType

    from tumble.plugins import load

    found = load("knowledge", "registry", FunctionType)
    if found is None:
        raise InputError("--registry: expected a package with an entry point tumble.knowledge: registry, found none")
    with found(place) as knowledge:
        yield knowledge
