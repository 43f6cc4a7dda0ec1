"""The registry: calibrations and limits of many devices, added and never changed, and what they say together.

A calibration file is known by its content: the SHA-256 of its JSON with sorted keys and without blanks. The same
calibration is the same record however its file is laid out or called. A log stands behind one record alone.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.documents import text_of_document
from tumble.errors import InputError, needs_extra
from tumble.files import FilePath
from tumble.lab.conformity import Verdict, verdict_at
from tumble.lab.limits import Limits, Occasion, parse_limits
from tumble.lab.registry.records import Due, LimitsRecord, Record, State
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_of, text_and_name
from tumble.result.launch_variances import LaunchVariances, launch_variances, variances_between

if TYPE_CHECKING:
    from tumble.inference.prior import DevicePrior
    from tumble.lab.datasheet import Datasheet
    from tumble.lab.device_type import Unit
    from tumble.lab.registry.database import Database
    from tumble.lab.registry.trend import Trend


@contextmanager
def open_registry(place: FilePath, *, create: bool = False) -> Iterator[Registry]:
    """Open a registry, in a `with`.

    Parameters
    ----------
    place
        An SQLite file, or the URL of a PostgreSQL database.
    create
        Whether to make a registry that does not exist.

    Raises
    ------
    InputError
        For no such registry, the database of another program, or a server that does not answer.
    MissingExtraError
        Without the extra `lab`.

    Examples
    --------
    >>> import tumble
    >>> from tumble.lab import open_registry
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> with open_registry("registry.sqlite", create=True) as registry:
    ...     record = registry.add_calibration(tumble.calibrate(folder))
    ...     trend = registry.trend("mems-1", "accel.bias.x")
    >>> record.number, record.occasion, len(trend.parameters[0].points)
    (1, 'incoming', 1)
    """
    with needs_extra("the registry", "lab", "psycopg", "sqlalchemy"):
        from tumble.lab.registry.database import connected

        database = connected(os.fspath(place), create)
    try:
        yield Registry(database=database)
    finally:
        database.engine.dispose()


@dataclass(frozen=True, kw_only=True, slots=True)
class Registry:
    """An open registry, as `open_registry` gives it."""

    database: Database

    @property
    def name(self) -> str:
        """What messages call it: its file, or its URL without the password."""
        return self.database.name

    # -------------------- adding --------------------

    def add_calibration(
        self,
        calibration: Calibration | FilePath,
        *,
        performed: datetime | None = None,
        occasion: Occasion | None = None,
        state: State = "unchanged",
    ) -> Record:
        """Add a calibration, or that of a file, and judge it by the limits in force.

        Parameters
        ----------
        calibration
            Where the accelerometers or the gyros alone are accepted, these are registered.
        performed
            When the device was calibrated; default: when it was recorded, or else when the file was made.
        occasion
            At which check; default: "incoming" for the first record of a device, then "periodic".
        state
            Before an adjustment ("as-found"), after it ("as-left"), or without one.

        Returns
        -------
        Record
            The new record, or that of the same calibration.

        Raises
        ------
        InputError
            One line: no calibration file, one that was not accepted, a date that is missing or in the future, another
            type for a known serial number, a log that another record stands on.
        """
        from tumble.lab.registry.database import CALIBRATION

        text, name = text_and_name(calibration)
        part = accepted_part(calibration_of(text, name), name)
        if not part.parameters:
            raise InputError(f"{name}: parameters: expected at least one, found none")
        performed = _performed(part, performed, name)
        canonical = json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(canonical.encode()).hexdigest()
        logs = {log for _, log in logs_of(part)} - {""}
        with self.database.writing() as rows:
            if same := rows.records(sha256=digest):
                return same[0]
            for record in rows.records(of_logs=logs):
                raise InputError(
                    f"{name}: expected a log that is not in the registry, found that of record {record.number} "
                    f"({record.serial}, {record.method})"
                )
            earlier = rows.records(serial=part.serial)
            model = part.model or next((r.model for r in earlier if r.model is not None), None)
            for record in earlier:
                if record.model not in (None, model):
                    raise InputError(
                        f"{name}: device.model: expected {record.model!r}, as device {part.serial} has it in record "
                        f"{record.number}, found {model!r}; serial numbers must be unique"
                    )
            occasion = occasion or ("periodic" if earlier else "incoming")
            limits = rows.limits_in_force(model)
            number = rows.add(
                CALIBRATION,
                sha256=digest,
                serial=part.serial,
                model=model,
                method=part.method,
                frame=part.frame,
                performed=performed,
                occasion=occasion,
                state=state,
                limits=None if limits is None else limits.number,
                verdict=None if limits is None else _in_a_word(part, limits.parsed(), occasion),
                file=text,
            )
            rows.add_logs(number, logs)
            return rows.records(number=number)[0]

    def set_limits(self, model: str, file: FilePath) -> LimitsRecord:
        """Put the acceptance limits of a file (TOML) in force for a device type, unless they are in force already.

        Raises InputError, one line, for a file that cannot be used."""
        from tumble.lab.registry.database import LIMITS

        text = text_of_document(Path(file))
        parse_limits(text, str(file))
        with self.database.writing() as rows:
            in_force = rows.limits_in_force(model)
            if in_force is None or in_force.file != text:
                rows.add(LIMITS, model=model, file=text)
                in_force = rows.limits()[-1]
            return in_force

    # -------------------- reading --------------------

    def records(self, serial: str | None = None) -> list[Record]:
        """The records of a device, by default of all devices, in the order in which they were performed. Raises
        InputError for a device without records."""
        with self.database.reading() as rows:
            records = rows.records() if serial is None else rows.records(serial=serial)
        if serial is not None and not records:
            raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
        return sorted(records, key=lambda record: (record.performed, record.number))

    def record(self, number: int) -> Record:
        """The record of a number. Raises InputError where there is none."""
        with self.database.reading() as rows:
            records = rows.records(number=number)
        if not records:
            raise InputError(f"record {number}: expected a record of the registry, found none of this number")
        return records[0]

    def file(self, record: Record) -> str:
        """The text of the calibration file of a record, as it was added."""
        with self.database.reading() as rows:
            return rows.file(record.number)

    def calibration(self, record: Record, frame: str | None = None) -> Calibration:
        """The accepted part of the calibration of a record, in its own frame or another. Raises InputError where it
        cannot be converted."""
        calibration = accepted_part(calibration_of(self.file(record), f"record {record.number}"))
        try:
            return calibration if frame is None else calibration.in_frame(frame)
        except InputError as error:
            raise InputError(
                f"record {record.number}: is in the frame {record.frame!r} and cannot be compared in the frame "
                f"{frame!r}: {error}"
            ) from error

    def limits(self) -> list[LimitsRecord]:
        """The limits of all types, former ones too, in the order in which they were added."""
        with self.database.reading() as rows:
            return rows.limits()

    def verdict(self, record: Record) -> Verdict | None:
        """The verdict on a record by the limits that were in force when it was added; None without any."""
        limits = next((each.parsed() for each in self.limits() if each.number == record.limits), None)
        if limits is None:
            return None
        return verdict_at(self.calibration(record, limits.frame), limits, record.occasion)

    # -------------------- what calibrations say together --------------------

    def trend(self, serial: str, parameter: str | None = None) -> Trend:
        """The parameters of a device over its calibrations, or one of them, against the limits in force now.

        Raises
        ------
        InputError
            For an unknown device or parameter, and for a record that cannot be taken to the frame of the limits, or of
            the latest record where there are none.
        """
        from tumble.lab.registry.trend import trend_of

        records = self.records(serial)
        with self.database.reading() as rows:
            in_force = rows.limits_in_force(records[-1].model)
        limits = None if in_force is None else in_force.parsed()
        frame = records[-1].frame if limits is None else limits.frame
        trend = trend_of([(record, self.calibration(record, frame)) for record in records], limits)
        return trend if parameter is None else trend.of(parameter)

    def due(self, on: date | None = None) -> list[Due]:
        """When every device is to be calibrated again, as on a day, by default today: devices that failed their latest
        check first, then the most urgent; those without an interval last."""
        on = datetime.now(UTC).date() if on is None else on
        in_force = {each.model: each.parsed() for each in self.limits() if each.in_force}
        of_devices = defaultdict[str, list[Record]](list)
        for record in self.records():
            of_devices[record.serial].append(record)
        items = []
        for serial, records in of_devices.items():
            latest, limits = records[-1], in_force.get(records[-1].model or "")
            months = None if limits is None else limits.interval(serial)
            day = None if limits is None else limits.due(serial, latest.performed.date())
            items.append(Due(record=latest, calibrations=len(records), on=on, months=months, day=day))
        return sorted(items, key=lambda item: (not item.withdrawn, item.day or date.max, item.record.serial))

    def launches(
        self, *, serial: str | None = None, model: str | None = None, frame: str = "accelerometer"
    ) -> tuple[LaunchVariances, ...]:
        """The launches behind the calibrations of a device, or of a type of devices, with variances in a `frame`, for
        `check_calibration` and `calibrate_launches`; calibrations that cannot be taken to the frame are left out.

        Calibrations of one launch each are launches of their device, too, if they are by one method and it was not
        adjusted between them. Raises InputError if no device has two launches."""
        variances = list[LaunchVariances | None]()
        single = defaultdict[tuple[str, int, str], list[Calibration]](list)
        adjusted = Counter[str]()
        for record in self.records(serial):
            adjusted[record.serial] += record.state == "as-left"
            if serial is not None or record.model == model:
                for calibration in self._in_frame(record, frame):
                    variances.append(launch_variances(calibration))
                    evidence = calibration.evidence
                    if not (evidence.launches or evidence.together or calibration.provenance.prior):
                        single[record.serial, adjusted[record.serial], record.method].append(calibration)
        variances += map(variances_between, single.values())
        if not any(variances):
            which = f"type {model!r}" if serial is None else f"device {serial!r}"
            raise InputError(f"{which}: expected several launches of one device in the registry, found none")
        return tuple(each for each in variances if each is not None)

    def prior(self, model: str, *, without: str | None = None) -> DevicePrior:
        """What the units of a type are like but for one, by its serial number, as a prior for `calibrate` and `plan`;
        without parameters if there are fewer than three units."""
        from tumble.lab.device_type import prior_of

        return prior_of([unit for unit in self._units(model) if unit.serial != without], model)

    def datasheet(self, model: str) -> Datasheet:
        """What the units of a type are like, parameter by parameter. Raises InputError for fewer than three units."""
        from tumble.lab.datasheet import datasheet_of

        return datasheet_of(self._units(model), model)

    def _units(self, model: str) -> list[Unit]:
        """The units of a type, each by the latest of its calibrations that say anything by themselves."""
        from tumble.lab.device_type import unit_of

        records = (record for record in self.records() if record.model == model)
        units = (unit_of(each) for record in records for each in self._in_frame(record, "accelerometer"))
        return list({unit.serial: unit for unit in units if unit is not None}.values())

    def _in_frame(self, record: Record, frame: str) -> Iterator[Calibration]:
        """The calibration of a record, if it can be taken to a frame."""
        with suppress(InputError):
            yield self.calibration(record, frame)


def _performed(calibration: Calibration, stated: datetime | None, name: str) -> datetime:
    """When a device was calibrated: as stated, or when it was recorded, or when the file was made."""
    if stated is None:
        place, text = "session.date", calibration.provenance.circumstances.date
        if text is None:
            place, text = "provenance.created", calibration.provenance.created
        if text is None:
            raise InputError(f"{name}: provenance.created: expected a time, found none; give --date")
        try:
            stated = datetime.fromisoformat(text)
            stated = stated.replace(tzinfo=UTC) if stated.tzinfo is None else stated.astimezone(UTC)
        except (ValueError, OverflowError):
            raise InputError(f"{name}: {place}: expected a date such as 2026-03-31, found {text!r}") from None
    if stated > datetime.now(UTC) + timedelta(days=1):  # a day is left to time zones
        raise InputError(f"{name}: expected a date that is past, found {stated:%Y-%m-%d}; give --date")
    return stated


def logs_of(calibration: Calibration) -> list[tuple[str | None, str]]:
    """The sessions behind a calibration, by name where there are several, with the SHA-256 of their logs."""
    one = (None, calibration.provenance.log_sha256 or "")
    return [(launch.session, launch.log_sha256) for launch in calibration.evidence.launches] or [one]


def _in_a_word(calibration: Calibration, limits: Limits, occasion: Occasion) -> str | None:
    """The verdict in a word; None where the limits have none for such a check."""
    try:
        verdict = verdict_at(calibration, limits, occasion)
    except InputError:
        return "other frame"
    return None if verdict is None else verdict.result
