"""The calibration of a device: `Calibration` with its methods for users, and its file."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from tumble.arguments import checked
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath, whole_file
from tumble.result.correction import corrected_readings
from tumble.result.file import calibration_of_text, check_replaceable, content_of, schema_of, text_of
from tumble.result.frames import calibration_in
from tumble.result.record import CalibrationData
from tumble.result.uncertainty_budget import BudgetLine, uncertainty_budget
from tumble.units import Array

if TYPE_CHECKING:
    import polars as pl

    from tumble.recording.arrays import Temperatures


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Calibration(CalibrationData):
    """Calibration of one device: a mapping from the names of its parameters to the parameters.

    Two calibrations are equal if their files are.

    Attributes
    ----------
    device : CalibratedDevice
        Serial number and type.
    method, frame : str
        Method of estimation, and frame of the parameters.
    parameters : tuple of Parameter
        Values with standard uncertainties, SI.
    covariance : ndarray, shape (m, m), or None
        In the order of the parameters.
    accel, gyro, mag : SensorModel or None
        Matrix and bias by kind of sensor; None if there are no such sensors or one of their parameters is
        unobservable. The magnetometer is in the frame "accelerometer" in every calibration, and in the unit of
        `mag.bias.x`.
    outcome : Outcome
        Whether the values may be used, and why not.
    groups : tuple of GroupFinding
        Findings on each group of parameters beyond the linear model.
    prediction : Prediction or None
        Standard uncertainties of corrected readings.
    axes : mapping of str to tuple
        Nominal sensing directions (n, 3) of "accel" and "gyro".
    temperature : CalibratedTemperature
        Reference temperatures and thermometers.
    evidence : Evidence
        Rests, turns, fits, budget and launches behind the parameters.
    provenance : Provenance
        Recording and software of its origin.
    """

    def __eq__(self, other: object) -> bool:
        """Return True if the calibration files of both are the same."""
        return self.content() == other.content() if isinstance(other, Calibration) else NotImplemented

    def __hash__(self) -> int:
        """Return the hash of device, method, frame, log and time of computing."""
        return hash((self.serial, self.method, self.frame, self.provenance.log_sha256, self.provenance.created))

    @property
    def headline(self) -> str:
        """Device, method, number of parameters and verdict in a line."""
        launches = self.evidence.launches
        several = f" of {len(launches)} launches" if launches else ""
        method = f"{self.method}{several}, {len(self.parameters)} parameters"
        return f"Calibration of {self.serial}: {method}, {self.outcome.verdict}"

    def __repr__(self) -> str:
        return f"<{self.headline}>"

    def _repr_html_(self) -> str:
        """Return the headline, the reasons and the table of parameters for a notebook."""
        return str(_views().as_html(self))

    def uncertainty_budget(self, name: str) -> tuple[BudgetLine, ...]:
        """Return the contributions to the u of a parameter by source, the largest first.

        Raises
        ------
        KeyError
            If there is no such parameter.
        CalibrationError
            If the calibration has no budget.
        """
        return uncertainty_budget(self, name)

    def table(self) -> str:
        """Return the table of the parameters as plain text, in the units of the field."""
        return str(_views().as_text(self))

    def to_polars(self) -> pl.DataFrame:
        """Return the parameters as a polars frame in SI, with the columns name, value, u, unit, deviation, run_to_run,
        k, dof, prior and learned."""
        import polars as pl

        columns = ("name", "value", "u", "unit", "deviation", "run_to_run", "k", "dof", "prior", "learned")
        schema = {name: pl.String if name in ("name", "unit") else pl.Float64 for name in columns}
        return pl.DataFrame({name: [getattr(p, name) for p in self.parameters] for name in schema}, schema=schema)

    @checked
    def apply(
        self,
        accel: npt.ArrayLike,
        gyro: npt.ArrayLike | None = None,
        *,
        dt: npt.ArrayLike | None = None,
        temperature: Temperatures | None = None,
    ) -> tuple[Array, Array | None]:
        """Correct readings by the whole model.

        Lever arms and delays, which need the motion, are not applied: see `apply_to_session`.

        Parameters
        ----------
        accel, gyro : array_like, shape (..., n)
            Readings in SI after nominal scale and offset, as arrays or frames; by least squares if n > 3.
        dt : array_like, shape (...), optional
            Intervals of the samples, s, if the readings are increments, m/s and rad.
        temperature : array_like, shape (...), or mapping of str to array_like, optional
            Temperature of the sensors, K, by default the reference temperature. In a stream it follows the thermometer
            with the lags `accel.lag` and `gyro.lag`. If the sensors have several thermometers, a mapping of "accel" and
            "gyro" to arrays (...) or (..., n).

        Returns
        -------
        force : ndarray, shape (..., 3)
            Specific force in the frame of the calibration, m/s², or its increments. Without accelerometers in the
            calibration it is NaN, and their uncorrected readings serve for the g-sensitivity of gyros.
        rate : ndarray, shape (..., 3), or None
            Angular rate, rad/s, or its increments; None without readings of gyros.

        Raises
        ------
        CalibrationError
            If neither accelerometers nor gyros were accepted; `compensator` corrects all the same.
        InputError
            If the number of sensors is another, numbers are not finite, intervals are not positive, columns of a frame
            are in another unit, or temperatures are not in kelvin.
        """
        return corrected_readings(self, accel, gyro, dt=dt, temperature=temperature)

    @checked
    def in_frame(self, frame: str) -> Calibration:
        """Convert the calibration of a triad to another frame.

        Covariance, iterations and launches are converted too; g-sensitivity and lever arms turn with the frame, a
        magnetometer keeps that of the accelerometers, and deviations from a systematic calibration are left out.

        Parameters
        ----------
        frame : {"accelerometer", "paper", "symmetric"}
            The frame. The frame `case` needs the session: see `calibrate`.

        Raises
        ------
        CalibrationError
            If a parameter of accelerometers or gyros is missing, or if there are more than three of them.
        """
        return calibration_in(self, frame)

    @checked
    def write(self, path: FilePath, *, force: bool = False) -> None:
        """Write the calibration file, whole or not at all.

        Parameters
        ----------
        path
            The file. An existing calibration file is replaced if it came from the same log by the same method, or if
            neither its accelerometers nor its gyros were accepted; any other kind of file is not.
        force
            Replace any calibration file.

        Raises
        ------
        CalibrationError
            If the file cannot be written or must not be replaced.
        """
        path = Path(path)
        if path.exists():
            check_replaceable(self, path, force=force)
        try:
            text = self.text()
        except ValueError:
            raise CalibrationError(
                f"{self.serial}: expected an estimate in numbers, found one beyond measure: the recording "
                "contradicts itself; look for a stretch of it in another unit, and leave it out with [[exclude]]"
            ) from None
        try:
            with whole_file(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CalibrationError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error

    def text(self) -> str:
        """Return the text of the calibration file."""
        return json.dumps(self.content(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def content(self) -> dict[str, Any]:
        """Return the content of the calibration file in the types of JSON."""
        return content_of(self)


@checked
def read_calibration(path: FilePath) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path
        The file, as `Calibration.write` writes it.

    Raises
    ------
    CalibrationError
        If the file is not a calibration file.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.read_calibration("calibration.json")
    <Calibration of mems-1: joint, 51 parameters, accepted>
    """
    return calibration_of(text_of(Path(path)), str(path))


def calibration_from(given: Calibration | FilePath) -> Calibration:
    """Return a calibration unchanged, or that of a file. Raises InputError for anything else."""
    return given if isinstance(given, Calibration) else calibration_of(*text_and_name(given))


def text_and_name(given: Calibration | FilePath) -> tuple[str, str]:
    """Return the text of the file of a calibration, and its name for messages. Raises InputError for anything else."""
    if isinstance(given, Calibration):
        return given.text(), f"calibration of {given.serial}"
    if not isinstance(given, str | os.PathLike):
        raise InputError(
            f"calibration: expected a Calibration or the path of a calibration file, found {type(given).__name__}"
        )
    return text_of(Path(given)), str(given)


def _views() -> Any:
    return import_module("tumble.views.calibration")


def calibration_of(text: str, name: str) -> Calibration:
    """Return the calibration from the text of a file, named `name` in messages."""
    return calibration_of_text(Calibration, text, name)


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a calibration file."""
    return schema_of(Calibration)
