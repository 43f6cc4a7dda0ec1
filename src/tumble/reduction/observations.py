"""Observations: the rests and turns of a log, which are all that an estimation method uses.

A rest is its mean reading with covariance. A turn is its preintegrated rotation with the sensitivities to the gyro
parameters, in the non-rotating frame of the body at its start, so that attitude, site and Earth's rate do not enter.
With E the relative error of the gyro matrix and δ the error of the gyro bias in the model of the integration,

    C(E, δ) = exp([−(M : E + B δ)×]) C,      M[i,p,q] = ∫ C_ip ω_q dt,   B = ∫ C dt.

A large update has a second-order effect, so turns are integrated again about the updated model
(`Observations.turns_about`); rests do not change.

Source: the rotation part of the preintegration of velocity and rotation increments (Lupton & Sukkarieh 2012,
Forster et al. 2017) with body-frame sensors and the two-sample coning term.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, ClassVar, TypeVar

import numpy as np

from tumble.advice import Advised, prefixed
from tumble.brief import Brief
from tumble.programme.positions import Programme
from tumble.recording.session import Site
from tumble.reduction.blocks.reducer import Reduction, extremes
from tumble.reduction.noise.rounding import Rounding, rounding_notes
from tumble.reduction.rests.blemishes import BadSamples, bad_sample_notes, blemish_notes
from tumble.reduction.rests.rests import Rests, reduced_rests, rows_of, thermometers_of
from tumble.reduction.rests.segmentation import Segmentation, Stretch, gap_between
from tumble.reduction.rests.sway import sway_of
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.rests.warming import warming_of
from tumble.reduction.turns.array_motion import ArrayMoments, array_moments
from tumble.reduction.turns.links import Links, is_linked
from tumble.reduction.turns.moments import NO_OWN_AXES, Compensation, Moments, OwnAxes, growing_moments, integrate
from tumble.reduction.turns.turns import (
    TurnReadings,
    Turns,
    TurnSamples,
    aliased_rotations,
    linear_compensation,
    reduced_turns,
    turn_readings,
)
from tumble.rotation import onto_body, unit_vector
from tumble.sensors.model import Block, SensorModel
from tumble.units import DEGREE, G_STANDARD, Array, IntArray

BLOW = 2.0 * G_STANDARD  # m/s²: the smallest full scale of accelerometers, beyond which a sample may hide clipping
COSINE_ALIKE = np.cos(10.0 * DEGREE)  # verticals, or attitudes by a turn, within 10° are one
WARMED = 1.0  # K: temperature change from which a rest is divided
SHORTEST_PART = 20.0  # s: a shorter part has too few blocks for the noise of its mean
MAX_PARTS = 60  # of a rest: the duration of the estimate grows with their number
PART_ROTATION = 1e-6  # rad per axis: motion of a support from one part of a rest to the next
_Arrays = TypeVar("_Arrays", Rests, Turns, TurnReadings)


def one_direction(vectors: Array) -> bool:
    """Return True if there are vectors (N, n) and all have the direction of the first."""
    directions = unit_vector(vectors)
    return bool(len(directions)) and bool((directions @ directions[0]).min() >= COSINE_ALIKE)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Together:
    """Sessions whose rests and turns are in one record of observations.

    `names`: of the sessions. `session`: index of the session of each rest (N,), ascending. `number`: number of each
    rest in its session (N,), from 0, which parts of a rest share."""

    names: tuple[str, ...]
    session: IntArray
    number: IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Observations(Brief):
    """The rests and turns of a session, with everything an estimation method uses besides them."""

    json_fields: ClassVar = ("rests", "turns", "notes")

    accel_block: Block
    gyro_block: Block | None
    site: Site
    rests: Rests
    turns: Turns | None = None
    turn_samples: TurnSamples | None = None
    programme: Programme | None = None
    position: IntArray | None = None  # position of each rest in the programme (N,), if there is one
    start: Mapping[str, float] = field(default_factory=dict)  # start values of parameters, by name; zero for the others
    turn_readings: TurnReadings | None = None  # only for more than three gyros
    rounding: Mapping[str, Rounding] = field(default_factory=dict)  # resolution of the readings of "accel" and "gyro"
    notes: tuple[str, ...] = ()  # notes on the log for the user
    thermometers: Thermometers | None = None
    together: Together | None = None  # the sessions, if there are several
    arrays: tuple[ArrayMoments, ...] = ()  # for every session, the moments of an accelerometer array in motion
    by_clock: Mapping[str, float] = field(default_factory=dict)  # change of groups by one u of the time base
    turns_left_out: tuple[str, ...] = ()  # a sentence on each turn that was not recorded completely
    unstamped: bool = False  # whether the log has no time stamps, which would show missing samples
    usual: Mapping[str, float] = field(default_factory=dict)  # standard deviation over instruments, SI, by group
    size_basis: Mapping[str, str] = field(default_factory=dict)  # source of the usual size, in words, by group
    too_small: Mapping[str, float] = field(default_factory=dict)  # by which factor the usual size may be too small
    links: Links | None = None  # motion from node to node that is no turn between rests
    in_run: Mapping[str, float] = field(default_factory=dict)  # usual in-run bias, standard deviation, SI, by kind
    drift: Mapping[str, float] = field(default_factory=dict)  # usual drift in the in-run process, SI/s, by kind

    @property
    def session(self) -> IntArray | None:
        """Index of the session of each rest (N,), None for a single session."""
        return None if self.together is None else self.together.session

    @property
    def one_vertical(self) -> bool:
        """Whether the vertical in the body is the same at all rests."""
        return one_direction(self.rests.accel @ onto_body(self.accel_block.axes).T)

    @property
    def one_attitude(self) -> bool:
        """Whether the device always lay in one attitude, neither tilted nor turned about the vertical, so that the
        Earth's rate, constant in the body, cannot be separated from the gyro biases."""
        if self.links is not None or not self.one_vertical:
            return False
        if self.turns is None or not len(self.turns) or self.gyro_block is None:
            return True
        at_rest = replace(self.gyro_block.nominal(), bias=np.median(self.rests.gyro, axis=0))
        turns = self.turns if self.turn_samples is None else self.turns_about(at_rest)
        cosine = 0.5 * (np.trace(turns.C, axis1=1, axis2=2) - 1.0)
        return bool(cosine.min() >= COSINE_ALIKE)

    def rest_named(self, i: int) -> str:
        """Return the name of rest i: its number, with several sessions after the name of its session."""
        if self.together is None:
            return f"rest {i + 1}"
        return f"{self.together.names[self.together.session[i]]}: rest {self.together.number[i] + 1}"

    def turn_named(self, k: int) -> str:
        """Return the name of turn k: the rests at its ends, and its times."""
        turns, rests = self.turns, self.rests
        assert turns is not None
        a, b = int(turns.first[k]), int(turns.last[k])
        before, after = self.rest_named(a), self.rest_named(b).rpartition(": ")[2]
        return f"the turn from {before} to {after} ({rests.stop[a]:.1f}–{rests.start[b]:.1f} s)"

    def start_values(self, block: Block) -> Array:
        """Return the start values of the parameters of a block, in their order."""
        return np.array([self.start.get(name, 0.0) for name in block.names])

    def of_accelerometers(self) -> Observations:
        """Return the observations of the accelerometers alone: rests without gyros, and no turns."""
        rests, none = self.rests, np.zeros((len(self.rests), 0))
        covariance = np.zeros((len(rests), 0, 0))
        at_rest = replace(rests, gyro=none, gyro_covariance=covariance, gyro_drift=none, gyro_noise=none)
        return replace(self, gyro_block=None, rests=at_rest, turns=None, turn_samples=None, turn_readings=None)

    def without_magnetometer(self) -> Observations:
        """Return the observations without the magnetometer."""
        rests = replace(self.rests, magnetometer=None, magnetometer_covariance=None)
        links = None if self.links is None else replace(self.links, magnetometer=None)
        return replace(self, rests=rests, links=links)

    def of_rest(self, i: int) -> Observations:
        """Return the observations of rest i alone."""
        return replace(
            self, rests=rows_of(self.rests, slice(i, i + 1)), turns=None, turn_samples=None, turn_readings=None,
            programme=None, position=None, arrays=(),
        )  # fmt: skip

    @property
    def _samples(self) -> TurnSamples:
        if self.turns is None or self.turn_samples is None:
            raise ValueError("moments: expected observations of a log with gyros and turns, found none")
        return self.turn_samples

    def moments_about(self, compensation: Compensation | Sequence[Compensation], own: OwnAxes = NO_OWN_AXES) -> Moments:
        """Return the moments of the turns about one compensation, or one for each turn."""
        return integrate(self._samples.pieces(), len(self._samples.lengths), compensation, own)

    def growing_moments_about(self, compensation: Compensation) -> tuple[Array, Array]:
        """Return Φ and Ψ of the turns, weighted with the time from the middle of each (`growing_moments`)."""
        return growing_moments(self._samples.pieces(), self._samples.lengths, compensation)

    def with_bad_samples(self, bad: BadSamples) -> Observations:
        """Return observations in which exactly these samples of turns are replaced."""
        samples, gyro = replace(self._samples, bad=bad), self.gyro_block
        assert gyro is not None
        turns = replace(self, turn_samples=samples).turns_about(gyro.nominal())
        turns = replace(turns, aliased=aliased_rotations(samples, turns.covariance))
        return replace(self, turns=turns, turn_samples=samples)

    def with_blow_variances(self) -> Observations:
        """Return observations whose velocity covariances include the squares of the velocities that blows in the turns
        may hide, ∫ max(|f| − BLOW, 0) dt.

        A device that is put down hard stops within a sample or two. A sensor may then be at the end of its range, which
        a mean over a sample does not show, and its nonlinearity at 10 g is not that at 1 g: a blow does not determine
        the quadratic and cubic terms at rest."""
        if self.turns is None or self.turn_samples is None:
            return self
        hidden = np.zeros(len(self.turns))
        for turn, _, forces, intervals in self.turn_samples.by_piece():
            hidden[turn] += (np.maximum(np.linalg.norm(forces, axis=1) - BLOW, 0.0) * intervals).sum()
        covariance = self.turns.velocity_covariance + (hidden**2)[:, None, None] * np.eye(3)
        return replace(self, turns=replace(self.turns, velocity_covariance=covariance))

    def turns_about(self, gyro: SensorModel) -> Turns:
        """Return the turns integrated about a gyro model, where M and B are the sensitivities."""
        if self.turns is None or self.gyro_block is None:
            raise ValueError("turns_about: expected observations of a log with gyros and turns, found none")
        accel = self.accel_block
        moments = self.moments_about(linear_compensation(self.gyro_block, gyro, accel, accel.nominal()))
        return replace(self.turns, C=moments.C, M=moments.Phi[..., 1:4], B=moments.Phi[..., 0], jumps=moments.jumps)


