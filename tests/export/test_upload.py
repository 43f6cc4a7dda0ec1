"""Parameters written into simulated autopilots over MAVLink: pymavlink at both ends, datagrams lost on the way."""

from __future__ import annotations

import random
import re
import socket
import struct
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import calibration, of_device, warmed
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.export.upload import ParameterChange, upload
from tumble.recording.session import AutopilotSensor
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.model import SensorModel

mavutil = pytest.importorskip("pymavlink.mavutil")
PX4, ARDUPILOT = 12, 3
PATIENCE = 0.1
IDS = {"accel": AutopilotSensor(number=1, id=1310988), "gyro": AutopilotSensor(number=1, id=1310992)}


def single(value: float) -> float:
    return float(np.float32(value))


class Peer:
    """An autopilot with parameters, whose datagrams are lost with a probability, and which `hears` each PARAM_SET
    before it obeys: what that returns is what it keeps, None being nothing at all."""

    def __init__(
        self, kind: int, values: dict[str, float], *, lost: float = 0.0, armed: bool = False, seed: int = 1
    ) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.kind, self.values, self.armed, self.lost = kind, dict(values), armed, lost
        self.hears: Callable[[str, float], float | None] = lambda _, value: value
        self.alive = True
        self._random, self._stopped = random.Random(seed), threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Peer:
        self._link: Any = mavutil.mavlink_connection(f"udpout:127.0.0.1:{self.port}", source_system=1)
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._stopped.set()
        self._thread.join()
        self._link.close()

    def _run(self) -> None:
        beat = 0.0
        while not self._stopped.is_set():
            if time.monotonic() > beat:
                self._link.mav.heartbeat_send(2, self.kind, 128 if self.armed else 0, 0, 4)
                beat = time.monotonic() + 0.02
            message = self._link.recv_match(type=["PARAM_SET", "PARAM_REQUEST_READ"], blocking=True, timeout=0.005)
            if message is None or not self.alive or self._random.random() < self.lost:
                continue
            name = message.param_id
            if name not in self.values:
                continue
            whole = name.endswith(("_ID", "ENABLE"))
            if message.get_type() == "PARAM_SET":
                given = message.param_value
                if whole and self.kind == PX4:
                    given = struct.unpack("<i", struct.pack("<f", given))[0]
                kept = self.hears(name, given)
                if kept is not None:
                    self.values[name] = kept
            if self._random.random() < self.lost or not self.alive:
                continue
            value = self.values[name]
            if whole and self.kind == PX4:
                value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
            kind = 6 if whole else 9
            self._link.mav.param_value_send(name.encode(), value, kind, len(self.values), 0)


def wanted(made: Calibration, target: str) -> dict[str, float]:
    """The parameters of an export, by the lines of its file."""
    text = export_calibration(made, target).content.decode()
    pattern = r"^(?:1\t1\t)?([A-Z0-9_]+)[\t,]([-0-9.e]+)"
    return {name: single(float(value)) for name, value in re.findall(pattern, text, re.MULTILINE)}


def before(values: dict[str, float]) -> dict[str, float]:
    """Another value of each that is not an id."""
    return {name: value if name.endswith("_ID") else single(value + 0.25) for name, value in values.items()}


CASES = [
    (PX4, "px4", False),
    (ARDUPILOT, "ardupilot", False),
    (PX4, "px4-thermal", True),
    (ARDUPILOT, "ardupilot-thermal", True),
]


def made_for(thermal: bool) -> Calibration:
    made = of_device(calibration(), imu=IDS)
    return warmed(made) if thermal else made


