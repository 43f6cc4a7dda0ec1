"""A campaign and a fleet, each in one call: read, computed or resumed, and summed up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tumble.brief import Brief
from tumble.campaigns.campaign import Campaign, read_campaign, run_campaign
from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Progress
from tumble.campaigns.fleet import Tally, run_fleet, sessions_of, tally
from tumble.campaigns.summary import SummaryLine, summary, write_summary
from tumble.files import FilePath
from tumble.run.calibrate import Method

SUMMARY_FILE = "summary.csv"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class CampaignResult(Brief):
    """The rows of a campaign, a Parquet file, their summary in lines, and the CSV file it is in."""

    rows: Path
    lines: tuple[SummaryLine, ...]
    summary: Path


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class FleetResult(Brief):
    """The rows of a fleet, a Parquet file, its sessions, and how they ended."""

    rows: Path
    sessions: tuple[str, ...]
    tally: Tally


def campaign(
    planned: Campaign | FilePath,
    out: FilePath,
    *,
    serial: bool = False,
    cluster: str | None = None,
    workers: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> CampaignResult:
    """Simulate and calibrate many times over the grid of a campaign, or of its TOML file, into a folder; what is there
    already is not computed again. `serial`, `cluster` and `workers` say where, as `executor_for`.

    >>> import tumble
    >>> from pathlib import Path
    >>> _ = Path("campaign.toml").write_text('seed = 1\\ntrials = 2\\n[grid]\\nmethod = "staged"\\ngrade = "mems"\\n')
    >>> tumble.campaign("campaign.toml", "results", serial=True).rows.name
    'rows.parquet'
    """
    known, folder = planned if isinstance(planned, Campaign) else read_campaign(Path(planned)), Path(out)
    with executor_for(serial=serial, cluster=cluster, workers=workers) as executor:
        rows = run_campaign(known, folder, executor=executor, progress=progress)
    lines = summary(rows)
    write_summary(lines, folder / SUMMARY_FILE)
    return CampaignResult(rows=rows, lines=lines, summary=folder / SUMMARY_FILE)


def fleet(
    sessions: FilePath,
    out: FilePath,
    *,
    method: Method = "joint",
    serial: bool = False,
    cluster: str | None = None,
    workers: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> FleetResult:
    """Calibrate all sessions that a glob matches or a manifest lists, with a row for each, into a folder; what is there
    already is not computed again. A session that cannot be calibrated does not stop the others: its row says why.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> for seed in (1, 2):
    ...     _ = tumble.simulate_session(f"sessions/{seed}", request, seed=seed)
    >>> tumble.fleet("sessions/*", "results", serial=True).tally.accepted
    2
    """
    found = sessions_of(str(sessions))
    with executor_for(serial=serial, cluster=cluster, workers=workers) as executor:
        rows = run_fleet(found, Path(out), method=method, executor=executor, progress=progress)
    return FleetResult(rows=rows, sessions=tuple(found), tally=tally(rows))
