"""The public names and where each is: type checkers read this file, and `tumble/__init__.py` imports from it."""

from tumble.campaigns.campaign import campaign as campaign
from tumble.campaigns.fleet import fleet as fleet
from tumble.drafting.new_session import new_session as new_session
from tumble.earth import normal_gravity as normal_gravity
from tumble.errors import InputError as InputError
from tumble.errors import MissingExtraError as MissingExtraError
from tumble.errors import TumbleError as TumbleError
from tumble.export import export_calibration as export_calibration
from tumble.export.exported import Exported as Exported
from tumble.inference.estimate import Outcome as Outcome
from tumble.planning.plan import Plan as Plan
from tumble.planning.plan import plan as plan
from tumble.planning.setup import Setup as Setup
from tumble.programme.positions import Programme as Programme
from tumble.programme.positions import programme_of as programme_of
from tumble.recording.session import Session as Session
from tumble.recording.session_file import read_session as read_session
from tumble.recording.session_file import session_of as session_of
from tumble.recording.session_file import write_session as write_session
from tumble.reduction.noise.allan_deviation import allan_deviation as allan_deviation
from tumble.result.calibration import Calibration as Calibration
from tumble.result.calibration import read_calibration as read_calibration
from tumble.result.parts import Parameter as Parameter
from tumble.run.calibrate import calibrate as calibrate
from tumble.run.from_readings import calibrate_readings as calibrate_readings
from tumble.run.launches import calibrate_launches as calibrate_launches
from tumble.run.observed import Observed as Observed
from tumble.run.observed import inspect_session as inspect_session
from tumble.run.quiet_samples import noise_of as noise_of
from tumble.run.together import calibrate_together as calibrate_together
from tumble.sensors.model import SensorModel as SensorModel
from tumble.simulation.session import simulate_session as simulate_session
from tumble.use.apply import apply_to_session as apply_to_session
from tumble.use.check import FieldCheck as FieldCheck
from tumble.use.check import check_calibration as check_calibration
from tumble.use.compare import Comparison as Comparison
from tumble.use.compare import compare_calibrations as compare_calibrations
from tumble.use.corrector import Corrected as Corrected
from tumble.use.corrector import Corrector as Corrector
from tumble.use.stream import check_stream as check_stream
from tumble.views.report.document import write_report as write_report
from tumble.views.sheet import write_sheet as write_sheet

__version__: str
__all__: list[str]
