"""What becomes of a command where the machine fails it: a full disk, a folder that is read-only or gone, a signal.

Every command that writes is run as a process of its own with each fault, every other one with those of its streams and
surroundings. A case is a finding where

* the exit status is not 0, 1 or 2 (or that of the signal), a traceback is printed, or a refusal is not one line;
* a command that failed leaves a file behind, or has changed the file that was there;
* a file is there that was not written whole: cut, or mixed of two writers;
* it takes more than 1 GB of memory, or more than 60 s;
* a program that was asked for a file of this machine opens a connection, or runs what is in its input.

    python studies/faults.py [--short] [--only WORD]

`--short` is one command with a full disk; `--only` takes the kinds of faults whose name has the word. As root the
read-only folder and the full disk are mounted where that is possible; otherwise the disk is a limit on the size of
files.
"""

from __future__ import annotations

import argparse
import gzip
import http.server
import importlib
import os
import pickle
import pkgutil
import pty
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fcntl import ioctl
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

import tumble as tumble_package
from tumble.__main__ import run as tumble

LONGEST, MOST = 60.0, 1 << 30
"""How long a process may be on a machine that has nothing else to do, and how large: s, bytes."""
KILLS = 6
"""How often a writer is killed, at times spread over its run."""

WRITERS = {
    "new": "new {out}/n {in}/csv/log.csv --latitude 50",
    "simulate": "simulate {out}/n --positions 3 --rest 4 --sample-rate 20 --format csv",
    "calibrate": "calibrate {in}/csv --terms linear -o {out}/n.json --force",
    "ellipsoid": "ellipsoid {in}/readings.csv --unit m/s^2 -o {out}/n.json --force",
    "apply csv": "apply {in}/calibration.json {in}/csv -o {out}/n.csv --force",
    "apply parquet": "apply {in}/calibration.json {in}/csv -o {out}/n.parquet --force",
    "export": "export {in}/calibration.json --to csv -o {out}/n.csv --force",
    "export mat": "export {in}/calibration.json --to mat -o {out}/n.mat --force",
    "report html": "report {in}/calibration.json -o {out}/n.html",
    "report pdf": "report {in}/calibration.json --certificate {in}/certificate.toml -o {out}/n.pdf",
    "inspect plot": "inspect {in}/csv --plot {out}/n.svg",
    "noise plot": "noise {in}/csv --plot {out}/n.svg",
    "programme": "programme cube-26 -o {out}/n.html",
    "example": "example {out}/n",
    "registry add": "registry add {in}/calibration.json --registry {out}/n.sqlite",
    "registry show": "registry show 1 -o {out}/n.json --registry {in}/r.sqlite",
    "campaign": "campaign {in}/campaign.toml --in-process -o {out}/n",
    "fleet": "fleet {in}/stil* --in-process -o {out}/n",
    "selftest": "selftest -o {out}/n.json",
}
"""A command that writes, of each family, by its name."""
GROWING = ("campaign", "fleet", "registry add")
"""Commands that keep what was done before they were stopped, to go on with."""
READERS = {
    "inspect": "inspect {in}/csv",
    "check": "check {in}/calibration.json {in}/other",
    "compare": "compare {in}/calibration.json {in}/other.json",
    "noise": "noise {in}/csv",
    "plan": "plan --grade mems",
    "plan of a method": "plan --method sequential --sources",
    "plan for accuracies": "plan --want accel.scale=100ppm",
    "registry list": "registry list --registry {in}/r.sqlite",
}
FAMILIES = ("new", "calibrate", "apply csv", "export", "report html", "programme", "registry add", "fleet", *READERS)
"""A command of each family, for what needs processes from the start."""
SHORT = ("programme",)


