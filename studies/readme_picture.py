"""What does a calibration on a rough turntable look like? Draws docs/pictures/rough-table.svg.

The session is that of `make demo`: programme rough-table, table and mounting off by up to 1° about each axis,
an instrument of navigation grade, seed 1. Above: the 15 positions and the accelerometer record as it was logged,
with the rests that were found. Below: how far each parameter was from nominal before the calibration and from the
truth after it, and whether the stated uncertainty u is true.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.result.further import linear_parameters
from tumble.result.parts import Parameter
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session
from tumble.units import ARCSEC, DEGREE_PER_HOUR, G_STANDARD, Array

TARGET = Path(__file__).parents[1] / "docs" / "pictures" / "rough-table.svg"
COLOURS = ("#c0392b", "#2e8b57", "#2c5fa8")
SECONDS_PER_POINT = 0.5
UNITS = {
    "accel.bias": (1e-6 * G_STANDARD, "µg"),
    "accel.scale": (1e-6, "ppm"),
    "accel.axis": (ARCSEC, "arcsec"),
    "gyro.bias": (1e-3 * DEGREE_PER_HOUR, "10⁻³ °/h"),
    "gyro.scale": (1e-6, "ppm"),
    "gyro.axis": (ARCSEC, "arcsec"),
}


def accelerometer_record(folder: Path) -> tuple[Array, Array]:
    """Times (K,), min, and accelerometer readings (K, 3), m/s², of a session, as means of half a second."""
    log = open_log(read_session(folder))
    chunks = list(log.chunks())
    time = np.concatenate([chunk.time for chunk in chunks])
    accel = np.concatenate([chunk.accel for chunk in chunks])
    size = round(SECONDS_PER_POINT * log.rate)
    count = len(time) // size
    means = accel[: count * size].reshape(count, size, -1).mean(axis=1)
    return time[: count * size].reshape(count, size).mean(axis=1) / 60.0, means


def draw_positions(axes: Axes, rests: list[tuple[float, float]], limits: tuple[float, float]) -> None:
    """The body axes in each position, seen from east-south-east, 20° above the horizon, over the middle of its rest."""
    towards_viewer = np.array([-0.470, 0.342, 0.814])  # no two arrows of any position fall together
    right = np.cross([0.0, 1.0, 0.0], towards_viewer)
    right /= np.linalg.norm(right)
    up = np.cross(towards_viewer, right)
    width, height = axes.get_window_extent().width, axes.get_window_extent().height
    across = (limits[1] - limits[0]) / width * height / 2.0
    for (start, stop), position in zip(rests, programme("rough-table").positions, strict=True):
        centre = 0.5 * (start + stop)
        for axis in np.argsort(towards_viewer @ position.matrix):
            along = position.matrix[:, axis]
            x, y = centre + 0.8 * across * (right @ along), 0.8 * (up @ along)
            axes.annotate(
                "",
                xy=(x, y),
                xytext=(centre, 0.0),
                arrowprops={"arrowstyle": "-|>", "color": COLOURS[axis], "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
            )
    axes.set_xlim(limits)
    axes.set_ylim(-1.0, 1.0)
    axes.axis("off")


def draw_record(axes: Axes, time: Array, accel: Array, rests: list[tuple[float, float]]) -> None:
    """The accelerometer record with the rests found."""
    for number, (start, stop) in enumerate(rests, 1):
        axes.axvspan(start, stop, color="#e8e8e8", lw=0)
        axes.text(0.5 * (start + stop), 11.4, str(number), ha="center", va="center", fontsize=8, color="#555555")
    for column, colour, name in zip(accel.T, COLOURS, "XYZ", strict=True):
        axes.plot(time, column, color=colour, lw=1.0, label=name)
    axes.set_ylim(-11.0, 13.0)
    axes.set_yticks([-9.8, 0.0, 9.8], ["−g", "0", "+g"])
    axes.set_xticks(range(0, int(time[-1]) + 1, 2))
    axes.set_xlabel("time, min")
    axes.set_ylabel("accelerometers")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.0)


def draw_improvement(axes: Axes, found: tuple[Parameter, ...], truth: dict[str, float]) -> None:
    """What each parameter is, and what is left of it after the calibration, each kind in its own unit."""
    sizes = np.array([UNITS[group_of(p.name)][0] for p in found])
    before = np.abs([truth[p.name] for p in found]) / sizes
    after = np.abs([p.value - truth[p.name] for p in found]) / sizes
    at = np.arange(len(sizes))
    axes.vlines(at, after, before, color="#c8c8c8", lw=1.0)
    axes.plot(at, before, "o", mfc="white", mec="#444444", ms=5, label="error of the instrument")
    axes.plot(at, after, "o", color="#444444", ms=4, label="what is left of it")
    axes.set_yscale("log")
    axes.set_ylim(0.002, 6000.0)
    axes.set_yticks([0.01, 0.1, 1.0, 10.0, 100.0, 1000.0], ["0.01", "0.1", "1", "10", "100", "1000"])
    axes.legend(loc="upper right", ncols=2, frameon=False, handletextpad=0.2, columnspacing=1.0)
    for group, (_, unit) in UNITS.items():
        members = [i for i, p in enumerate(found) if group_of(p.name) == group]
        axes.text(float(np.mean(members)), 0.003, unit, ha="center", fontsize=8, color="#555555")
    name_parameters(axes, found)


def draw_pulls(axes: Axes, found: tuple[Parameter, ...], truth: dict[str, float]) -> None:
    """(value − truth)/u with the band of two standard uncertainties."""
    pulls = [(p.value - truth[p.name]) / p.u for p in found if p.u]
    axes.axhspan(-2.0, 2.0, color="#e8e8e8", lw=0)
    axes.axhline(0.0, color="#888888", lw=0.8)
    axes.plot(pulls, "o", color="#444444", ms=4)
    axes.set_ylim(-4.0, 4.0)
    axes.set_ylabel("(value − truth)/u")
    name_parameters(axes, found)


def name_parameters(axes: Axes, found: tuple[Parameter, ...]) -> None:
    """Ticks with the parameters, and lines between their kinds."""
    names = [p.name for p in found]
    axes.set_xticks(range(len(names)), [name.split(".")[2] for name in names], fontsize=8)
    axes.set_xlim(-0.7, len(names) - 0.3)
    for group in UNITS:
        members = [i for i, name in enumerate(names) if group_of(name) == group]
        if members[0] > 0:
            axes.axvline(members[0] - 0.5, color="#bbbbbb", lw=0.6)
        axes.text(
            float(np.mean(members)),
            -0.16,
            group.replace(".", "\n"),
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="top",
            fontsize=8,
        )


def group_of(name: str) -> str:
    """Kind of a parameter: "accel.bias" of "accel.bias.x"."""
    return ".".join(name.split(".")[:2])


def draw(target: Path) -> float:
    """Draw the picture into a file; the result is the rms of (value − truth)/u."""
    with tempfile.TemporaryDirectory() as folder:
        session = simulate_session(Path(folder) / "launch", Setup.of(), seed=1)
        truth = json.loads((session / "truth.json").read_text())
        time, accel = accelerometer_record(session)
        calibration = calibrate(session)
    mpl.rcParams |= {"font.size": 9, "svg.hashsalt": "tumble", "axes.spines.top": False, "axes.spines.right": False}
    found = linear_parameters(calibration.parameters)
    rests = [(rest.start / 60.0, rest.stop / 60.0) for rest in calibration.evidence.rests]
    figure = plt.figure(figsize=(10.0, 5.6))
    grid = figure.add_gridspec(
        3, 2, height_ratios=(0.5, 1.5, 2.0), left=0.065, right=0.955, top=0.985, bottom=0.125, hspace=0.0, wspace=0.17
    )
    strip, record = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    lower = grid[2, :].subgridspec(2, 2, height_ratios=(0.32, 1.0), hspace=0.0, wspace=0.17)
    draw_record(record, time, accel, rests)
    record.set_xlim(0.0, float(time[-1]))
    draw_positions(strip, rests, (0.0, float(time[-1])))
    draw_improvement(figure.add_subplot(lower[1, 0]), found, truth)
    draw_pulls(figure.add_subplot(lower[1, 1]), found, truth)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, metadata={"Date": None} if target.suffix == ".svg" else None, dpi=150)
    plt.close(figure)
    pulls = [(p.value - truth[p.name]) / p.u for p in found if p.u]
    return float(np.sqrt(np.mean(np.square(pulls))))


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET
    print(f"{target}: rms of (value − truth)/u {draw(target):.2f}")
