"""Exports: a calibration as other programs read it.

`export_calibration` makes the bytes; nothing is written. What a target cannot hold comes with them in sentences. Most
targets are templates, `targets/*.tmpl`; those of BUILT_IN need code. Other packages bring more (`tumble.plugins`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from tumble.arguments import checked
from tumble.errors import InputError, did_you_mean
from tumble.files import FilePath
from tumble.plugins import entry_points_of, load

if TYPE_CHECKING:
    from tumble.export.exported import Exported
    from tumble.export.kalibr import NoiseDensities
    from tumble.export.templates import Template
    from tumble.recording.session import Session
    from tumble.result.calibration import Calibration


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """A format that a calibration can be written in: `write` makes an `Exported` of an accepted calibration and of the
    options, by keyword, that are given; it `takes` options of these names and `needs` some of them; names of its files
    have an `ending`."""

    write: Callable[..., Exported]
    takes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    ending: str = ".txt"


def _from(module: str, function: str) -> Callable[..., Exported]:
    """A function of a module of this folder, which is imported when it is called."""

    def write(calibration: Calibration, **options: Any) -> Exported:
        exported: Exported = getattr(import_module(f"tumble.export.{module}"), function)(calibration, **options)
        return exported

    return write


BUILT_IN: Mapping[str, Target] = {
    "px4": Target(write=_from("autopilots", "px4"), takes=("imu",), ending=".params"),
    "px4-thermal": Target(write=_from("autopilots", "px4_thermal"), takes=("imu", "sensor_ids"), ending=".params"),
    "ardupilot": Target(write=_from("autopilots", "ardupilot"), takes=("imu",), ending=".parm"),
    "ardupilot-thermal": Target(write=_from("autopilots", "ardupilot_thermal"), takes=("imu",), ending=".parm"),
    "kalibr": Target(write=_from("kalibr", "kalibr"), takes=("noise",), ending=".yaml"),
    "c": Target(write=_from("c_header", "c_header"), ending=".h"),
    "json": Target(write=_from("tables", "json_file"), ending=".json"),
    "csv": Target(write=_from("tables", "csv_table"), ending=".csv"),
    "csv-thermal": Target(write=_from("tables", "csv_thermal"), ending=".csv"),
    "mat": Target(write=_from("tables", "mat"), ending=".mat"),
}
"""Targets that need code, by name."""

TEMPLATES = Path(__file__).with_name("targets")
"""Where the templates that come with tumble are."""


def targets() -> tuple[str, ...]:
    """Names of all targets: those that need code, the templates, and those of other packages.

    >>> from tumble.export import targets
    >>> targets()[:3]
    ('px4', 'px4-thermal', 'ardupilot')
    """
    templates = sorted(file.stem for file in TEMPLATES.glob("*.tmpl"))
    return (*dict.fromkeys([*BUILT_IN, *templates, *entry_points_of("exports")]),)


def target(name: str) -> Target:
    """The target of a name. Raises InputError for any other name."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    file = TEMPLATES / f"{name}.tmpl"
    if name and Path(name).name == name and file.is_file():
        return _of_template(file, name)
    brought = cast("Target | Path | None", load("exports", name, (Target, Path)))
    if brought is None:
        longer = next((each for each in targets() if name and each.startswith(name)), "")
        advice = did_you_mean(longer or name, targets())
        raise InputError(f"export: expected one of {', '.join(targets())}, found {name!r}{advice}")
    return brought if isinstance(brought, Target) else _of_template(brought, name)


def _of_template(file: Path, name: str | None = None) -> Target:
    from tumble.export.templates import read_template

    template: Template = read_template(file, name)
    takes = ("counts",) if template.front.counts is not None else ()
    return Target(write=template.write, takes=takes, ending=template.front.ending)


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

    Where the accelerometers or the gyros alone are accepted, they are written, and the others named as absent.

    Parameters
    ----------
    calibration
        One that was accepted, or its file.
    to
        The name of the target, one of `tumble.export.targets()`.
    template
        The file of a template of one's own instead (`tumble.export.templates`).
    noise
        For `kalibr`: noise densities, or a session whose longest rest shows them; those of the calibration's rests by
        default.
    imu
        For PX4 and ArduPilot: the number of the IMU whose parameters are to be written, from 1, where the recording
        does not say it.
    sensor_ids
        For `px4-thermal`: the device ids of accelerometer and gyro, where the recording does not say them.
    counts
        For targets that work in counts: how many a g and a °/s are, where the recording was not in counts.
    **further
        Options of targets that other packages bring.

    Returns
    -------
    Exported
        The content of the file, and what it cannot hold, in at most four notes.

    Raises
    ------
    InputError
        For a calibration that was not accepted or that the format has no place for, and for an option that the target
        does not take.

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
    chosen = _of_template(Path(template)) if template is not None else target(to or "")
    options = {"noise": noise, "imu": imu, "sensor_ids": sensor_ids, "counts": counts} | further
    chosen_options = {name: value for name, value in options.items() if value is not None}
    name = to or "a template"
    for option in chosen_options:
        if option not in chosen.takes:
            takes = " and ".join(map(_option, chosen.takes)) or "no options"
            raise InputError(f"export to {name}: expected {takes}, found {_option(option)}")
    for option in chosen.needs:
        if option not in chosen_options:
            raise InputError(f"export to {name}: expected {_option(option)}, found none")
    exported = chosen.write(calibration, **chosen_options)
    return replace(exported, losses=(*calibration.provenance.absent, *exported.losses))


def _option(name: str) -> str:
    """An option as the command line has it."""
    return f"--{name.replace('_', '-')}"
