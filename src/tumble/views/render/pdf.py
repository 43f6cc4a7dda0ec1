"""A report as PDF/A-2b on A4, set by typst from the same content: what comes from files is data to the template, never
markup. Fonts are those that typst and matplotlib bring along, so that a report is the same bytes on every machine.
"""

from __future__ import annotations

import base64
import json
from datetime import datetime
from importlib.resources import files

import typst
from matplotlib import get_data_path

from tumble.views.blocks import Document
from tumble.views.render.characters import drawable, printed


def pdf(document: Document) -> bytes:
    """The PDF of a report. Its date is that of the calibration."""
    content = printed(document, drawable)
    if content["letterhead"] is not None:
        content["letterhead"]["logo"] = list(base64.b64decode(content["letterhead"]["logo"]))
    template = files("tumble.views.render").joinpath("templates/document.typ").read_bytes()
    return set_in_type(template, json.dumps(content), timestamp=_timestamp(document.created))


def set_in_type(template: bytes, content: str, *, timestamp: int) -> bytes:
    """The PDF/A-2b that a template makes of `content`, as JSON, with a date in seconds since 1970."""
    fonts = typst.Fonts(include_system_fonts=False, font_paths=[f"{get_data_path()}/fonts/ttf"])
    compiler = typst.Compiler(template, font_paths=fonts, sys_inputs={"document": content})
    made = compiler.compile(format="pdf", pdf_standards=["a-2b"], timestamp=timestamp)
    assert isinstance(made, bytes)
    return made


def _timestamp(created: str) -> int:
    """Seconds since 1970 of a time in ISO 8601; 0 for what is none."""
    try:
        return int(datetime.fromisoformat(created).timestamp())
    except ValueError:
        return 0
