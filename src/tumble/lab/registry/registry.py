"""The registry: calibrations and acceptance limits of many devices, which are added and never changed.

A calibration is identified by the SHA-256 of its canonical JSON (sorted keys, no blanks), so that its record does not
depend on the layout or the name of the file. A log belongs to at most one record.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.documents import text_of_document
from tumble.errors import CalibrationError, InputError, needs_extra
from tumble.files import FilePath
from tumble.lab.conformity import Verdict, judge_check
from tumble.lab.limits import Occasion, months_later, parse_limits
from tumble.lab.registry.records import NOT_ACCEPTED, Due, LimitsRecord, Record, State
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_of, text_and_name
from tumble.result.further import recording_dates
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
    ...     trend = registry.trend("mems-1")
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
    """An open registry; see `open_registry`."""

    database: Database

    @property
    def name(self) -> str:
        """File of the registry, or its URL without the password."""
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
            Calibration or its file. If only its accelerometers or only its gyros are accepted, these are registered;
            one that is not accepted withdraws the device.
        performed
            When the device was calibrated; default: the date of the recording, or else of the file.
        occasion
            Check whose limits apply; default: "incoming" for the earliest calibration of a device, then "periodic".
        state
            Before an adjustment ("as-found"), after it ("as-left"), or without one.

        Returns
        -------
        Record
            The new record, or that of the same calibration.

        Raises
        ------
        InputError
            If the file is not a calibration, its date is missing or in the future, its device type differs
            from that of earlier records of the serial number, or its log belongs to another record.
        """
        from tumble.lab.registry.database import CALIBRATION

        text, name = text_and_name(calibration)
        part = _accepted_or_whole(calibration_of(text, name))
        accepted = part.outcome.accepted
        if accepted and not part.parameters:
            raise InputError(f"{name}: parameters: expected at least one, found none")
        performed = _performed(part, performed, name)
        canonical = json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(canonical.encode()).hexdigest()
        logs = {log for _, log in logs_of(part)} - {""}
        with self.database.writing() as rows:
            if same := rows.records(sha256=digest):
                return same[0]
            for record in rows.records(logs=logs):
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
            if occasion is None:
                occasion = "periodic" if any(record.performed <= performed for record in earlier) else "incoming"
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
                verdict=_verdict_word(part, limits, occasion),
                file=text,
            )
            rows.add_logs(number, logs if accepted else ())  # a better calibration of the log may follow
            # all records are read, so that nothing is added to a registry with a damaged one
            return next(record for record in rows.records() if record.number == number)

    def set_limits(self, model: str, file: FilePath) -> LimitsRecord:
        """Put the acceptance limits of a TOML file in force for a device type, unless they are already.

        Raises InputError for a file that is not one of limits."""
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
        """Return the records of a device, by default of all devices, in chronological order.

        Raises InputError for a device without records."""
        with self.database.reading() as rows:
            records = rows.records() if serial is None else rows.records(serial=serial)
        if serial is not None and not records:
            raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
        return sorted(records, key=lambda record: (record.performed, record.number))

    def record(self, number: int) -> Record:
        """Return the record with a number. Raises InputError if there is none."""
        with self.database.reading() as rows:
            records = rows.records(number=number)
        if not records:
            raise InputError(f"record {number}: expected a record of the registry, found none of this number")
        return records[0]

    def similar(self, record: Record) -> list[str]:
        """Return other serial numbers that differ from that of a record only by case, blanks, O for 0, or I for 1."""

        def canonical(serial: str) -> str:
            return "".join(serial.upper().split()).translate(str.maketrans("OI", "01"))

        others = {other.serial for other in self.records()} - {record.serial}
        return sorted(serial for serial in others if canonical(serial) == canonical(record.serial))

    def file(self, record: Record) -> str:
        """Return the text of the calibration file of a record, as it was added."""
        with self.database.reading() as rows:
            return rows.file(record.number)

    def calibration(self, record: Record, frame: str | None = None) -> Calibration:
        """Return the accepted part of the calibration of a record, or all of it if nothing is, in its own frame or
        another.

        Raises InputError if it cannot be converted to the frame."""
        calibration = _accepted_or_whole(calibration_of(self.file(record), f"record {record.number}"))
        try:
            return calibration if frame is None else calibration.in_frame(frame)
        except InputError as error:
            raise InputError(
                f"record {record.number}: is in the frame {record.frame!r} and cannot be compared in the frame "
                f"{frame!r}: {error}"
            ) from error

    def limits(self) -> list[LimitsRecord]:
        """Return the limits of all types, former ones included, in the order in which they were added."""
        with self.database.reading() as rows:
            return rows.limits()

    def verdict(self, record: Record) -> Verdict | None:
        """Judge a record by the limits that were in force when it was added; None without limits, or if it is not
        accepted."""
        limits = next((known.parsed() for known in self.limits() if known.number == record.limits), None)
        if limits is None or not record.accepted:
            return None
        return judge_check(self.calibration(record, limits.frame), limits, record.occasion)

    # -------------------- several calibrations --------------------

    def trend(self, serial: str) -> Trend:
        """Return the trend of the parameters of a device, against the limits that are in force now.

        Raises InputError for an unknown device or one without accepted calibrations, and if a record cannot be
        converted to the frame of the limits, or without limits to that of the latest record."""
        from tumble.lab.registry.trend import trend_of

        records = [record for record in self.records(serial) if record.accepted]
        if not records:
            raise InputError(f"device {serial!r}: expected an accepted calibration in the registry, found none")
        with self.database.reading() as rows:
            in_force = rows.limits_in_force(records[-1].model)
        limits = None if in_force is None else in_force.parsed()
        frame = records[-1].frame if limits is None else limits.frame
        return trend_of([(record, self.calibration(record, frame)) for record in records], limits)

    def due(self, on: date | None = None) -> list[Due]:
        """Return the due dates of all devices, evaluated on a day (today by default).

        Devices that failed their latest check come first, then the most urgent, those without an interval last."""
        on = datetime.now(UTC).date() if on is None else on
        in_force = {limits.model: limits.parsed() for limits in self.limits() if limits.in_force}
        by_serial = defaultdict[str, list[Record]](list)
        for record in self.records():
            by_serial[record.serial].append(record)
        items = []
        for serial, records in by_serial.items():
            latest, limits = records[-1], in_force.get(records[-1].model or "")
            months = None if limits is None else limits.device_interval_months.get(serial, limits.interval_months)
            day = None if months is None else months_later(latest.performed.date(), months)
            items.append(Due(record=latest, calibrations=len(records), on=on, months=months, day=day))
        return sorted(items, key=lambda item: (not item.withdrawn, item.day or date.max, item.record.serial))

    def launches(self, serial: str) -> tuple[LaunchVariances, ...]:
        """Return the variances between the launches of a device, for `check_calibration`.

        Consecutive calibrations of one launch each count as launches too, if they are by one method and the device was
        not adjusted between them. Calibrations that cannot be converted to the frame `accelerometer` are left out.

        Raises InputError if the device does not have two launches."""
        variances = list[LaunchVariances | None]()
        single = defaultdict[tuple[int, str], list[Calibration]](
            list
        )  # of one launch, by adjustments so far and method
        adjustments = 0
        for record in self.records(serial):
            adjustments += record.state == "as-left"
            for calibration in self._in_frame(record, "accelerometer"):
                variances.append(launch_variances(calibration))
                evidence = calibration.evidence
                if not (evidence.launches or evidence.together or calibration.provenance.prior):
                    single[adjustments, record.method].append(calibration)
        variances += map(variances_between, single.values())
        if not any(variances):
            raise InputError(f"device {serial!r}: expected several launches of one device in the registry, found none")
        return tuple(variance for variance in variances if variance is not None)

    def prior(self, model: str, *, without: str | None = None) -> DevicePrior:
        """Return the distribution of the units of a device type as a prior for `calibrate` and `plan`.

        The unit with the serial number `without` is left out. With fewer than three units the prior has no
        parameters."""
        from tumble.lab.device_type import prior_of

        return prior_of([unit for unit in self._units(model) if unit.serial != without], model)

    def datasheet(self, model: str) -> Datasheet:
        """Return the data sheet of a device type. Raises InputError for fewer than three units."""
        from tumble.lab.datasheet import datasheet_of

        return datasheet_of(self._units(model), model)

    def _units(self, model: str) -> list[Unit]:
        """Return the units of a type, each by its latest calibration without a prior by the type."""
        from tumble.lab.device_type import unit_of

        records = (record for record in self.records() if record.model == model)
        units = (unit_of(calibration) for record in records for calibration in self._in_frame(record, "accelerometer"))
        return list({unit.serial: unit for unit in units if unit is not None}.values())

    def _in_frame(self, record: Record, frame: str) -> Iterator[Calibration]:
        """Yield the calibration of a record in a frame, if it is accepted and can be converted."""
        if record.accepted:
            with suppress(InputError):
                yield self.calibration(record, frame)


