"""Steps from a session to its observations, and the faults found in them.

    session → log → blocks → rests and turns → observations → (programme) → observations of its positions

`inspect_session` returns all rests found, `observations_for_calibration` those of the session's programme.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from tumble.advice import Advised
from tumble.arguments import checked
from tumble.brief import Judged
from tumble.diagnosis.carried_vertical import vertical_faults
from tumble.diagnosis.channels import (
    accelerometer_faults,
    channel_faults,
    dead_zones,
    high_passed,
    mixed_rows,
    normalised,
)
from tumble.diagnosis.verdict import no_rests
from tumble.errors import SessionError
from tumble.files import FilePath
from tumble.inference.estimate import Judgement, Outcome
from tumble.inference.hyperparameters import size_factors
from tumble.inference.mended_samples import with_mended_samples
from tumble.recording.log import Chunk, Log, open_log
from tumble.recording.session import Circumstances, Session
from tumble.recording.session_file import session_from
from tumble.reduction.blocks.reducer import FileBlocks, Reduction, reduce_log
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.observations import Observations, hold_attitude, observe, split_warming_rests
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import match_rests, without_jump, without_numbered, without_times
from tumble.reduction.rests.rests import thermometers_of
from tumble.reduction.rests.segmentation import Segmentation, Stretch, find_rests, gap_between
from tumble.reduction.turns.links import links_of
from tumble.reduction.turns.turns import clipping_limits, torn_turns, without_ambiguous_turns
from tumble.rotation import onto_body
from tumble.run.from_estimate import origin_of
from tumble.sensors.grades import GRADES, guessed_grade
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import prior_sizes, usual_sizes
from tumble.units import DEGREE, IntArray

OTHER_GRADE_NOISE = 10.0  # ratio to the usual white noise of a grade; within a grade noise differs by a factor of 3
REJECTED_RESTS_RATIO = 2  # rests rejected by the gyros per rest found, above which the gyros are faulty
LARGEST_SQUARED = 1e100  # SI; sums of products of larger numbers overflow
FEWEST_RESTS = 9  # below this number rests alone do not determine accelerometers
SHORTEST_MOTION = 20.0  # s; a shorter motion determines nothing
TREMOR = 0.07 * DEGREE  # rad/s rms about an axis over tenths of a second; a hand trembles by more
Progress = Callable[[Log], Iterable[Chunk]]
"""Function that yields the chunks of a log, for instance to show the progress of reading."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Observed(Judged):
    """Rests, turns and faults of a session's log.

    `segmentation` has rests and turns, found and rejected, `observations` those found, None if nothing rests. `faults`
    are sentences on the recording, `gyro_faults` on the gyros, which are left out then, and `gyro_bias_faults` on their
    biases. `notes` are remarks on the times of the log."""

    json_fields: ClassVar = ("verdict", "reasons", "gyro", "rate", "segmentation", "observations")

    session: Session
    log: Log
    reduction: Reduction
    segmentation: Segmentation
    observations: Observations | None
    faults: tuple[str, ...]
    gyro_faults: tuple[str, ...] = ()
    gyro_bias_faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def sha256(self) -> str:
        """SHA-256 of the log's content."""
        return self.log.sha256()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Faults of the recording."""
        return self.faults

    @property
    def gyro(self) -> Judgement:
        """Judgement on the gyros."""
        return Judgement(reasons=(*self.faults, *self.gyro_faults, *self.gyro_bias_faults))

    @property
    def circumstances(self) -> Circumstances:
        """Circumstances of the session, with the date of the log if it states none."""
        stated = self.session.circumstances
        return stated if stated.date is not None else replace(stated, date=self.log.recorded)

    @property
    def rate(self) -> float:
        """Sample rate, Hz."""
        return self.reduction.rate

    @property
    def origin(self) -> dict[str, Any]:
        """Log, sample rate and circumstances, as fields of `Provenance`."""
        return origin_of(self.sha256) | {"sample_rate": self.rate, "circumstances": self.circumstances}


@checked
def inspect_session(
    session: Session | FilePath, *, progress: Progress = Log.chunks, tuning: Tuning = USUAL
) -> Observed:
    """Find the rests and turns of a session, without matching them to its programme, and faults of the recording.

    Parameters
    ----------
    session
        A session, or the path of its folder.
    progress
        See `calibrate`.
    tuning
        Thresholds.

    Raises
    ------
    InputError
        If the session or its log cannot be read.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> found = tumble.inspect_session(folder)
    >>> len(found.segmentation.rests), found.faults
    (4, ())
    """
    described = session_from(session).of_known_scales()
    log = open_log(described)
    reduction = reduce_log(log, described.accel_block, described.gyro_block, progress(log), tuning)
    return _inspected(log, described, reduction)


def _inspected(log: Log, session: Session, reduction: Reduction) -> Observed:
    """Find rests, turns and faults in a reduced log, once more without its gyros if they are faulty."""
    as_read, accel_block = reduction, session.accel_block
    of_accel, of_gyros = channel_faults(reduction, session.log)
    faults = (
        [fault.sentence for fault in of_accel]
        or [*accelerometer_faults(reduction, session)]
        or [*mixed_rows(reduction, session.log)]
    )
    with np.errstate(over="ignore", invalid="ignore"):  # in a wrong unit, or of damaged samples
        reduction = without_blemishes(reduction)
        segmentation, rejected = _rests_of_sensors(reduction, session)
        faults = faults or [*normalised(reduction, segmentation.rests, onto_body(accel_block.axes))]
        files, last = len(reduction.files), max((each.file or 1 for each in session.excluded), default=1)
        if last > files:
            raise SessionError(f"session.toml: exclude.file: expected a file from 1 to {files}, found {last}")
        segmentation = without_times(reduction, segmentation, session.excluded)
        segmentation = replace(segmentation, stated_rate=session.log.rate)
        if session.gyro_block is not None and session.log.gyro is not None:
            clipped = [fault.sensor for fault in of_gyros if fault.clipped]
            reduction = without_ambiguous_turns(
                reduction, segmentation.rests, session.gyro_block, session.log.gyro, clipped
            )
            enough = len(clipped) == len(of_gyros) and _suffices(reduction, segmentation, clipped)
            if of_gyros and not (faults or enough):
                alone = _inspected(log, session.without_gyros(), _of_accelerometers(as_read))
                sentences = tuple(fault.sentence for fault in of_gyros)
                if alone.observations is not None and not alone.faults:
                    return replace(alone, gyro_faults=sentences)
                faults = list(sentences)
        observations = _observed(session, reduction, segmentation.rests)
        # with gyros in a wrong unit no turn is fast enough for a rest to be found
        trial = observations
        if trial is None and not faults:
            trial = _observed(session, reduction, find_rests(reduction, accel_block, None).rests)
    gyro_faults = list[str]()
    if trial is not None and not faults:
        by_grade = usual_sizes(grade_of(session, trial)[0], session.device.prior)
        faults, lost = vertical_faults(trial, session, reduction.rate, by_grade["gyro.g_sensitivity"])
        if lost and trial is observations:
            rests = segmentation.rests
            gaps = [gap_between(rests[i], rests[i + 1], 1, "no rotation", why) for i, why in lost.items()]
            reduction = replace(reduction, gaps=(*reduction.gaps, *gaps))
            observations = _observed(session, reduction, segmentation.rests)
        if faults or rejected:
            gyro_faults = [*high_passed(reduction, segmentation.rests)]
            if rejected and not (faults or gyro_faults):
                gyro_faults = [rejected]
        if gyro_faults:
            faults, _ = vertical_faults(trial.of_accelerometers(), session, reduction.rate, 0.0)
    if session.log.gyro is not None and not faults and not gyro_faults:
        gyro_faults = [*dead_zones(reduction, segmentation.rests, session.log.gyro)]
    return Observed(
        session=session,
        log=log,
        reduction=reduction,
        segmentation=segmentation,
        observations=observations,
        faults=tuple(faults),
        gyro_faults=tuple(gyro_faults),
        gyro_bias_faults=() if faults else segmentation.jumped(),
        notes=(*log.notes, *(fault.sentence for fault in of_gyros if not faults)),
    )


def _rests_of_sensors(reduction: Reduction, session: Session) -> tuple[Segmentation, str]:
    """Return the rests of a log, and a fault of the gyros if these read another rate in most of the rests of the
    accelerometers, which are then returned; else an empty sentence."""
    segmentation = find_rests(reduction, session.accel_block, session.gyro_block)
    found, few = len(segmentation.rests), reduction.tuning.level_attitudes
    if session.log.gyro is None or not 0 < found < few:
        return segmentation, ""
    by_accel = find_rests(reduction, session.accel_block, None)
    more = len(by_accel.rests) - found
    if more <= max(REJECTED_RESTS_RATIO * found, few):
        return segmentation, ""
    return by_accel, (
        f"the gyros read another rate in {more} of {len(by_accel.rests)} rests of the accelerometers, and why cannot "
        "be told: look at the rests with `tumble inspect`"
    )


def _of_accelerometers(reduction: Reduction) -> Reduction:
    """Return the reduction of the accelerometers alone."""
    files = list[FileBlocks]()
    for file in reduction.files:
        gyro = file.gyro
        none = replace(gyro, means=gyro.means[:, :0], ends=gyro.ends[:, :0], tail_total=gyro.tail_total[:0])
        files.append(replace(file, gyro=none))
    return replace(reduction, files=tuple(files), gyro_channels=(), samples=None)


def _suffices(reduction: Reduction, segmentation: Segmentation, clipped: list[int]) -> bool:
    """Return True if gyros of which some are `clipped` are sound in all rests and in enough turns.

    A turn determines n − 1 combinations of the n gyros, because the heading after it is not known, and each gyro has
    a scale factor and two angles. A recording of motion with few rests must be sound as a whole."""
    rests, files, n = segmentation.rests, reduction.by_file, len(reduction.gyro_channels)
    if len(rests) < FEWEST_RESTS:
        return False
    low, high = clipping_limits(reduction, clipped)
    for rest in rests:
        readings = files[rest.file].gyro.ends[rest.first : rest.last]
        if ((readings <= low) | (readings >= high)).any():
            return False
    sound = sum(before.file == after.file for before, after in pairwise(rests)) - len(torn_turns(rests, reduction.gaps))
    return (n - 1) * sound >= 3 * n


def grade_of(session: Session, observations: Observations) -> tuple[str, str]:
    """Return the grade of a session's device, and the evidence if it was guessed, or "" if it was stated.

    It is guessed if none is stated, or if the recording contradicts the stated grade: the guess is a poorer grade, and
    the noise exceeds OTHER_GRADE_NOISE times that of the stated grade, or gyro biases are too large for it."""
    rests, links = observations.rests, observations.links
    white = {  # median noise density, SI/√Hz: at rest, or in motion without rests
        kind: float(np.median(noise))
        for kind, noise in (("accel", rests.accel_noise), ("gyro", rests.gyro_noise))
        if noise.size
    }
    if links is not None and not len(rests):
        white = {"accel": links.accel_density**0.5, "gyro": links.gyro_density**0.5}
    bias = float(np.abs(np.median(rests.gyro, axis=0)).max()) if "gyro" in white and len(rests) else 0.0
    guess, because = guessed_grade(white["accel"], white.get("gyro"), bias)
    stated, order = session.device.grade, list(GRADES)
    if stated is None:
        return guess, because
    kind = "gyro" if "gyro" in white else "accel"
    noisier = white[kind] > OTHER_GRADE_NOISE * getattr(grade_named(stated).noise, f"{kind}_white")
    poorer = order.index(guess) > order.index(stated)
    return (guess, because) if poorer and (noisier or because != "the noise") else (stated, "")


def with_grade(session: Session, observations: Observations) -> Observations:
    """Return the observations with the sizes of parameter groups and in-run biases usual for the grade of the
    device."""
    grade, guessed_from = grade_of(session, observations)
    sheet, noise = session.device.prior, grade_named(grade).noise
    sizes, usual = prior_sizes(grade, sheet), usual_sizes(grade)
    note = f"errors other than bias, scale factor and axis angles have the size usual for the grade {grade}"
    if guessed_from:
        note = Advised(f"{note}, guessed from {guessed_from}", "state another as [device] grade")
    basis = f"{'guessed' if guessed_from else 'stated'} grade {grade}"
    return replace(
        observations,
        usual=sizes,
        size_basis={name: "data sheet" if name in sheet else basis for name in sizes},
        too_small=size_factors(grade, sizes, sheet, guessed=bool(guessed_from)),
        in_run={"accel": noise.accel_instability, "gyro": noise.gyro_instability},
        drift={kind: usual[f"{kind}.bias.drift"] for kind in ("accel", "gyro") if f"{kind}.bias.drift" not in sizes},
        notes=(*observations.notes, note),
    )


def _observed(session: Session, reduction: Reduction, rests: tuple[Stretch, ...]) -> Observations | None:
    """Return the observations of rests; None without rests, or for numbers beyond LARGEST_SQUARED."""
    channels = (*reduction.accel_channels, *reduction.gyro_channels)
    if not rests or max(max(-each.minimum, each.maximum) for each in channels) > LARGEST_SQUARED:
        return None
    return observe(reduction, rests, session.accel_block, session.gyro_block, session.site)


def observations_for_calibration(
    observed: Observed, *, joint: bool = False, motion: bool = True
) -> Observations | Outcome:
    """Return the positions of a session's programme (all rests without one), or an Outcome with the reason for none.

    For the method `joint` these include gyros whose biases jump, the magnetometer and, if `motion`, the motion of a
    device with few rests. Faulty gyros are left out. Raises ProgrammeError for a recording that does not follow the
    programme."""
    if joint and motion and (moving := _in_motion(observed)) is not None:
        return moving
    matched = _matched(observed)
    if isinstance(matched, Outcome):
        return matched
    reduction, match, torn = matched
    if joint and observed.gyro_bias_faults:
        reduction = without_jump(reduction, match, observed.session.gyro_block)
    observations = _observed_again(observed, reduction, match, torn)
    if observed.gyro_faults or (observed.gyro_bias_faults and not joint):
        observations = observations.of_accelerometers()
    return observations if joint else observations.without_magnetometer()


def _in_motion(observed: Observed) -> Observations | None:
    """Return the observations from node to node of a recording with few or no rests; None for other recordings.

    A device that was shaken in place is described by rests: neither a few harmonics nor a smooth process can follow
    shaking from node to node, especially if it is aliased. Pauses in the hand are no rests: the device has a velocity,
    and nodes describe its constant place better."""
    session, segmentation = observed.session, observed.segmentation
    faulty = observed.faults or observed.gyro_faults or observed.gyro_bias_faults
    n_rests = len(segmentation.rests) + len(segmentation.shaken)
    if session.programme is not None or session.log.gyro is None or faulty or n_rests >= FEWEST_RESTS:
        return None
    reduction, match = without_numbered(observed.reduction, segmentation, session.excluded)
    spans, notes = match.rests, tuple[str, ...]()
    links = links_of(reduction, spans)
    trembling = [reduction.by_file[span.file].gyro.means[span.first : span.last].var(axis=0).mean() for span in spans]
    if links and spans and np.median(trembling) > TREMOR**2 + 2.0 * links.gyro_density / reduction.block_seconds:
        notes = (Advised(f"held in the hand in {len(spans)} pauses, which are no rests", "put it down in them"),)
        spans, links = (), links_of(reduction, ())
    if links is None or links.duration.sum() < SHORTEST_MOTION:
        return None
    if links.bad_samples:
        several = "s" if links.bad_samples > 1 else ""
        notes += (f"{links.bad_samples} bad sample{several} in motion, far off the rest: half a second each left out",)
    observations = observe(reduction, spans, session.accel_block, session.gyro_block, session.site, links=links)
    thermometers = thermometers_of(reduction) if any(f.temperature is not None for f in reduction.files) else None
    return replace(observations, thermometers=thermometers, notes=(*observed.notes, *notes, *observations.notes))


def observations_in_parts(observed: Observed, least: int = 1) -> tuple[Observations, IntArray] | Outcome:
    """Return the observations with rests that warm cut into `least` or more parts, and the rest number of each part."""
    matched = _matched(observed)
    if isinstance(matched, Outcome):
        return matched
    reduction, match_of_rests, torn = matched
    match, numbers = split_warming_rests(reduction, match_of_rests, least)
    return hold_attitude(_observed_again(observed, reduction, match, torn)), numbers


def _observed_again(
    observed: Observed, reduction: Reduction, match: Segmentation, torn: tuple[str, ...]
) -> Observations:
    """Return the observations of matched rests, with mended samples and notes on the turns that are left out."""
    session, out = observed.session, observed.observations
    if out is None or match.rests != observed.segmentation.rests or reduction is not observed.reduction:
        arrays = None if out is None or observed.gyro_bias_faults else out.arrays
        out = observe(reduction, match.rests, session.accel_block, session.gyro_block, session.site, arrays)
    notes = (*observed.notes, *out.notes, *torn)
    out = replace(out, programme=match.programme, position=match.position, notes=notes, turns_left_out=torn)
    return with_mended_samples(out).with_blow_variances()


def _matched(observed: Observed) -> tuple[Reduction, Segmentation, tuple[str, ...]] | Outcome:
    """Return the reduction without excluded turns, the rests of a session's programme (without one, all rests), and
    notes on incomplete turns."""
    session = observed.session
    if observed.faults:
        return Outcome(reasons=observed.faults)
    match = match_rests(session, observed.reduction, observed.segmentation)
    if not match.rests:
        return no_rests(observed.segmentation)
    reduction, match = without_numbered(observed.reduction, match, session.excluded)
    return reduction, match, torn_turns(match.rests, reduction.gaps) if session.gyro_block is not None else ()
