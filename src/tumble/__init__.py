"""tumble: calibration of strapdown inertial measurement units from recordings made on rough equipment.

The way the data go
    session.toml + log → Session, Log → rests and turns → Observations → method → Estimate → Calibration

Conventions, for every module
    units     SI and radians inside; a name that is not SI carries its unit (`latitude_deg`)
    frames    b  body X, Y, Z, fixed by the accelerometers (see `model`)
              n  geographic N (north), U (up), E (east), right-handed in the order N, U, E
              s  sensor: one coordinate a sensor
    vectors   `vec_a` is resolved in frame a; `mat_ab` takes coordinates in b to a
    model     reading = matrix @ true + bias; matrix n×3 = diag(1 + k) A(γ), Eq. (1) of the turntable paper
    gravity   an accelerometer at rest with its axis up reads +g; g is positive, m/s²
    samples   a sample is the mean over the interval that ends at its time stamp
    u         standard uncertainty (k = 1)

Symbols used as names where an equation is printed
    S   matrix of a block                u   direction of the vertical in the body, a unit vector
    C   rotation of a turn, body at its end → body at its start
    M   ∫ C ⊗ ω dt, B   ∫ C dt           sensitivities of a turn to gyro matrix and bias
    k   scale-factor error               γ   axis angle        Ω   Earth's rate
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from tumble.result.shown import Views, shown_by

if TYPE_CHECKING:
    from tumble.campaigns.run import CampaignResult as CampaignResult
    from tumble.campaigns.run import FleetResult as FleetResult
    from tumble.campaigns.run import campaign as campaign
    from tumble.campaigns.run import fleet as fleet
    from tumble.drafting.draft import Draft as Draft
    from tumble.drafting.new_session import new_session as new_session
    from tumble.earth import normal_gravity as normal_gravity
    from tumble.errors import CalibrationError as CalibrationError
    from tumble.errors import InputError as InputError
    from tumble.errors import LogError as LogError
    from tumble.errors import MissingExtraError as MissingExtraError
    from tumble.errors import ProgrammeError as ProgrammeError
    from tumble.errors import SessionError as SessionError
    from tumble.errors import TumbleError as TumbleError
    from tumble.export import export_calibration as export_calibration
    from tumble.export.exported import Exported as Exported
    from tumble.inference.estimate import Estimate as Estimate
    from tumble.inference.estimate import Fit as Fit
    from tumble.inference.estimate import Outcome as Outcome
    from tumble.methods.ellipsoid_fit import EllipsoidFit as EllipsoidFit
    from tumble.methods.ellipsoid_fit import fit_ellipsoid as fit_ellipsoid
    from tumble.planning.best_positions import PlanResult as PlanResult
    from tumble.planning.best_positions import plan as plan
    from tumble.planning.bounds import Bound as Bound
    from tumble.planning.bounds import bound as bound
    from tumble.planning.budget import Budget as Budget
    from tumble.planning.budget import budget as budget
    from tumble.planning.requirements import Requirements as Requirements
    from tumble.planning.requirements import require as require
    from tumble.planning.setup import Setup as Setup
    from tumble.programme.positions import Programme as Programme
    from tumble.programme.positions import programme_of as programme_of
    from tumble.recording.arrays import session_of_arrays as session_of_arrays
    from tumble.recording.description import description_of as description_of
    from tumble.recording.log import Chunk as Chunk
    from tumble.recording.log import Log as Log
    from tumble.recording.log import open_log as open_log
    from tumble.recording.session import Session as Session
    from tumble.recording.session_file import read_session as read_session
    from tumble.recording.session_file import session_of as session_of
    from tumble.recording.session_file import write_session as write_session
    from tumble.reduction.noise.allan_deviation import allan_deviation as allan_deviation
    from tumble.reduction.observations import Observations as Observations
    from tumble.registry.adding import add_calibration as add_calibration
    from tumble.registry.due import Due as Due
    from tumble.registry.due import due as due
    from tumble.registry.monitor import Monitored as Monitored
    from tumble.registry.monitor import monitored as monitored
    from tumble.registry.records import records as records
    from tumble.registry.series import device_launches as device_launches
    from tumble.registry.series import type_spread as type_spread
    from tumble.registry.store.connect import Registry as Registry
    from tumble.registry.store.connect import open_registry as open_registry
    from tumble.registry.types import Record as Record
    from tumble.result.calibration import Calibration as Calibration
    from tumble.result.calibration import read_calibration as read_calibration
    from tumble.result.parts import Launch as Launch
    from tumble.result.parts import Member as Member
    from tumble.result.parts import Parameter as Parameter
    from tumble.result.parts import RestResult as RestResult
    from tumble.result.parts import TurnResult as TurnResult
    from tumble.run.calibrate import calibrate as calibrate
    from tumble.run.from_readings import ReadingsCalibration as ReadingsCalibration
    from tumble.run.from_readings import calibrate_table as calibrate_table
    from tumble.run.launches import Run as Run
    from tumble.run.launches import calibrate_launches as calibrate_launches
    from tumble.run.launches import mean_of_launches as mean_of_launches
    from tumble.run.observed import Observed as Observed
    from tumble.run.observed import inspect_session as inspect_session
    from tumble.run.quiet_samples import RecordedNoise as RecordedNoise
    from tumble.run.quiet_samples import noise as noise
    from tumble.run.together import calibrate_together as calibrate_together
    from tumble.run.type_spread import KnownLaunches as KnownLaunches
    from tumble.run.type_spread import TypeSpread as TypeSpread
    from tumble.selftest import run_selftest as run_selftest
    from tumble.sensors.model import Block as Block
    from tumble.sensors.model import SensorModel as SensorModel
    from tumble.simulation.session import simulate_session as simulate_session
    from tumble.use.apply import apply_to_session as apply_to_session
    from tumble.use.apply import rest_residuals as rest_residuals
    from tumble.use.check import FieldCheck as FieldCheck
    from tumble.use.check import check_calibration as check_calibration
    from tumble.use.compare import Comparison as Comparison
    from tumble.use.compare import compare_calibrations as compare_calibrations
    from tumble.use.verify import Positions as Positions
    from tumble.use.verify import Verification as Verification
    from tumble.use.verify import positions_of as positions_of
    from tumble.use.verify import verify_calibration as verify_calibration
    from tumble.views.report.write import write_report as write_report
    from tumble.views.sheet import write_sheet as write_sheet

__version__ = "0.1.0"

_PUBLIC = {
    "Session": "recording.session",
    "read_session": "recording.session_file",
    "session_of": "recording.session_file",
    "write_session": "recording.session_file",
    "session_of_arrays": "recording.arrays",
    "description_of": "recording.description",
    "open_log": "recording.log",
    "Log": "recording.log",
    "Chunk": "recording.log",
    "Block": "sensors.model",
    "SensorModel": "sensors.model",
    "Observations": "reduction.observations",
    "Calibration": "result.calibration",
    "read_calibration": "result.calibration",
    "Parameter": "result.parts",
    "Launch": "result.parts",
    "Member": "result.parts",
    "RestResult": "result.parts",
    "TurnResult": "result.parts",
    "Estimate": "inference.estimate",
    "Outcome": "inference.estimate",
    "Fit": "inference.estimate",
    "EllipsoidFit": "methods.ellipsoid_fit",
    "fit_ellipsoid": "methods.ellipsoid_fit",
    "calibrate": "run.calibrate",
    "Observed": "run.observed",
    "inspect_session": "run.observed",
    "Run": "run.launches",
    "calibrate_launches": "run.launches",
    "mean_of_launches": "run.launches",
    "calibrate_together": "run.together",
    "calibrate_table": "run.from_readings",
    "ReadingsCalibration": "run.from_readings",
    "Comparison": "use.compare",
    "compare_calibrations": "use.compare",
    "FieldCheck": "use.check",
    "check_calibration": "use.check",
    "Positions": "use.verify",
    "Verification": "use.verify",
    "positions_of": "use.verify",
    "verify_calibration": "use.verify",
    "apply_to_session": "use.apply",
    "rest_residuals": "use.apply",
    "RecordedNoise": "run.quiet_samples",
    "noise": "run.quiet_samples",
    "new_session": "drafting.new_session",
    "Draft": "drafting.draft",
    "Exported": "export.exported",
    "export_calibration": "export",
    "write_report": "views.report.write",
    "Registry": "registry.store.connect",
    "open_registry": "registry.store.connect",
    "add_calibration": "registry.adding",
    "records": "registry.records",
    "due": "registry.due",
    "Due": "registry.due",
    "monitored": "registry.monitor",
    "Monitored": "registry.monitor",
    "Record": "registry.types",
    "KnownLaunches": "run.type_spread",
    "TypeSpread": "run.type_spread",
    "device_launches": "registry.series",
    "type_spread": "registry.series",
    "simulate_session": "simulation.session",
    "Setup": "planning.setup",
    "Budget": "planning.budget",
    "budget": "planning.budget",
    "Bound": "planning.bounds",
    "bound": "planning.bounds",
    "Requirements": "planning.requirements",
    "require": "planning.requirements",
    "PlanResult": "planning.best_positions",
    "plan": "planning.best_positions",
    "Programme": "programme.positions",
    "programme_of": "programme.positions",
    "write_sheet": "views.sheet",
    "CampaignResult": "campaigns.run",
    "FleetResult": "campaigns.run",
    "campaign": "campaigns.run",
    "fleet": "campaigns.run",
    "run_selftest": "selftest",
    "allan_deviation": "reduction.noise.allan_deviation",
    "normal_gravity": "earth",
    "TumbleError": "errors",
    "InputError": "errors",
    "CalibrationError": "errors",
    "LogError": "errors",
    "ProgrammeError": "errors",
    "SessionError": "errors",
    "MissingExtraError": "errors",
}
"""Where each public name is; type checkers see the imports above."""

__all__ = ["__version__", *sorted(_PUBLIC)]


if not TYPE_CHECKING:  # with it type checkers would take any name for one of the module

    def __getattr__(name: str) -> Any:
        """Public names are imported when they are first used: the command line starts without NumPy."""
        if name not in _PUBLIC:
            raise AttributeError(f"module 'tumble' has no attribute {name!r}")
        return getattr(import_module(f"tumble.{_PUBLIC[name]}"), name)


shown_by(lambda: cast("Views", import_module("tumble.views.calibration")))


def __dir__() -> list[str]:
    """The public names, imported or not."""
    return __all__