@dataclass(frozen=True, kw_only=True, slots=True)
class Ended:
    """How a process ended: its exit status (negative: the signal), its words, its time, and its memory in bytes."""

    status: int
    out: str
    err: str
    seconds: float
    memory: int

    def fault(self, *, refused: bool = False, signals: tuple[int, ...] = ()) -> str:
        """What is wrong with it; `refused` where it must not have worked."""
        if self.seconds > LONGEST:
            return f"longer than {LONGEST:g} s"
        if self.memory > MOST:
            return f"{self.memory / 1e6:.0f} MB of memory"
        if "Traceback" in self.err or "panicked" in self.err or "Exception ignored" in self.err:
            return f"traceback: {self.err.splitlines()[-1][:200]}"
        if self.status not in (0, 1, 2, *signals):
            return f"exit status {self.status}: {self.err[-200:]}"
        if refused and self.status != 2:
            return f"exit status {self.status} where it cannot have worked"
        lines = [line for line in self.err.splitlines() if line.startswith("tumble: ")]
        if self.status == 2 and (len(lines) != 1 or not self.err.endswith(f"{lines[0]}\n")):
            return f"{len(lines)} lines where one is promised: {self.err[:200]!r}"
        return ""


def _nothing() -> None:
    pass


class Bench:
    """The inputs, an empty folder for what is written, and processes that are run there."""

    def __init__(self, folder: Path, *, short: bool) -> None:
        self.inputs, self.out = folder / "in", folder / "out"
        self.inputs.mkdir()
        folder.chmod(0o755)
        self.environment = dict(os.environ)
        if short:
            return
        written = "import sys, pathlib, damaged_inputs as d; d.write_inputs(pathlib.Path(sys.argv[1]))"
        here = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
        subprocess.run([sys.executable, "-c", written, str(self.inputs)], env=here, check=True)  # no threads here
        for module in pkgutil.walk_packages(tumble_package.__path__, "tumble."):
            if "migrations" not in module.name:
                importlib.import_module(module.name)

    def emptied(self) -> Path:
        """The folder for what is written, empty."""
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        self.out.chmod(0o777)
        return self.out

    def words(self, command: str) -> list[str]:
        """A command as a process is given it."""
        filled = command.replace("{out}", str(self.out)).replace("{in}", str(self.inputs))
        return [sys.executable, "-m", "tumble", *filled.split()]

    def started(self, command: str, prepare: Callable[[], object] = _nothing, **how: Any) -> subprocess.Popen[bytes]:
        """A command as a process: a copy of this one, which has imported all it needs."""
        how = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | how
        words = self.words(command)

        def instead() -> NoReturn:
            prepare()
            _become(words[3:])

        return subprocess.Popen(words, preexec_fn=instead, **how)

    def run(self, command: str, prepare: Callable[[], object] = _nothing) -> Ended:
        """A command as a copy of this process, to its end."""
        return _ended(self.started(command, prepare))

    def run_fresh(self, command: str, **how: Any) -> Ended:
        """A command as a process of its own, to its end."""
        how = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | how
        return _ended(subprocess.Popen(self.words(command), **how))

    def left(self) -> list[str]:
        """What stands in the folder for what is written."""
        return sorted(str(path.relative_to(self.out)) for path in self.out.rglob("*")) if self.out.exists() else []


def _ended(process: subprocess.Popen[bytes]) -> Ended:
    started, longest = time.monotonic(), LONGEST * max(1.0, 2.0 * os.getloadavg()[0] / (os.cpu_count() or 1))
    guard = threading.Timer(longest, process.kill)
    guard.start()
    out, err = process.communicate()
    guard.cancel()
    return Ended(
        status=process.returncode,
        out=(out or b"").decode(errors="replace"),
        err=(err or b"").decode(errors="replace"),
        seconds=(time.monotonic() - started) * LONGEST / longest,
        memory=resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024,
    )


