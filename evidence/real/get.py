"""Public recordings: where each is published, under which licence, and how to get it.

    python -m evidence.real.get                    download what is missing into the cache
    python -m evidence.real.get --clones FOLDER    take it from clones that are there, FOLDER/name

Nothing of it is part of this repository. The cache is TUMBLE_EVIDENCE_DATA, by default ~/.cache/tumble/evidence; a file
is kept if its SHA-256 is the one below. What has no licence is read and measured, never passed on.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import urllib.parse
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """Somebody's recordings: the repository (owner/name) with the commit, or the address where they are described."""

    name: str
    title: str
    licence: str
    repository: str = ""
    commit: str = ""
    files: dict[str, str] = field(default_factory=dict)
    """SHA-256 by path in the repository; empty where the recordings come from the data folder (TUMBLE_DATA)."""
    address: str = ""
    place: str = ""
    """Where it was recorded, as far as the authors say or their address tells."""


MIMU_DIGESTS = (
    "4719cc83ea38e181a79be4a23420fe70dffb909143dc871f48042d78e9342fbe",
    "88aac16bd6946574fc1deb33a0a78dfb80830b7225b64d2f1e1c2e61d96a930a",
    "9ac62de2bc225aeedeab21f7abaf11749f866a1eed2fe3d71eb8870d8c017712",
    "4859af5843b3f761809b3c44ccf98ff40b689f2542b9e81e5a0e3c2a93c6abac",
    "fabd1ff8086b0c35fb8754c55b30bc15ff06a733ebeca807d09fcd6d7a33e92f",
    "48cd1b2b2c14f03f86b968d82ad6abe5344118e52e3250229a8b7a44fae99977",
    "8cf65d957afd5efab0bf8e94a69fdc7d43f9e9c9a01eb0ec478ebe88d91accbb",
    "2b9ca7a44230adb8b8f5469e9a5825f68b367f9a04f6029e2e399f33bfef06d9",
    "b297f84b981d41628f39d865fd6d25b0bf9010f7dfddbd72d32cde0307855659",
)
"""SHA-256 of the recordings of the array, from the first to the ninth."""

NO_LICENCE = "none stated: not passed on"

SOURCES = (
    Source(
        name="xsens-mti",
        title="Tedaldi, Pretto and Menegatti: test data of imu_tk, an Xsens MTi",
        licence="BSD-3-Clause",
        address="https://github.com/Kyle-ak/imu_tk, bin/test_data (xsens_acc.mat, xsens_gyro.mat)",
        place="Padova, inferred",
    ),
    Source(
        name="imucal-ferraris",
        title="Küderle and others: example data of imucal",
        licence="MIT",
        address="https://github.com/mad-lab-fau/imucal, example_data",
        place="Erlangen",
    ),
    Source(
        name="mimu4444",
        title="Carlsson, Skog and Jaldén: an array of eight InvenSense chips",
        licence="MIT",
        repository="hcarlsso/Self-Calibration-Inertial-Sensor-Arrays-BCD.jl",
        commit="2f2a8b179882f05b2343e1be6e861af50d583b3d",
        files={
            f"experimental_data/calibration/exp_{number}/data.bin": digest
            for number, digest in enumerate(MIMU_DIGESTS, start=1)
        },
        place="Stockholm",
    ),
    Source(
        name="openaxes-imu9",
        title="Webering and others: a Bosch BMI160 and an Analog Devices ADXL355 on one OpenAXES board",
        licence=NO_LICENCE,
        address="https://github.com/OpenAXES-IMU/OpenAXES, calibration/matlab/OpenAXES",
        place="Hannover",
    ),
    Source(
        name="ln100-updown",
        title="an LN-100 and a MEMS IMU, X up and down",
        licence="MIT",
        address="the data folder's README",
        place="Calgary",
    ),
    Source(
        name="mpu9150",
        title="Mikov, Reginya and Moschevikin: five InvenSense MPU-9150, by hand",
        licence="MIT",
        repository="mikoff/imu-calib",
        commit="12dff577725dbc7bd7161431e4142b6249395fec",
        files={
            "data/imu0.log": "b99da3fe9018966b1cd37cb26426f9c0b57be6fe84f33614b649f40246f3de01",
            "data/imu1.log": "cfeeed0ae5298d86697fd17884597094b41f341aa061521d0b2d8beca2ae4943",
            "data/imu2.log": "71ec21151637aa012eae8f182675fa5b4dfc0b2151c59a4ddfeb11d408e47fcb",
            "data/imu3.log": "b03fbd25c0d6b4f35efb512823785a50ca1a1084a9df27a8156813be38cc8d7c",
            "data/imu4.log": "760d1bb14d13896bb389e4234e694c4d34678764ee8cf1486cc876aecdb4a02b",
        },
        place="Petrozavodsk, inferred",
    ),
    Source(
        name="kim",
        title="Kim: an attitude reference turned by hand, three recordings",
        licence=NO_LICENCE,
        repository="ChanghyeonKim93/IMU_calibration_staticposes",
        commit="468a3dc3db1575a73222128461b1c19e565bd377",
        files={
            "imu_good1.txt": "6eb2d25e637580306cb07c821c6f807573f25c8e9c668e3cdd034936640c4ca0",
            "imu_good2.txt": "8bf71efcd5f500caf0cbc3c1de97b6041129e3594824f5d8584325b7741b7014",
            "imu_good3.txt": "b34ed1cc40003f5323568df8976b39c3813f0494e3f065a0ee988119bfe21e9e",
        },
        place="Seoul",
    ),
    Source(
        name="suarez",
        title="Suárez, Corazza and Pérez: an InvenSense MPU-6050, by hand",
        licence="MIT",
        repository="tomisuarez2/ImuCalibration",
        commit="c86ea2531da0da7929b884b52d8955c0ea0615ff",
        files={
            "calibration data/example_data_calibration.csv": (
                "e6185b2814aa51fcb981048de5c00481af53aee568ed8ce209f46004a228cf54"
            ),
        },
        place="Mendoza",
    ),
    Source(
        name="mascia",
        title="Mascia: accelerometers of a MIMU at 1200 Hz",
        licence=NO_LICENCE,
        repository="Maskul93/MIMU-calib-tutorial",
        commit="2926f70d8dda0fd4ee647b9aca09294f5b994017",
        files={"data/acc_triax.mat": "e5985fc331f56cc5ef8c9dc300e37912fa5590f4dfc6141c0b28b16f5a7bdcc2"},
        place="Rome",
    ),
    Source(
        name="wrona",
        title="Wrona: readings of an accelerometer in 178 positions, with the results of Magneto",
        licence=NO_LICENCE,
        repository="michaelwro/accelerometer-calibration",
        commit="8c80fa685c77086857b498792cb6c9fc2445ed6f",
        files={"examples/acceldata-example.txt": "3df1ebe1d205318d581aa82412f53673ced69e33b812dce8713b0b9d1c68432e"},
    ),
    Source(
        name="rohac",
        title="Roháč, Šipoš and Šimánek: mean readings of an accelerometer in 24 and in 49 positions",
        licence=NO_LICENCE,
        repository="labliscvut/imu_calibration",
        commit="053aa5d56669c115fba484ea119e50af8ddc1e79",
        files={
            "acc_calibration/measured_accelerations.mat": (
                "22722ffa2dadc54b89ef85063b9446e22a996e7c25cb7e44a39a5b3657646cec"
            ),
            "acc_calibration/measured_accelerations_50orientations.mat": (
                "436e34f33ea241e94eba7d8361453b6f19bc3a1baae79cb85e69baf06bf6f511"
            ),
        },
        place="Prague",
    ),
    Source(
        name="broad",
        title="Laidig and others: BROAD, an IMU with a magnetometer moved by hand, attitudes from cameras",
        licence="CC-BY-4.0",
        repository="dlaidig/broad",
        commit="7e2f8189bb4a3ac91eae32c69b6bc87f08a6e2ad",
        files={
            "data_hdf5/02_undisturbed_slow_rotation_B.hdf5": (
                "33ed3432ece89cfbd8c5c069a176106a05dad019302759353244c71d70d7e5f5"
            ),
            "data_hdf5/03_undisturbed_slow_rotation_C.hdf5": (
                "389e1ff9dae1f6f9e2703bf136e12475dcf498be0edc8eae533bd263c7b61e05"
            ),
            "data_hdf5/05_undisturbed_slow_rotation_with_breaks_B.hdf5": (
                "d74cc90958fc05a9fc1a6d58465a62c75a61f205a75ea2e6207ef37d7b1c89a7"
            ),
        },
        place="Berlin",
    ),
)