@pytest.mark.parametrize(("kind", "target", "thermal"), CASES)
@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_what_the_autopilot_has_is_what_the_export_says(
    kind: int, target: str, thermal: bool, lost: float, tmp_path: Path
) -> None:
    made = made_for(thermal)
    values = wanted(made, target)
    others = {"SYS_AUTOSTART": 4001.0}
    there = before(values) | {name: 0.0 for name in values if name.endswith("ENABLE")}
    with Peer(kind, there | others, lost=lost) as peer:
        done = upload(made, f"udp:{peer.port}", thermal=thermal, backup=tmp_path / "before.params", patience=PATIENCE)
        assert peer.values == values | others
    assert done.autopilot == target
    assert {c.name: c.after for c in done.changes} == values
    assert {c.name: c.before for c in done.changes} == there
    kept = (tmp_path / "before.params").read_text()
    pattern = r"^(?:1\t1\t)?([A-Z0-9_]+)[\t,]([-0-9.e]+)"
    assert {n: single(float(v)) for n, v in re.findall(pattern, kept, re.MULTILINE)} == there


def test_a_dry_run_writes_nothing(tmp_path: Path) -> None:
    made = made_for(thermal=False)
    there = before(wanted(made, "px4"))
    with Peer(PX4, there) as peer:
        done = upload(made, f"udp:{peer.port}", backup=tmp_path / "b.params", dry_run=True, patience=PATIENCE)
        assert peer.values == there
    assert any(c.before != c.after for c in done.changes)
    assert done.backup is None
    assert not (tmp_path / "b.params").exists()


@pytest.mark.parametrize(
    ("change", "armed", "words"),
    [
        ({"CAL_ACC0_ID": 17.0}, False, "expected the sensors that were calibrated, CAL_ACC0_ID 1310988, found 17"),
        ({}, True, "expected a disarmed autopilot, found it armed"),
        ({"CAL_GYRO0_YOFF": None}, False, "found no answer for CAL_GYRO0_YOFF"),
    ],
)
def test_it_is_refused_before_anything_is_written(
    change: dict[str, float | None], armed: bool, words: str, tmp_path: Path
) -> None:
    made = made_for(thermal=False)
    given = before(wanted(made, "px4")) | change
    there = {name: value for name, value in given.items() if value is not None}
    with Peer(PX4, there, armed=armed) as peer:
        with pytest.raises(InputError, match=re.escape(words)):
            upload(made, f"udp:{peer.port}", backup=tmp_path / "b.params", patience=PATIENCE / 2)
        assert peer.values == there
    assert not (tmp_path / "b.params").exists()


def test_no_autopilot_and_no_such_link_are_said(tmp_path: Path) -> None:
    made = made_for(thermal=False)
    with pytest.raises(InputError, match="expected the heartbeat of PX4 or ArduPilot, found none"):
        upload(made, "udp:127.0.0.1:0", backup=tmp_path / "b", patience=0.01)
    with pytest.raises(InputError, match="expected udp:"):
        upload(made, "carrier-pigeon", backup=tmp_path / "b")
    (tmp_path / "b").touch()
    with pytest.raises(InputError, match="expected a new file for the backup"):
        upload(made, "udp:14550", backup=tmp_path / "b")


def test_a_refused_write_is_taken_back_whole(tmp_path: Path) -> None:
    made = made_for(thermal=False)
    there = before(wanted(made, "ardupilot"))
    with Peer(ARDUPILOT, there) as peer:
        peer.hears = lambda name, value: None if name == "INS_GYROFFS_Y" else value
        with pytest.raises(
            InputError, match=r"expected INS_GYROFFS_Y to become .*; all values are as they were before"
        ):
            upload(made, f"udp:{peer.port}", backup=tmp_path / "b.parm", patience=PATIENCE / 2)
        assert peer.values == there


def test_arming_on_the_way_ends_it_and_is_taken_back(tmp_path: Path) -> None:
    made = made_for(thermal=False)
    there = before(wanted(made, "px4"))
    with Peer(PX4, there) as peer:

        def armed_after_three(change: ParameterChange) -> None:
            if change.name == "CAL_ACC0_ZOFF":
                peer.armed = True
                time.sleep(3 * 0.02)

        with pytest.raises(InputError, match="expected it to stay disarmed, found it armed before"):
            upload(made, f"udp:{peer.port}", backup=tmp_path / "b", progress=armed_after_three, patience=PATIENCE)
        assert peer.values == there


