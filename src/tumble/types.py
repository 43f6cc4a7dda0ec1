"""The types that stand in public signatures and are made by the library alone: for annotations and documentation.

from tumble.types import Device, Site
"""

from __future__ import annotations

from tumble.campaigns.campaign import Campaign as Campaign
from tumble.campaigns.summary import SummaryLine as SummaryLine
from tumble.diagnosis.observability import Refusal as Refusal
from tumble.drafting.new_session import Given as Given
from tumble.inference.estimate import GroupFinding as GroupFinding
from tumble.inference.estimate import HyperparameterEstimate as HyperparameterEstimate
from tumble.inference.estimate import Integral as Integral
from tumble.inference.estimate import Judgement as Judgement
from tumble.inference.estimate import ProcessBias as ProcessBias
from tumble.inference.likelihood import Linearised as Linearised
from tumble.inference.prediction import Prediction as Prediction
from tumble.methods.ellipsoid_fit import WorstPosition as WorstPosition
from tumble.methods.field_check import ChangedParameter as ChangedParameter
from tumble.methods.field_check import ParameterTest as ParameterTest
from tumble.planning.next_positions import NextPosition as NextPosition
from tumble.planning.next_positions import TurnTable as TurnTable
from tumble.planning.plan import PlannedGroup as PlannedGroup
from tumble.planning.plan import Requirement as Requirement
from tumble.programme.positions import Move as Move
from tumble.programme.positions import Position as Position
from tumble.recording.log_source import LogSource as LogSource
from tumble.recording.rows.gaps import Gap as Gap
from tumble.recording.rows.gaps import Grid as Grid
from tumble.recording.session import AutopilotSensor as AutopilotSensor
from tumble.recording.session import Circumstances as Circumstances
from tumble.recording.session import Device as Device
from tumble.recording.session import Exclusion as Exclusion
from tumble.recording.session import LogSpec as LogSpec
from tumble.recording.session import ProgrammeSpec as ProgrammeSpec
from tumble.recording.session import Site as Site
from tumble.reduction.blocks.reducer import Reduction as Reduction
from tumble.reduction.blocks.tuning import Tuning as Tuning
from tumble.reduction.noise.allan_deviation import AllanDeviation as AllanDeviation
from tumble.reduction.noise.rounding import Rounding as Rounding
from tumble.reduction.noise.wavelet_moments import Panel as Panel
from tumble.reduction.observations import Together as Together
from tumble.reduction.rests.rests import Rests as Rests
from tumble.reduction.rests.segmentation import Segmentation as Segmentation
from tumble.reduction.rests.thermometer import Thermometers as Thermometers
from tumble.reduction.turns.array_motion import ArrayMoments as ArrayMoments
from tumble.reduction.turns.moments import Compensation as Compensation
from tumble.reduction.turns.moments import Moments as Moments
from tumble.reduction.turns.moments import OwnAxes as OwnAxes
from tumble.reduction.turns.turns import TurnReadings as TurnReadings
from tumble.reduction.turns.turns import Turns as Turns
from tumble.reduction.turns.turns import TurnSamples as TurnSamples
from tumble.result.launch_variances import LaunchVariances as LaunchVariances
from tumble.result.parts import CalibratedDevice as CalibratedDevice
from tumble.result.parts import CalibratedTemperature as CalibratedTemperature
from tumble.result.parts import Readings as Readings
from tumble.result.parts import SensorsAtRest as SensorsAtRest
from tumble.result.parts import SourceContributions as SourceContributions
from tumble.result.uncertainty_budget import BudgetLine as BudgetLine
from tumble.run.readings_table import Nominal as Nominal
from tumble.run.readings_table import ReadingsTable as ReadingsTable
from tumble.sensors.compensation import Compensator as Compensator
from tumble.sensors.grades import NoiseModel as NoiseModel
from tumble.sensors.grades import Spread as Spread
from tumble.sensors.instrument import Instrument as Instrument
from tumble.simulation.scenario import Vibration as Vibration
from tumble.simulation.temperature_profile import TemperatureProfile as TemperatureProfile
from tumble.use.check import CheckedRest as CheckedRest
from tumble.use.compare import Difference as Difference
