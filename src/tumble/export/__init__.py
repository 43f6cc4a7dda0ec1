"""Exports: calibrations in the formats of other programs.

`export_calibration` returns the bytes of the file, and sentences on what the format cannot hold. Most targets are
templates, `targets/*.tmpl`; those of BUILT_IN need code. Other packages can add targets (`tumble.plugins`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from tumble.arguments import checked
from tumble.documents import text_of_document, toml_of
from tumble.errors import InputError, did_you_mean
from tumble.files import FilePath
from tumble.plugins import entry_points_of, load

if TYPE_CHECKING:
    from tumble.export.exported import Exported
    from tumble.export.kalibr import NoiseDensities
    from tumble.recording.session import Session
    from tumble.result.calibration import Calibration


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """A format that a calibration can be written in.

    `write` returns the `Exported` of an accepted calibration, with keyword options named in `takes`, of which those in
    `needs` are required. `about` describes the format in a few words; files have the suffix `ending`."""

    write: Callable[..., Exported]
    about: str = ""
    takes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    ending: str = ".txt"


def _call(function: str, *arguments: Any, **options: Any) -> Exported:
    """Call a function, "module.name" in this folder, which is imported now."""
    module, _, name = function.partition(".")
    exported: Exported = getattr(import_module(f"tumble.export.{module}"), name)(*arguments, **options)
    return exported


BUILT_IN: Mapping[str, Target] = {
    name: Target(write=partial(_call, function), about=about, ending=ending, takes=tuple(takes))
    for name, function, about, ending, *takes in (
        ("px4", "autopilots.px4", "PX4: parameter file for QGroundControl", ".params", "imu"),
        ("px4-thermal", "autopilots.px4_thermal", "PX4: offsets over temperature", ".params", "imu", "sensor_ids"),
        ("ardupilot", "autopilots.ardupilot", "ArduPilot: parameter file for Mission Planner", ".parm", "imu"),
        ("ardupilot-thermal", "autopilots.ardupilot_thermal", "ArduPilot: offsets over temperature", ".parm", "imu"),
        ("kalibr", "kalibr.kalibr", "Kalibr and OpenVINS: kalibr_imu_chain.yaml", ".yaml", "noise"),
        ("c", "c_header.c_header", "C and C++: header with functions", ".h"),
        ("json", "tables.json_file", "correction with its formula", ".json"),
        ("csv", "tables.csv_table", "table of all parameters with covariance", ".csv"),
        ("csv-thermal", "tables.csv_thermal", "table of parameters over temperature", ".csv"),
        ("mat", "tables.mat", "MATLAB and GNU Octave: MAT-file, version 5", ".mat"),
    )
}
"""Targets that need code, by name."""

TEMPLATES = Path(__file__).with_name("targets")
"""Folder of the templates that come with tumble."""
FENCE = "+++\n"
"""Line before and after the front matter of a template."""


def targets() -> tuple[str, ...]:
    """Return the names of all targets: those that need code, the templates, and those of other packages.

    >>> from tumble.export import targets
    >>> targets()[:3]
    ('px4', 'px4-thermal', 'ardupilot')
    """
    templates = sorted(file.stem for file in TEMPLATES.glob("*.tmpl"))
    return (*dict.fromkeys([*BUILT_IN, *templates, *entry_points_of("exports")]),)


def described_targets() -> Iterator[tuple[str, str]]:
    """Yield the names of all targets with a few words on each: those of a template are its `about`."""
    for name in targets():
        try:
            yield name, target(name).about
        except InputError:
            yield name, "cannot be loaded"


def target(name: str) -> Target:
    """Return the target with a name. Raises InputError for any other name."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    file = TEMPLATES / f"{name}.tmpl"
    is_template = name != "" and Path(name).name == name and file.is_file()
    found = file if is_template else load("exports", name, (Target, Path))
    if found is None:
        lower = name.lower()
        longer = next((each for each in targets() if name and each.startswith(lower)), name)
        advice = did_you_mean("c" if lower in ("arduino", "esp32", "stm32") else longer, targets())
        raise InputError(f"--to: expected one of {', '.join(targets())}, found {name!r}{advice}")
    return _template_target(found, name) if isinstance(found, Path) else cast(Target, found)