def _become(words: list[str]) -> NoReturn:
    """The command line in this process, a copy that was just made, to its end."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # as the program does when it begins
    os.closerange(3, 1024)  # the parent waits for one of them
    sys.stdin, sys.stdout, sys.stderr = (open(n, mode, closefd=False) for n, mode in enumerate("rww"))  # noqa: SIM115
    status = 1
    try:
        sys.argv = ["tumble", *words]
        tumble()
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 1
    except BaseException:
        traceback.print_exc()
    with suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


Found = Iterator[tuple[str, str]]
"""Of cases, what was found in each, or nothing: (name, finding)."""


# -------------------- the disk --------------------


def full_disk(bench: Bench, commands: dict[str, str]) -> Found:
    """No room: at once, and after the first kilobytes."""
    for name, command in commands.items():
        for room in (0, 3000):
            bench.emptied()
            ended = bench.run(command, prepare=lambda room=room: _limited(room))
            yield f"{name}, files of {room} bytes at most", _of_failure(bench, name, ended)
        with _mounted(bench.emptied(), "size=4k,nr_inodes=20") as mounted:
            if mounted:
                (bench.out / "full").write_bytes(b"x" * 4096)
                ended = bench.run(command)
                (bench.out / "full").unlink()
                yield f"{name}, a disk that is full", _of_failure(bench, name, ended)


def _limited(room: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))


def _of_failure(bench: Bench, name: str, ended: Ended) -> str:
    small = ended.status in (0, 1) and bool(bench.left())  # what it writes has room
    left = [] if small or name in GROWING else bench.left()
    return ended.fault(refused=not small) or (f"left behind: {' '.join(left[:3])}" if left else "")


@contextmanager
def _mounted(folder: Path, options: str) -> Iterator[bool]:
    """A small file system in memory over a folder, where this user may mount one."""
    words = ["mount", "-t", "tmpfs", "-o", options, "none", str(folder)]
    mounted = os.geteuid() == 0 and subprocess.run(words, capture_output=True, check=False).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


def folders(bench: Bench, commands: dict[str, str]) -> Found:
    """A folder that is read-only, one that is not there, one that is a file, a name that is too long, and one that
    vanishes meanwhile."""
    for name, command in commands.items():
        with _read_only(bench) as possible:
            if possible:
                yield f"{name}, into a read-only folder", bench.run(command).fault(refused=True)
        bench.emptied().rmdir()
        ended = bench.run(command)
        made = ended.status in (0, 1) and bench.out.exists()  # `new`, `simulate`, `campaign` make folders
        yield f"{name}, into a folder that is not there", ended.fault(refused=not made)
        shutil.rmtree(bench.out, ignore_errors=True)
        bench.out.write_bytes(b"a file")
        found = bench.run(command).fault(refused=True)
        yield f"{name}, into a file", found or ("" if bench.out.read_bytes() == b"a file" else "the file is changed")
        bench.out.unlink()
        bench.emptied()
        found = bench.run(command.replace("/n", f"/{'n' * 300}")).fault(refused=True)
        yield f"{name}, a name of 300 characters", found
        bench.emptied()
        process = bench.started(command, stdout=subprocess.DEVNULL)
        while process.poll() is None and not bench.left():
            time.sleep(0.002)
        shutil.rmtree(bench.out, ignore_errors=True)
        err = process.communicate()[1].decode()
        ended = Ended(status=process.returncode, out="", err=err, seconds=0.0, memory=0)
        yield f"{name}, a folder that vanishes", ended.fault()


@contextmanager
def _read_only(bench: Bench) -> Iterator[bool]:
    folder = bench.emptied()
    if os.geteuid() != 0:
        folder.chmod(0o555)
        yield True
        folder.chmod(0o777)
        return
    with _mounted(folder, "ro") as mounted:
        yield mounted


# -------------------- signals, and two at once --------------------


def killed(bench: Bench, commands: dict[str, str]) -> Found:
    """Killed at any time, the file that was there stands, or the new one, whole; stopped by SIGTERM or SIGINT, nothing
    else is left."""
    for name, command in commands.items():
        if name in GROWING:
            continue
        bench.emptied()
        started = time.monotonic()
        bench.run(command)
        taken = time.monotonic() - started
        whole = _content(bench.out)
        for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
            for at in np.linspace(0.0, 1.0, KILLS if how == signal.SIGKILL else KILLS // 2):
                bench.emptied()
                process = bench.started(command, stdout=subprocess.DEVNULL)
                _until_writing(process, bench, at * taken)
                process.send_signal(how)
                err = process.communicate()[1].decode()
                said = Ended(status=process.returncode, out="", err=err, seconds=0.0, memory=0)
                found = said.fault(signals=(-how, 128 + how))
                there = _content(bench.out)
                if not found and any(
                    len(there[file]) < 0.9 * len(whole.get(file, b"")) for file in there if file in whole
                ):
                    found = "a file that is cut"
                if not found and how != signal.SIGKILL and set(there) not in (set(), set(whole)):
                    found = f"left behind: {' '.join(sorted(set(there) - set(whole)))}"
                yield f"{name}, {how.name} at {at:.0%}", found


def _until_writing(process: subprocess.Popen[bytes], bench: Bench, seconds: float) -> None:
    """Until a process writes, or has run so long."""
    until = time.monotonic() + seconds
    while process.poll() is None and time.monotonic() < until and not bench.left():
        time.sleep(0.001)


def _content(folder: Path) -> dict[str, bytes]:
    return (
        {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        if folder.exists()
        else {}
    )


def two_at_once(bench: Bench, commands: dict[str, str]) -> Found:
    """Two processes that write the same: both end as they may, and one whole file stands."""
    for name, command in commands.items():
        bench.emptied()
        bench.run(command)
        alone = _content(bench.out)
        bench.emptied()
        both = [bench.started(command, stdout=subprocess.DEVNULL) for _ in "ab"]
        ended = [
            Ended(status=p.returncode, out="", err=err.decode(), seconds=0.0, memory=0)
            for p, err in [(p, p.communicate()[1]) for p in both]
        ]
        there = _content(bench.out)
        found = next((e.fault() for e in ended if e.fault()), "")
        cut = [f for f in alone if f in there and len(there[f]) < 0.9 * len(alone[f])]
        yield f"{name}, twice at once", found or (f"cut: {cut[0]}" if cut else "") or _strange_files(there, alone)


def _strange_files(there: dict[str, bytes], alone: dict[str, bytes]) -> str:
    more = [name for name in there if name not in alone and "parts/" not in name]
    return f"left behind: {' '.join(more[:3])}" if more else ""


# -------------------- streams and surroundings --------------------


def streams(bench: Bench, commands: dict[str, str]) -> Found:
    """Standard input, output and error closed, one, two or all of them; a pipe that nobody reads, or of which a byte is
    read; /dev/full; a terminal of 20 columns."""
    streams = ("input", "output", "error")
    for name, command in commands.items():
        for closed in ((0,), (1,), (2,), (1, 2), (0, 1, 2)):
            bench.emptied()
            ended = bench.run_fresh(command, preexec_fn=lambda closed=closed: [*map(os.close, closed)])
            yield f"{name}, standard {' and '.join(streams[n] for n in closed)} closed", ended.fault()
        for count in (0, 1):
            bench.emptied()
            reading, writing = os.pipe()
            reader = threading.Thread(target=_read_and_close, args=(reading, count))
            reader.start()
            if not count:
                reader.join()
            ended = bench.run_fresh(command, stdout=writing)
            os.close(writing)
            reader.join()
            complains = "it complains" if "tumble:" in ended.err else ""
            yield f"{name}, a pipe of which {count} bytes are read", ended.fault() or complains
        if Path("/dev/full").exists():
            bench.emptied()
            with Path("/dev/full").open("w", encoding="utf-8") as full:
                yield f"{name}, standard output full", bench.run_fresh(command, stdout=full).fault()
        bench.emptied()
        yield f"{name}, a terminal of 20 columns", _on_terminal(bench, command, 20)


def _read_and_close(descriptor: int, count: int) -> None:
    if count:
        os.read(descriptor, count)
    os.close(descriptor)


def _on_terminal(bench: Bench, command: str, columns: int) -> str:
    master, slave = pty.openpty()
    ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    shown: list[bytes] = []
    reader = threading.Thread(target=_read, args=(master, shown))
    reader.start()
    ended = bench.run_fresh(command, stdout=slave, stderr=slave)
    os.close(slave)
    reader.join()
    return ended.fault() or ("traceback" if b"Traceback" in b"".join(shown) else "")


def _read(descriptor: int, into: list[bytes]) -> None:
    with suppress(OSError):
        while part := os.read(descriptor, 65536):
            into.append(part)
    os.close(descriptor)


def surroundings(bench: Bench, commands: dict[str, str]) -> Found:
    """No HOME, no TMPDIR, no locale, next to no environment."""
    nowhere = dict.fromkeys(("HOME", "TMPDIR", "TMP", "TEMP", "XDG_CACHE_HOME", "XDG_DATA_HOME"), "/nonexistent")
    python = {k: v for k, v in bench.environment.items() if k in ("PYTHONPATH", "VIRTUAL_ENV")}
    for name, command in commands.items():
        for what, environment in {
            "no HOME and no TMPDIR": bench.environment | nowhere,
            "locale C": bench.environment | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
            "no environment": python,
        }.items():
            bench.emptied()
            yield f"{name}, {what}", bench.run_fresh(command, env=environment).fault()


# -------------------- inputs of others --------------------


def bombs(bench: Bench, _: dict[str, str]) -> Found:
    """Archives that unpack to 1,000 times their size: of one byte, of one line, and of rows."""
    row = b"0.05,0.1,0.2,9.8,0.0,0.0,0.0\n"
    contents = {"zeros": b"\0" * (1 << 20), "one line": b"1" * (1 << 20), "rows": row * 36000}
    for what, block in contents.items():
        path = bench.inputs / "bomb.csv.gz"
        with gzip.open(path, "wb", compresslevel=9) as file:
            file.write(b"t,ax,ay,az,gx,gy,gz\n")
            for _number in range(1500):
                file.write(block)
        size = path.stat().st_size
        folder = bench.inputs / "bomb"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(bench.inputs / "csv", folder)
        text = (folder / "session.toml").read_text(encoding="utf-8").replace("log.csv", "../bomb.csv.gz")
        (folder / "session.toml").write_text(text, encoding="utf-8")
        for command in ("new {out}/n {in}/bomb.csv.gz", "inspect {in}/bomb", "ellipsoid {in}/bomb.csv.gz --unit g"):
            bench.emptied()
            ended = bench.run(command)
            found = ended.fault(refused=True) or (f"left behind: {bench.left()[0]}" if bench.left() else "")
            yield f"{command.split()[0]}, an archive of {what}, {1500 * (1 << 20) / size:.0f} times its size", found


class _Knocked(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.server.knocked = True  # type: ignore[attr-defined]
        self.send_error(404)

    def log_message(self, *_: object) -> None:
        pass


def inputs_of_others(bench: Bench, _: dict[str, str]) -> Found:
    """URLs in sessions, XML with entities, pickles."""
    with http.server.HTTPServer(("127.0.0.1", 0), _Knocked) as server:
        server.knocked = False  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        host = f"127.0.0.1:{server.server_address[1]}"
        for key in ("log.file", "device.systematic"):
            found = _pointed_elsewhere(bench, key, f"http://{host}/s")
            yield f"inspect, {key} at a URL", found or ("it went there" if server.knocked else "")
        server.shutdown()
    yield from _malicious(bench)


def _pointed_elsewhere(bench: Bench, key: str, url: str) -> str:
    folder = bench.inputs / "elsewhere"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(bench.inputs / "csv", folder)
    text = (folder / "session.toml").read_text(encoding="utf-8")
    changed = (
        text.replace('"log.csv"', f'"{url}"')
        if key == "log.file"
        else text.replace("[device]", f'[device]\nsystematic = "{url}"')
    )
    (folder / "session.toml").write_text(changed, encoding="utf-8")
    return bench.run("calibrate {in}/elsewhere -o {out}/n.json").fault(refused=True)


class _Harm:
    """What a pickle does when it is opened."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.system, (f"touch {os.environ['HARM']}",)


LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
    + "]><l>&j;</l>"
)


def _malicious(bench: Bench) -> Found:
    harm = bench.inputs / "harm"
    os.environ["HARM"] = str(harm)
    pickled = pickle.dumps({"accel": _Harm(), "gyro": _Harm()})
    for what, content in (("XML with entities", LAUGHS.encode()), ("a pickle", pickled)):
        for command in (
            "new {out}/n {in}/x.csv", "new {out}/n {in}/x.mat", "new {out}/n {in}/x.h5", "new {out}/n {in}/x.ulg",
            "new {out}/n {in}/x.bag", "new {out}/n {in}/x.npy", "new {out}/n {in}/x.parquet",
            "compare {in}/x.json {in}/calibration.json", "compare {in}/x.yaml {in}/calibration.json",
            "fleet {in}/x.csv --in-process -o {out}/n",
            "export {in}/calibration.json --to dcc --certificate {in}/x.toml -o {out}/n.xml",
            "registry list --registry {in}/x.sqlite", "campaign {in}/x.toml --in-process -o {out}/n",
        ):  # fmt: skip
            bench.emptied()
            file = next(word for word in command.split() if "{in}/x" in word).replace("{in}", str(bench.inputs))
            Path(file).write_bytes(content)
            found = bench.run(command).fault(refused=True)
            yield (
                f"{command.split()[0]}, {Path(file).suffix} that is {what}",
                found or ("it ran" if harm.exists() else ""),
            )
    npy = bench.inputs / "x.npy"
    np.save(npy, np.array([_Harm()], dtype=object), allow_pickle=True)
    found = bench.run("new {out}/n {in}/x.npy").fault(refused=True)
    yield "new, .npy of objects", found or ("it ran" if harm.exists() else "")