def _accepted_or_whole(calibration: Calibration) -> Calibration:
    try:
        return accepted_part(calibration)
    except CalibrationError:
        return calibration


def _performed(calibration: Calibration, stated: datetime | None, name: str) -> datetime:
    """Return the date of a calibration: as stated, or of the recording, or of the file."""
    recorded = max((moment[:10] for moment in recording_dates(calibration)), default="")
    if stated is not None and f"{stated:%Y-%m-%d}" < recorded:
        found = f"the day of the recording, or later, found {stated:%Y-%m-%d}"
        raise InputError(f"{name}: --date: expected {recorded}, {found}; leave --date out or correct it")
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
    if stated > datetime.now(UTC) + timedelta(days=1):  # a day for time zones
        raise InputError(f"{name}: expected a date that is past, found {stated:%Y-%m-%d}; give --date")
    return stated


def logs_of(calibration: Calibration) -> list[tuple[str | None, str]]:
    """Return the sessions of a calibration (None if it has only one) with the SHA-256 of their logs."""
    single = (None, calibration.provenance.log_sha256 or "")
    return [(launch.session, launch.log_sha256) for launch in calibration.evidence.launches] or [single]


def _verdict_word(calibration: Calibration, limits: LimitsRecord | None, occasion: Occasion) -> str | None:
    """Return the verdict of a check as a word; None if it has no limits."""
    if not calibration.outcome.accepted:
        return NOT_ACCEPTED
    try:
        verdict = None if limits is None else judge_check(calibration, limits.parsed(), occasion)
    except InputError:
        return "other frame"
    return None if verdict is None else verdict.result
