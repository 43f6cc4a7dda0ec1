"""Thresholds of the search for rests and bad samples, in one record, so that a study can vary them.

Noise floors and resolutions are derived from the recording and are no thresholds. Every field has a description and a
reason: a derivation, or, for a value chosen by hand, the study that varies it (`studies/tuning.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from tumble.units import DEGREE, G_STANDARD

BY_HAND = "chosen by hand; swept by studies/tuning.py"
_UNITS = {"°": DEGREE, "°/s": DEGREE, "°/K": DEGREE, "°/s/g": DEGREE / G_STANDARD}  # SI


def _threshold(value: float, unit: str, words: str, why: str = BY_HAND) -> Any:
    """Return a field with its default in a unit, a description and the reason for the value."""
    size = value * _UNITS[unit] if unit in _UNITS else value
    return field(default=size, metadata={"value": value, "unit": unit, "words": words, "why": why})


@dataclass(frozen=True, kw_only=True, slots=True)
class Tuning:
    """Thresholds in SI units."""

    # fmt: off

    # rests
    window: float = _threshold(1.0, "s", "averaging time of the means and scatters that distinguish rest from motion")
    floor_factor: float = _threshold(
        5.0, "", "largest distance of the rate from its level at rest, in noise floors",
        BY_HAND + "; the floor is clipped at the same multiple")
    scatter_factor: float = _threshold(10.0, "", "largest scatter of the accelerometers at rest, in noise floors")
    quiet_factor: float = _threshold(
        2.0, "", "largest scatter of the accelerometers, in noise floors, in blocks that show the gyro level")
    quiet_share: float = _threshold(0.1, "", "least fraction of a recording at rest: noise floors start there")
    edge: float = _threshold(4.0, "", "distance of a block, in standard deviations of a rest, at which the rest ends")
    step_beyond: float = _threshold(
        7.0, "", "change of a reading within a rest, in standard deviations of all such changes, that divides it",
        "3e-12 of Gaussian changes; below 1e-5 a rest where 24 changes give the deviation")
    rest: float = _threshold(2.0, "s", "shortest rest between its margins")
    fewest_blocks: int = _threshold(2, "", "fewest blocks of a rest", "a covariance needs two")
    margin_fraction: float = _threshold(0.05, "", "margin at each end, as a fraction of a quiet stretch")
    margin_least: float = _threshold(0.2, "s", "smallest margin")
    margin_most: float = _threshold(1.0, "s", "largest margin")
    tilt: float = _threshold(2.0, "°", "largest motion of the vertical in a rest")
    tilt_per_kelvin: float = _threshold(
        0.1, "°/K", "additional motion per kelvin of temperature change", "1.7 mg/K: biases of the poorest sensors")
    short_rest: float = _threshold(0.6, "s", "shortest rest in a recording of short rests")
    short_samples: int = _threshold(40, "", "fewest samples of such a rest", "1/√(2·40): their noise is known to 11 %")
    short_window: float = _threshold(0.5, "s", "averaging time in such a recording")
    short_margin: float = _threshold(0.1, "s", "smallest margin in such a recording")
    fewest_short: int = _threshold(9, "", "additional rests that make a recording one of short rests")
    few_share: float = _threshold(0.02, "", "least fraction at rest of a recording that is mostly motion")
    moment: float = _threshold(0.2, "s", "shortest moment of rest that is reported if there is no rest", "two blocks")
    # the level of the gyros at rest
    level_blocks: int = _threshold(10, "", "fewest blocks of a stretch that shows the gyro level")
    level_spread: float = _threshold(
        20.0, "°/s", "largest difference of the gyro level between attitudes, or at a jump",
        "the biases of the poorest sensors")
    vertical_moves: float = _threshold(
        1.0 / 3.0, "", "largest motion of the vertical in a rest off the level, relative to a turn at that rate")
    vertical_stays: float = _threshold(0.05, "°", "motion of the vertical that is always accepted")
    g_sensitivity: float = _threshold(
        1.0, "°/s/g", "usual dependence of the gyro level on attitude", "ten times that of a MEMS unit")
    level_drift: float = _threshold(1.0, "°/s", "usual drift of the gyro level over half a log, and usual jump")
    level_attitudes: int = _threshold(
        6, "", "fewest stretches for a level that depends on attitude alone",
        "four unknowns per axis, and two more: a rest on each of six faces")
    level_stretches: int = _threshold(
        8, "", "fewest stretches for a level that depends on time",
        "five unknowns per axis, and three more")
    level_share: float = _threshold(2.0 / 3.0, "", "least fraction of all stretches that follow this dependence")
    level_gain: float = _threshold(0.2, "", "least additional fraction that follow it, compared with a simpler one")
    beside_jump: int = _threshold(
        2, "", "fewest stretches on either side of a jump", "one alone may be a turn about the vertical")
    level_uncertainty: float = _threshold(
        2.0, "", "largest uncertainty of a predicted level, relative to that of a single level")
    # bad samples in rests
    side: float = _threshold(1.0, "s", "time before and after a block with which it is compared")
    longest_blemish: float = _threshold(
        0.3, "s", "longest run of blocks with bad samples", "most of both sides is sound")
    block_beyond: float = _threshold(
        12.0, "", "distance of a block with a bad sample, in standard deviations of blocks",
        "Student's t of 18 degrees of freedom: in an hour of 6 channels a false one with 1e-4")
    sides_agree: float = _threshold(
        4.0, "", "largest difference of the means of both sides, in standard errors",
        "Gaussian: with six channels 4e-4 of all blocks are not tested")
    sample_beyond: float = _threshold(
        6.0, "", "distance of a bad sample in such a block, in standard deviations of samples", "Gaussian: 2e-9 of all")
    brief: float = _threshold(
        0.03, "s", "longest total duration of bad samples", "no body turns and comes to rest again so fast")
    # bad samples in turns
    band: float = _threshold(0.25, "s", "time before and after a sample that gives the band of a channel")
    band_samples: int = _threshold(
        12, "", "fewest samples of the band on either side", "the largest of 24 is two standard deviations")
    band_beyond: float = _threshold(
        4.0, "", "distance of a bad sample from the cubic through its neighbours, in bands",
        "Gaussian: of 24 samples a side 1.5e-8 by chance, 0.03 in an hour of turns at 100 Hz, of 12 a side 4e-6")
    noise_beyond: float = _threshold(
        9.0, "", "the same, in standard deviations of a sample at rest",
        "6.5 of its own, 2e-4 in an hour at 100 Hz; a smaller one changes the integral of n samples by 9/√n of its u")
    steps_beyond: float = _threshold(3.0, "", "the same, in steps of the resolution", "rounding makes 1.3 at most")
    alone: float = _threshold(
        30.0, "", "ratio of the distance in one channel to those in the others of its kind that makes it bad",
        "of blows in random directions, one of 600 is along an axis to 1/30 rad")
    violent_velocity: float = _threshold(
        0.5, "m/s", "change of velocity in a sample that makes several channels bad", "no hand does, nor a table")
    violent_angle: float = _threshold(0.1, "", "the same for the attitude, rad", "no hand does, nor a table")
    longest_run: int = _threshold(3, "", "longest run of equal bad samples", "a longer run may be a blow")
    # held samples, and samples out of range
    held_share: float = _threshold(0.2, "", "fraction of a log, at rest, in which channels may repeat by chance")
    fewest_clipped: int = _threshold(
        2, "", "samples at the end of a converter that exclude a turn", "a single one may just have reached it")
    # fmt: on

    @property
    def rest_seconds(self) -> int:
        """Duration to lie still, whole s, that leaves a rest between its margins."""
        return math.ceil(self.rest + 2.0 * self.margin_least)

    def margin_of(self, duration: float) -> float:
        """Return the margin, s, at each end of a stretch of this duration, s, that borders on motion."""
        return max(self.margin_least, min(self.margin_fraction * duration, self.margin_most))


USUAL = Tuning()  # of every recording outside of studies