def cluster(bench: Bench, _: dict[str, str]) -> Found:
    """The processes of a fleet listen on this machine alone."""
    bench.emptied()
    process = subprocess.Popen(
        bench.words("campaign {in}/campaign.toml --workers 2 -o {out}/n"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    open_to_all: set[str] = set()
    while process.poll() is None:
        open_to_all |= set(_listening(process.pid))
        time.sleep(0.05)
    err = (process.stderr.read() if process.stderr else b"").decode()
    ended = Ended(status=process.returncode, out="", err=err, seconds=0.0, memory=0)
    elsewhere = sorted(address for address in open_to_all if not address.startswith("127."))
    yield "campaign on processes of its own", ended.fault() or (f"listens at {elsewhere[0]}" if elsewhere else "")


def _listening(session: int) -> Iterator[str]:
    """Addresses at which the processes of a session listen."""
    inodes = set()
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getsid(int(process.name)) != session:
                continue
            opened = [str(fd.readlink()) for fd in (process / "fd").iterdir()]
            inodes |= {name[8:-1] for name in opened if name.startswith("socket:")}
    for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
        _, local, _, state, *_more = line.split()
        if state == "0A" and line.split()[9] in inodes:
            yield socket.inet_ntoa(struct.pack("<I", int(local.split(":")[0], 16)))


# -------------------- the live page --------------------

RECORDED = "bench {out}/n --listen stdin --serial A-1 --port 0"
OPENED, TAKEN = 30.0, 20.0
"""How long a page may take to open, and what was sent to be recorded: s."""


class _Page:
    """A bench that records its standard input, until it is ended; what it has said, and what was sent to it."""

    def __init__(self, bench: Bench, command: str = RECORDED, **how: Any) -> None:
        how = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE} | how
        self.process = subprocess.Popen(bench.words(command), **how)
        self.said: list[bytes] = []
        self.log, self.sent = bench.out / "n" / "log.csv", b""
        if self.process.stderr is not None:
            self._reader = threading.Thread(target=_read, args=(os.dup(self.process.stderr.fileno()), self.said))
            self._reader.start()

    @property
    def err(self) -> str:
        return b"".join(self.said).decode(errors="replace")

    def open(self) -> bool:
        """Whether the page opens."""
        return _until(lambda: "the page: " in self.err or self.process.poll() is not None, OPENED) and self.alive

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def send(self, rows: bytes, *, sound: bool = True) -> None:
        """Send rows, which are recorded as they are where they are `sound`."""
        assert self.process.stdin is not None
        self.process.stdin.write(rows)
        self.process.stdin.flush()
        self.sent += rows if sound else b""

    def taken(self) -> bool:
        """Whether all that is sound is in the log."""
        return _until(lambda: self.log.exists() and self.log.stat().st_size >= len(self.sent), TAKEN)

    def end(self, how: signal.Signals = signal.SIGTERM) -> str:
        """End it; what is wrong with how it ended."""
        if self.alive:
            self.process.send_signal(how)
        started = time.monotonic()
        self.process.wait(LONGEST)
        if self.process.stdin is not None:
            with suppress(OSError):
                self.process.stdin.close()
        if self.process.stderr is not None:
            self._reader.join()
        memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
        seconds = time.monotonic() - started
        ended = Ended(status=self.process.returncode, out="", err=self.err, seconds=seconds, memory=memory)
        return ended.fault(signals=(-how, 128 + how))

    def differs(self) -> str:
        """Whether the log is something else than what was sent."""
        return "" if self.log.read_bytes() == self.sent else "the log is not what was sent"


def _until(what: Callable[[], bool], seconds: float) -> bool:
    until = time.monotonic() + seconds
    while not what() and time.monotonic() < until:
        time.sleep(0.02)
    return what()


def live_page(bench: Bench, _: dict[str, str]) -> Found:
    """The bench: a port that is taken, two on one folder, a closed standard input, a stream of garbage, a full disk,
    a folder that vanishes, and signals."""
    lines = (bench.inputs / "csv" / "log.csv").read_bytes().splitlines(keepends=True)
    rows = [b"".join(lines[at : at + 200]) for at in range(0, 1200, 200)]
    yield from _not_opened(bench)
    yield "bench, twice on one folder", _twice(bench, rows)
    yield "bench, a stream of garbage", _garbage(bench, rows)
    yield "bench, a folder that vanishes", _vanished(bench, rows)
    for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
        yield f"bench, {how.name} and again", _again(bench, rows, how)
    with _mounted(bench.emptied(), "size=200k") as mounted:
        if mounted:
            yield "bench, a disk that fills up", _filled_up(bench, rows)
    with _mounted(bench.emptied(), "size=4k") as mounted:
        if mounted:
            (bench.out / "full").write_bytes(b"x" * 4096)
            ended = bench.run_fresh(RECORDED)
            (bench.out / "full").unlink()
            yield "bench, a full disk", ended.fault(refused=True) or _left(bench)


def _left(bench: Bench) -> str:
    return f"left behind: {' '.join(bench.left()[:3])}" if bench.left() else ""


def _not_opened(bench: Bench) -> Found:
    bench.emptied()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        ended = bench.run_fresh(RECORDED.replace("--port 0", f"--port {port}"))
        yield "bench, a port that is taken", ended.fault(refused=True) or _left(bench)
    bench.emptied()
    ended = bench.run_fresh(RECORDED, preexec_fn=lambda: os.close(0))
    yield "bench, standard input closed", ended.fault(refused=True) or _left(bench)
    for number, what in ((1, "output"), (2, "error")):
        bench.emptied()
        page = _Page(
            bench, stderr=None if number == 2 else subprocess.PIPE, preexec_fn=lambda number=number: os.close(number)
        )
        there = _until(lambda page=page: page.log.exists(), OPENED)
        time.sleep(1.0)
        yield f"bench, standard {what} closed", page.end() or ("" if there else "it did not open")


def _twice(bench: Bench, rows: list[bytes]) -> str:
    bench.emptied()
    first = _Page(bench)
    if not first.open():
        return first.end() or "it did not open"
    first.send(rows[0])
    second = bench.run_fresh(RECORDED)
    first.send(rows[1])
    taken = first.taken()
    return second.fault(refused=True) or first.end() or ("" if taken else "rows are lost") or first.differs()


def _garbage(bench: Bench, rows: list[bytes]) -> str:
    bench.emptied()
    page, rng = _Page(bench), np.random.default_rng(1)
    if not page.open():
        return page.end() or "it did not open"
    strange = (rng.bytes(100_000), b"x" * 8_000_000, b"nan,nan\n" * 1000, b"\0" * 1000, b"\xff\xfe1,2\r\n", b",,,,,,\n")
    for sound, garbage in zip(rows, strange, strict=True):
        page.send(sound)
        page.send(b"\x01" + garbage + b"\n", sound=False)
    taken = page.taken()
    return page.end() or ("" if taken else "rows are lost") or page.differs()


def _vanished(bench: Bench, rows: list[bytes]) -> str:
    bench.emptied()
    page = _Page(bench)
    if not page.open():
        return page.end() or "it did not open"
    page.send(rows[0])
    page.taken()
    shutil.rmtree(bench.out / "n")
    page.send(rows[1] + b"garbage\n")
    time.sleep(2.0)
    alive = page.alive
    return page.end() or ("" if alive else "it ended")


def _again(bench: Bench, rows: list[bytes], how: signal.Signals) -> str:
    bench.emptied()
    page = _Page(bench)
    if not page.open():
        return page.end() or "it did not open"
    page.send(rows[0])
    taken, found = page.taken(), page.end(how)
    again = _Page(bench)
    if found or not again.open():
        return found or again.end() or "it did not open again"
    again.sent = page.sent
    again.send(rows[1])
    taken = taken and again.taken()
    return again.end() or ("" if taken else "rows are lost") or again.differs()


def _filled_up(bench: Bench, rows: list[bytes]) -> str:
    page = _Page(bench)
    if not page.open():
        return page.end() or "it did not open"
    page.send(rows[0])
    page.taken()
    filler = bench.out / "full"
    with suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(b"x" * 4096)
    for row in rows[1:]:
        page.send(b"garbage\n" * 100, sound=False)
        page.send(row)
        time.sleep(0.3)
    alive = page.alive
    filler.unlink()
    taken = page.taken()
    return page.end() or ("" if alive else "it ended") or ("" if taken else "rows are lost") or page.differs()


# -------------------- the study --------------------


def _of(names: Iterable[str]) -> dict[str, str]:
    return {name: command for name, command in (WRITERS | READERS).items() if name in names}


EVERY: dict[str, tuple[Callable[[Bench, dict[str, str]], Found], dict[str, str]]] = {
    "disk": (full_disk, WRITERS),
    "folders": (folders, WRITERS),
    "killed": (killed, WRITERS),
    "two": (two_at_once, WRITERS),
    "streams": (streams, WRITERS | READERS),
    "surroundings": (surroundings, _of(FAMILIES)),
    "bombs": (bombs, {}),
    "inputs": (inputs_of_others, {}),
    "cluster": (cluster, {}),
    "bench": (live_page, {}),
}
"""Kinds of faults, each with the commands that meet it."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--command", default="")
    given = parser.parse_args()
    kinds = ("disk",) if given.short else tuple(EVERY)
    cases, findings = 0, 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), short=given.short)
        for kind in kinds:
            if given.only not in kind:
                continue
            faults, commands = EVERY[kind]
            chosen = {n: c for n, c in commands.items() if (n in SHORT if given.short else given.command in n)}
            counted, started = 0, time.monotonic()
            for name, finding in faults(bench, chosen):
                counted += 1
                if finding:
                    findings += 1
                    print(f"{kind}: {name}: {finding.replace(folder, '')}", flush=True)
            cases += counted
            print(f"{kind}: {counted} cases, {time.monotonic() - started:.0f} s", flush=True)
    answer = f"Yes, {findings} of {cases} times" if findings else "No."
    print(f"Does a fault of the machine end otherwise than it should? {answer}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
