"""What do the results look like? Draws docs/pictures/gallery-*.svg and writes docs/howto/gallery.md.

Every picture is a function of this script, and the page shows its source: matplotlib axes, and the library as anyone
would call it.
"""

from __future__ import annotations

import contextlib
import inspect
import sys
import tempfile
import textwrap
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import tumble

DOCS = Path(__file__).parents[1] / "docs"
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "tumble",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
HEAD = """# Gallery

Pictures of results, each with the lines that draw it. The page and its pictures are made by
`python studies/gallery.py`; `axes` are matplotlib axes, and [the library](../reference/api.md) says what else can be
called. All begin with two simulated launches of a MEMS unit, turned by hand:

```python
import numpy as np
import tumble

request = tumble.Setup.of(grade="mems", positions=15)
session, second = (tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2))
calibration = tumble.calibrate(session)
```
"""


def recording(axes: Axes, session: Path) -> None:
    """The recording, and the rests that were found in it"""
    observed = tumble.inspect_session(session)
    chunks = list(tumble.open_log(observed.session).chunks())
    time = np.concatenate([chunk.time for chunk in chunks])[::25]
    axes.plot(time, np.concatenate([chunk.accel for chunk in chunks])[::25], linewidth=0.7)
    for rest in observed.segmentation.rests:
        axes.axvspan(rest.start, rest.stop, color="0.9", linewidth=0)
    axes.set(xlabel="time, s", ylabel="accelerometers, m/s²")


def residuals(axes: Axes, calibration: tumble.Calibration) -> None:
    """How well the calibration fits its own rests"""
    calibration.plot(axes)


def parameters(axes: Axes, session: Path, calibration: tumble.Calibration) -> None:
    """The scale factors by two methods, with their expanded uncertainty, about those of the first"""
    names = [f"{kind}.scale.{axis}" for kind in ("accel", "gyro") for axis in "xyz"]
    for shift, method in ((-0.1, "joint"), (0.1, "ellipsoid")):
        found = tumble.calibrate(session, method=method)
        differences = [found[name].value - calibration[name].value for name in names]
        expanded = [(found[name].k or 0.0) * (found[name].u or 0.0) for name in names]
        ppm = np.array([differences, expanded]) / 1e-6
        axes.errorbar(np.arange(len(names)) + shift, *ppm, fmt="o", capsize=3, label=method)
    axes.set_xticks(range(len(names)), names, rotation=30)
    axes.set(ylabel="ppm")
    axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def check(axes: Axes, second: Path, calibration: tumble.Calibration) -> None:
    """Whether the calibration holds in another launch"""
    found = tumble.check_calibration(calibration, second)
    axes.axhspan(-found.rest_limit, found.rest_limit, color="0.93", linewidth=0)
    axes.plot(range(1, len(found.rests) + 1), [rest.sigmas for rest in found.rests], "o")
    axes.set(xlabel="rest of the second launch", ylabel="(g − |f|) / u")


def corrected(axes: Axes, second: Path, calibration: tumble.Calibration) -> None:
    """What the correction does to a recording"""
    observations, found = tumble.inspect_session(second).observations, tumble.check_calibration(calibration, second)
    before = observations.site.gravity - np.linalg.norm(observations.rests.accel, axis=1)
    number = np.arange(1, len(found.rests) + 1)
    axes.plot(number, 1e3 * before, "o", label="as recorded")
    axes.plot(number, [1e3 * rest.difference for rest in found.rests], "o", label="corrected")
    axes.set(xlabel="rest of the second launch", ylabel="g − |f|, mm/s²")
    axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def noise(axes: Axes, session: Path) -> None:
    """The noise of the gyros in the longest rest"""
    gyros = tumble.noise(session).panels[1]
    axes.loglog(gyros.deviation.tau, np.degrees(gyros.deviation.deviation) * 3600.0)
    axes.set(xlabel="averaging time, s", ylabel="Allan deviation, °/h")


PICTURES: tuple[Callable[..., None], ...] = (
    recording,
    residuals,
    parameters,
    check,
    corrected,
    noise,
)


def page() -> str:
    """The page: each picture under its title, with its source."""
    return HEAD + "".join(map(_section, PICTURES))


def _section(draw: Callable[..., None]) -> str:
    lines = inspect.getsource(draw).splitlines()[2:]
    code = textwrap.dedent("\n".join(lines))
    picture = f"../pictures/gallery-{draw.__name__}.svg"
    return f"\n## {draw.__doc__}\n\n![{draw.__doc__}]({picture})\n\n```python\n{code}\n```\n"


def draw_all(folder: Path) -> None:
    """Draw the pictures into a folder."""
    request = tumble.Setup.of(grade="mems", positions=15)
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        session, second = (tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2))
        known = {"session": session, "second": second, "calibration": tumble.calibrate(session)}
        for draw in PICTURES:
            figure = Figure(figsize=(6.4, 3.0), layout="constrained")
            draw(
                figure.add_subplot(),
                **{name: known[name] for name in inspect.signature(draw).parameters if name in known},
            )
            figure.savefig(folder / f"gallery-{draw.__name__}.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    mpl.rcParams.update(STYLE)
    if "--short" in sys.argv:
        with tempfile.TemporaryDirectory() as target:
            draw_all(Path(target))
    else:
        draw_all(DOCS / "pictures")
        (DOCS / "howto/gallery.md").write_text(page(), encoding="utf-8")
    print(f"{len(PICTURES)} pictures drawn")
