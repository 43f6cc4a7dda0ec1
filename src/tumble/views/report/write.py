"""From calibration files to the file of a report."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.arguments import checked
from tumble.errors import InputError
from tumble.files import FilePath, ending_in, whole_file
from tumble.result.calibration import Calibration, calibration_of, text_and_name

if TYPE_CHECKING:
    from tumble.views.blocks import Document
    from tumble.views.report.document import ReportedFile


@checked
def write_report(calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath) -> list[str]:
    """Write the report of a calibration, or of several of one device, as a page of HTML that prints well.

    Parameters
    ----------
    calibrations
        A calibration or its file, or several of one device.
    out
        The file to write: .html. To have a PDF print the page.

    Returns
    -------
    list of str
        Why a calibration is not accepted.

    Raises
    ------
    InputError
        For files that cannot be used.
    MissingExtraError
        Without the extra `tumble[lab]`.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.write_report("calibration.json", "report.html")
    []
    """
    if Path(out).suffix.lower() == ".pdf":
        raise InputError(
            f"{out}: expected a file that ends in .html, found '.pdf'; print the page for a PDF (of a certificate, "
            "--certificate, there is one)"
        )
    ending_in(Path(out), ".html")
    sources = sources_of(calibrations)
    from tumble.views.report.document import reasons_of, report_of

    write_document(report_of(sources), out)
    return reasons_of(sources)


def sources_of(calibrations: Calibration | FilePath | Sequence[Calibration | FilePath]) -> list[ReportedFile]:
    """Calibrations with the names of their files and the SHA-256 of what is in them."""
    from tumble.views.report.document import ReportedFile

    listed = [calibrations] if isinstance(calibrations, Calibration | str | os.PathLike) else calibrations
    sources = []
    for each in listed:
        text, name = text_and_name(each)
        content = text.encode() if isinstance(each, Calibration) else Path(each).read_bytes()
        file, digest = name if isinstance(each, Calibration) else Path(each).name, hashlib.sha256(content).hexdigest()
        sources.append(ReportedFile(file=file, sha256=digest, calibration=calibration_of(text, name)))
    return sources


def write_document(document: Document, out: FilePath) -> None:
    """Write a document as HTML or PDF by the ending of `out`. Raises InputError where it cannot be written, and
    MissingExtraError without the extra `tumble[lab]`."""
    out = Path(out)
    from tumble.views.render.pages import page, pdf

    content = page(document).encode() if out.suffix.lower() == ".html" else pdf(document)
    try:
        with whole_file(out) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error
