"""What is small on disk and large in memory, and what never ends, is refused in one line before it is read."""

from __future__ import annotations

import os
import struct
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag1Writer
from scipy.io import savemat

from tumble.cli import main
from tumble.documents import toml_of
from tumble.drafting.new_session import new_session
from tumble.errors import InputError, SessionError
from tumble.files import whole_file
from tumble.recording.session_file import read_session

COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
HUGE = b"{'descr': '<f8', 'fortran_order': False, 'shape': (68719476736, 3)}\n"


def write_parquet(path: Path) -> None:
    pl.DataFrame({c: np.zeros(4_000_000) for c in COLUMNS}).write_parquet(path, row_group_size=1 << 24)


def write_mcap(path: Path) -> None:
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1 << 30)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/said", "cdr", schema)
        for _ in range(4):
            writer.add_message(channel, 0, b"\0" * (1 << 26), 0)
        writer.finish()  # type: ignore[no-untyped-call]


def write_bag(path: Path) -> None:
    bag = Bag1Writer(path)
    bag.set_compression(Bag1Writer.CompressionFormat.BZ2)
    with bag:
        there = bag.add_connection("/said", "std_msgs/msg/String", msgdef="string data", md5sum="0" * 32)
        bag.write(there, 0, b"\0" * (1 << 27))


PACKED: dict[str, Callable[[Path], object]] = {
    "a.parquet": write_parquet,
    "a.npz": lambda path: np.savez_compressed(path, *[np.zeros(4_000_000) for _ in COLUMNS]),
    "a.mat": lambda path: savemat(path, {c: np.zeros(4_000_000) for c in COLUMNS}, do_compression=True),
    "a.mcap": write_mcap,
    "a.bag": write_bag,
}


def test_an_array_that_is_longer_than_its_file_is_damaged_and_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(np.lib.format.magic(1, 0) + struct.pack("<H", len(HUGE)) + HUGE)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.npy: expected an intact recording, found it damaged"):
        new_session(tmp_path / "session", tmp_path / "a.npy")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 30_000_000


@pytest.mark.parametrize("name", PACKED)
def test_what_unpacks_to_hundreds_of_its_size_is_refused_before_it_is(name: str, tmp_path: Path) -> None:
    PACKED[name](tmp_path / name)
    tracemalloc.start()
    with pytest.raises(InputError, match=f"{name}: expected readings, of which a packed file of .* holds at most"):
        new_session(tmp_path / "session", tmp_path / name)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 30_000_000


@pytest.mark.parametrize("name", ["a.h5", "a.mat"])
def test_arrays_of_which_a_file_holds_nothing_are_refused(name: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / name, "w") as file:
        for kind in ("accel", "gyro"):
            file.create_dataset(kind, shape=(2**36, 3), chunks=(1024, 3), dtype="f8")
    assert (tmp_path / name).stat().st_size < 10_000
    with pytest.raises(InputError, match=r"expected readings, of which a packed file of .* found 3\.3e"):
        new_session(tmp_path / "session", tmp_path / name)


@pytest.mark.parametrize("rows", [0, 3000])
def test_a_line_of_a_million_commas_is_refused_before_it_is_split(rows: int, tmp_path: Path) -> None:
    samples = "".join(f"{k / 100},0,0,9.8,0,0,0\n" for k in range(3000))
    header = ",".join(COLUMNS) + "\n"
    (tmp_path / "log.csv").write_text(
        header + samples[: len(samples) * rows // 3000] + "," * 1_000_000 + "\n" + samples
    )
    with pytest.raises(InputError, match="expected"):
        new_session(tmp_path / "session", tmp_path / "log.csv")


def test_a_key_of_thousands_of_parts_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text("format = 1\n" + ".".join(["a"] * 20_000) + " = 1\n")
    tracemalloc.start()
    with pytest.raises(SessionError, match=r"session\.toml: expected keys of at most 16 parts, found a longer one"):
        read_session(tmp_path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10_000_000


PART = st.sampled_from(["a", "b-1", '"c d"', "'e.f'", '"g\\"h"'])


@given(st.lists(PART, min_size=1, max_size=40), st.sampled_from([".", " . ", "\t."]), st.sampled_from(["", "[", "{"]))
def test_keys_are_counted_by_their_parts(parts: Sequence[str], dot: str, before: str) -> None:
    key = dot.join(parts)
    text = {"": f"{key} = 1", "[": f"[{key}]", "{": f"x = {{ {key} = 1 }}"}[before]
    if len(parts) > 16 and '"g\\"h"' not in parts:
        with pytest.raises(InputError, match="at most 16 parts"):
            toml_of(text, "x.toml")
    elif len(parts) <= 16:
        assert toml_of(text, "x.toml")


def test_words_and_numbers_with_many_dots_are_no_keys() -> None:
    numbers = ", ".join(f"{0.1 * k:.1f}" for k in range(1, 30))
    assert toml_of(f'a = 1.5\nb = "1.2.3.4"\nc = [{numbers}]', "x.toml")["b"] == "1.2.3.4"


@pytest.mark.skipif(os.name != "posix", reason="devices and pipes of POSIX")
@pytest.mark.parametrize(
    "words",
    ["new {out} {}", "calibrate {} --latitude 5", "report {} -o {out}", "ellipsoid {} --unit g", "check {} {out}"],
)
@pytest.mark.parametrize("what", ["device", "pipe"])
def test_devices_and_pipes_are_no_documents(words: str, what: str, tmp_path: Path) -> None:
    path = Path("/dev/zero") if what == "device" else tmp_path / "pipe"
    if what == "pipe":
        os.mkfifo(path)
    given = words.replace("{out}", str(tmp_path / "out.html")).replace("{}", str(path)).split()
    result = CliRunner().invoke(main, given)
    assert result.exit_code == 2, result.output
    assert f"{path}: expected a file, found a device or a pipe" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_pipe_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is no file that could be replaced"), whole_file(tmp_path / "pipe"):
        pass
    assert not (tmp_path / "pipe").is_file()


def test_arrays_that_are_there_are_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("accel", data=np.tile([0.0, 0.0, 9.81], (3000, 1)), compression="gzip", chunks=(1000, 3))
    draft, _ = new_session(tmp_path / "session", tmp_path / "a.h5")
    assert draft.content["log"]["accel"]["unit"] == "m/s^2"


def test_a_log_whose_noise_cannot_be_found_is_refused_in_one_line(tmp_path: Path) -> None:
    """What was found out of its columns is said of a log that can be used alone."""
    rows = ["t,ax,ay,az", *(f"{k / 100},{0.01 * (k % 7)},0.02,9.8{k % 5}" for k in range(500))]
    (tmp_path / "log.csv").write_text("\n".join(rows), encoding="utf-8")
    result = CliRunner().invoke(
        main, ["noise", str(tmp_path / "log.csv"), "--accel-unit", "furlong"], prog_name="tumble"
    )
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
