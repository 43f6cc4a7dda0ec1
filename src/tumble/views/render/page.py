"""A document as one page of HTML that needs nothing else: no script, no font, no other file."""

from __future__ import annotations

import re

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tumble.views.blocks import Document
from tumble.views.render.characters import printed, visible


def page(document: Document) -> str:
    """The HTML of a document. All text is escaped; only the figures, which hold no text, are markup."""
    environment = Environment(
        loader=PackageLoader("tumble.views.render"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["inline"] = _inline
    environment.filters["css"] = _css
    return environment.get_template("page.html").render(document=printed(document, visible)) + "\n"


def _css(text: str) -> Markup:
    """A text in a string of CSS: every character by its code, so that none can end the string."""
    return Markup("".join(f"\\{ord(character):06x}" for character in text))


def _inline(svg: str) -> Markup:
    """A figure as part of a page, where SVG needs no name spaces."""
    return Markup(re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace(" xlink:href=", " href="))
