"""From calibration files to a report file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from tumble.calibration.calibration_file import read_calibration
from tumble.errors import InputError, needs_extra
from tumble.files import FilePath, whole_file

ENDINGS = (".html", ".pdf")


def write_report(
    calibrations: FilePath | Sequence[FilePath],
    out: FilePath,
    *,
    limits: FilePath | None = None,
    certificate: FilePath | None = None,
) -> list[str]:
    """Write the report of a calibration file, or of several of one device, to `out`, HTML or PDF by its ending, and
    return why it is not accepted: the reasons of the calibrations, and what is not within the acceptance limits of the
    file `limits`. With the file `certificate` it is the certificate of one calibration, whose limits that file names.

    Raises InputError for files that cannot be used, MissingExtraError without the extra `tumble[report]`.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.write_report("calibration.json", "report.html")
    []
    """
    files = [calibrations] if isinstance(calibrations, str | os.PathLike) else calibrations
    out = Path(out)
    ending = out.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{out}: expected a name that ends in .html or .pdf, found {out.suffix or 'no ending'!r}")
    with needs_extra("a report", "report", "jinja2", "matplotlib", "typst"):
        from tumble.report.content import Source, document, not_accepted
        from tumble.report.page import page
        from tumble.report.pdf import pdf
    from tumble.export.certificate import read_certificate
    from tumble.registry.limits import limits_of

    stated = None if certificate is None else read_certificate(Path(certificate))
    if limits is None and stated is not None:
        limits = stated.limits
    acceptance = None if limits is None else limits_of(Path(limits))
    as_found = None if stated is None or stated.as_found is None else read_calibration(stated.as_found)
    sources = [
        Source(file=path.name, calibration=read_calibration(path), sha256=_sha256(path)) for path in map(Path, files)
    ]
    made = document(sources, acceptance, stated, as_found)
    content = page(made).encode() if ending == ".html" else pdf(made)
    try:
        with whole_file(out) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error
    return not_accepted(sources, acceptance)


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
