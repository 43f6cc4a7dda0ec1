"""Documents as pages of HTML, and as PDF/A-2b.

A page needs no other file: no script, no font; styles for print are included. PDFs, for certificates, are set by typst
with the fonts of typst and matplotlib, so that they have the same bytes on every machine. Content that comes from files
is data to the templates, never markup.
"""

from __future__ import annotations

import base64
import json
import re
from contextlib import suppress
from datetime import datetime
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tumble.errors import needs_extra
from tumble.views.blocks import Document
from tumble.views.render.characters import drawable, printed, visible


def page(document: Document) -> str:
    """Return the HTML of a document. All text is escaped, in CSS every character by its code; only figures are markup,
    without text and name spaces."""
    environment = escaping_environment("tumble.views.render")
    environment.filters["inline"] = lambda svg: Markup(
        re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace(" xlink:href=", " href=")
    )
    environment.filters["css"] = lambda text: Markup("".join(f"\\{ord(character):06x}" for character in text))
    return environment.get_template("page.html").render(document=printed(document, visible)) + "\n"


def escaping_environment(package: str) -> Environment:
    """Return a Jinja environment for the templates of a package, which escapes all text."""
    return Environment(
        loader=PackageLoader(package), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


def pdf(document: Document) -> bytes:
    """Return the PDF of a document, dated by its calibration, or 1970 without a date."""
    content = printed(document, drawable)
    if content["letterhead"] is not None:
        content["letterhead"]["logo"] = list(base64.b64decode(content["letterhead"]["logo"]))
    timestamp = 0
    with suppress(ValueError):
        timestamp = int(datetime.fromisoformat(document.created).timestamp())
    return set_in_type("document.typ", json.dumps(content), timestamp=timestamp)


def set_in_type(template: str, content: str, *, timestamp: int) -> bytes:
    """Return the PDF/A-2b of a template with `content` as JSON, dated in seconds since 1970."""
    with needs_extra("a PDF", "lab", "matplotlib", "typst"):
        import typst
        from matplotlib import get_data_path
    fonts = typst.Fonts(include_system_fonts=False, font_paths=[f"{get_data_path()}/fonts/ttf"])
    source = files("tumble.views.render").joinpath(f"templates/{template}").read_bytes()
    compiler = typst.Compiler(source, font_paths=fonts, sys_inputs={"document": content})
    document = compiler.compile(format="pdf", pdf_standards=["a-2b"], timestamp=timestamp)
    assert isinstance(document, bytes)
    return document
