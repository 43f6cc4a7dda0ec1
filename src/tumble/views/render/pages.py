"""A document as a page of HTML, and as PDF/A-2b.

The page needs nothing else: no script, no font, no other file; styles for print are in it. The PDF, of certificates, is
set by typst from the same content, with the fonts of typst and matplotlib, so that it is the same bytes on every
machine. What comes from files is data to the templates, never markup.
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
    """The HTML of a document. All text is escaped, in CSS by the code of every character, so that none can end a
    string; only the figures, which hold no text, are markup, of which a page needs no name spaces."""
    environment = Environment(
        loader=PackageLoader("tumble.views.render"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["inline"] = lambda svg: Markup(
        re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace(" xlink:href=", " href=")
    )
    environment.filters["css"] = lambda text: Markup("".join(f"\\{ord(character):06x}" for character in text))
    return environment.get_template("page.html").render(document=printed(document, visible)) + "\n"


def pdf(document: Document) -> bytes:
    """The PDF of a document. Its date is that of the calibration; 1970 where that has none."""
    content = printed(document, drawable)
    if content["letterhead"] is not None:
        content["letterhead"]["logo"] = list(base64.b64decode(content["letterhead"]["logo"]))
    timestamp = 0
    with suppress(ValueError):
        timestamp = int(datetime.fromisoformat(document.created).timestamp())
    return set_in_type("document.typ", json.dumps(content), timestamp=timestamp)


def set_in_type(template: str, content: str, *, timestamp: int) -> bytes:
    """The PDF/A-2b that a template makes of `content`, as JSON, with a date in seconds since 1970."""
    with needs_extra("a PDF", "lab", "matplotlib", "typst"):
        import typst
        from matplotlib import get_data_path
    fonts = typst.Fonts(include_system_fonts=False, font_paths=[f"{get_data_path()}/fonts/ttf"])
    source = files("tumble.views.render").joinpath(f"templates/{template}").read_bytes()
    compiler = typst.Compiler(source, font_paths=fonts, sys_inputs={"document": content})
    document = compiler.compile(format="pdf", pdf_standards=["a-2b"], timestamp=timestamp)
    assert isinstance(document, bytes)
    return document