def without_rests(links: Links, accel: Block, gyro: Block | None, site: Site) -> Observations:
    """Return the observations of a recording that has links only."""
    readings = {"accel": np.zeros((0, accel.size)), "gyro": np.zeros((0, 0 if gyro is None else gyro.size))}
    rests = Rests.of_white_noise(np.zeros(0), np.zeros(0), **readings, densities=(0.0, 0.0))
    if links.magnetometer is not None:
        rests = replace(rests, magnetometer=np.zeros((0, 3)), magnetometer_covariance=np.zeros((0, 3, 3)))
    none, square, places = np.zeros(0), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.int64)
    turns = Turns(
        first=places, last=places, duration=none, C=square, M=np.zeros((0, 3, 3, 3)), B=square, covariance=square,
        moment_ratio=none, velocity_covariance=square, jumps=none, aliased=none,
    )  # fmt: skip
    samples = TurnSamples(samples=links.samples.samples, start=places, stop=places)
    return Observations(
        accel_block=accel, gyro_block=gyro, site=site, rests=rests, turns=turns, turn_samples=samples, links=links
    )


def observe(
    reduction: Reduction,
    spans: tuple[Stretch, ...],
    accel: Block,
    gyro: Block | None,
    site: Site,
    arrays: tuple[ArrayMoments, ...] | None = None,
    links: Links | None = None,
) -> Observations:
    """Return all rests of a log, and the turns that were recorded completely.

    `spans` are the rests, at least one unless `links` between them are given, of a device that is moved
    (`tumble.reduction.turns.links.links_of`). `arrays` are moments of an array in motion, which do not depend on the
    rests, if already known."""
    if links is not None:
        gaps = [gap_between(a, b, 1, "links", why="") for a, b in pairwise(spans) if is_linked(a, b)]
        reduction = replace(reduction, gaps=(*reduction.gaps, *gaps))
        if not spans:
            return without_rests(links, accel, gyro, site)
    sway = None if gyro is None else sway_of(reduction, spans)
    rests, noise, rounded = reduced_rests(reduction, spans, accel, gyro, sway)
    notes, turns, turn_samples, readings = list[str](), None, None, None
    count = reduction.accel_channels[0].samples
    if reduction.held:
        notes.append(
            f"{reduction.held} of {count} samples ({100.0 * reduction.held / count:.2g} %) repeat the one before in "
            "every channel: they were held, or sent twice"
        )
    if reduction.lost:
        notes.append(f"long intervals leave room for {reduction.lost} lost samples among {count}")
    notes += blemish_notes(reduction, spans)
    if gyro is not None and reduction.samples is not None:
        if sway is not None:
            notes.append(
                Advised(
                    f"the device sways by {sway.angle / DEGREE:.2g}° in its rests, as in the hand; the gyros follow "
                    "it, so that turns are taken from mean attitude to mean attitude",
                    "put it down on something firm in each position: everything is known better, the biases of the "
                    "gyros most of all",
                )
            )
            rests = replace(rests, accel=rests.accel * (1.0 + sway.shortened)[:, None])
        turned = reduced_turns(reduction, reduction.samples, spans, rests, (accel, gyro), noise, rounded, sway)
        turns, turn_samples = turned
        notes += bad_sample_notes(turn_samples.bad, turns.first)
        if gyro.size > 3:
            readings = turn_readings(reduction, spans, turned, gyro, noise["gyro"], rounded["gyro"])
        if arrays is None:  # includes turns that are left out
            parts = [(f.first_sample, f.sample_at(len(f))) for f in reduction.files]
            limits = extremes(reduction.accel_channels), extremes(reduction.gyro_channels)
            at_rest = onto_body(gyro.axes) @ rests.gyro.mean(axis=0)
            moments = array_moments(reduction.samples, parts, (accel, gyro), limits, at_rest)
            arrays = () if moments is None else (moments,)
    return Observations(
        accel_block=accel,
        gyro_block=gyro,
        site=site,
        rests=rests,
        turns=turns,
        turn_samples=turn_samples,
        turn_readings=readings,
        arrays=arrays or (),
        links=links,
        rounding=rounded,
        notes=(*notes, *rounding_notes(rounded)),
        thermometers=None if rests.temperatures is None else thermometers_of(reduction),
    )