def interrupted(moment: int, folder: Path) -> None:
    """By Ctrl-C, or a link that ends for good or for a while, at some moment: either all values are as before, or those
    that may be new are named; and the backup is there."""
    made = made_for(thermal=False)
    values = wanted(made, "px4")
    there = before(values)
    rng = random.Random(moment)
    after, how = rng.randrange(1, 1 + sum(there[n] != values[n] for n in there)), moment % 3
    with Peer(PX4, there, lost=0.05, seed=moment) as peer:
        heard = 0

        def counted(_: str, value: float) -> float | None:
            nonlocal heard
            heard += 1
            if heard == after and how:
                peer.alive = False
                if how == 2:
                    threading.Timer(14 * PATIENCE / 2, lambda: setattr(peer, "alive", True)).start()
            return value

        def stopped(_: ParameterChange) -> None:
            if how == 0 and heard >= after:
                raise KeyboardInterrupt

        peer.hears = counted
        backup = folder / f"{moment}.params"
        said = ""
        try:
            upload(made, f"udp:{peer.port}", backup=backup, progress=stopped, patience=PATIENCE / 2)
        except InputError as error:
            said = str(error)
        assert backup.exists()
        changed = {name for name in there if peer.values[name] != there[name]}
        if not said:  # the link was there again before the upload gave it up
            assert how == 2
            assert peer.values == values
        elif "all values are as they were before" in said:
            assert not changed
        else:
            named = said.partition("may have new values: ")[2].partition(";")[0].split(", ")
            assert changed <= set(named)
            assert str(backup) in said


def test_an_interruption_leaves_nothing_half_written_unsaid(tmp_path: Path) -> None:
    """At fifty moments, eight at a time: what they wait for is time-outs."""
    with ThreadPoolExecutor(8) as pool:
        for _ in pool.map(lambda moment: interrupted(moment, tmp_path), range(50)):
            pass


def test_the_command_shows_each_parameter_and_keeps_the_values_before(tmp_path: Path) -> None:
    made = made_for(thermal=False)
    file = tmp_path / "calibration.json"
    made.write(file)
    values = wanted(made, "px4")
    with Peer(PX4, before(values)) as peer:
        done = CliRunner().invoke(main, ["upload", str(file), "--mavlink", f"udp:{peer.port}"])
        assert done.exit_code == 0, done.output
        assert peer.values == values
    assert f"CAL_ACC0_XOFF\t{before(values)['CAL_ACC0_XOFF']:.9g}\t{values['CAL_ACC0_XOFF']:.9g}" in done.stdout
    assert "9 of 11 parameters changed and read back" in done.stderr
    assert (tmp_path / "calibration.before.params").exists()


@pytest.mark.parametrize(("kind", "target"), [(PX4, "px4"), (ARDUPILOT, "ardupilot")])
def test_a_magnetometer_is_written_where_that_is_asked_for(kind: int, target: str, tmp_path: Path) -> None:
    """No calibration knows which of the autopilot's magnetometers it is of."""
    bare = made_for(thermal=False)
    assert bare.covariance is not None
    field = Parameter(name="mag.bias.x", value=3.0, u=0.5, unit="uT")
    mag = SensorModel(matrix=np.diag([1.1, 0.95, 1.0]), bias=np.array([3.0, -20.0, 8.0]))
    covariance = np.pad(bare.covariance, (0, 1))
    covariance[-1, -1] = 0.25
    made = replace(bare, parameters=(*bare.parameters, field), covariance=covariance, mag=mag)
    values = wanted(made, target)
    of_field = {name for name in values if name.startswith(("CAL_MAG", "COMPASS"))}
    assert len(of_field) >= 9
    there = before(values)
    with Peer(kind, there) as peer:
        done = upload(made, f"udp:{peer.port}", backup=tmp_path / "a.params", patience=PATIENCE)
        assert {name: peer.values[name] for name in of_field} == {name: there[name] for name in of_field}
        assert any("--magnetometer" in loss for loss in done.losses)
        upload(made, f"udp:{peer.port}", magnetometer=True, backup=tmp_path / "b.params", patience=PATIENCE)
        assert peer.values == values
