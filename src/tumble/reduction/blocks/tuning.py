"""The thresholds of the search for rests and for bad samples, in one record, so that a study can sweep them.

Noise floors and resolutions follow from the recording itself and are no thresholds. Every field has its meaning in
words and a reason: a derivation, or, for a value chosen by hand, the study that moves it (`studies/tuning.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from tumble.units import DEGREE, G_STANDARD

BY_HAND = "chosen by hand; swept by studies/tuning.py"
_UNITS = {"°": DEGREE, "°/s": DEGREE, "°/K": DEGREE, "°/s/g": DEGREE / G_STANDARD}
"""SI values of the units that are shown."""


def _of(value: float, unit: str, words: str, why: str = BY_HAND) -> Any:
    """A field with its default in a unit, its meaning in words and the reason for the value."""
    size = value * _UNITS[unit] if unit in _UNITS else value
    return field(default=size, metadata={"value": value, "unit": unit, "words": words, "why": why})


@dataclass(frozen=True, kw_only=True, slots=True)
class Tuning:
    """Thresholds, SI."""

    # fmt: off

    # rests
    window: float = _of(1.0, "s", "means and scatters that tell rest from movement are taken over this time")
    floor_factor: float = _of(
        5.0, "", "distance of the rate from its level at rest, in noise floors",
        BY_HAND + "; the floor is clipped at as many")
    scatter_factor: float = _of(10.0, "", "scatter of the accelerometers at rest, in noise floors")
    quiet_factor: float = _of(
        2.0, "", "scatter of the accelerometers, in noise floors, where the level of the gyros is sought")
    quiet_share: float = _of(0.1, "", "part of the time of a recording that rests at least: noise floors start there")
    edge: float = _of(4.0, "", "a rest ends where a block is so many of its standard deviations off")
    rest: float = _of(2.0, "s", "the shortest rest between its margins")
    fewest_blocks: int = _of(2, "", "blocks of a rest at least", "a covariance needs two")
    margin_fraction: float = _of(0.05, "", "part of a quiet stretch that is its margin at each end")
    margin_least: float = _of(0.2, "s", "the least margin")
    margin_most: float = _of(1.0, "s", "the largest margin")
    tilt: float = _of(2.0, "°", "how far the vertical may move in a rest")
    tilt_per_kelvin: float = _of(
        0.1, "°/K", "how much farther for each K by which it warms or cools", "1.7 mg/K: biases of the poorest sensors")
    short_rest: float = _of(0.6, "s", "the shortest rest in a recording of short rests")
    short_samples: int = _of(40, "", "samples of such a rest at least", "1/√(2·40): their noise is known to 11 %")
    short_window: float = _of(0.5, "s", "the window in such a recording")
    short_margin: float = _of(0.1, "s", "the least margin in it")
    fewest_short: int = _of(9, "", "rests more than before that make it such a recording")
    few_share: float = _of(0.02, "", "the same of a recording in which no rest is found with that: it moves mostly")
    moment: float = _of(0.2, "s", "the shortest rest that is named where there is none", "two blocks")
    # the level of the gyros at rest
    level_blocks: int = _of(10, "", "blocks of a stretch at least that shows the level of the gyros")
    level_spread: float = _of(
        20.0, "°/s", "how far that level may be from that in another attitude, or after a jump",
        "the biases of the poorest sensors")
    vertical_moves: float = _of(
        1.0 / 3.0, "", "part of the angle of a turn that the vertical moves by at most where it is taken for none")
    vertical_stays: float = _of(0.05, "°", "angle by which the vertical may move in any case")
    g_sensitivity: float = _of(
        1.0, "°/s/g", "what is usual of a level that depends on attitude", "ten times that of a MEMS unit")
    level_drift: float = _of(1.0, "°/s", "what is usual of its drift over half a log, and of a jump")
    level_attitudes: int = _of(
        6, "", "stretches at least that show how the level depends on attitude alone",
        "four unknowns an axis, and two: a rest on each of six faces")
    level_stretches: int = _of(
        8, "", "stretches at least that show how the level depends on time",
        "five unknowns an axis, and three")
    level_share: float = _of(2.0 / 3.0, "", "part of all stretches that follow this dependence")
    level_gain: float = _of(0.2, "", "part more that follow it than a simpler one")
    beside_jump: int = _of(
        2, "", "stretches at least on either side of a jump", "one alone may be a turn about the vertical")
    level_uncertainty: float = _of(
        2.0, "", "uncertainty of a predicted level, in that of one, up to which it is a prediction")
    # bad samples in rests
    side: float = _of(1.0, "s", "a block is compared with this time before and after it")
    longest_blemish: float = _of(0.3, "s", "of blocks with bad samples in a row", "most of both sides is sound")
    block_beyond: float = _of(
        12.0, "", "by how many standard deviations of blocks a block with a bad sample is off",
        "Student's t of 18 degrees of freedom: in an hour of 6 channels a false one with 1e-4")
    sides_agree: float = _of(
        4.0, "", "by how many standard errors the means of both sides may differ",
        "Gaussian: with six channels 4e-4 of all are passed over")
    sample_beyond: float = _of(
        6.0, "", "by how many standard deviations of samples a bad one in such a block is off", "Gaussian: 2e-9 of all")
    brief: float = _of(
        0.03, "s", "bad samples together last at most so long", "no body turns and comes to rest again so fast")
    # bad samples in turns
    band: float = _of(0.25, "s", "the band of a channel is what it does in this time before and after a sample")
    band_samples: int = _of(
        12, "", "samples of the band at least on either side", "the largest of 24 is two standard deviations")
    band_beyond: float = _of(
        4.0, "", "by how many bands a bad sample is off the cubic through its neighbours",
        "Gaussian: of 24 samples a side 1.5e-8 by chance, 0.03 in an hour of turns at 100 Hz, of 12 a side 4e-6")
    noise_beyond: float = _of(
        9.0, "", "and by how many standard deviations of a sample at rest",
        "6.5 of its own, 2e-4 in an hour at 100 Hz; a smaller one changes the integral of n samples by 9/√n of its u")
    steps_beyond: float = _of(3.0, "", "and by how many steps of the resolution", "rounding makes 1.3 at most")
    alone: float = _of(
        30.0, "", "one channel is bad where it is off by so many times what others of its kind are",
        "a blow along an axis to 1/30 rad is one of 600 in any direction")
    violent_velocity: float = _of(
        0.5, "m/s", "several are bad where the velocity would change by more in a sample", "no hand does, nor a table")
    violent_angle: float = _of(0.1, "", "or the attitude, rad", "no hand does, nor a table")
    longest_run: int = _of(3, "", "times that a bad sample is held at most", "others in a row may be a blow")
    # held samples, and samples out of range
    held_share: float = _of(0.2, "", "part of a log in which channels are taken to repeat by chance, that at rest")
    fewest_clipped: int = _of(
        2, "", "samples at the end of a converter that leave a turn out", "a single one may just have reached it")
    # fmt: on

    @property
    def still(self) -> int:
        """The time to lie still, whole s, that leaves a rest between its margins."""
        return math.ceil(self.rest + 2.0 * self.margin_least)

    def margin_of(self, duration: float) -> float:
        """The margin, s, at each end of a stretch of this duration, s, that borders on movement."""
        return max(self.margin_least, min(self.margin_fraction * duration, self.margin_most))


USUAL = Tuning()
"""The thresholds of every recording outside of studies."""