SIMULATED_BY_OTHERS = tuple(
    Source(name=name, title=title, licence=licence, address=address)
    for name, title, licence, address in (
        ("truth-turntable", "a rough turntable, simulated independently", "of the data folder", "its README"),
        ("truth-handheld", "a MEMS device by hand, simulated independently", "of the data folder", "its README"),
        ("truth-full", "a MEMS device with all dynamic groups, simulated independently", "of the data folder",
         "its README"),
        ("psins-systematic", "Yan: the systematic calibration of PSINS", "BSD-2-Clause",
         "https://psins.org.cn, its example of a systematic calibration"),
    )
)  # fmt: skip


def named(name: str) -> Source:
    """The source of a name."""
    return next(source for source in (*SOURCES, *SIMULATED_BY_OTHERS) if source.name == name)


def cache() -> Path:
    """Where downloaded recordings are."""
    return Path(os.environ.get("TUMBLE_EVIDENCE_DATA") or Path.home() / ".cache" / "tumble" / "evidence")


def place_of(source: Source, file: str) -> Path:
    """Where a file of a source is in the cache, there or not."""
    return cache() / source.name / Path(file)


def content(source: Source, file: str, clones: Path | None) -> bytes:
    """The bytes of a file as published. Raises OSError or CalledProcessError where they cannot be had."""
    if clones is not None:
        clone = clones / source.repository.split("/")[1]
        command = ["git", "-C", str(clone), "show", f"{source.commit}:{file}"]
        return subprocess.run(command, check=True, capture_output=True).stdout
    path = urllib.parse.quote(f"{source.repository}/{source.commit}/{file}")
    with urllib.request.urlopen(f"https://raw.githubusercontent.com/{path}", timeout=60) as answer:
        return bytes(answer.read())


def get(source: Source, file: str, clones: Path | None = None) -> str:
    """Bring one file into the cache; a word on what happened."""
    path, digest = place_of(source, file), source.files[file]
    if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() == digest:
        return "there"
    try:
        data = content(source, file, clones)
    except (OSError, subprocess.CalledProcessError) as error:
        return f"not to be had: {error}"
    if hashlib.sha256(data).hexdigest() != digest:
        return "not kept: its content has changed since it was measured"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return "fetched"


def main() -> None:
    parser = argparse.ArgumentParser(description="Public recordings for the benchmark")
    parser.add_argument("--clones", type=Path, help="a folder of clones, each under the name of its repository")
    clones = parser.parse_args().clones
    for source in SOURCES:
        if not source.files:
            print(f"{source.name}: {source.address} ({source.licence}); read from TUMBLE_DATA")
        for file in source.files:
            print(f"{source.name}: {file}: {get(source, file, clones)}")
    sys.exit(0)


if __name__ == "__main__":
    main()
