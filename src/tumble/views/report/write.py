"""From calibration files to a report file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.errors import InputError, needs_extra
from tumble.files import FilePath, ending_in, whole_file
from tumble.result.calibration import Calibration, calibration_of, read_calibration, text_and_name

if TYPE_CHECKING:
    from tumble.views.report.document import ReportedFile

ENDINGS = (".html", ".pdf")


def write_report(
    calibrations: Calibration | FilePath | Sequence[Calibration | FilePath],
    out: FilePath,
    *,
    limits: FilePath | None = None,
    certificate: FilePath | None = None,
) -> list[str]:
    """Write the report of a calibration, in memory or a file, or of several of one device, to `out`, HTML or PDF by
    its ending, and return why it is not accepted: the reasons of the calibrations, and what is not within the
    acceptance limits of the file `limits`. With the file `certificate` it is the certificate of one calibration, whose
    limits that file names.

    Raises InputError for files that cannot be used, MissingExtraError without the extra `tumble[lab]`.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.write_report("calibration.json", "report.html")
    []
    """
    given = [calibrations] if isinstance(calibrations, Calibration | str | os.PathLike) else calibrations
    out = Path(out)
    ending = ending_in(out, *ENDINGS)
    from tumble.lab.certificate import judged_by, read_certificate
    from tumble.lab.limits import limits_of

    stated = None if certificate is None else read_certificate(Path(certificate))
    acceptance = None if stated is None else judged_by(stated)
    if limits is not None:
        acceptance = limits_of(Path(limits))
    as_found = None if stated is None or stated.as_found is None else read_calibration(stated.as_found)
    with needs_extra("a report", "lab", "jinja2", "matplotlib", "typst"):
        from tumble.views.render.pages import written
        from tumble.views.report.document import as_certified, document, not_accepted

        sources = list(map(_source, given))
        sources = sources if stated is None else [as_certified(source, stated) for source in sources]
        content = written(document(sources, acceptance, stated, as_found), ending)
    try:
        with whole_file(out) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error
    return not_accepted(sources, acceptance)


def _source(given: Calibration | FilePath) -> ReportedFile:
    """A calibration with the name of its file and the SHA-256 of the bytes that are there."""
    from tumble.views.report.document import ReportedFile

    text, name = text_and_name(given)
    content = text.encode() if isinstance(given, Calibration) else Path(given).read_bytes()
    file = name if isinstance(given, Calibration) else Path(given).name
    return ReportedFile(file=file, sha256=hashlib.sha256(content).hexdigest(), calibration=calibration_of(text, name))
