"""From a session to its observations, and what is wrong on the way: the one chain that everything goes through.

    session → log → blocks → rests and turns → observations → (programme) → observations of its positions

A log is opened, read and reduced here and nowhere else. `inspect_session` takes every rest that was found;
`observations_for_calibration` takes those of the session's programme.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

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
from tumble.files import FilePath
from tumble.inference.estimate import Judgement, Outcome
from tumble.inference.mended_samples import with_mended_samples
from tumble.recording.log import Chunk, Log, open_log
from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Circumstances, Session
from tumble.recording.session_file import session_from
from tumble.reduction.blocks.reducer import Reduction, reduce_log
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import match_rests, without_jump, without_numbered, without_times
from tumble.reduction.rests.rests import thermometers_of
from tumble.reduction.rests.segmentation import Segmentation, Stretch, find_rests
from tumble.reduction.together import hold_attitude, split_warming_rests
from tumble.reduction.turns.links import links_of
from tumble.reduction.turns.turns import torn_turns, without_ambiguous_turns
from tumble.rotation import onto_body
from tumble.units import DEGREE, IntArray

Progress = Callable[[Log], Iterable[Chunk]]
"""Gives the chunks of a log, to show how far reading is or to keep samples on the way."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Observed(Judged):
    """What a session's log shows: the `digest` of its content, perhaps still on its way, the gaps that were bridged,
    the rests and turns that were found and rejected, and the observations of all of them (None where nothing rests);
    `faults`, in sentences, are what is wrong with the recording, `gyro_faults` what spoils the gyros alone, and
    `gyro_bias_faults` what spoils nothing but their biases. When it was `recorded`, ISO 8601, is by the log's own
    times; `notes` are what is remarkable in these.

    `trial` are the observations, or, where no rest was found with the gyros, those of the rests that the accelerometers
    alone show: in a wrong unit every turn is too slow to be one."""

    json_fields: ClassVar = ("verdict", "reasons", "gyro", "rate", "segmentation", "observations")

    session: Session
    digest: Future[str]
    gaps: tuple[Gap, ...]
    reduction: Reduction
    segmentation: Segmentation
    observations: Observations | None
    trial: Observations | None
    faults: tuple[str, ...]
    gyro_faults: tuple[str, ...] = ()
    gyro_bias_faults: tuple[str, ...] = ()
    recorded: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def sha256(self) -> str:
        """The SHA-256 of the log's content."""
        return self.digest.result()

    @property
    def reasons(self) -> tuple[str, ...]:
        """What is wrong with the recording."""
        return self.faults

    @property
    def gyro(self) -> Judgement:
        """Whether the gyros can be used."""
        return Judgement(reasons=(*self.faults, *self.gyro_faults, *self.gyro_bias_faults))

    @property
    def circumstances(self) -> Circumstances:
        """Those of the session, with the date of the log where it states none."""
        stated = self.session.circumstances
        return stated if stated.date is not None else replace(stated, date=self.recorded)

    @property
    def rate(self) -> float:
        """Sample rate, Hz."""
        return self.reduction.rate


MANY_LOST = 2
"""Times the rests: so many of the accelerometers that are none by the gyros say that these are at fault."""
LARGEST_SQUARED = 1e100
"""SI: of larger numbers sums of products are none."""


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
    with ThreadPoolExecutor(max_workers=1) as beside:
        return inspected(session_from(session).of_known_scales(), progress, beside, tuning)