# Several sessions as one, and rests that warm up divided into parts: a rest is its mean reading at its mean
# temperature, so that it shows a temperature dependence only if it is divided. The parts are joined by turns of
# duration 0, which leave the attitude unchanged to PART_ROTATION.


def split_warming_rests(reduction: Reduction, whole: Segmentation, least: int = 1) -> tuple[Segmentation, IntArray]:
    """Divide each rest into one part per WARMED of temperature change, at least `least` if it is long enough. Return
    the parts in place of the rests, and the number (N,) of the rest that each part belongs to."""
    by_file, spans, number = reduction.by_file, list[Stretch](), list[int]()
    for i, span in enumerate(whole.rests):
        file, parts = by_file[span.file], 1
        if file.temperature is not None:
            kelvin = file.temperature[span.first : span.last]
            tenths = [part.mean(axis=0) for part in np.array_split(kelvin, min(10, len(kelvin)))]
            change = max(warming_of(kelvin), float(np.ptp(tenths, axis=0).max()))
            most = min(MAX_PARTS, int((span.stop - span.start) / SHORTEST_PART))
            parts = max(1, min(max(int(np.ceil(change / WARMED)), least), most))
        blocks = np.linspace(span.first, span.last, parts + 1).round().astype(int).tolist()
        times = [span.start, *file.edges[blocks[1:-1]].tolist(), span.stop]
        for (first, last), (start, stop) in zip(pairwise(blocks), pairwise(times), strict=True):
            spans.append(replace(span, first=first, last=last, start=start, stop=stop))
            number.append(i)
    position = None if whole.position is None else whole.position[number]
    return replace(whole, rests=tuple(spans), position=position), np.array(number, dtype=np.int64)


