"""What the site needs beyond Sphinx and its extensions: formulas without a script, and pages made from the program.

Formulas become MathML by the converter of docutils, which every browser of today shows without a script or a font.

The directive `made` puts a table or a section where it stands that is made when the site is built, from the program
itself or from stored results (`docs/made.py`), so that it cannot be out of date:

    ```{made} commands
    ```

The directive `public` describes public names of the library from their docstrings:

    ```{public} calibrate read_calibration
    ```

where `*` is all names that the page does not have elsewhere.

When the site is built, `checked` looks at the pages themselves: no raw table, nothing loaded from elsewhere, every
public name described.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

logger = logging.getLogger(__name__)
TAG = re.compile(r"\s*\\tag\{([^}]*)\}")
ACCENT = re.compile(
    r"<munderover>(\s*<m[a-z]+>[^<]*</m[a-z]+>)(\s*<m.*?)(\s*<mo stretchy=\"false\">[^<]*</mo>)\s*</munderover>", re.S
)
"""An accent with an index, which docutils writes below the letter."""


class Made(SphinxDirective):
    """Text in Markdown by a function of `made`, with its words as arguments."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        import made

        name, *words = self.arguments[0].split()
        return self.parse_text_to_nodes(getattr(made, name)(*words), allow_section_headings=True)


class Public(SphinxDirective):
    """Public names of the library, each with its signature and docstring."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = False
    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        import tumble

        lines, names = [], self.arguments[0].split()
        if names == ["*"]:
            source = Path(self.env.doc2path(self.env.docname)).read_text(encoding="utf-8")
            named = set(" ".join(re.findall(r"^```\{public\} (.*)$", source, re.M)).split())
            names = sorted(set(tumble.__all__) - named - {"__version__"})
        for name in names:
            if name not in tumble.__all__:
                raise self.error(f"{name} is no public name of tumble")
            item = getattr(tumble, name)
            kind = "exception" if inspect.isclass(item) and issubclass(item, BaseException) else "class"
            lines.append(f".. auto{kind if inspect.isclass(item) else 'function'}:: tumble.{name}")
            data = inspect.isclass(item) and any(base.__name__ == f"{name}Data" for base in item.__bases__)
            inherited = ["   :inherited-members: Mapping"] if data else []  # of a class that adds to its own data
            lines += ["   :members:", *inherited, ""] if inspect.isclass(item) else [""]
        text = "```{eval-rst}\n" + "\n".join(lines) + "\n```\n"
        return self.parse_text_to_nodes(text)


def mathml(source: str, *, block: bool) -> str:
    """A formula as MathML; of a block with a \\tag{n} the number stands at the right."""
    numbers = TAG.findall(source)
    markup = tex2mathml(TAG.sub("", source).strip(), as_block=block)
    markup = ACCENT.sub(r"<msub><mover>\1\3</mover>\2</msub>", markup)
    number = f'<span class="number">({numbers[0]})</span>' if numbers else ""
    anchor = f' id="eq-{numbers[0]}"' if numbers else ""
    return f'<div class="formula"{anchor}><div>{markup}</div>{number}</div>\n' if block else markup


def visit_inline(self: Any, node: nodes.math) -> None:
    """Write an inline formula."""
    self.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def visit_block(self: Any, node: nodes.math_block) -> None:
    """Write a formula in a line of its own."""
    self.body.append(mathml(node.astext(), block=True))
    raise nodes.SkipNode


def moduli(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Leave vertical bars of a docstring alone: they are moduli, no substitutions."""
    del app, what, name, obj, options
    example = False
    for i, line in enumerate(lines):
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if not example:
            lines[i] = re.sub(r"(?<!`)\|(?!`)", r"\\|", line)


def shortened(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> Any:
    """Leave out the signature of data classes: their fields are listed below."""
    del app, name, options
    if what == "class" and is_dataclass(obj):
        return "", None
    return signature, returned


RAW = re.compile(r"\|\s*:?[-–—]+:?\s*\||^(?:[ \t]|<\w+>)*\|.*\|(?:[ \t]|</\w+>)*$|&lt;!-- ", re.M)
"""What a built page has where a table or a comment of its source was not understood (dashes become long ones)."""
LOADED = re.compile(r"""<(?:script|img|iframe|link)\b[^>]*?(?:src|href)=["']?(?:https?:)?//""")


def checked(app: Sphinx, exception: Exception | None) -> None:
    """Fail if a built page has a raw table, loads something from elsewhere, or lacks a public name."""
    if exception is not None or app.builder.name != "html":
        return
    import tumble

    faults = []
    for path in sorted(Path(app.outdir).rglob("*.html")):
        text = path.read_text(encoding="utf-8")
        shown = re.sub(r"<(pre|code)\b.*?</\1>|<!--.*?-->", "", text, flags=re.S)
        faults += [f"{path.name}: raw text {found[0]!r}" for found in RAW.finditer(shown)]
        faults += [f"{path.name}: loaded from elsewhere, {found[0]!r}" for found in LOADED.finditer(text)]
    described = (Path(app.outdir) / "reference/api.html").read_text(encoding="utf-8")
    names = sorted(set(tumble.__all__) - {"__version__"})
    faults += [f"api.html: {name} is not described" for name in names if f'id="tumble.{name}"' not in described]
    for fault in faults:
        logger.error(fault)
    app.statuscode = app.statuscode or int(bool(faults))


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register all of it."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.config.html_math_renderer = "mathml"
    app.connect("autodoc-process-docstring", moduli, priority=1000)
    app.connect("autodoc-process-signature", shortened)
    app.connect("build-finished", checked)
    app.add_directive("made", Made)
    app.add_directive("public", Public)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