def inspected(session: Session, progress: Progress, beside: Executor, tuning: Tuning = USUAL) -> Observed:
    """The same; the content of a log that was read is hashed `beside` what follows, which needs one core alone."""
    log = open_log(session)
    reduction = reduce_log(log, session.accel_block, session.gyro_block, progress(log), tuning)
    digest = beside.submit(log.sha256)
    faults = (
        channel_faults(reduction, session.log)
        or accelerometer_faults(reduction, session)
        or mixed_rows(reduction, session.log)
    )
    with np.errstate(over="ignore", invalid="ignore"):  # in a wrong unit, or of damaged samples
        reduction = without_blemishes(reduction)
        segmentation = find_rests(reduction, session.accel_block, session.gyro_block)
        lost = ""
        if session.log.gyro is not None and 0 < len(segmentation.rests) < reduction.tuning.level_attitudes:
            by_accel = find_rests(reduction, session.accel_block, None)
            more = len(by_accel.rests) - len(segmentation.rests)
            if more > max(MANY_LOST * len(segmentation.rests), reduction.tuning.level_attitudes):
                segmentation = by_accel
                lost = (
                    f"the gyros read another rate in {more} of {len(by_accel.rests)} rests of the accelerometers, and "
                    "why cannot be told: look at the rests with `tumble inspect`"
                )
        faults = faults or normalised(reduction, segmentation.rests, onto_body(session.accel_block.axes))
        segmentation = without_times(reduction, segmentation, session.excluded)
        segmentation = replace(segmentation, stated_rate=session.log.rate)
        if session.gyro_block is not None and session.log.gyro is not None:
            reduction = without_ambiguous_turns(reduction, segmentation.rests, session.gyro_block, session.log.gyro)
        observations = _observed(session, reduction, segmentation.rests)
        trial = observations
        if trial is None and not faults:
            trial = _observed(session, reduction, find_rests(reduction, session.accel_block, None).rests)
    of_gyros = list[str]()
    if trial is not None and not faults:
        faults = vertical_faults(trial, session, reduction.rate)
        if faults or lost:
            of_gyros = high_passed(reduction, segmentation.rests) or ([lost] if lost and not faults else [])
        if of_gyros:
            faults = vertical_faults(trial.of_accelerometers(), session, reduction.rate)
    if session.log.gyro is not None and not faults and not of_gyros:
        of_gyros = dead_zones(reduction, segmentation.rests, session.log.gyro)
    return Observed(
        session=session,
        digest=digest,
        gaps=log.gaps,
        reduction=reduction,
        segmentation=segmentation,
        observations=observations,
        trial=trial,
        faults=tuple(faults),
        gyro_faults=tuple(of_gyros),
        gyro_bias_faults=() if faults else segmentation.jumped(),
        recorded=log.recorded,
        notes=log.notes,
    )


def _observed(session: Session, reduction: Reduction, rests: tuple[Stretch, ...]) -> Observations | None:
    """The observations of all of these rests; None where there is none, or numbers that have no squares."""
    channels = (*reduction.accel_channels, *reduction.gyro_channels)
    if not rests or max(max(-each.minimum, each.maximum) for each in channels) > LARGEST_SQUARED:
        return None
    return observe(reduction, rests, session.accel_block, session.gyro_block, session.site)


def observations_for_calibration(observed: Observed, *, joint: bool = False) -> Observations | Outcome:
    """What a method sees of a session: the positions of its programme, or all rests where it has none; an Outcome where
    there is nothing to calibrate with.

    The method `joint` follows a device with few rests through its motion, and gyros whose biases jump, and takes the
    magnetometer in. For others gyros that jump are left out, as spoiled ones always are. Raises ProgrammeError for a
    recording that does not go through the programme.
    """
    if joint and (moving := _in_motion(observed)) is not None:
        return moving
    matched = _matched(observed)
    if isinstance(matched, Outcome):
        return matched
    reduction, match, torn = matched
    if joint and observed.gyro_bias_faults:
        reduction = without_jump(reduction, match, observed.session.gyro_block)
    every = _observed_again(observed, reduction, match, torn)
    spoiled = observed.gyro_faults or (observed.gyro_bias_faults and not joint)
    every = every.of_accelerometers() if spoiled else every
    return every if joint else every.without_magnetometer()