def split_template(text: str, name: str) -> tuple[dict[str, Any], str]:
    """Return the front matter of a template and its body. Raises InputError without a front matter."""
    front, fence, body = text.removeprefix(FENCE).partition(f"\n{FENCE}")
    if not text.startswith(FENCE) or not fence:
        raise InputError(f"{name}: expected a front matter of TOML between two lines +++, found none")
    return toml_of(front, name), body


def _template_target(file: Path, name: str) -> Target:
    """Return the target that a template describes; what else is in the template is checked when it is written."""
    front, _ = split_template(text_of_document(file), name)
    return Target(
        write=partial(_call, "templates.write_template", file, name),
        about=str(front.get("about", "")),
        takes=("counts",) if "counts" in front else (),
        ending=str(front.get("ending", ".txt")),
    )


@checked
def export_calibration(
    calibration: Calibration | FilePath,
    to: str | None = None,
    *,
    template: FilePath | None = None,
    noise: NoiseDensities | Session | FilePath | None = None,
    imu: int | None = None,
    sensor_ids: tuple[int, int] | None = None,
    counts: tuple[float, float] | None = None,
    **further: Any,
) -> Exported:
    """Export a calibration in the format of another program.

    If only the accelerometers or only the gyros are accepted, these are exported and the others named as absent.

    Parameters
    ----------
    calibration
        An accepted calibration, or its file.
    to
        The name of the target, one of `tumble.export.targets()`.
    template
        The file of your own template instead (`tumble.export.templates`).
    noise
        For `kalibr`: noise densities, or a session from whose longest rest they are estimated; default: from the rests
        of the calibration.
    imu
        For PX4 and ArduPilot: the number, from 1, of the IMU whose parameters are written, if the recording has none.
    sensor_ids
        For `px4-thermal`: the device ids of accelerometer and gyro, if the recording has none.
    counts
        For targets that work in counts: counts per g and per °/s, if the recording was not in counts.
    **further
        Options of targets of other packages.

    Returns
    -------
    Exported
        The content of the file, and at most four notes on what it cannot hold.

    Raises
    ------
    InputError
        For a calibration that was not accepted or that the format cannot hold, and for an option that the target does
        not take.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> exported = tumble.export_calibration(tumble.calibrate(folder), "csv")
    >>> exported.content.splitlines()[0].split(b",")[0]
    b'# device mems-1'
    """
    from tumble.result.accepted import accepted_part
    from tumble.result.calibration import calibration_from

    if (to is None) == (template is None):
        stated = "neither" if to is None else "both"
        raise InputError(f"export: expected --to with the name of a target, or --template with a file, found {stated}")
    calibration = accepted_part(calibration_from(calibration))
    chosen = _template_target(Path(template), str(template)) if template is not None else target(to or "")
    options = {"noise": noise, "imu": imu, "sensor_ids": sensor_ids, "counts": counts} | further
    chosen_options = {name: value for name, value in options.items() if value is not None}
    name = to or "a template"
    for option in chosen_options:
        if option not in chosen.takes:
            takes = " and ".join(map(_option_name, chosen.takes)) or "no options"
            raise InputError(f"export to {name}: expected {takes}, found {_option_name(option)}")
    for option in chosen.needs:
        if option not in chosen_options:
            raise InputError(f"export to {name}: expected {_option_name(option)}, found none")
    exported = chosen.write(calibration, **chosen_options)
    origin = calibration.provenance
    return replace(exported, losses=(*origin.absent, *origin.doubts, *exported.losses))


def _option_name(name: str) -> str:
    """Return an option as on the command line."""
    return f"--{name.replace('_', '-')}"