def join_sessions(sessions: Sequence[Observations], names: Sequence[str], numbers: Sequence[IntArray]) -> Observations:
    """Join the observations of sessions of one device at one place; `numbers` are for each session the numbers (N,) of
    its rests, which parts of a rest share."""
    counts = [len(session.rests) for session in sessions]
    rests, turns, readings = list[Rests](), list[Turns](), list[TurnReadings]()
    samples, records = list[tuple[int, TurnSamples]](), dict[int, tuple[float, Array]]()
    rounding = dict[str, Rounding]()  # by kind of sensor, from the first session which has it
    files_before = rests_before = turns_before = 0
    for session, count in zip(sessions, counts, strict=True):
        files = session.thermometers.files if session.thermometers is not None else {}
        rests.append(replace(session.rests, file=session.rests.file + files_before))
        records |= {file + files_before: record for file, record in files.items()}
        rounding = dict(session.rounding) | rounding
        if session.turns is not None:
            first, last = session.turns.first + rests_before, session.turns.last + rests_before
            turns.append(replace(session.turns, first=first, last=last))
            if session.turn_samples is not None:
                samples.append((turns_before, session.turn_samples))
                turns_before += len(session.turns)
        if session.turn_readings is not None:
            readings.append(session.turn_readings)
        files_before += 1 + max([int(session.rests.file.max()), *files])
        rests_before += count
    thermometers = all(session.thermometers is not None for session in sessions)
    return replace(
        sessions[0],
        rests=replace(_stacked(rests), magnetometer=None, magnetometer_covariance=None),
        turns=_stacked(turns) if turns else None,
        turn_samples=replace(samples[0][1], others=tuple(samples[1:])) if samples else None,
        turn_readings=_stacked(readings) if readings else None,
        arrays=tuple(moments for session in sessions for moments in session.arrays),
        programme=None,
        position=None,
        rounding=rounding,
        thermometers=Thermometers(files=records) if thermometers else None,
        notes=tuple(
            prefixed(f"{name}: ", note) for name, session in zip(names, sessions, strict=True) for note in session.notes
        ),
        turns_left_out=tuple(
            f"{name}: {turn}" for name, session in zip(names, sessions, strict=True) for turn in session.turns_left_out
        ),
        together=Together(
            names=tuple(names), session=np.repeat(np.arange(len(sessions)), counts), number=np.concatenate(numbers)
        ),
    )


