"""A calibration into the parameters of an autopilot over MAVLink, PX4 or ArduPilot, as `tumble export` writes them.

Nothing is written before all of this holds: the autopilot answers and is disarmed, it has every parameter, and where
the calibration knows the device ids of its sensors they are the autopilot's. The values it has are then in a backup
file, which its ground station loads. Each value is set, and read back as single precision keeps it; those that switch
a curve on are the last. A set that cannot be finished is taken back, and where that fails too, every parameter that may
have a new value is named.

Parameters are numbers of single precision; whole numbers are sent by their bits to PX4, and as such a number to
ArduPilot (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE and _C_CAST).

Source: MAVLink, "Parameter protocol"; message definitions PARAM_REQUEST_READ, PARAM_SET, PARAM_VALUE, HEARTBEAT.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.errors import InputError, needs_extra
from tumble.export import export_calibration
from tumble.export.autopilots import PILOTS, parameter_lines
from tumble.files import FilePath
from tumble.result.calibration import Calibration, calibration_from

AUTOPILOTS = {12: "px4", 3: "ardupilot"}
"""By MAV_AUTOPILOT of a heartbeat: the formats of `tumble export`."""
ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED of base_mode."""
REAL, INTEGERS = 9, (1, 2, 3, 4, 5, 6)
"""MAV_PARAM_TYPE of single precision, and of whole numbers of 8 to 32 bits."""
_BACKUP = "# values before an upload of tumble; load this file to have them back"
TRIES = 12
"""Of a request that is not answered, each for `patience` seconds."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterChange:
    """A parameter with its value before and after, as the autopilot keeps them."""

    name: str
    before: float
    after: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Upload:
    """What an upload did, or would do: the autopilot by its format, the changes, the backup, None of a dry run, and in
    sentences what the autopilot has no place for."""

    autopilot: str
    changes: tuple[ParameterChange, ...]
    backup: Path | None
    losses: tuple[str, ...]


def upload(
    calibration: Calibration | FilePath,
    link: str,
    *,
    backup: FilePath,
    thermal: bool = False,
    imu: int | None = None,
    magnetometer: bool = False,
    dry_run: bool = False,
    progress: Callable[[ParameterChange], None] = lambda _: None,
    patience: float = 0.5,
) -> Upload:
    """Write a calibration into an autopilot.

    Parameters
    ----------
    calibration
        A calibration or its file, accepted.
    link
        ``udp:[HOST:]PORT`` to listen on, ``tcp:HOST:PORT``, or ``serial:DEVICE:BAUD``.
    backup
        A new file for the values before, in the format that the autopilot's ground station loads.
    thermal
        Curves over temperature too.
    imu
        The number of the IMU, from 1, where the calibration does not know it.
    magnetometer
        Its parameters too, as those of the autopilot's first one: no calibration knows which one that is.
    dry_run
        Compare, and write nothing.
    progress
        Called with every change that was made.
    patience
        Seconds to wait for an answer; a request is sent TRIES times.

    Raises
    ------
    InputError
        Before anything is written: no autopilot answers, it is armed, lacks a parameter, or has other sensors; and
        after a set that could not be finished, saying which values it has.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> made = tumble.calibrate(folder)
    >>> tumble.upload(made, "udp:14999", backup="before.params", patience=0.01)
    Traceback (most recent call last):
    tumble.errors.InputError: udp:14999: expected the heartbeat of PX4 or ArduPilot, found none; is it connected?
    """
    calibration, path = calibration_from(calibration), Path(backup)
    if path.exists():
        raise InputError(f"{path}: expected a new file for the backup, found one that exists; name another")
    with _Link(link, patience) as pilot:
        target = AUTOPILOTS[pilot.kind] + ("-thermal" if thermal else "")
        exported = export_calibration(calibration, target, imu=imu)
        parameters = [p for p in exported.parameters if magnetometer or not p.magnetometer]
        losses = exported.losses
        if len(parameters) < len(exported.parameters):
            losses += ("the magnetometer was left as it is: --magnetometer writes it, as the autopilot's first",)
        wanted = {p.name: p.value if p.whole else float(np.float32(p.value)) for p in parameters}
        before = {name: pilot.read(name) for name in wanted}
        missing = [name for name, value in before.items() if value is None]
        if missing:
            raise InputError(
                f"{link}: expected the parameters of {target}, found no answer for {', '.join(missing[:5])}"
                f"{' and others' if len(missing) > 5 else ''}; is it another release, or is the link too bad?"
            )
        there = {name: value for name, value in before.items() if value is not None}
        for p in parameters:
            if p.identity and there[p.name] != p.value:
                raise InputError(
                    f"{link}: expected the sensors that were calibrated, {p.name} {p.value:.0f}, found "
                    f"{there[p.name]:.0f}; connect that device, or calibrate this one"
                )
        order = sorted(wanted, key=lambda name: name.endswith("ENABLE"))
        changes = tuple(ParameterChange(name=name, before=there[name], after=wanted[name]) for name in order)
        if not dry_run:
            kept = [replace(p, value=there[p.name]) for p in parameters]
            lines = parameter_lines(PILOTS[AUTOPILOTS[pilot.kind]], kept)
            with path.open("x", encoding="utf-8") as file:
                file.writelines(f"{line}\n" for line in (_BACKUP, *lines))
            _write(pilot, [c for c in changes if c.before != c.after], path, progress)
    return Upload(autopilot=target, changes=changes, backup=None if dry_run else path, losses=losses)


def _write(
    pilot: _Link, changes: Sequence[ParameterChange], backup: Path, progress: Callable[[ParameterChange], None]
) -> None:
    """Set all of them, or none."""
    begun: list[ParameterChange] = []
    try:
        for change in changes:
            begun.append(change)
            pilot.write(change.name, change.after)
            progress(change)
        for change in changes:
            found = pilot.read(change.name)
            if found != change.after:
                raise InputError(f"{pilot.name}: expected {change.name} {change.after:.9g}, found {found}")
    except BaseException as error:
        new = []
        for change in reversed(begun):
            try:
                pilot.write(change.name, change.before, even_if_armed=True)
            except (InputError, OSError):
                new.append(change.name)
                pilot.tries = 1  # the link is bad, or gone: the others are asked for once
        reason = str(error) or type(error).__name__
        if not isinstance(error, (InputError, OSError, KeyboardInterrupt)):
            raise
        if new:
            raise InputError(
                f"{reason}; these may have new values: {', '.join(reversed(new))}; load {backup} before you fly"
            ) from error
        raise InputError(f"{reason}; all values are as they were before") from error


class _Link:
    """The parameters of one autopilot at the other end of a link, read and written one by one."""

    def __init__(self, where: str, patience: float) -> None:
        with needs_extra("MAVLink", "bench", "pymavlink"):
            from pymavlink import mavutil
        self.name, self.patience, self.tries = where, patience, TRIES
        kind, _, rest = where.partition(":")
        options: dict[str, int] = {}
        try:
            match kind, *rest.rsplit(":", 1):
                case "udp", port:
                    address = f"udpin:127.0.0.1:{int(port)}"
                case "udp", host, port:
                    address = f"udpin:{host}:{int(port)}"
                case "tcp", host, port:
                    address = f"tcp:{host}:{int(port)}"
                case "serial", device, baud:
                    address, options = device, {"baud": int(baud)}
                case _:
                    raise ValueError("no such link")
            self._link: Any = mavutil.mavlink_connection(address, source_system=254, autoreconnect=False, **options)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--mavlink {where}: expected udp:[HOST:]PORT, tcp:HOST:PORT or serial:DEVICE:BAUD: {error}"
            ) from None
        self.armed = False
        self.kind = 0
        self._types: dict[str, int] = {}
        deadline = time.monotonic() + TRIES * patience
        while self.kind not in AUTOPILOTS:
            if time.monotonic() > deadline:
                self._link.close()
                found = "none" if self.kind == 0 else f"MAV_AUTOPILOT {self.kind}"
                raise InputError(
                    f"{where}: expected the heartbeat of PX4 or ArduPilot, found {found}; is it connected?"
                )
            self._hear(("HEARTBEAT",), patience)
        if self.armed:
            self._link.close()
            raise InputError(f"{where}: expected a disarmed autopilot, found it armed; disarm it")

    def __enter__(self) -> _Link:
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()

    def _hear(self, kinds: Sequence[str], seconds: float) -> Any:
        """The next message of some kinds from the autopilot; its heartbeats are noted on the way."""
        message = self._link.recv_match(type=list({*kinds, "HEARTBEAT"}), blocking=True, timeout=seconds)
        if message is not None and message.get_type() == "HEARTBEAT" and message.autopilot != 8:  # 8: no autopilot
            self.kind, self.armed = message.autopilot, bool(message.base_mode & ARMED)
            self._link.target_system, self._link.target_component = message.get_srcSystem(), message.get_srcComponent()
        return message

    def _asked(self, name: str, ask: Callable[[], None], answers: Callable[[float], bool]) -> float | None:
        """The value that the autopilot says of a parameter, asked until it is an answer, at most `tries` times."""
        said = None
        for _ in range(self.tries):
            ask()
            deadline = time.monotonic() + self.patience
            while (left := deadline - time.monotonic()) > 0.0:
                message = self._hear(("PARAM_VALUE",), left)
                if message is None or message.get_type() != "PARAM_VALUE" or message.param_id != name:
                    continue
                self._types[name] = message.param_type
                as_bits = message.param_type in INTEGERS and AUTOPILOTS[self.kind] == "px4"
                said = _bits("f", "i", message.param_value) if as_bits else float(np.float32(message.param_value))
                if answers(said):
                    return said
        return said

    def read(self, name: str) -> float | None:
        """The value of a parameter, None where it has none of that name."""
        send, to = self._link.mav.param_request_read_send, self._link
        return self._asked(name, lambda: send(to.target_system, to.target_component, name.encode(), -1), lambda _: True)

    def write(self, name: str, value: float, *, even_if_armed: bool = False) -> None:
        """Set a parameter that was read. Raises InputError where it does not come to have that value."""
        if self.armed and not even_if_armed:
            raise InputError(f"{self.name}: expected it to stay disarmed, found it armed before {name}")
        send, to, kind = self._link.mav.param_set_send, self._link, self._types[name]
        sent = _bits("i", "f", int(value)) if kind in INTEGERS and AUTOPILOTS[self.kind] == "px4" else value
        found = self._asked(
            name,
            lambda: send(to.target_system, to.target_component, name.encode(), sent, kind),
            lambda said: said == value,
        )
        if found != value:
            said = "no answer" if found is None else f"{found:.9g}"
            raise InputError(f"{self.name}: expected {name} to become {value:.9g}, found {said}")


def _bits(of: str, to: str, value: float) -> float:
    """The number of another type of 32 bits that has the same bits, "f" a real and "i" a whole one."""
    return float(struct.unpack(f"<{to}", struct.pack(f"<{of}", value))[0])