FEWEST_RESTS = 9
"""Fewer rests determine no accelerometers: then the motion between them counts too."""
SHORTEST_MOTION = 20.0
"""s: less motion determines nothing."""
TREMOR = 0.07 * DEGREE
"""rad/s, root mean square about an axis, of tenths of a second: a hand that holds a device still trembles by more."""


def _in_motion(observed: Observed) -> Observations | None:
    """The observations of a recording with few rests or none, from node to node; None of others.

    A device that was shaken where it lay is one with rests: shaking is no displacement that a few harmonics or a smooth
    process follow from node to node, least of all one that is aliased. Nor does one rest that pauses in the hand: it
    has velocities, and stays where it was, which nodes tell better than a rest."""
    session, segmentation = observed.session, observed.segmentation
    spoiled = observed.faults or observed.gyro_faults or observed.gyro_bias_faults
    rests = len(segmentation.rests) + len(segmentation.shaken)
    if session.programme is not None or session.log.gyro is None or spoiled or rests >= FEWEST_RESTS:
        return None
    reduction, match = without_numbered(observed.reduction, observed.segmentation, session.excluded)
    spans, notes, links = match.rests, tuple[str, ...](), links_of(reduction, match.rests)
    trembling = [reduction.by_file[span.file].gyro.means[span.first : span.last].var(axis=0).mean() for span in spans]
    if links and spans and np.median(trembling) > TREMOR**2 + 2.0 * links.gyro_density / reduction.block_seconds:
        notes = (f"held in the hand in {len(spans)} pauses, which are no rests; put it down in them",)
        spans, links = (), links_of(reduction, ())
    if links is None or links.duration.sum() < SHORTEST_MOTION:
        return None
    if links.bad_samples:
        several = "s" if links.bad_samples > 1 else ""
        notes += (f"{links.bad_samples} bad sample{several} in motion, far off the rest: half a second each left out",)
    every = observe(reduction, spans, session.accel_block, session.gyro_block, session.site, links=links)
    thermometers = thermometers_of(reduction) if any(f.temperature is not None for f in reduction.files) else None
    return replace(every, thermometers=thermometers, notes=(*observed.notes, *notes, *every.notes))


def observations_in_parts(observed: Observed, least: int = 1) -> tuple[Observations, IntArray] | Outcome:
    """The same with rests that warm in parts, each in so many at `least`, and the number of the rest that each part is
    of."""
    matched = _matched(observed)
    if isinstance(matched, Outcome):
        return matched
    reduction, match_of_rests, torn = matched
    match, numbers = split_warming_rests(reduction, match_of_rests, least)
    return hold_attitude(_observed_again(observed, reduction, match, torn)), numbers


def _observed_again(
    observed: Observed, reduction: Reduction, match: Segmentation, torn: tuple[str, ...]
) -> Observations:
    """The observations of these rests and turns, made anew where they are others, with mended samples and notes
    of the turns that are left out."""
    session, again = observed.session, observed.observations
    if again is None or match.rests != observed.segmentation.rests or reduction is not observed.reduction:
        arrays = None if again is None or observed.gyro_bias_faults else again.arrays
        again = observe(reduction, match.rests, session.accel_block, session.gyro_block, session.site, arrays)
    notes = (*observed.notes, *again.notes, *torn)
    again = replace(again, programme=match.programme, position=match.position, notes=notes, turns_left_out=torn)
    return with_mended_samples(again).with_blow_variances()


def _matched(observed: Observed) -> tuple[Reduction, Segmentation, tuple[str, ...]] | Outcome:
    """The rests of a session's programme, or all, the reduction without the turns that are left out, and notes of those
    that were not recorded as a whole."""
    session = observed.session
    if observed.faults:
        return Outcome(reasons=observed.faults)
    match = match_rests(session, observed.reduction, observed.segmentation)
    if not match.rests:
        return no_rests(observed.segmentation)
    reduction, match = without_numbered(observed.reduction, match, session.excluded)
    return reduction, match, torn_turns(match.rests, reduction.gaps) if session.gyro_block is not None else ()