def _stacked(parts: Sequence[_Arrays]) -> _Arrays:
    """Concatenate the rows of all parts; None for a field that is None in one of them."""
    columns = {field.name: [getattr(part, field.name) for part in parts] for field in fields(parts[0])}
    whole: dict[str, Any] = {k: None if any(v is None for v in c) else np.concatenate(c) for k, c in columns.items()}
    return replace(parts[0], **whole)


def extract_session(observations: Observations, rests: slice, turns: slice) -> Observations:
    """Return the observations of one session, with these rests and turns, out of several that were joined."""
    together, samples, readings = observations.together, observations.turn_samples, observations.turn_readings
    assert together is not None
    its_turns = None
    if observations.turns is not None and turns.stop > turns.start:
        its_turns = rows_of(observations.turns, turns)
        its_turns = replace(its_turns, first=its_turns.first - rests.start, last=its_turns.last - rests.start)
    if samples is not None:  # sessions are identified by their first turn
        samples = ({0: replace(samples, others=())} | dict(samples.others)).get(turns.start)
    return replace(
        observations,
        rests=rows_of(observations.rests, rests),
        turns=its_turns,
        turn_samples=None if its_turns is None else samples,
        turn_readings=None if its_turns is None or readings is None else rows_of(readings, turns),
        together=replace(together, session=together.session[rests], number=together.number[rests]),
    )


def hold_attitude(observations: Observations) -> Observations:
    """Return observations whose turns of duration 0 leave the attitude unchanged to PART_ROTATION."""
    turns = observations.turns
    if turns is None:
        return observations
    covariance = turns.covariance.copy()
    covariance[turns.duration == 0.0] = PART_ROTATION**2 * np.eye(3)
    return replace(observations, turns=replace(turns, covariance=covariance))
